"""ResNet-18 (He, Zhang, Ren and Sun 2016, arXiv:1512.03385) without its classifier, with torchvision's names.

Our own, because torchvision is a large dependency for sixty lines; `load_published` takes the file that torchvision
publishes as `resnet18`.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from hrt_cli.errors import InputError
from hrt_cli.steering.network.gemm import Conv3x3

FEATURES = 512
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""What torchvision's weights expect of pixels in [0, 1]."""


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = Conv3x3(inputs, outputs, stride)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = Conv3x3(outputs, outputs)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or inputs != outputs:
            shortcut = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor, dropout: nn.Module | None = None) -> Tensor:
        """Return features, float [n, outputs, h / stride, w / stride]; `dropout` goes before the second convolution."""
        shortcut = x if self.downsample is None else self.downsample(x)
        y = self.relu(self.bn1(self.conv1(x)))
        if dropout is not None:
            y = dropout(y)
        y = self.bn2(self.conv2(y))
        return torch.relu_(y + shortcut)


class ResNet18(nn.Module):
    """From pictures [n, 3, h, w] to features [n, 512, ceil(h / 32), ceil(w / 32)]."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = nn.Sequential(BasicBlock(64, 64, 1), BasicBlock(64, 64, 1))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128, 1))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2), BasicBlock(256, 256, 1))
        self.layer4 = nn.Sequential(BasicBlock(256, FEATURES, 2), BasicBlock(FEATURES, FEATURES, 1))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
            if isinstance(module, BasicBlock):
                # Each block begins as its shortcut, and a training of few steps goes faster (Goyal et al. 2017,
                # arXiv:1706.02677, 5.1).
                nn.init.zeros_(module.bn2.weight)

    def forward(self, x: Tensor, dropout: nn.Module | None = None) -> Tensor:
        """See the class; `dropout` goes before the last convolution."""
        return self.end(self.layer4[0](self.to_layer3(x)), dropout)

    def to_layer3(self, x: Tensor) -> Tensor:
        """Return what the last but one stage gives, float [n, 256, ceil(h / 16), ceil(w / 16)]."""
        x = self.maxpool(self.relu(self.bn1(self.conv1(x))))
        seen: Tensor = self.layer3(self.layer2(self.layer1(x)))
        return seen

    def end(self, x: Tensor, dropout: nn.Module | None = None) -> Tensor:
        """Return features from what the first block of the last stage gives: all that `dropout` changes."""
        last: nn.Module = self.layer4[1]
        features: Tensor = last(x, dropout)
        return features


def load_published(trunk: ResNet18, path: Path) -> None:
    """Load the weights of torchvision's `resnet18` into a trunk; its classifier is left out.

    Parameters
    ----------
    path : Path
        A state dict as `torch.save` writes it. It is read with `weights_only=True`: code in it never runs.

    Raises
    ------
    InputError
        It is not that, or its names, shapes or values are not those of a ResNet-18.
    """
    found = _tensors(path)
    wanted = {name: tensor.shape for name, tensor in trunk.state_dict().items()}
    wanted |= {"fc.weight": torch.Size((1000, FEATURES)), "fc.bias": torch.Size((1000,))}
    # Files from before PyTorch 0.4.1 do not count batches.
    uncounted = {name for name in wanted if name.endswith("num_batches_tracked")} - set(found)
    for name in sorted((set(wanted) - uncounted) ^ set(found)):
        problem = "lacks" if name in wanted else "holds the unknown"
        raise InputError(path, f"is not torchvision's resnet18: {problem} {name!r}")
    for name, tensor in found.items():
        if tensor.shape != wanted[name]:
            shape, right = tuple(tensor.shape), tuple(wanted[name])
            raise InputError(path, f"is not torchvision's resnet18: {name!r} is {shape}, not {right}")
        if not torch.isfinite(tensor).all():
            raise InputError(path, f"{name!r} holds values that are not finite")
    own = trunk.state_dict()
    trunk.load_state_dict(own | {name: tensor.to(own[name].dtype) for name, tensor in found.items() if name in own})


def _tensors(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        with warnings.catch_warnings(action="ignore"):  # PyTorch muses about the pickles of others
            found = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InputError(path, "is not a file of weights alone, and nothing else is read from it") from error
    except Exception as error:  # in a damaged file the unpickler stumbles over anything
        raise InputError(path, "is no file of weights that PyTorch wrote, or a damaged one") from error
    if not isinstance(found, Mapping) or not all(
        isinstance(name, str) and isinstance(tensor, Tensor) for name, tensor in found.items()
    ):
        raise InputError(path, "is not a state dict: names of parameters with their tensors")
    return dict(found)
