"""Batches of frames, cut and augmented a batch ahead of the network.

All that is random in a batch is drawn from the seed, the epoch and the batch's number alone: a training that goes on
after a stop needs no state of a generator to see the same batches.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.pictures import prepare
from hrt_cli.steering.training.augment import Augment, Shown, augment
from hrt_cli.steering.training.balance import class_weights, draw_epoch, unexplained

_ORDER, _AUGMENT, _DROPOUT = 1, 2, 3
"""Streams of random numbers that must not be one another."""


@dataclass(frozen=True)
class Frames:
    """Some frames of an array of pictures.

    Attributes
    ----------
    pictures : uint8 [m, height, width, 3]
        All pictures, fitted; perhaps mapped from a file, so it is never copied.
    rows : int64 [n]
        Which of them.
    steering : float32 [n, outputs]
        In [-1, 1].
    goal : float32 [n, goals] or None
        Bearings in radians; the first is the frame's own, to which its steering belongs.
    costs : float32 [n, goals, turns] or None
        In seconds, what turning by each angle costs on the way to each goal.
    """

    pictures: NDArray[np.uint8]
    rows: NDArray[np.int64]
    steering: NDArray[np.float32]
    goal: NDArray[np.float32] | None
    costs: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return int(self.rows.size)

    def cut(self, which: NDArray[np.int64]) -> Shown:
        """Return the pictures, steering, goals and costs of some of the frames."""
        goal = None if self.goal is None else self.goal[which]
        costs = None if self.costs is None else self.costs[which]
        return self.pictures[self.rows[which]], self.steering[which], goal, costs


@dataclass(frozen=True)
class Batch:
    """What the network sees at once: see `pictures.prepare` and `Frames`."""

    pictures: Tensor
    steering: Tensor
    goal: Tensor | None
    costs: Tensor | None = None


def batch_count(frames: int, batch: int) -> int:
    """Return how many batches an epoch has: each of `batch` frames or a few more, never fewer if there are as many."""
    return max(1, frames // batch)


def ready(shown: Shown, config: SteeringConfig) -> Batch:
    """Return frames as tensors."""
    pictures, steering, goal, costs = shown
    seen = torch.from_numpy(prepare(pictures, config)).contiguous(memory_format=torch.channels_last)
    more = (None if each is None else torch.from_numpy(each) for each in (goal, costs))
    return Batch(seen, torch.from_numpy(steering), *more)


def epoch_batches(
    frames: Frames,
    config: SteeringConfig,
    *,
    batch: int,
    balance_strength: float,
    strengths: Augment,
    seed: int,
    epoch: int,
    first: int = 0,
) -> Generator[Batch, None, None]:
    """Yield the batches of an epoch from number `first` on, each made while the one before it is in use.

    Every frame comes once an epoch; with a balance, those of rare yaw more often, and as many in all. Where the network
    is told goals, rare is what the goal does not explain.
    """
    rare = unexplained(frames.steering[:, 0], None if frames.goal is None else frames.goal[:, 0])
    weight = class_weights(rare, config.half_classes, balance_strength)
    order = draw_epoch(weight, np.random.default_rng([seed, _ORDER, epoch]))
    parts = np.array_split(order, batch_count(len(frames), batch))

    def make(number: int) -> Batch:
        own = np.random.default_rng([seed, _AUGMENT, epoch, number])
        return ready(augment(*frames.cut(parts[number]), strengths, own), config)

    with ThreadPoolExecutor(1) as ahead:
        waiting = [ahead.submit(make, number) for number in range(len(parts))[first : first + 1]]
        for number in range(first, len(parts)):
            made = waiting.pop().result()
            if number + 1 < len(parts):
                waiting.append(ahead.submit(make, number + 1))
            yield made


def dropout_seed(seed: int, epoch: int, number: int) -> int:
    """Return the seed of PyTorch's generator for one batch: a number of 63 bits."""
    return int(np.random.SeedSequence([seed, _DROPOUT, epoch, number]).generate_state(1, np.uint64)[0] >> np.uint64(1))
