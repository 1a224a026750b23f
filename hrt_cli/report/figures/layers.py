"""Layers of a map: the orthomosaic as it is or as shading, scores, no-go ground, paths and places."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap
from hrt_cli.raster.style import NO_GO_COLOUR, SCORE_RAMP, rgb_of
from hrt_cli.raster.track import points_on
from hrt_cli.report.figures.canvas import Backdrop, Entry, size_m
from hrt_cli.report.figures.palette import END, PATH, PATH_EDGE, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Floats = NDArray[np.float64]

NO_GO = Entry(NO_GO_COLOUR, "no-go", "////")
_LUMA = (0.299, 0.587, 0.114)
_HATCHED_PX, _HATCHES, _HATCH_RGB = 1200, 90, 150
_NO_GO_TINT = 0.6
_CASING = 3.2


def extent_on(grid: Grid, base: Grid) -> tuple[float, float, float, float]:
    """Where a raster lies on a map of `base` (left, right, bottom, top), in ground metres."""
    (left, right), (top, bottom) = place_on(grid, base, [0, grid.rows], [0, grid.cols])
    return float(left), float(right), float(bottom), float(top)


def place_on(grid: Grid, base: Grid, rows: ArrayLike, cols: ArrayLike) -> tuple[Floats, Floats]:
    """Return (right, down) in ground metres on a map of `base` of pixel positions [n] of `grid`, in the same CRS."""
    row, col = np.asarray(rows, np.float64), np.asarray(cols, np.float64)
    row_m, col_m = base.pixel_m
    if grid is not base and grid.crs is not None and base.crs is not None:
        x, y = grid.xy(row, col)
        back = ~base.transform
        row, col = back.d * x + back.e * y + back.f, back.a * x + back.b * y + back.c
    return col * col_m, row * row_m


def lonlat_on(path: Path, base: Grid, lonlat: ArrayLike) -> tuple[Floats, Floats]:
    """Return (right, down) in ground metres on a map of `base` of places [n, 2] in degrees, which `path` holds."""
    rows, cols = points_on(path, np.asarray(lonlat, np.float64), "EPSG:4326", base, "map")
    row_m, col_m = base.pixel_m
    return cols * col_m, rows * row_m


def require_aligned(grid: Grid, behind: Backdrop | None) -> None:
    """Refuse a backdrop on which a raster would not lie straight.

    Raises
    ------
    InputError
        Its coordinate reference system is another, or it is turned against the raster.
    """
    if behind is None:
        return
    if grid.crs is None or grid.crs != behind.grid.crs:
        raise InputError("--backdrop", "the orthomosaic and the map have different coordinate reference systems")
    turned = ~_linear(behind.grid) @ _linear(grid)
    if abs(turned.b) + abs(turned.d) > 1e-3 * (abs(turned.a) + abs(turned.e)):
        raise InputError("--backdrop", "the orthomosaic is turned against the map")


def _linear(grid: Grid) -> Affine:
    a, b, _, d, e, _ = grid.transform[:6]
    return Affine(a, b, 0.0, d, e, 0.0)


def show_picture(axes: Axes, behind: Backdrop) -> None:
    """Show the orthomosaic as it is."""
    width, height = size_m(behind.grid)
    axes.imshow(behind.rgba, extent=(0.0, width, height, 0.0), interpolation="antialiased")


def show_shading(axes: Axes, behind: Backdrop | None, strength: float) -> None:
    """Shade what is drawn already by the orthomosaic's light and dark.

    Colours keep their hue, and ground of middling brightness its very colour, so that a legend holds.
    """
    if behind is None:
        return
    luma = behind.rgba[..., :3] @ np.array(_LUMA)
    valid = behind.rgba[..., 3] > 0
    middle = float(np.median(luma[valid])) if valid.any() else 0.0
    reach = max(1.0, float(np.quantile(np.abs(luma[valid] - middle), 0.98))) if valid.any() else 1.0
    lighter = np.clip((luma - middle) / reach, -1, 1)
    layer = np.zeros(behind.rgba.shape, np.uint8)
    layer[lighter > 0, :3] = 255
    layer[..., 3] = np.round(255 * strength * np.abs(lighter) * valid)
    width, height = size_m(behind.grid)
    axes.imshow(layer, extent=(0.0, width, height, 0.0), interpolation="antialiased")


def show_scores(figure: Figure, axes: Axes, scoremap: Scoremap, base: Grid, *, tint: float | None = None) -> None:
    """Show a scoremap with its colour bar, no-go cells grey and hatched; as a tint in (0, 1) of what lies below it."""
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list("score", list(SCORE_RAMP)).with_extremes(bad=(0, 0, 0, 0))
    top = max(1.0, float(np.nanmax(scoremap.score)))
    there = extent_on(scoremap.grid, base)
    scores = np.ma.masked_invalid(scoremap.score)
    shown = axes.imshow(scores, extent=there, cmap=ramp, vmin=0, vmax=top, alpha=tint, interpolation="nearest")
    show_no_go(axes, scoremap, base, faint=tint is not None)
    label = "expected score" if tint is None else "expected score, as a tint"
    bar = figure.colorbar(shown, ax=axes, label=label, shrink=0.6, pad=0.01)
    if bar.solids is not None:
        bar.solids.set_alpha(1.0)


def show_no_go(axes: Axes, scoremap: Scoremap, base: Grid, *, faint: bool = False) -> None:
    """Show the no-go cells of a scoremap grey and hatched, and let what lies below shine through where `faint`."""
    hatched = _hatched(np.isnan(scoremap.score))
    alpha = _NO_GO_TINT if faint else None
    axes.imshow(hatched, extent=extent_on(scoremap.grid, base), alpha=alpha, interpolation="nearest")


def _hatched(no_go: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Draw no-go cells grey with lighter diagonals, told from a grey score without its colour."""
    factor = max(1, _HATCHED_PX // max(no_go.shape))
    mask = no_go.repeat(factor, axis=0).repeat(factor, axis=1)
    period = max(4, max(mask.shape) // _HATCHES)
    rows, cols = np.ogrid[: mask.shape[0], : mask.shape[1]]
    picture = np.zeros((*mask.shape, 4), np.uint8)
    picture[mask] = (*rgb_of(NO_GO_COLOUR), 255)
    picture[mask & ((rows + cols) % period < max(1, period // 5)), :3] = _HATCH_RGB
    return picture


def show_path(axes: Axes, right: ArrayLike, down: ArrayLike, **line: Any) -> None:
    """Draw a path as a light line in a dark edge; `line` as for `Axes.plot`."""
    from matplotlib import patheffects

    width = line.setdefault("lw", 1.6)
    edge = [patheffects.Stroke(linewidth=_CASING / 1.6 * width, foreground=PATH_EDGE), patheffects.Normal()]
    style: dict[str, Any] = {"color": PATH, "zorder": 5, "path_effects": edge}
    axes.plot(right, down, **(style | line))


def show_ends(
    axes: Axes, right: Floats, down: Floats, *, colour: str | None = None, labels: tuple[str, str] = ("start", "end")
) -> None:
    """Mark where a path starts and ends, in colours of their own, or in that of the one of several that it is."""
    # A closed path ends on its start: the square goes first, so that the round mark is seen in it.
    marks = ((-1, "s", END, labels[1], 11, 6), (0, "o", START, labels[0], 8, 7))
    for index, marker, fill, label, size, order in reversed(marks):
        axes.plot(
            right[index],
            down[index],
            marker,
            color=colour or fill,
            ms=size,
            mec=PATH_EDGE if colour else "white",
            mew=1.5,
            label=label,
            zorder=order,
        )


def explain_ends(axes: Axes, labels: tuple[str, str] = ("start", "end")) -> None:
    """Put the marks of the ends of several paths into the legend once."""
    for marker, size, label in (("o", 8, labels[0]), ("s", 11, labels[1])):
        axes.plot([], [], marker, color=PATH, mec=PATH_EDGE, mew=1.5, ms=size, label=label)
