"""One raster on the grid of another: whatever its resolution, extent or CRS, its values where they are asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import RasterioError
from rasterio.warp import reproject

from hrt_cli.errors import InputError
from hrt_cli.raster.gate import Raster, is_nodata
from hrt_cli.raster.gather import average, greatest, relative, sampled
from hrt_cli.raster.grid import Grid, transform_points
from hrt_cli.raster.windows import Window

Rule = Literal["bilinear", "average", "max", "nearest", "mode"]
"""How a value is made of the pixels about it.

`bilinear` and `nearest`: at the middle of the cell (GDAL). Of all pixels in the cell, however the grids lie to each
other: `average`, by the share of the cell that each covers; `max`, of those whose middle lies in it; `mode`, what
covers most of it.
"""

MAX_PX = 2**28
"""Most pixels of a source that are read at once (1 GB as float32)."""

_MARGIN_PX = 4
_EDGE_POINTS = 9

_UPRIGHT = Affine(1, 0, 1, 0, -1, 1)
"""Pixels as coordinates; GDAL takes an origin at 0, 0 for no transform at all."""
_FLAT = CRS.from_epsg(32631)
"""Stands for whatever CRS both rasters have: between the same GDAL transforms nothing."""
_PLAIN = {"bilinear": {"XSCALE": 1, "YSCALE": 1}}
"""GDAL guesses from the two sizes how wide to interpolate, and is misled where the grids are turned."""


def field_on(
    raster: Raster, grid: Grid, rule: Rule, *, band: int = 1, void: tuple[float, ...] = ()
) -> NDArray[np.float32]:
    """Return a band of a raster on another grid.

    Parameters
    ----------
    raster : Raster
        Open, and georeferenced.
    grid : Grid
        Where the values are wanted.
    rule : str
        Of pixels that carry no data (by the nodata value, a mask, a declared alpha band, or as NaN) none counts; a
        value is NaN only where no pixel with data lies about it.
    band : int
        Counted from 1.
    void : tuple of float
        Values that carry no data though the raster does not say so.

    Returns
    -------
    float32 [rows, cols]
        In the raster's own unit; NaN where it has no data.

    Raises
    ------
    InputError
        The raster does not reach the grid, or the part of it that does has more than `MAX_PX` pixels.
    """
    window = window_on(raster.path, raster.grid, grid)
    real = real_values(raster, window, band)
    for value in void:
        real[real == np.float32(value)] = np.nan
    part = part_of(raster.grid, window)
    try:
        if rule == "max":
            return greatest(real, part, grid)
        if rule == "average":
            return average(real, part, grid)
        if rule == "mode":
            return sampled(real, part, grid, mode=True)
    except ValueError as error:
        raise InputError(raster.path, f"cannot be laid on the other raster: {error}") from error
    out = np.full(grid.shape, np.nan, np.float32)
    warp_onto(raster.path, real, part, out, grid, rule, src_nodata=np.nan, dst_nodata=np.nan)
    return out


def real_values(raster: Raster, window: Window, band: int = 1) -> NDArray[np.float32]:
    """Read a band in a window inside the raster as float32 [height, width], NaN where it has no data."""
    values = raster.read_bands([band], window)[0]
    empty = is_nodata(values, raster.nodata[band - 1])
    if raster.has_mask:
        empty |= ~raster.read_mask(window)
    if ColorInterp.alpha in raster.colours:
        empty |= ~(raster.read_bands([raster.colours.index(ColorInterp.alpha) + 1], window)[0] > 0)
    with np.errstate(over="ignore"):  # what is beyond float32 is no measurement
        real: NDArray[np.float32] = values.astype(np.float32)
    real[empty | np.isinf(real)] = np.nan
    return real


def window_on(path: Path, source: Grid, target: Grid) -> Window:
    """Return the pixels of `source` that lie on `target`, with a small margin.

    Raises
    ------
    InputError
        There are none, or more than `MAX_PX`; `path` names the source.
    """
    window = window_or_none(path, source, target)
    if window is None:
        raise InputError(path, "does not cover the place: it lies wholly beside the other raster")
    if window.height * window.width > MAX_PX:
        raise InputError(
            path, f"has {window.height} x {window.width} pixels there, more than are read at once", "resample it first"
        )
    return window


def window_or_none(path: Path, source: Grid, target: Grid) -> Window | None:
    """Return the pixels of `source` that lie on `target`, however many, with a small margin; None if there are none.

    Raises
    ------
    InputError
        One of them has no place on the Earth; `path` names the source.
    """
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    rows, cols = (a.ravel() * side for a, side in zip(np.meshgrid(along, along), target.shape, strict=True))
    x, y = target.xy(rows, cols)
    try:
        if source.crs is None or target.crs is None:
            raise ValueError("has no coordinate reference system")
        if source.crs != target.crs:
            x, y = transform_points(target.crs, source.crs, x, y)
    except ValueError as error:
        raise InputError(path, f"cannot be laid on the other raster: {error}") from error
    back = ~source.transform
    at_col, at_row = back.a * x + back.b * y + back.c, back.d * x + back.e * y + back.f
    top, left = int(np.floor(at_row.min())) - _MARGIN_PX, int(np.floor(at_col.min())) - _MARGIN_PX
    bottom, right = int(np.ceil(at_row.max())) + _MARGIN_PX, int(np.ceil(at_col.max())) + _MARGIN_PX
    window = Window(top, left, bottom - top, right - left).clipped(source.shape)
    inside = (at_row.max() > 0) & (at_row.min() < source.rows) & (at_col.max() > 0) & (at_col.min() < source.cols)
    return window if inside and window.height and window.width else None


def part_of(grid: Grid, window: Window) -> Grid:
    """Return the grid of a window of a raster."""
    transform = grid.transform @ type(grid.transform).translation(window.col, window.row)
    return Grid(window.height, window.width, transform, grid.crs)


def warp_onto(
    path: Path,
    values: NDArray[Any],
    source: Grid,
    out: NDArray[Any],
    target: Grid,
    rule: Rule,
    **options: Any,
) -> None:
    """Resample an array [(bands,) rows, cols] of `source` into `out` on `target`; `options` as GDAL's warper takes."""
    places: dict[str, Any] = {"src_transform": source.transform, "src_crs": source.crs}
    places |= {"dst_transform": target.transform, "dst_crs": target.crs}
    if source.crs == target.crs:  # then in pixels of the source, which large coordinates would blur
        places = {"src_transform": _UPRIGHT, "dst_transform": _UPRIGHT @ relative(target, source)}
        places |= {"src_crs": _FLAT, "dst_crs": _FLAT}
    try:
        reproject(
            values,
            out,
            resampling=Resampling[rule],
            init_dest_nodata=False,
            **_PLAIN.get(rule, {}),
            **places,
            **options,
        )
    except RasterioError as error:
        raise InputError(path, f"cannot be laid on the other raster: {' '.join(str(error).split())}") from error
