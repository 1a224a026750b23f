"""A picture of a sample site: orthomosaic, true classes, heights and, where there is one, heat, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.gate import is_nodata, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window
from hrt_cli.report.figures.canvas import (
    begin_drawing,
    class_entries,
    class_picture,
    figure_of,
    map_axes,
    read_backdrop,
    show_caption,
    show_legend,
    show_title,
    size_m,
    thinned,
)
from hrt_cli.report.figures.layers import show_picture
from hrt_cli.report.figures.palette import VALUE_RAMP

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    Floats = NDArray[np.float64]

STAGE_VERSION = 1
_PANEL_PX = 700
_PANEL_IN = 5.0
_CAPTION_CHARS = 110
_SUN_DEG = (315.0, 45.0)
"""Azimuth from the top of the picture, clockwise, and height of the light that shades heights."""


def draw_site(files: Mapping[str, Path], output: Path, *, caption: str, existing: Existing) -> bool:
    """Draw a sample site.

    Parameters
    ----------
    files : mapping of str to Path
        `ortho`, `truth`, `dsm` and, where there is one, `thermal`.
    output : Path
        The PNG to write.
    caption : str
        The title.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        A raster cannot be used; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {role: files[role] for role in ("ortho", "truth", "dsm", "thermal") if role in files}
    parameters = {"caption": caption}
    job = begin_drawing(
        "figure-site", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    from matplotlib.figure import Figure

    behind = read_backdrop(files["ortho"])
    width, height = size_m(behind.grid)
    panel = float(np.clip(_PANEL_IN * height / width, 2.5, 9.0))
    rows, cols = (2, 2) if "thermal" in files else (1, 3)
    figure = Figure(figsize=(cols * (_PANEL_IN + 0.6), rows * (panel + 0.5) + 0.5), layout="compressed")
    show_caption(figure, caption, _CAPTION_CHARS)
    panels = figure.subplots(rows, cols).ravel()
    for axes, title in zip(panels, ("orthomosaic", "true classes", "heights", "heat"), strict=False):
        map_axes(axes, behind.grid)
        show_title(axes, title, _PANEL_IN, size=10)
    show_picture(panels[0], behind)
    _show_truth(panels[1], files["truth"])
    _show_heights(panels[2], files["dsm"])
    if "thermal" in files:
        heat, grid, _ = band_of(files["thermal"])
        show_values(panels[3], heat, grid, "temperature, °C")
    job.publish(figure, trimmed=True)
    return False


def _show_truth(axes: Axes, path: Path) -> None:
    with open_classes(path) as raster:
        values, _ = thinned(raster.read, raster.grid.shape, _PANEL_PX)
        grid, names = raster.grid, raster.names
    axes.imshow(class_picture(values), extent=whole(grid), interpolation="nearest")
    show_legend(axes, class_entries(values, names), width_in=_PANEL_IN)


def band_of(path: Path, *, nodata: float | None = None, unreferenced: bool = False) -> tuple[Floats, Grid, int]:
    """Return every n-th value of the first band as float64 [rows, cols], NaN where there is none; the grid; and n."""
    with open_raster(path, nodata=nodata, unreferenced=unreferenced) as raster:

        def read(window: Window) -> Floats:
            found = raster.read_bands([1], window)[0]
            empty = is_nodata(found, raster.nodata[0])
            if raster.has_mask:
                empty |= ~raster.read_mask(window)
            return np.where(empty, np.nan, found.astype(np.float64))

        values, step = thinned(read, raster.grid.shape, _PANEL_PX)
        return values, raster.grid, step


def hillshade(heights: Floats, row_m: float, col_m: float) -> Floats:
    """Return the brightness in [0, 1] of ground of these heights under a low sun (Horn 1981, with plain differences).

    Parameters
    ----------
    heights : float64 [rows, cols]
        In metres; NaN gives NaN.
    row_m, col_m : float
        Metres between rows and between columns.
    """
    if min(heights.shape) < 2:
        return np.where(np.isnan(heights), np.nan, np.sin(np.radians(_SUN_DEG[1])))
    down, right = np.gradient(heights, row_m, col_m)
    azimuth, high = np.radians(_SUN_DEG)
    # The normal of the ground is (-right, -down, 1); the light comes from (sin a cos h, -cos a cos h, sin h).
    lit = np.cos(high) * (-right * np.sin(azimuth) + down * np.cos(azimuth)) + np.sin(high)
    return np.asarray(np.clip(lit / np.sqrt(1 + right**2 + down**2), 0, 1))


def _show_heights(axes: Axes, path: Path) -> None:
    heights, grid, step = band_of(path)
    row_m, col_m = grid.pixel_m
    show_values(axes, heights, grid, "height, m")
    lit = hillshade(heights, row_m * step, col_m * step)
    level = np.sin(np.radians(_SUN_DEG[1]))
    layer = np.zeros((*lit.shape, 4), np.uint8)
    with np.errstate(invalid="ignore"):
        layer[lit > level, :3] = 255
        layer[..., 3] = np.nan_to_num(np.round(200 * np.abs(lit - level)))
    axes.imshow(layer, extent=whole(grid), interpolation="antialiased")


def show_values(axes: Axes, values: Floats, grid: Grid, label: str) -> None:
    """Show values [rows, cols] that fill a grid, with a colour bar; the outermost hundredths in its last colours."""
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list("value", list(VALUE_RAMP)).with_extremes(bad=(0, 0, 0, 0))
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, (0.01, 0.99)) if known.size else (0.0, 1.0)
    shown = axes.imshow(
        np.ma.masked_invalid(values), extent=whole(grid), cmap=ramp, vmin=low, vmax=high, interpolation="nearest"
    )
    figure_of(axes).colorbar(shown, ax=axes, label=label, shrink=0.7, pad=0.01, extend="both")


def whole(grid: Grid) -> tuple[float, float, float, float]:
    """Return where a picture that fills a grid lies on its map (left, right, bottom, top)."""
    width, height = size_m(grid)
    return 0.0, width, height, 0.0
