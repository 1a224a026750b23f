"""Rasters and areas as layers of a page's map: pixels with their place, their legend and their colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.errors import HrtError, InputError
from hrt_cli.raster.align import real_values, warp_onto
from hrt_cli.raster.aoi import read_aoi
from hrt_cli.raster.classes import NODATA, open_classes
from hrt_cli.raster.gate import Raster, is_plain, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import VOID, in_metres, open_heights
from hrt_cli.raster.image import open_image
from hrt_cli.raster.scoremap import read_scoremap
from hrt_cli.raster.style import NO_GO_COLOUR, SCORE_RAMP, class_colour
from hrt_cli.raster.thermal import in_celsius, settle
from hrt_cli.raster.windows import Window
from hrt_cli.report.figures.palette import VALUE_RAMP
from hrt_cli.report.page.frame import Frame
from hrt_cli.report.page.pictures import levels, packed, webp

_WEBP_QUALITY = 78
_STRIP_PX = 4_000_000
"""Pixels that are read at once."""
_BENT_PX = 0.25
"""Layers whose place an affine transform misses by more pixels than this are resampled."""
_VALUES = tuple((k / (len(VALUE_RAMP) - 1), colour) for k, colour in enumerate(VALUE_RAMP))
_SD_RAMP = ((0.0, "#f7fbff"), (0.5, "#6baed6"), (1.0, "#08306b"))
_SUN_AZIMUTH_RAD, _SUN_HEIGHT_RAD = np.radians(315.0), np.radians(45.0)

Ramp = tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class Pixels:
    """What is to be shown of a raster: `values` [rows, cols(, 4)] on `grid`."""

    values: NDArray[Any]
    grid: Grid


def thinned(grid: Grid, most: int) -> tuple[int, Grid]:
    """Return every how many pixels to take so that neither side has more than `most`, and the grid of those.

    Pixel (r, c) of it lies where pixel (r, c) x step does, and fills the square that it stands for.
    """
    step = max(1, -(-max(grid.shape) // most))
    shape = tuple(-(-side // step) for side in grid.shape)
    return step, Grid(shape[0], shape[1], grid.transform @ Affine.scale(step), grid.crs)


def picture_layer(path: Path, frame: Frame, most: int, **about: Any) -> dict[str, Any]:
    """Return an orthomosaic as a layer, with at most `most` rows and columns."""
    with open_image(path, unreferenced=is_plain(path)) as image:
        rgb, valid = image.thumbnail(most)
        _, grid = thinned(image.grid, most)
    rgba = np.dstack([rgb, np.where(valid, 255, 0).astype(np.uint8)])
    rgba[~valid] = 0  # what is not valid would cost bytes
    placed = _placed(path, Pixels(rgba, grid), frame, 0)
    return about | _geometry(placed, frame) | {"type": "image", "href": webp(placed.values, _WEBP_QUALITY)}


def class_layer(path: Path, frame: Frame, most: int, **about: Any) -> dict[str, Any]:
    """Return a class raster as a layer with its legend: names, colours, shares of the pixels, ids."""
    with open_classes(path, unreferenced=is_plain(path)) as raster:
        step, grid = thinned(raster.grid, most)
        rows, counts = [], np.zeros(256, np.int64)
        for top in range(0, raster.grid.rows, step):
            values = raster.read(Window(top, 0, min(step, raster.grid.rows - top), raster.grid.cols))
            counts += np.bincount(values.ravel(), minlength=256)
            middle = np.minimum(np.arange(step // 2, grid.cols * step, step), raster.grid.cols - 1)
            rows.append(values[values.shape[0] // 2, middle])
        names = raster.names
    counts[NODATA] = 0
    placed = _placed(path, Pixels(np.stack(rows), grid), frame, NODATA)
    legend = [
        {
            "id": k,
            "colour": class_colour(k),
            "label": names[k] if k < len(names) and names[k] else f"class {k}",
            "share": float(counts[k] / counts.sum()),
        }
        for k in np.flatnonzero(counts).tolist()
    ]
    data = {"type": "ids", "data": packed(placed.values), "nodata": NODATA, "legend": legend}
    return about | _geometry(placed, frame) | data


def score_layers(path: Path, frame: Frame, **about: Any) -> dict[str, dict[str, Any]]:
    """Return a scoremap's layers: `score`, `no_go`, and `sd` where there is any."""
    found = read_scoremap(path)
    top = max(1.0, float(np.nanmax(found.score)))
    no_go = np.where(np.isnan(found.score), 0, NODATA).astype(np.uint8)
    score = _placed(path, Pixels(found.score, found.grid), frame, np.nan)
    layers = {
        "score": about | value_data(score, frame, (0.0, top), SCORE_RAMP, "score"),
        "no_go": about
        | _geometry(closed := _placed(path, Pixels(no_go, found.grid), frame, NODATA), frame)
        | {
            "type": "ids",
            "data": packed(closed.values),
            "nodata": NODATA,
            "legend": [{"id": 0, "colour": NO_GO_COLOUR, "label": "no-go", "share": float(np.mean(no_go == 0))}],
        },
    }
    if np.nanmax(found.sd) > 0:
        sd = _placed(path, Pixels(found.sd, found.grid), frame, np.nan)
        layers["sd"] = about | value_data(sd, frame, (0.0, float(np.nanmax(found.sd))), _SD_RAMP, "sd of the score")
    return layers


