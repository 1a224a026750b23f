"""Concrete Dropout, against the formulas of its authors written out anew, its limits, and values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.steering.network.dropout import ConcreteDropout, dropped


def by_the_authors(x: np.ndarray, p: float, noise: np.ndarray, temperature: float) -> np.ndarray:
    """As in yaringal/ConcreteDropout, in float64."""
    eps = 1e-7
    drop = np.log(p + eps) - np.log(1.0 - p + eps) + np.log(noise + eps) - np.log(1.0 - noise + eps)
    keep = 1.0 - 1.0 / (1.0 + np.exp(-drop / temperature))
    return x * keep / (1.0 - p)


@given(st.floats(0.01, 0.9), st.sampled_from([0.1, 2 / 3]), st.integers(0, 1000))
def test_the_mask_is_that_of_the_authors(p: float, temperature: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, noise = rng.normal(size=(4, 6)), rng.uniform(0.001, 0.999, (4, 6))
    found = dropped(torch.from_numpy(x), torch.tensor(p, dtype=torch.float64), torch.from_numpy(noise), temperature)
    np.testing.assert_allclose(found, by_the_authors(x, p, noise, temperature), atol=1e-9)


def test_a_mask_by_hand() -> None:
    # logit 0.2 + logit 0.8 = 0: half of it is dropped, and the rest scaled by 1 / (1 - p).
    found = dropped(torch.tensor([2.0]), torch.tensor(0.2), torch.tensor([0.8]), 0.1)
    assert float(found) == pytest.approx(2.0 * 0.5 / 0.8, rel=1e-5)
    # logit 0.5 + logit u = ln 3; at t = 1/2 the mask is sigmoid(2 ln 3) = 9/10.
    found = dropped(torch.tensor([1.0]), torch.tensor(0.5), torch.tensor([0.75]), 0.5)
    assert float(found) == pytest.approx(0.1 / 0.5, rel=1e-4)


def test_large_noise_drops_and_small_noise_keeps() -> None:
    kept, gone = dropped(torch.ones(2), torch.tensor(0.3), torch.tensor([0.05, 0.99]), 0.1)
    assert float(kept) == pytest.approx(1 / 0.7, rel=1e-4)
    assert float(gone) == pytest.approx(0.0, abs=1e-6)


def test_nothing_is_dropped_as_p_goes_to_zero() -> None:
    x = torch.randn(50, 20)
    layer = ConcreteDropout(20, p=1e-6).train()
    torch.testing.assert_close(layer(x), x, atol=2e-2, rtol=1e-2)


@pytest.mark.parametrize(("spatial", "temperature"), [(False, 0.1), (True, 2 / 3)])
def test_temperatures_of_the_paper(spatial: bool, temperature: float) -> None:
    assert ConcreteDropout(3, spatial=spatial).temperature == temperature


def test_the_layer_draws_its_mask_from_the_generator() -> None:
    x = torch.randn(3, 5)
    layer = ConcreteDropout(5, p=0.3).train()
    torch.manual_seed(4)
    found = layer(x)
    torch.manual_seed(4)
    np.testing.assert_allclose(
        found.detach(), by_the_authors(x.numpy(), 0.3, torch.rand(3, 5).double().numpy(), 0.1), atol=1e-4
    )


def test_it_is_the_probability_that_is_dropped() -> None:
    torch.manual_seed(0)
    layer = ConcreteDropout(1000, p=0.3).train()
    found = layer(torch.ones(100, 1000))
    assert float((found < 0.5 / 0.7).float().mean()) == pytest.approx(0.3, abs=0.01)
    assert float(layer.p) == pytest.approx(0.3)


def test_the_expectation_is_the_input() -> None:
    torch.manual_seed(0)
    x = torch.tensor([1.0, -2.0, 0.5])
    found = ConcreteDropout(3, p=0.4).train()(x.expand(20_000, 3)).mean(0)
    torch.testing.assert_close(found, x, atol=0.03, rtol=0.03)


def test_whole_channels_are_dropped() -> None:
    torch.manual_seed(0)
    found = ConcreteDropout(16, spatial=True, p=0.5).train()(torch.ones(4, 16, 3, 5))
    assert found.shape == (4, 16, 3, 5)
    assert torch.equal(found, found[:, :, :1, :1].expand_as(found))
    assert len(found[:, :, 0, 0].unique()) == 64


def test_inputs_pass_in_prediction_unless_sampling() -> None:
    x = torch.randn(3, 5)
    layer = ConcreteDropout(5, p=0.5).eval()
    assert layer(x) is x
    layer.sampling = True
    assert not torch.equal(layer(x), x)


def test_half_precision_is_computed_in_float32() -> None:
    layer = ConcreteDropout(5).train()
    with torch.autocast("cpu", torch.bfloat16):
        assert layer(torch.randn(3, 5, dtype=torch.bfloat16)).dtype == torch.float32


def test_the_penalty_by_hand() -> None:
    layer = ConcreteDropout(2, p=0.5)
    weights = [torch.tensor([[1.0, 2.0]]), torch.tensor([[3.0, 0.0]])]
    found = float(layer.penalty(weights, weight_decay=0.1, dropout_decay=0.01))
    assert found == pytest.approx(0.1 * 14.0 / 0.5 - 0.01 * 2 * math.log(2.0), rel=1e-5)


@pytest.mark.parametrize("p", [0.05, 0.3, 0.8])
def test_the_penalty_is_that_of_the_authors(p: float) -> None:
    weight = torch.randn(4, 7)
    found = float(ConcreteDropout(7, p=p).penalty([weight], weight_decay=0.02, dropout_decay=0.3))
    square = float((weight.double() ** 2).sum())
    assert found == pytest.approx(
        0.02 * square / (1 - p) + 0.3 * 7 * (p * math.log(p) + (1 - p) * math.log(1 - p)), rel=1e-4
    )


def test_gradients_reach_p_and_are_those_of_finite_differences() -> None:
    noise, x = torch.rand(6, 4, dtype=torch.float64) * 0.9 + 0.05, torch.randn(6, 4, dtype=torch.float64)

    def of(p: torch.Tensor) -> torch.Tensor:
        return (dropped(x, p, noise, 2 / 3) ** 2).sum()

    assert torch.autograd.gradcheck(of, torch.tensor(0.3, dtype=torch.float64, requires_grad=True))
    layer = ConcreteDropout(4).train()
    layer(torch.randn(6, 4)).square().sum().backward()
    assert layer.p_logit.grad is not None
    assert float(layer.p_logit.grad) != 0.0


def test_weights_pull_p_down_and_nothing_pulls_it_to_a_half() -> None:
    layer = ConcreteDropout(4, p=0.2)
    layer.penalty([torch.full((3, 4), 10.0)], weight_decay=1.0, dropout_decay=1e-6).backward()
    assert float(layer.p_logit.grad) > 0  # type: ignore[arg-type]
    layer.p_logit.grad = None
    layer.penalty([torch.zeros(3, 4)], weight_decay=1.0, dropout_decay=1.0).backward()
    assert float(layer.p_logit.grad) < 0  # type: ignore[arg-type]
