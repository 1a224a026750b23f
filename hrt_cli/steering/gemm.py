"""A 3 x 3 convolution as one product of matrices, for maps of a few pixels under many channels.

There the convolutions of oneDNN are bound by their weights, above all backwards. The patches of all pictures of a batch
as one matrix make a product that is not.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

_LEAST_CHANNELS, _MOST_PIXELS = 512, 4096
"""It is used from so many channels up, for as many pixels of a whole batch at most: patches take much room."""


class Conv3x3(nn.Conv2d):
    """A 3 x 3 convolution without bias that a margin of zeros keeps the size of, or halves it at stride 2.

    The same as PyTorch's but for rounding, and with its parameter.

    Parameters
    ----------
    inputs, outputs : int
        Channels.
    stride : int
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(inputs, outputs, 3, stride, 1, bias=False)

    def forward(self, input: Tensor) -> Tensor:
        """Return features, float [n, outputs, ceil(h / stride), ceil(w / stride)]."""
        if self.training and self._is_small(input):
            made: Tensor = _Product.apply(input, self.weight, self.stride[0])  # type: ignore[no-untyped-call]
            return made
        return super().forward(input)

    def _is_small(self, x: Tensor) -> bool:
        stride = self.stride[0]
        pixels = x.shape[0] * -(-x.shape[2] // stride) * -(-x.shape[3] // stride)
        plain = x.device.type == "cpu" and x.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")
        return plain and self.out_channels >= _LEAST_CHANNELS and pixels <= _MOST_PIXELS


class _Product(torch.autograd.Function):
    """Patches, [n h w, 9 inputs], times weights, [9 inputs, outputs]: channels last throughout."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, stride: int) -> Tensor:
        n, channels, height, width = x.shape
        rows, cols = -(-height // stride), -(-width // stride)
        padded = nn.functional.pad(x.permute(0, 2, 3, 1), (0, 0, 1, 1, 1, 1)).contiguous()
        picture, row, col, _ = padded.stride()
        strides = (picture, row * stride, col * stride, row, col, 1)
        patches = padded.as_strided((n, rows, cols, 3, 3, channels), strides).reshape(n * rows * cols, 9 * channels)
        ctx.save_for_backward(patches, weight)
        ctx.shape, ctx.stride = (n, channels, height, width, rows, cols), stride
        return (patches @ _flat(weight).t()).view(n, rows, cols, -1).permute(0, 3, 1, 2)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        patches, weight = ctx.saved_tensors
        (n, channels, height, width, rows, cols), stride = ctx.shape, ctx.stride
        grad = grads[0].permute(0, 2, 3, 1).reshape(n * rows * cols, -1)
        of_weight = (grad.t() @ patches).view(-1, 3, 3, channels).permute(0, 3, 1, 2)
        of_patches = (grad @ _flat(weight)).view(n, rows, cols, 3, 3, channels)
        padded = grad.new_zeros(n, height + 2, width + 2, channels)
        for i in range(3):
            for j in range(3):
                down, right = (
                    slice(i, i + stride * (rows - 1) + 1, stride),
                    slice(j, j + stride * (cols - 1) + 1, stride),
                )
                padded[:, down, right] += of_patches[:, :, :, i, j]
        return padded[:, 1:-1, 1:-1].permute(0, 3, 1, 2), of_weight, None


def _flat(weight: Tensor) -> Tensor:
    """Return weights as a matrix, [outputs, 9 inputs]: no copy where they lie channels last."""
    return weight.permute(0, 2, 3, 1).reshape(weight.shape[0], -1)