def heat_layer(path: Path, frame: Frame, most: int, **about: Any) -> dict[str, Any]:
    """Return a thermal orthomosaic in degrees Celsius, or in its own unit where that is not sure."""
    with open_raster(path, unreferenced=is_plain(path)) as raster:
        pixels = _averaged(raster, most)
        try:
            units, _ = settle(raster, "auto")
        except InputError:  # not certain: then its own numbers are shown
            units = None
        values = pixels.values if units is None else in_celsius(pixels.values, raster, units).astype(np.float32)
    placed = _placed(path, Pixels(values, pixels.grid), frame, np.nan)
    unit = "°C" if units is not None else "in the file's unit"
    return about | value_data(placed, frame, _span(placed.values), _VALUES, f"temperature, {unit}")


def measured_layer(path: Path, frame: Frame, most: int, label: str, **about: Any) -> dict[str, Any]:
    """Return the first band of a raster of measured values."""
    with open_raster(path, unreferenced=is_plain(path)) as raster:
        pixels = _averaged(raster, most)
    placed = _placed(path, pixels, frame, np.nan)
    return about | value_data(placed, frame, _span(placed.values), _VALUES, label)


def relief_layer(path: Path, frame: Frame, most: int, **about: Any) -> dict[str, Any]:
    """Return a surface model as a shaded relief, lit from the north-west, whose heights can be read off.

    Shading after Horn (1981), Hill shading and the reflectance map, Proc. IEEE 69(1), Lambert's law.
    """
    with open_heights(path) as raster:
        pixels = _averaged(raster, most, void=VOID)
        height = in_metres(raster, pixels.values)
    placed = _placed(path, Pixels(height.astype(np.float32), pixels.grid), frame, np.nan)
    affine, _ = frame.affine_of(placed.grid)
    down, across = np.gradient(placed.values.astype(np.float64))
    # From (col, row) to (east, north): the gradient goes by the inverse transposed.
    inverse = ~affine
    east, north = across * inverse.a + down * inverse.d, across * inverse.b + down * inverse.e
    sun = np.sin(_SUN_AZIMUTH_RAD), np.cos(_SUN_AZIMUTH_RAD)
    lit = np.sin(_SUN_HEIGHT_RAD) - np.cos(_SUN_HEIGHT_RAD) * (east * sun[0] + north * sun[1])
    shade = np.clip(lit / np.sqrt(1 + east**2 + north**2), 0.0, 1.0)
    known = np.isfinite(shade)
    grey = np.where(known, np.rint(255 * shade), 0).astype(np.uint8)
    rgba = np.dstack([grey, grey, grey, np.where(known, 255, 0).astype(np.uint8)])
    low, high = _span(placed.values)
    read_off = {"data": packed(levels(placed.values, low, high)), "low": low, "high": high, "label": "height, m"}
    return about | _geometry(placed, frame) | {"type": "image", "href": webp(rgba, _WEBP_QUALITY)} | read_off


