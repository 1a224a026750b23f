"""Pictures changed so that what the steering depends on stays, and the label follows where it does not.

Flips and shifts with the label changed to fit are those of Bojarski et al. 2016 (arXiv:1604.07316).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

YAW_UNIT_RAD = math.pi / 4
"""The heading error that yaw 1 stands for in hrt's recordings."""
_LEVELS = np.arange(256, dtype=np.float32) / 255.0

Pictures = NDArray[np.uint8]
Labels = NDArray[np.float32]
Shown = tuple[Pictures, Labels, Labels | None, Labels | None]
"""Pictures, steering, goals and costs of some frames, as `batches.Frames` has them."""


@dataclass(frozen=True)
class Augment:
    """How strongly pictures are changed; each strength is drawn anew for each picture.

    Attributes
    ----------
    flip : float
        Probability of mirroring: yaw and goal change sign.
    shift : float
        Largest shift sideways, as a share of the width, to either side; the outermost column is repeated.
    shift_gain : float
        By how much yaw grows with a shift of a whole width to the right (what is ahead then lies farther to the
        right). Of the order of what is usual for Udacity's simulator: 0.004 a pixel at 320. A goal turns as yaw does,
        by `YAW_UNIT_RAD` times as much.
    brightness : float
        Largest offset, as a share of full scale.
    contrast : float
        Largest change of the contrast about mid-grey, as a share.
    gamma : float
        Largest logarithm (base 2) of the exponent.
    colour : float
        Largest change of red, green and blue each, as a share.
    blur : float
        Probability of a blur (binomial, 3 x 3).
    noise : float
        Largest standard deviation of independent noise, as a share of full scale.
    """

    flip: float = 0.5
    shift: float = 0.1
    shift_gain: float = 1.0
    brightness: float = 0.15
    contrast: float = 0.25
    gamma: float = 0.4
    colour: float = 0.1
    blur: float = 0.1
    noise: float = 0.02

    @classmethod
    def none(cls) -> Augment:
        """Return strengths that change nothing."""
        return cls(flip=0.0, shift=0.0, brightness=0.0, contrast=0.0, gamma=0.0, colour=0.0, blur=0.0, noise=0.0)


def augment(
    pictures: Pictures,
    steering: Labels,
    goal: Labels | None,
    costs: Labels | None,
    strengths: Augment,
    rng: np.random.Generator,
) -> Shown:
    """Return changed copies of pictures, and labels that fit them; the inputs stay as they are.

    Parameters
    ----------
    pictures : uint8 [n, height, width, 3]
    steering : float32 [n, outputs]
        Yaw first; pitch stays as it is.
    goal : float32 [n, goals], optional
        Bearings in radians, right positive.
    costs : float32 [n, goals, turns], optional
        At evenly spaced yaws from -1 to 1.
    strengths : Augment
    rng : numpy.random.Generator
        All that is random comes from it: the same state gives the same result.

    Returns
    -------
    pictures, steering, goal, costs
        As they came; yaw clipped to [-1, 1], goals in [-pi, pi], costs beyond the ends as at them.
    """
    n, height, width, _ = pictures.shape
    flip = np.asarray(rng.random(n) < strengths.flip)
    shift_px = np.rint(_uniform(rng, n, strengths.shift) * width).astype(np.int64)
    blur = np.asarray(rng.random(n) < strengths.blur)
    noise = np.abs(_uniform(rng, n, strengths.noise)) * 255.0
    tables = _tables(rng, n, strengths)
    # One field for all, each taking its own part: drawing noise takes longer than all else.
    field = rng.standard_normal(2 * height * width * 3 if strengths.noise > 0 else 0, np.float32)
    begin = rng.integers(height * width * 3, size=n)
    out = np.empty_like(pictures)
    for index in range(n):
        # In this order light falls, lenses blur and sensors make noise.
        changed = cv2.LUT(_moved(pictures[index], flip[index], int(shift_px[index])), tables[index])
        if blur[index]:
            changed = cv2.GaussianBlur(changed, (3, 3), 0)
        if noise[index] > 0:
            part = field[begin[index] :][: changed.size].reshape(changed.shape)
            changed = cv2.add(changed, part * np.float32(noise[index]), dtype=cv2.CV_8U)
        out[index] = changed
    turn = strengths.shift_gain * shift_px / width
    sign = np.where(flip, -1.0, 1.0)
    labels = steering.copy()
    labels[:, 0] = np.clip(sign * steering[:, 0] + turn, -1.0, 1.0)
    changed_costs = None if costs is None else _turned(costs, sign, turn)
    if goal is None:
        return out, labels, None, changed_costs
    bearing = sign[:, None] * goal + turn[:, None] * YAW_UNIT_RAD
    return out, labels, np.arctan2(np.sin(bearing), np.cos(bearing)).astype(np.float32), changed_costs


def _turned(costs: Labels, sign: NDArray[np.float64], turn: NDArray[np.float64]) -> Labels:
    """Return costs mirrored where `sign` is -1, then moved by `turn` along the yaws."""
    yaw = np.linspace(-1.0, 1.0, costs.shape[2])
    moved = [[np.interp(s * (yaw - t), yaw, one) for one in each] for each, s, t in zip(costs, sign, turn, strict=True)]
    return np.array(moved, np.float32).reshape(costs.shape)


def _uniform(rng: np.random.Generator, n: int, largest: float) -> NDArray[np.float64]:
    return rng.uniform(-largest, largest, n)


def _moved(picture: Pictures, flip: bool, shift_px: int) -> Pictures:
    """Return a picture mirrored, then shifted to the right, the outermost column repeated."""
    source = picture[:, ::-1] if flip else picture
    if shift_px == 0:
        return np.ascontiguousarray(source)
    columns = np.clip(np.arange(source.shape[1]) - shift_px, 0, source.shape[1] - 1)
    return np.ascontiguousarray(source[:, columns])


def _tables(rng: np.random.Generator, n: int, strengths: Augment) -> Pictures:
    """Return for each picture what becomes of each level of red, green and blue, uint8 [n, 1, 256, 3]."""
    exponent = 2.0 ** _uniform(rng, n, strengths.gamma)[:, None, None]
    contrast = 1.0 + _uniform(rng, n, strengths.contrast)[:, None, None]
    offset = _uniform(rng, n, strengths.brightness)[:, None, None]
    gain = 1.0 + rng.uniform(-strengths.colour, strengths.colour, (n, 1, 3))
    level = _LEVELS[None, :, None] ** exponent
    level = ((level - 0.5) * contrast + 0.5 + offset) * gain
    return np.rint(np.clip(level, 0.0, 1.0) * 255.0).astype(np.uint8)[:, None]
