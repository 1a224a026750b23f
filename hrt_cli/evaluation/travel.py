"""How far and which way a robot went, from its places alone: compiled, for logs of a day."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from affine import Affine
from numba import njit
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.raster.grid import Grid, metres_per_degree

Floats = NDArray[np.float64]

_IDENTITY = Affine.identity()
_THIN_M = 0.5
"""A track without speeds is measured between places so far apart: errors of the position would lengthen it."""
_SOON = 500
"""Records ahead in which a robot's next metre is looked for."""

kernel: Any = njit(cache=True, nogil=True)


def metres_gone(places: Floats, crs: CRS | None, breaks: Sequence[int]) -> Floats:
    """Return the ground metres driven up to each record [n], between places half a metre apart or more.

    Parameters
    ----------
    places : float64 [n, 2]
        x and y in `crs`; metres where that is None.
    breaks : sequence of int
        Records that no drive leads to.
    """
    # A grid of one unit a pixel with its origin at 0, 0: places are pixel positions, and lengths ground metres.
    grid = Grid(1, 1, _IDENTITY, crs)
    broken = np.zeros(len(places), np.bool_)
    broken[np.array(breaks, np.int64)] = True
    kept = np.flatnonzero(_apart(*_in_metres(places, grid), broken, _THIN_M))
    legs = grid.ground_length_m(places[kept, 1], places[kept, 0])
    gone = np.zeros(len(places))
    gone[kept[1:]] = np.where(broken[kept[1:]], 0.0, legs)
    return np.cumsum(gone)


def _in_metres(places: Floats, grid: Grid) -> tuple[Floats, Floats, Floats, Floats]:
    """Return coordinates [n] and what one unit of each is in metres there [n]."""
    x, y = places[:, 0], places[:, 1]
    if grid.crs is None:
        one = np.ones(len(places))
        return x.copy(), y.copy(), one, one
    lon, lat = grid.lonlat(*grid.xy(y, x))
    return np.unwrap(lon, period=360.0), lat, *metres_per_degree(lat)


@kernel
def _apart(
    x: Floats, y: Floats, x_m: Floats, y_m: Floats, broken: NDArray[np.bool_], apart_m: float
) -> NDArray[np.bool_]:
    """Return which places [n] lie `apart_m` or more from the one kept before; the first and broken ones are kept."""
    kept = np.zeros(len(x), np.bool_)
    kept[0] = True
    last = 0
    for k in range(1, len(x)):
        if not broken[k]:
            east = (x[k] - x[last]) * 0.5 * (x_m[k] + x_m[last])
            south = (y[k] - y[last]) * 0.5 * (y_m[k] + y_m[last])
            if east * east + south * south < apart_m * apart_m:
                continue
        kept[k] = True
        last = k
    return kept


def travel_heading(place: Floats) -> Floats:
    """Return the direction of travel in radians at each place [n, 2]: over the next metre, at the end the last."""
    return np.asarray(_headings(np.ascontiguousarray(place)), np.float64)


@kernel
def _headings(place: Floats) -> Floats:
    n = len(place)
    heading = np.zeros(n)
    last = 0.0
    for k in range(n):
        for ahead in range(k + 1, min(k + _SOON, n)):
            east, south = place[ahead, 0] - place[k, 0], place[ahead, 1] - place[k, 1]
            if east * east + south * south >= 1.0:
                last = math.atan2(east, -south)
                break
        heading[k] = last
    return heading