def area_layer(path: Path, frame: Frame, **about: Any) -> dict[str, Any]:
    """Return the polygons of an area of interest or of keep-outs, as rings of metres."""
    rings = []
    for outer, holes in read_aoi(path).lonlat_polygons():
        for ring in (outer, *holes):
            east, north = frame.of_lonlat(ring[:, 0], ring[:, 1])
            rings.append(np.round(np.stack([east, north], axis=1), 3).tolist())
    return about | {"type": "area", "rings": rings}


def value_data(pixels: Pixels, frame: Frame, span: tuple[float, float], ramp: Ramp, label: str) -> dict[str, Any]:
    """Return real values, NaN where there are none, as a layer that a page colours and reads off."""
    data = packed(levels(pixels.values, *span))
    more = {"low": span[0], "high": span[1], "ramp": [list(stop) for stop in ramp], "label": label}
    return _geometry(pixels, frame) | {"type": "values", "data": data} | more


def _averaged(raster: Raster, most: int, void: tuple[float, ...] = ()) -> Pixels:
    """Return the first band thinned out, each pixel the mean of what is known of its square; read strip by strip."""
    step, grid = thinned(raster.grid, most)
    rows, cols = raster.grid.shape
    tall = step * max(1, _STRIP_PX // (step * cols))
    strips = []
    for top in range(0, rows, tall):
        values = real_values(raster, Window(top, 0, min(tall, rows - top), cols))
        for empty in void:
            values[values == np.float32(empty)] = np.nan
        strips.append(_means(values, step))
    return Pixels(np.concatenate(strips), grid)


def _means(values: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return the mean of each square of `step` pixels, at the edge of the rest of one; NaN where nothing is known."""
    if step == 1:
        return values
    rows, cols = (-(-side // step) for side in values.shape)
    whole = np.full((rows * step, cols * step), np.nan, np.float32)
    whole[: values.shape[0], : values.shape[1]] = values
    squares = whole.reshape(rows, step, cols, step)
    known = np.isfinite(squares)
    count = known.sum(axis=(1, 3))
    total = np.where(known, squares, 0).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _span(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not known.size:
        raise HrtError("holds no value that can be shown")
    return float(known.min()), float(known.max())


def _placed(path: Path, pixels: Pixels, frame: Frame, nothing: float) -> Pixels:
    """Return pixels that an affine transform can put in their place, resampled (nearest) where it could not."""
    if frame.crs is None or frame.affine_of(pixels.grid)[1] <= _BENT_PX:
        return pixels
    west, south, east, north = frame.box_of(pixels.grid)
    side = float(np.mean(pixels.grid.pixel_m))
    rows, cols = (max(1, int(np.ceil(extent / side))) for extent in (north - south, east - west))
    upright = Grid(rows, cols, Affine(side, 0, west, 0, -side, north), frame.crs)
    source = pixels.values if pixels.values.ndim == 2 else np.moveaxis(pixels.values, 2, 0)
    out = np.full((*source.shape[:-2], rows, cols), nothing, source.dtype)
    rule: Literal["nearest"] = "nearest"
    warp_onto(path, np.ascontiguousarray(source), pixels.grid, out, upright, rule, dst_nodata=nothing)
    return Pixels(out if out.ndim == 2 else np.moveaxis(out, 0, 2), upright)


def _geometry(pixels: Pixels, frame: Frame) -> dict[str, Any]:
    affine, _ = frame.affine_of(pixels.grid)
    return {
        "rows": pixels.grid.rows,
        "cols": pixels.grid.cols,
        "affine": [affine.a, affine.b, affine.c, affine.d, affine.e, affine.f],
    }
