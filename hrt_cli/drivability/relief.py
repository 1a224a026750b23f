"""How steep and how rough the ground is at the points of a lattice of heights, and what that leaves of a score."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_HORN = (1.0, 2.0, 1.0)


def gradient(heights: ArrayLike, row_m: float, col_m: float) -> tuple[Floats, Floats]:
    """Return how much the ground rises per metre along the rows axis and along the columns axis (Horn 1981).

    Along the columns that is Σ w (right - left) / (2 col_m Σ w) over the three rows about a point, w = 1, 2, 1: the
    slope of gdaldem. Of pairs that are not both known none counts, so that a plane has its own slope beside a hole.

    Parameters
    ----------
    heights : [rows, cols]
        Metres; NaN where not known.
    row_m, col_m : float
        Ground metres between two rows, and between two columns.

    Returns
    -------
    by_row, by_col : float64 [rows, cols]
        Metres per metre; NaN where no pair is known.

    References
    ----------
    Horn, Hill shading and the reflectance map, Proc. IEEE 69(1), 1981.
    """
    z = np.asarray(heights, np.float64)
    return _rise(z.T, row_m).T, _rise(z, col_m)


def _rise(z: Floats, step_m: float) -> Floats:
    """Return the rise per metre along the columns."""
    rows, cols = z.shape
    ringed = np.pad(z, 1, constant_values=np.nan)
    total, weights = np.zeros(z.shape), np.zeros(z.shape)
    for row, weight in enumerate(_HORN):
        band = ringed[row : row + rows]
        pair = band[:, 2:] - band[:, :cols]
        known = np.isfinite(pair)
        total += np.where(known, weight * pair, 0.0)
        weights += weight * known
    return np.where(weights > 0, total / np.where(weights > 0, 2.0 * step_m * weights, 1.0), np.nan)


def slope(by_row: Floats, by_col: Floats) -> Floats:
    """Return the slope of a gradient in degrees, 0 to 90."""
    return np.asarray(np.degrees(np.arctan(np.hypot(by_row, by_col))))


def ruggedness(by_row: Floats, by_col: Floats) -> Floats:
    """Return the Vector Ruggedness Measure in windows of 3 x 3 points: 1 - |Σ n| / count, 0 (plane) to 1.

    n are the unit vectors normal to the ground; those that are not known do not count.

    Parameters
    ----------
    by_row, by_col : float64 [rows, cols]
        The gradient, metres per metre.

    Returns
    -------
    float64 [rows, cols]
        NaN where the gradient is.

    References
    ----------
    Sappington, Longshore and Thompson, Quantifying landscape ruggedness for animal habitat analysis, J. Wildlife
    Management 71(5), 2007.
    """
    up = 1.0 / np.sqrt(1.0 + by_row * by_row + by_col * by_col)
    known = np.isfinite(up)
    squared = np.zeros(up.shape)
    count = np.maximum(_window_sum(known.astype(np.float64)), 1.0)
    for normal in (-by_row * up, -by_col * up, up):
        squared += (_window_sum(np.where(known, normal, 0.0)) / count) ** 2
    return np.where(known, np.maximum(0.0, 1.0 - np.sqrt(squared)), np.nan)


def _window_sum(values: Floats) -> Floats:
    ringed = np.pad(values, 1)
    rows = ringed[:-2] + ringed[1:-1] + ringed[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def eased(slope_deg: ArrayLike, rugosity: ArrayLike, slope_limit_deg: float, rugosity_limit: float) -> Floats:
    """Return by what progress, or a score, counts on a slope and on rough ground.

    (1 - (slope/limit)²) (1 - (rugosity/limit)²): 1 on a level floor, 0 from either limit on. The rugosity may be any
    measure, with the limit in its own unit.
    """
    steep, rough = np.asarray(slope_deg) / slope_limit_deg, np.asarray(rugosity) / rugosity_limit
    return np.asarray(np.maximum(0.0, 1.0 - steep * steep) * np.maximum(0.0, 1.0 - rough * rough))


def greatest_in_cells(values: Floats, per_cell: int) -> NDArray[np.float32]:
    """Return the greatest of the values [rows, cols] in each square of `per_cell` points a side; NaN if none is."""
    rows, cols = values.shape[0] // per_cell, values.shape[1] // per_cell
    in_cells = np.where(np.isnan(values), -math.inf, values).reshape(rows, per_cell, cols, per_cell)
    top = in_cells.max(axis=(1, 3))
    return np.where(np.isneginf(top), np.nan, top).astype(np.float32)
