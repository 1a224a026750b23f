"""Donkeycar's pilots `linear` and `categorical` in PyTorch, trained as Donkeycar trains them.

After donkeycar/parts/keras.py, pipeline/training.py, utils.py and templates/cfg_complete.py of autorope/donkeycar
(MIT), state of February 2026: networks, losses, bins, initialisation, Adam, batches, early stopping; no augmentation,
which is its default. Its networks want pictures of 160 x 120 (at 80 x 60 nothing is left for the last convolution).

Otherwise than there, the validation loss is that of each frame once: Donkeycar fills its last batch up with some twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrt_cli.steering.training.augment import Augment, augment

WIDTH, HEIGHT = 160, 120
KINDS = ("linear", "categorical")
ANGLE_BINS, THROTTLE_BINS = 15, 20
DROP = 0.2
_CONVOLUTIONS = ((24, 5, 2), (32, 5, 2), (64, 5, 2), (64, 3, 1), (64, 3, 1))
"""Channels, side of the kernel, stride; the fourth has a stride of 2 in `categorical`."""
_DENSE = (100, 50)
_AT_ONCE = 128


@dataclass(frozen=True)
class Recipe:
    """Donkeycar's defaults (`cfg_complete.py`)."""

    batch: int = 128
    epochs: int = 100
    patience: int = 5
    min_delta: float = 5e-4
    learning_rate: float = 1e-3
    throttle_range: float = 0.8
    angle_weight: float = 0.5
    throttle_weight: float = 0.5
    """Of the two losses of `categorical`; those of `linear` are added as they are."""


@dataclass(frozen=True)
class Driven:
    """Frames: uint8 [n, 120, 160, 3], float32 [n] in [-1, 1], float32 [n]."""

    pictures: NDArray[np.uint8]
    angle: NDArray[np.float32]
    throttle: NDArray[np.float32]


@dataclass(frozen=True)
class Trained:
    """A network as of its best epoch (from 1), and how many epochs there were."""

    net: Pilot
    epochs: int
    best_epoch: int


class Pilot(nn.Module):
    """Five convolutions, two dense layers, an output for the angle and one for the throttle.

    Parameters
    ----------
    kind : {"linear", "categorical"}
    """

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind
        layers: list[nn.Module] = []
        channels, height, width = 3, HEIGHT, WIDTH
        for number, (wanted, side, stride) in enumerate(_CONVOLUTIONS):
            stride = 2 if kind == "categorical" and number == 3 else stride
            layers += [nn.Conv2d(channels, wanted, side, stride), nn.ReLU(), nn.Dropout(DROP)]
            channels, height, width = wanted, (height - side) // stride + 1, (width - side) // stride + 1
        layers.append(nn.Flatten())
        features = channels * height * width
        for wanted in _DENSE:
            layers += [nn.Linear(features, wanted), nn.ReLU(), nn.Dropout(DROP)]
            features = wanted
        self.trunk = nn.Sequential(*layers)
        sizes = (1, 1) if kind == "linear" else (ANGLE_BINS, THROTTLE_BINS)
        self.angle, self.throttle = (nn.Linear(features, size) for size in sizes)
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                nn.init.xavier_uniform_(module.weight)  # Keras's glorot_uniform
                nn.init.zeros_(module.bias)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Return angle and throttle of pictures [n, 3, 120, 160] in [0, 1]: values [n, 1], or logits [n, bins]."""
        seen = self.trunk(pictures)
        return self.angle(seen), self.throttle(seen)


def linear_bin(value: NDArray[np.floating], bins: int, offset: float, span: float) -> NDArray[np.int64]:
    """Return the bin of each value as Donkeycar's `linear_bin` does; halves go to the even one, as Python rounds."""
    step = span / (bins - offset)
    return np.rint((value.astype(np.float64) + offset) / step).clip(0, bins - 1).astype(np.int64)


