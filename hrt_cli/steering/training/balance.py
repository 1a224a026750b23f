"""Rare steering drawn more often: most frames of most drives go straight ahead."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.steering.network.angles import nearest_class
from hrt_cli.steering.training.augment import YAW_UNIT_RAD

MOST = 10.0
"""How many times more often than on average a frame is drawn at most."""


def class_weights(yaw: NDArray[np.float32], half_classes: int, strength: float) -> NDArray[np.float64]:
    """Return how often to draw each frame in an epoch, on average, float64 [n]; they sum to n.

    Parameters
    ----------
    yaw : float32 [n]
        In [-1, 1].
    half_classes : int
        M, of the 2M + 1 classes.
    strength : float
        In [0, 1]: a frame's weight goes with its class's count to the power of minus this. At 0 all are alike; at 1
        all classes that occur are, as far as `MOST` allows.

    Raises
    ------
    ArgumentError
        The strength is not in [0, 1].
    """
    if not 0.0 <= strength <= 1.0:
        raise ArgumentError(f"the strength of balancing is {strength:g}; it must lie in [0, 1]")
    classes = nearest_class(torch.from_numpy(yaw), half_classes).numpy()
    wanted = np.bincount(classes, minlength=2 * half_classes + 1)[classes].astype(np.float64) ** -strength
    capped = np.zeros(len(yaw), np.bool_)
    while True:
        # What the capped frames do not take is shared by the others, which may then reach the cap, too.
        scale = (len(yaw) - MOST * capped.sum()) / wanted[~capped].sum()
        weight = np.where(capped, MOST, wanted * scale)
        beyond = weight > MOST
        if not (beyond & ~capped).any():
            return weight
        capped |= beyond


def unexplained(yaw: NDArray[np.float32], goal: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Return what of the steering is not just making for the goal, float32 [n] in [-1, 1]; without goals all of it.

    Where nothing is in the way, yaw is the goal's bearing: those frames are many, and teach a network nothing to see.

    Parameters
    ----------
    yaw : float32 [n]
        In [-1, 1].
    goal : float32 [n] or None
        Bearings in radians.
    """
    if goal is None:
        return yaw
    return np.asarray(np.clip(yaw - np.clip(goal / YAW_UNIT_RAD, -1.0, 1.0), -1.0, 1.0), np.float32)


def draw_epoch(weight: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the frames of an epoch in random order, int64 [n].

    By systematic sampling: frame i comes floor(weight_i) or ceil(weight_i) times, so that equal weights give each once.

    Parameters
    ----------
    weight : float64 [n]
        As `class_weights` returns them.
    """
    n = len(weight)
    ends = np.cumsum(weight) * (n / weight.sum())
    drawn = np.searchsorted(ends, np.arange(n) + rng.random(), side="right")
    return rng.permutation(drawn.clip(max=n - 1)).astype(np.int64)
