"""What a surface model holds: bare ground, what stands on it, slope; and how gaps in a survey are filled."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Heights = NDArray[np.float32]

_WINDOWS_M = (0.5, 1.0, 2.0, 4.0, 8.0, 12.0)
"""Sides of the opening windows: things up to the widest are told from hills."""
_STEEPEST = 0.45
"""Rise over run that bare ground may have between two windows."""
_STEP_M = 0.08

NO_OBSTACLE_M = 1e6
"""Clearance where there is no obstacle at all: farther than any, and a number, so that it can be interpolated."""


def fill(values: NDArray[Any], known: Mask) -> NDArray[Any]:
    """Fill the gaps of a picture smoothly from around them (pull-push: Gortler et al. 1996, section 3.4.2).

    Parameters
    ----------
    values : float32 or uint8 array, [rows, cols] or [rows, cols, bands]
        What it holds where not `known` does not matter.
    known : bool array, [rows, cols]

    Returns
    -------
    array of the same shape and dtype
        Zeros if nothing is known.
    """
    if known.all():
        return values
    weight = known.astype(np.float32)
    cube = values.astype(np.float32)
    shaped = cube[..., None] if cube.ndim == 2 else cube
    shaped = np.where(known[..., None], shaped, np.float32(0))
    filled = _pull_push(shaped, weight)
    out = np.where(known[..., None], shaped, filled).reshape(values.shape)
    return np.asarray(np.clip(np.rint(out), 0, 255) if values.dtype == np.uint8 else out).astype(values.dtype)


def _pull_push(weighted: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean where there is weight, else what coarser levels say; `weighted` [rows, cols, bands]."""
    rows, cols = weight.shape
    # However little the weight of a lone pixel is on a coarse level, its value is not to fade.
    mean = np.divide(weighted, weight[..., None], out=np.zeros_like(weighted), where=weight[..., None] > 0)
    if (weight > 0).all() or max(rows, cols) <= 1:
        return mean
    half = (max(1, (cols + 1) // 2), max(1, (rows + 1) // 2))
    coarse_weight = np.asarray(cv2.resize(weight, half, interpolation=cv2.INTER_AREA), np.float32)
    coarse = np.asarray(cv2.resize(weighted, half, interpolation=cv2.INTER_AREA), np.float32)
    below = _pull_push(coarse.reshape(half[1], half[0], -1), coarse_weight.reshape(half[1], half[0]))
    up = cv2.resize(below, (cols, rows), interpolation=cv2.INTER_LINEAR).reshape(rows, cols, -1)
    share = np.clip(weight, 0, 1)[..., None]
    return (share * mean + (1 - share) * up).astype(np.float32)


def bare_ground(surface: Heights, pixel_m: float) -> Heights:
    """Return the ground under what stands on it: a progressive morphological filter (Zhang et al. 2003).

    The surface is opened by growing windows; where an opening takes off more than a slope of `_STEEPEST` explains
    something stands, and the ground is filled in from around.

    Parameters
    ----------
    surface : float32 array, [rows, cols]
        Heights in metres, finite.
    pixel_m : float

    Returns
    -------
    float32 array, [rows, cols]
    """
    step = max(1, round(0.25 / pixel_m))
    rows, cols = surface.shape
    small = (max(1, cols // step), max(1, rows // step))
    coarse = cv2.resize(surface, small, interpolation=cv2.INTER_AREA) if step > 1 else surface.copy()
    cell_m = pixel_m * step
    stands = np.zeros(coarse.shape, np.bool_)
    level, before = coarse, 0.0
    for window_m in _WINDOWS_M:
        side = 2 * int(np.ceil(window_m / 2 / cell_m)) + 1
        if side <= 1 or side > min(coarse.shape):
            continue
        opened = cv2.morphologyEx(
            level,
            cv2.MORPH_OPEN,
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)),
            borderType=cv2.BORDER_REFLECT,
        )
        stands |= level - opened > _STEEPEST * (window_m - before) / 2 + _STEP_M
        level, before = opened, window_m
    ground = fill(coarse, ~stands)
    ground = cv2.GaussianBlur(ground, (0, 0), 0.5 / cell_m)
    back = cv2.resize(ground, (cols, rows), interpolation=cv2.INTER_LINEAR) if step > 1 else ground
    return np.asarray(np.minimum(back, surface), np.float32)


def rise(surface: Heights, pixel_m: float, reach_m: float) -> Heights:
    """Return the height that the surface rises and falls within `reach_m` across each pixel, float32 [rows, cols]."""
    side = 2 * max(1, round(reach_m / 2 / pixel_m)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.morphologyEx(surface, cv2.MORPH_GRADIENT, kernel, borderType=cv2.BORDER_REFLECT))


def slope(ground: Heights, pixel_m: float, smooth_m: float = 0.5) -> Heights:
    """Return the slope, rise over run, of the ground smoothed over about a robot's length, float32 [rows, cols]."""
    smooth = cv2.GaussianBlur(ground, (0, 0), max(smooth_m / pixel_m, 0.3), borderType=cv2.BORDER_REPLICATE)
    along_row = np.gradient(smooth, pixel_m, axis=0) if smooth.shape[0] > 1 else np.zeros_like(smooth)
    along_col = np.gradient(smooth, pixel_m, axis=1) if smooth.shape[1] > 1 else np.zeros_like(smooth)
    return np.asarray(np.hypot(along_row, along_col), np.float32)


def clearance(obstacle: Mask, pixel_m: float) -> Heights:
    """Return each pixel's distance to the nearest obstacle pixel's centre in metres; `NO_OBSTACLE_M` without any.

    float32 [rows, cols]; 0 on an obstacle.
    """
    if not obstacle.any():
        return np.full(obstacle.shape, NO_OBSTACLE_M, np.float32)
    free = (~obstacle).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * pixel_m, np.float32)
