"""The steering network: a ResNet-18, Concrete Dropout, and for each output a distribution over the angles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from hrt_cli.artifacts.jsonio import Document
from hrt_cli.steering.network.dropout import ConcreteDropout
from hrt_cli.steering.network.loss import steering_loss
from hrt_cli.steering.network.resnet import FEATURES, ResNet18

Output = Literal["yaw", "pitch"]
Positive = Annotated[float, Field(gt=0)]

_HIDDEN = 128
"""Units in which what is seen and where to go meet."""
_BEARINGS = 24
"""Directions all round by which a bearing is told: 15 degrees apart."""
LOUDNESS = 8.0
"""Of a bearing: one input beside hundreds of what is seen is heard only if it is loud."""
SHARPNESS = math.log(2.0) / (1.0 - math.cos(math.pi / _BEARINGS))


class SteeringConfig(Document):
    """What a network is, and what it wants to see: with the weights, all that a prediction depends on.

    Attributes
    ----------
    outputs : ('yaw',) or ('yaw', 'pitch')
    half_classes : int
        M: each output has 2M + 1 classes, the angles -1, ..., 1.
    width, height : int
        Of the picture that the network sees, in pixels; larger ones are scaled down to it.
    crop_top : float
        Share of the picture cut off at the top before that.
    mean, std : 3 floats
        Of red, green and blue, for pixels in [0, 1].
    columns : int
        Into how many columns the features are averaged: 1 is ResNet's own average over the whole picture; more keep
        what is on the left apart from what is on the right.
    goal : bool
        Whether it is also told where to go: the bearing of a point ahead on the path, in the robot's frame.
    hfov_deg : float, optional
        Horizontal field of view of the lens through which it learnt to see, where that is known: through another,
        things lie elsewhere than they seem.
    mirrored : bool
        Whether it learnt from mirrored pictures, too, and so may be asked about the mirror image of one.
    spatial_dropout : bool
        Whether channels are dropped before the last convolution, too.
    temperature : dict of str to float
        By output, what logits are divided by (Guo et al. 2017, arXiv:1706.04599).
    """

    outputs: tuple[Output, ...] = ("yaw",)
    half_classes: int = Field(default=7, ge=1, le=127)
    width: int = Field(default=160, ge=32, le=2048)
    height: int = Field(default=120, ge=32, le=2048)
    crop_top: float = Field(default=0.0, ge=0.0, le=0.9)
    mean: tuple[float, float, float] = (0.5, 0.5, 0.5)
    std: tuple[Positive, Positive, Positive] = (0.25, 0.25, 0.25)
    columns: int = Field(default=1, ge=1, le=64)
    goal: bool = False
    hfov_deg: float | None = Field(default=None, gt=0.0, lt=180.0)
    mirrored: bool = False
    spatial_dropout: bool = False
    temperature: dict[Output, Positive] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _whole(self) -> SteeringConfig:
        if self.outputs not in (("yaw",), ("yaw", "pitch")):
            raise ValueError("outputs must be yaw, or yaw and pitch")
        if set(self.temperature) - set(self.outputs):
            raise ValueError("has a temperature of an output that it has not")
        return self

    @property
    def classes(self) -> int:
        """2M + 1."""
        return 2 * self.half_classes + 1


class SteeringNet(nn.Module):
    """From pictures (and goals) to logits.

    Parameters
    ----------
    config : SteeringConfig
    """

    def __init__(self, config: SteeringConfig) -> None:
        super().__init__()
        self.config = config
        self.trunk = ResNet18()
        self.spatial = ConcreteDropout(FEATURES, spatial=True) if config.spatial_dropout else None
        features = FEATURES * config.columns
        self.merge: nn.Module | None = None
        if config.goal:
            self.merge = nn.Sequential(nn.Linear(features + _BEARINGS, _HIDDEN), nn.ReLU(inplace=True))
            features = _HIDDEN + _BEARINGS
        self.dropout = ConcreteDropout(features)
        self.heads = nn.ModuleDict({name: nn.Linear(features, config.classes) for name in config.outputs})

    def features(self, pictures: Tensor, goal: Tensor | None = None) -> Tensor:
        """Return what the last layer sees, float [n, features]; see `forward`."""
        return self.gathered(self.trunk(pictures, self.spatial), goal)

    def gathered(self, seen: Tensor, goal: Tensor | None = None) -> Tensor:
        """Return `features` of what the trunk saw, float [n, 512, rows, cols]: a row for each picture and goal."""
        columns = nn.functional.adaptive_avg_pool2d(seen.float(), (1, self.config.columns)).flatten(1)
        if self.merge is None:
            return columns
        if goal is None:
            raise ValueError("this network must be told where to go")
        if goal.ndim == 2:
            columns, goal = columns.repeat_interleave(goal.shape[1], dim=0), goal.flatten()
        bearing = told(goal)
        # The head is told the bearing, too: to make for the goal is what it does where nothing is in the way.
        return torch.cat([self.merge(torch.cat([columns, bearing], dim=1)), bearing], dim=1)

    def logits(self, features: Tensor) -> dict[Output, Tensor]:
        """Return the logits of each output, float [n, 2M + 1], before temperature."""
        kept = self.dropout(features)
        return {name: self.heads[name](kept) for name in self.config.outputs}

    def forward(self, pictures: Tensor, goal: Tensor | None = None) -> dict[Output, Tensor]:
        """Return the logits of each output.

        Parameters
        ----------
        pictures : float [n, 3, height, width]
            As `pictures.prepare` makes them.
        goal : float [n] or [n, goals], optional
            Bearings of the goal in radians, right positive; needed where the configuration says so. With several for a
            picture there are n * goals rows of logits, those of a picture one after the other: to see is what takes
            time, to ask for other goals is not.
        """
        return self.logits(self.features(pictures, goal))

    def penalty(self, *, weight_decay: float, dropout_decay: float) -> Tensor:
        """Return L_reg: the regulariser of every Concrete Dropout here, a scalar."""
        heads = [parameter for name, parameter in self.heads.named_parameters() if name.endswith("weight")]
        total = self.dropout.penalty(heads, weight_decay=weight_decay, dropout_decay=dropout_decay)
        if self.spatial is not None:
            fed = [self.get_parameter("trunk.layer4.1.conv2.weight")]
            total = total + self.spatial.penalty(fed, weight_decay=weight_decay, dropout_decay=dropout_decay)
        return total

    def undecayed(self) -> set[str]:
        """Name the parameters that the optimiser must not decay: those of the regulariser, biases and norms."""
        held = {f"heads.{name}.weight" for name in self.config.outputs}
        if self.spatial is not None:
            held.add("trunk.layer4.1.conv2.weight")
        return held | {name for name, parameter in self.named_parameters() if parameter.ndim < 2}

    @contextmanager
    def sampling(self) -> Iterator[None]:
        """Draw dropout masks in prediction, too: Monte-Carlo dropout (Gal and Ghahramani 2016, arXiv:1506.02142)."""
        layers = [each for each in (self.dropout, self.spatial) if each is not None]
        for each in layers:
            each.sampling = True
        try:
            yield
        finally:
            for each in layers:
                each.sampling = False


def told(goal: Tensor) -> Tensor:
    """Return bearings as the network is told them, float [n, 24]: high near each of 24 directions, falling off to 0.

    8 exp(k (cos(goal - d) - 1)) for the directions d, with k so that it is half as high midway between two of them.

    Parameters
    ----------
    goal : float [n]
        Radians.
    """
    return LOUDNESS * torch.exp(SHARPNESS * (torch.cos(goal[:, None] - directions().to(goal)) - 1.0))


def directions() -> Tensor:
    """Return the directions by which a bearing is told, float32 [24] in radians."""
    return torch.arange(_BEARINGS) * (2.0 * math.pi / _BEARINGS)


def total_loss(logits: dict[Output, Tensor], labels: dict[Output, Tensor], entropy_weight: float) -> Tensor:
    """Return the sum over the outputs of the mean of l, a scalar (without the regulariser).

    Parameters
    ----------
    logits, labels : dict of float [n, 2M + 1]
        For each output with an n of its own.
    entropy_weight : float
        lambda2.
    """
    return torch.stack([steering_loss(logits[name], labels[name], entropy_weight).mean() for name in logits]).sum()
