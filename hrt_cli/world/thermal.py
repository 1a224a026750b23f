"""The thermal layer of a burnt site: ambient temperatures and hot spots that still smoulder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hrt_cli.world.layout import Frame, Mask
from hrt_cli.world.noise import FloatArray, derive_seed, fbm

_PEAK_RANGE_C = (60.0, 300.0)
_DIAMETER_RANGE_M = (0.5, 2.0)
_COUNT_RANGE = (6, 12)
_BLUR_M = 0.15
"""Thermal cameras see several times less sharply than the colour camera."""


@dataclass(frozen=True)
class Hotspot:
    """One hot spot.

    Attributes
    ----------
    row, col : int
        The pixel of its peak.
    peak_c : float
        Temperature there, degrees Celsius.
    diameter_m : float
        Width of the spot where the excess temperature has fallen to half.
    """

    row: int
    col: int
    peak_c: float
    diameter_m: float


def thermal_layer(
    frame: Frame, ambient_c: FloatArray, allowed: Mask, seed: int
) -> tuple[npt.NDArray[np.float32], tuple[Hotspot, ...]]:
    """Draw surface temperatures with 6 to 12 hot spots on `allowed` ground.

    Parameters
    ----------
    ambient_c : float64 array, [rows, cols]
        Temperature of each pixel's class, degrees Celsius.
    allowed : bool array, [rows, cols]
        Where a hot spot may lie.
    seed : int

    Returns
    -------
    tuple of float32 array [rows, cols] and tuple of Hotspot
        At a listed spot the layer holds its `peak_c` exactly (to float32).
    """
    drift = 0.8 * fbm(frame.y_m, frame.x_m, 6.0, derive_seed(seed, "warmth"), octaves=3)
    field = ndimage.gaussian_filter(ambient_c, _BLUR_M / frame.pixel_m) + np.clip(drift, -2.0, 2.0)
    spots = _place(frame, allowed, seed)
    base = field.copy()
    for spot in spots:
        y, x = frame.y_m - (spot.row + 0.5) * frame.pixel_m, frame.x_m - (spot.col + 0.5) * frame.pixel_m
        fall = np.exp2(-((2.0 * np.hypot(y, x) / spot.diameter_m) ** 2))
        field = np.maximum(field, base + (spot.peak_c - base) * fall)
    return field.astype(np.float32), spots


def _place(frame: Frame, allowed: Mask, seed: int) -> tuple[Hotspot, ...]:
    """Throw darts at the allowed ground; spots keep apart by two of their widths."""
    rng = np.random.default_rng(derive_seed(seed, "hotspots"))
    wanted = int(rng.integers(_COUNT_RANGE[0], _COUNT_RANGE[1] + 1))
    cells = np.argwhere(allowed)
    spots: list[Hotspot] = []
    apart = 1.0
    while len(cells) and len(spots) < wanted:
        row, col = (int(i) for i in cells[rng.integers(len(cells))])
        diameter = float(np.round(frame.scale * rng.uniform(*_DIAMETER_RANGE_M), 2))
        diameter = max(diameter, _DIAMETER_RANGE_M[0])
        gaps = [np.hypot(row - s.row, col - s.col) * frame.pixel_m - apart * (s.diameter_m + diameter) for s in spots]
        apart *= 0.995
        if min(gaps, default=0.0) < 0.0:
            continue
        low, high = np.log(_PEAK_RANGE_C)
        peak = float(np.round(np.exp(rng.uniform(low, high)), 1))
        spots.append(Hotspot(row, col, peak, diameter))
    return tuple(spots)
