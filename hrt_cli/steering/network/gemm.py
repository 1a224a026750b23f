"""A 3 x 3 convolution by products of matrices, for maps of a few pixels under many channels.

There the convolutions of oneDNN are bound by their weights, above all backwards. The patches of all pictures of a batch
as one matrix make a product that is not; in bfloat16, too (which autocast asks for).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

_MOST_PIXELS = 4096
"""Of a whole batch: patches take much room."""
_ALL, _WEIGHTS = 512, 128
"""From so many channels up all of it is a product; from so many up only the gradient of the weights is."""


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
        if not (self.training and self._is_small(input)):
            return super().forward(input)
        kind = _Product if self.out_channels >= _ALL else _WeightProduct
        lowered = torch.get_autocast_dtype("cpu") if torch.is_autocast_enabled("cpu") else torch.float32
        with torch.autocast("cpu", enabled=False):
            made: Tensor = kind.apply(  # type: ignore[no-untyped-call]
                input.to(lowered), self.weight.to(lowered), self.stride[0]
            )
        return made

    def _is_small(self, x: Tensor) -> bool:
        stride = self.stride[0]
        pixels = x.shape[0] * -(-x.shape[2] // stride) * -(-x.shape[3] // stride)
        on_cpu = x.device.type == "cpu" and x.dtype in (torch.float32, torch.bfloat16)
        return on_cpu and self.out_channels >= _WEIGHTS and pixels <= _MOST_PIXELS


class _Product(torch.autograd.Function):
    """Patches, [n h w, taps inputs], times weights, [taps inputs, outputs]: channels last throughout."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, stride: int) -> Tensor:
        seen = _Taps.of(x, stride)
        patches = seen.patches(x)
        ctx.save_for_backward(patches, weight)
        ctx.seen = seen
        return (patches @ seen.flat(weight).t()).view(x.shape[0], seen.rows, seen.cols, -1).permute(0, 3, 1, 2)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        patches, weight = ctx.saved_tensors
        seen: _Taps = ctx.seen
        grad = _pixels(grads[0])
        of_patches = grad @ seen.flat(weight)
        return seen.unpatched(of_patches, weight.shape[1]), seen.unflat(grad.t() @ patches, weight), None


class _WeightProduct(torch.autograd.Function):
    """oneDNN's convolution; its weights' gradient is the product of patches and the outputs' gradient."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.stride = stride
        return nn.functional.conv2d(x, weight, stride=stride, padding=1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        x, weight = ctx.saved_tensors
        step, margin = [ctx.stride, ctx.stride], [1, 1]
        of_x, _, _ = torch.ops.aten.convolution_backward(
            grads[0], x, weight, None, step, margin, [1, 1], False, [0, 0], 1, [True, False, False]
        )
        seen = _Taps.of(x, ctx.stride)
        return of_x, seen.unflat(_pixels(grads[0]).t() @ seen.patches(x), weight), None


@dataclass(frozen=True)
class _Taps:
    """Which of a kernel's 3 x 3 taps ever meet a map: on one of a single row, two in three meet its margin alone.

    Attributes
    ----------
    height, width : int
        Of the map that comes in.
    rows, cols : int
        Of what goes out.
    stride : int
    down, right : (int, int)
        The first tap that meets it, and that after the last.
    """

    height: int
    width: int
    rows: int
    cols: int
    stride: int
    down: tuple[int, int]
    right: tuple[int, int]

    @classmethod
    def of(cls, x: Tensor, stride: int) -> _Taps:
        height, width = x.shape[2:]
        rows, cols = -(-height // stride), -(-width // stride)
        down, right = ((0 if out > 1 else 1, 3 if size > 1 else 2) for out, size in ((rows, height), (cols, width)))
        return cls(height, width, rows, cols, stride, down, right)

    def patches(self, x: Tensor) -> Tensor:
        """Return what each pixel that goes out is made of, float [n rows cols, taps inputs]."""
        n, channels = x.shape[:2]
        padded = nn.functional.pad(x.permute(0, 2, 3, 1), (0, 0, 1, 1, 1, 1)).contiguous()
        picture, row, col, _ = padded.stride()
        shape = n, self.rows, self.cols, self.down[1] - self.down[0], self.right[1] - self.right[0], channels
        strides = picture, row * self.stride, col * self.stride, row, col, 1
        first = self.down[0] * row + self.right[0] * col
        return padded.as_strided(shape, strides, first).reshape(n * self.rows * self.cols, -1)

    def unpatched(self, patches: Tensor, channels: int) -> Tensor:
        """Return the sum of what patches hold of each pixel that came in, float [n, inputs, height, width]."""
        taps = self.down[1] - self.down[0], self.right[1] - self.right[0]
        taken = patches.view(-1, self.rows, self.cols, *taps, channels)
        padded = patches.new_zeros(taken.shape[0], self.height + 2, self.width + 2, channels)
        down, right = (self.stride * (size - 1) + 1 for size in (self.rows, self.cols))
        for i in range(*self.down):
            for j in range(*self.right):
                part = padded[:, i : i + down : self.stride, j : j + right : self.stride]
                part += taken[:, :, :, i - self.down[0], j - self.right[0]]
        return padded[:, 1:-1, 1:-1].permute(0, 3, 1, 2)

    def flat(self, weight: Tensor) -> Tensor:
        """Return the weights of these taps, [outputs, taps inputs]: no copy of all where they lie channels last."""
        taken = weight.permute(0, 2, 3, 1)[:, slice(*self.down), slice(*self.right)]
        return taken.reshape(weight.shape[0], -1)

    def unflat(self, flat: Tensor, weight: Tensor) -> Tensor:
        """Return a gradient of these taps as one of all the weights: 0 for the others."""
        outputs, inputs = weight.shape[:2]
        if flat.shape[1] == 9 * inputs:
            return flat.view(outputs, 3, 3, inputs).permute(0, 3, 1, 2)
        whole = flat.new_zeros(outputs, 3, 3, inputs)
        taken = whole[:, slice(*self.down), slice(*self.right)]
        taken.copy_(flat.view(taken.shape))
        return whole.permute(0, 3, 1, 2)


def _pixels(x: Tensor) -> Tensor:
    """Return a map as a matrix, [n rows cols, channels]."""
    return x.permute(0, 2, 3, 1).reshape(-1, x.shape[1])
