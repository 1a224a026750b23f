"""A trunk a thousandth of ResNet-18's size, so that a test trains in a moment and its files are small."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hrt_cli.steering.network.resnet import FEATURES


class TinyTrunk(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 12, 5, 4, 2, bias=False)
        self.bn1 = nn.BatchNorm2d(12)
        self.layer4 = nn.Conv2d(12, FEATURES, 1)

    def forward(self, x: Tensor, dropout: nn.Module | None = None) -> Tensor:
        seen: Tensor = self.layer4(self.to_layer3(x))
        return seen

    def to_layer3(self, x: Tensor) -> Tensor:
        return torch.relu(self.bn1(self.conv1(x)))
