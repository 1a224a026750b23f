"""How far apart two ways lie, in ground metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.raster.grid import Grid, metres_per_degree, wrapped_deg

Floats = NDArray[np.float64]


def ground_metres(lon_deg: Floats, lat_deg: Floats, origin_deg: tuple[float, float]) -> Floats:
    """Return places [n, 2] (east, north) in metres from an origin (longitude, latitude) not farther than a site."""
    east, north = metres_per_degree(np.array([origin_deg[1]]))
    return np.stack([wrapped_deg(lon_deg - origin_deg[0]) * east, (lat_deg - origin_deg[1]) * north], axis=1)


def metres_of(grid: Grid, x: Floats, y: Floats, origin_deg: tuple[float, float]) -> Floats:
    """Return map coordinates of a grid as places [n, 2] in metres; its own, where it has no CRS."""
    if grid.crs is None:
        return np.stack([x, y], axis=1)
    return ground_metres(*grid.lonlat(x, y), origin_deg)


def frechet(a: Floats, b: Floats) -> float:
    """Return the discrete Fréchet distance of two ways [n, 2] and [m, 2] (Eiter and Mannila 1994).

    The length of the shortest lead by which two walkers, each going on along one way from place to place and never
    back, stay together. Unlike the Hausdorff distance it tells a way from its reverse. By antidiagonals of the table of
    leads: O(nm) time, O(n + m) memory.
    """
    n, m = len(a), len(b)
    if a.shape == b.shape and np.array_equal(a, b):
        return 0.0
    before = last = np.full(n, np.inf)
    for diagonal in range(n + m - 1):
        rows = np.arange(max(0, diagonal - m + 1), min(n, diagonal + 1))
        lead = np.hypot(*(a[rows] - b[diagonal - rows]).T)
        now = np.full(n, np.inf)
        if diagonal == 0:
            now[0] = lead[0]
        else:
            # last[i] is (i, j - 1), last[i - 1] is (i - 1, j), before[i - 1] is (i - 1, j - 1).
            up = np.where(rows > 0, np.minimum(last[rows - 1], before[rows - 1]), np.inf)
            now[rows] = np.maximum(lead, np.minimum(last[rows], up))
        before, last = last, now
    return float(last[n - 1])
