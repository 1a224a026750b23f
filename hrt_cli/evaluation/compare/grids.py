"""How the grids of two rasters lie to each other; what does not lie pixel on pixel is never compared as if it did."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from affine import Affine

from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.result import Figure, apart, number, text
from hrt_cli.raster.grid import Grid, lattice_offset, lonlat_length_m, require_same_grid
from hrt_cli.raster.windows import Window

_SAME_SIZE = 1e-6
_NAME = re.compile(r'^\w+\["([^"]*)"')


def compare_grids(path_a: Path, a: Grid, path_b: Path, b: Grid) -> list[Figure]:
    """Return the figures of two grids; all are 0 where they are the same to a hundredth of a pixel.

    `shift_m` is the farthest that a corner of one raster lies from that of the other, in ground metres (pixels of
    plain images); None where only one has a CRS.
    """
    same = is_same_grid(path_a, a, path_b, b)
    pixel_a, pixel_b = _pixel(a), _pixel(b)
    if same or abs(pixel_a - pixel_b) <= _SAME_SIZE * pixel_a:
        pixel_b = pixel_a
    unit = "px" if a.transform == b.transform == Affine.identity() else "m"
    return [
        text("crs", _crs(a), _crs(b), same=same or ((a.crs is None) == (b.crs is None) and a.crs == b.crs)),
        text("size", f"{a.rows} x {a.cols}", f"{b.rows} x {b.cols}"),
        number("pixel_m", pixel_a, pixel_b, unit),
        apart("shift_m", 0.0 if same else _shift(a, b), unit),
    ]


def is_same_grid(path_a: Path, a: Grid, path_b: Path, b: Grid) -> bool:
    """Whether two rasters lie pixel on pixel, by the rule of `require_same_grid`."""
    try:
        require_same_grid(path_a, a, path_b, b)
    except InputError:
        return False
    return True


def common_windows(a: Grid, b: Grid) -> tuple[Window, Window] | None:
    """Return the pixels of each raster that lie on those of the other; None where they share none."""
    offset = lattice_offset(a, b)
    if offset is None:
        return None
    down, right = offset
    there = Window(down, right, a.rows, a.cols).clipped(b.shape)
    if not (there.height and there.width):
        return None
    return Window(there.row - down, there.col - right, there.height, there.width), there


def _pixel(grid: Grid) -> float:
    """Return the side of a pixel in metres on the ground; without a CRS in the raster's own unit."""
    return math.sqrt(abs(grid.transform.determinant) if grid.crs is None else math.prod(grid.pixel_m))


def _shift(a: Grid, b: Grid) -> float | None:
    corners = [
        grid.xy(np.array([0.0, 0.0, 1.0, 1.0]) * grid.rows, np.array([0.0, 1.0, 0.0, 1.0]) * grid.cols)
        for grid in (a, b)
    ]
    if a.crs is None or b.crs is None:
        (x_a, y_a), (x_b, y_b) = corners
        return float(np.hypot(x_a - x_b, y_a - y_b).max()) if a.crs is b.crs else None
    (lon_a, lat_a), (lon_b, lat_b) = (grid.lonlat(*each) for grid, each in zip((a, b), corners, strict=True))
    pairs = zip(lon_a, lon_b, lat_a, lat_b, strict=True)
    return max(float(lonlat_length_m([lo_a, lo_b], [la_a, la_b])[0]) for lo_a, lo_b, la_a, la_b in pairs)


def _crs(grid: Grid) -> str:
    told = grid.crs_text()
    if told is None:
        return "none"
    found = _NAME.match(told)
    return found[1] if found else told