def linear_unbin(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle that Donkeycar steers: that of the likeliest bin of each distribution [n, 15]."""
    bins = probability.shape[1]
    return np.asarray(probability.argmax(axis=1) * (2.0 / (bins - 1)) - 1.0)


def loss_of(kind: str, found: Sequence[Tensor], angle: NDArray[np.float32], throttle: NDArray[np.float32],
            recipe: Recipe) -> Tensor:  # fmt: skip
    """Return Donkeycar's loss, a mean over the frames."""
    if kind == "linear":
        wanted = (torch.from_numpy(each)[:, None].to(found[0]) for each in (angle, throttle))
        return torch.stack([nn.functional.mse_loss(a, b) for a, b in zip(found, wanted, strict=True)]).sum()
    bins = (
        linear_bin(angle, ANGLE_BINS, 1.0, 2.0),
        linear_bin(throttle, THROTTLE_BINS, 0.0, recipe.throttle_range),
    )
    parts = [
        nn.functional.cross_entropy(logits, torch.from_numpy(which).to(logits.device))
        for logits, which in zip(found, bins, strict=True)
    ]
    return recipe.angle_weight * parts[0] + recipe.throttle_weight * parts[1]


def train_pilot(kind: str, training: Driven, validation: Driven, seed: int, recipe: Recipe, strengths: Augment,
                device: str = "cpu") -> Trained:  # fmt: skip
    """Train a pilot; with `strengths` other than `Augment.none()` on pictures changed as hrt changes them.

    The frames are shuffled once and then come round and round in that order, in batches that run on over the end.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng([seed, 7])
    net = Pilot(kind).to(device)
    # Keras's Adam, whose epsilon is not PyTorch's.
    optimiser = torch.optim.Adam(net.parameters(), lr=recipe.learning_rate, eps=1e-7)
    order = rng.permutation(len(training.angle))
    stopping, best, at = _Stopping(recipe), dict(net.state_dict()), 0
    while not stopping.ended:
        net.train()
        for _ in range(math.ceil(len(order) / recipe.batch)):
            rows = order[np.arange(at, at + recipe.batch) % len(order)]
            at += recipe.batch
            pictures, angle, *_ = augment(
                training.pictures[rows], training.angle[rows, None], None, None, strengths, rng
            )
            optimiser.zero_grad()
            found = net(as_seen(pictures).to(device))
            loss_of(kind, found, angle[:, 0], training.throttle[rows], recipe).backward()
            optimiser.step()
        outputs = predict(net, validation.pictures)
        loss = loss_of(kind, outputs, validation.angle, validation.throttle, recipe).item()
        if stopping.is_best(loss):
            best = {name: tensor.clone() for name, tensor in net.state_dict().items()}
    net.load_state_dict(best)
    return Trained(net, stopping.epoch, stopping.best_epoch)


class _Stopping:
    """Keras's ModelCheckpoint keeps the lowest loss; its EarlyStopping counts only what is lower by `min_delta`."""

    def __init__(self, recipe: Recipe) -> None:
        self.epoch, self.best_epoch = 0, 0
        self._recipe = recipe
        self._lowest = self._mark = math.inf
        self._waited = 0

    @property
    def ended(self) -> bool:
        return self.epoch >= self._recipe.epochs or self._waited >= self._recipe.patience

    def is_best(self, loss: float) -> bool:
        """Take note of an epoch's validation loss; return whether it is the lowest so far."""
        self.epoch += 1
        self._waited += 1
        if loss < self._mark - self._recipe.min_delta:
            self._mark, self._waited = loss, 0
        if loss >= self._lowest:
            return False
        self._lowest, self.best_epoch = loss, self.epoch
        return True


def as_seen(pictures: NDArray[np.uint8]) -> Tensor:
    """Return pictures as Donkeycar's networks see them, float32 [n, 3, 120, 160] in [0, 1]."""
    return torch.from_numpy(pictures.transpose(0, 3, 1, 2).astype(np.float32) / np.float32(255.0))


@torch.no_grad()
def predict(net: Pilot, pictures: NDArray[np.uint8]) -> tuple[Tensor, Tensor]:
    """Return angle and throttle as `Pilot.forward` does, of any number of pictures, on the CPU."""
    net.eval()
    device = next(net.parameters()).device
    parts = [net(as_seen(pictures[first : first + _AT_ONCE]).to(device)) for first in range(0, len(pictures), _AT_ONCE)]
    return torch.cat([angle for angle, _ in parts]).cpu(), torch.cat([throttle for _, throttle in parts]).cpu()
