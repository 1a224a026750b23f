"""The convolution as a product of matrices, beside PyTorch's own."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from hrt_cli.steering.network.gemm import Conv3x3


@pytest.mark.parametrize("outputs", [128, 512])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize(("height", "width"), [(3, 5), (2, 2), (1, 1), (4, 7), (1, 2), (3, 1), (2, 4)])
def test_values_and_gradients_are_pytorchs(outputs: int, stride: int, height: int, width: int) -> None:
    torch.manual_seed(0)
    conv = Conv3x3(8, outputs, stride).train()
    x = torch.randn(3, 8, height, width, requires_grad=True)
    made = conv(x)
    assert "Product" in type(made.grad_fn).__name__
    right = nn.functional.conv2d(x, conv.weight, stride=stride, padding=1)
    torch.testing.assert_close(made, right, atol=1e-5, rtol=1e-5)
    grad = torch.randn_like(right)
    for found, wanted in zip(
        torch.autograd.grad(made, (x, conv.weight), grad),
        torch.autograd.grad(right, (x, conv.weight), grad),
        strict=True,
    ):
        torch.testing.assert_close(found, wanted, atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize(("outputs", "pixels", "training"), [(64, 4, True), (128, 4100, True), (512, 4, False)])
def test_elsewhere_it_is_pytorchs(outputs: int, pixels: int, training: bool) -> None:
    conv = Conv3x3(4, outputs).train(training)
    made = conv(torch.randn(1, 4, 1, pixels, requires_grad=True))
    assert "Product" not in type(made.grad_fn).__name__


@pytest.mark.parametrize("outputs", [128, 512])
@pytest.mark.parametrize("stride", [1, 2])
def test_under_autocast_it_computes_in_half_precision(outputs: int, stride: int) -> None:
    torch.manual_seed(0)
    conv, x = Conv3x3(8, outputs, stride).train(), torch.randn(3, 8, 3, 5, requires_grad=True)
    with torch.autocast("cpu", torch.bfloat16):
        made = conv(x)
        right = nn.functional.conv2d(x, conv.weight, stride=stride, padding=1)
    assert "Product" in type(made.grad_fn).__name__
    assert made.dtype == torch.bfloat16
    torch.testing.assert_close(made, right)
    grad = torch.randn_like(right)
    for found, wanted in zip(
        torch.autograd.grad(made, (x, conv.weight), grad),
        torch.autograd.grad(right, (x, conv.weight), grad),
        strict=True,
    ):
        assert found.dtype == torch.float32
        # Sums over many pixels, each rounded to 8 bits on its way.
        torch.testing.assert_close(found, wanted, rtol=0.02, atol=0.02 * float(wanted.abs().max()))


def test_the_parameter_has_pytorchs_name() -> None:
    assert list(Conv3x3(4, 512).state_dict()) == ["weight"]
