"""A picture of what `hrt` sees of a raster: its pixels as they are taken, what is valid, and how the values lie."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import InputError
from hrt_cli.raster.files import choose_files
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.image import open_orthomosaic
from hrt_cli.report.figures.canvas import (
    MAX_PX,
    Backdrop,
    Entry,
    begin_drawing,
    map_axes,
    map_inches,
    plain,
    show_legend,
    show_title,
)
from hrt_cli.report.figures.layers import show_picture
from hrt_cli.report.figures.palette import CANVAS, INK, SERIES
from hrt_cli.report.figures.site import band_of, show_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Floats = NDArray[np.float64]

STAGE_VERSION = 1
_HISTOGRAM_IN = 1.7
_BINS = 128
_CHANNELS = (("red", "#c1272d", "-"), ("green", "#117733", "--"), ("blue", "#332288", ":"))


def draw_raster(
    paths: Sequence[Path],
    output: Path,
    *,
    caption: str,
    picture: bool,
    bands: tuple[int, ...] = (),
    nodata: float | None = None,
    unreferenced: bool = False,
    existing: Existing,
) -> bool:
    """Draw a raster as it is read here: as a picture of 8 bits, or as the values of its first band.

    Parameters
    ----------
    paths : sequence of Path
        One raster, or the tiles of one orthomosaic.
    output : Path
        The PNG to write.
    caption : str
        The title.
    picture : bool
        Draw what `hrt segment` sees; else the values.
    bands, nodata, unreferenced
        As in `hrt_cli.raster.image.open_orthomosaic`.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        The raster cannot be read, or values are asked of several; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {f"raster/{index}": path for index, path in enumerate(choose_files(paths).files)}
    reading = {"bands": list(bands), "nodata": nodata, "unreferenced": unreferenced, "picture": picture}
    parameters = reading | {"caption": caption}
    job = begin_drawing(
        "figure-raster", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    if picture:
        with open_orthomosaic(paths, bands=bands, nodata=nodata, unreferenced=unreferenced) as image:
            rgb, valid = image.thumbnail(MAX_PX)
            behind = Backdrop(image.grid, np.dstack([rgb, valid.astype(np.uint8) * 255]))
        figure, axes, below = _panels(behind.grid, caption)
        show_picture(axes, behind)
        _show_channels(below, rgb[valid])
        share = float(valid.mean())
    else:
        values, grid = _values(paths, nodata)
        figure, axes, below = _panels(grid, caption)
        show_values(axes, values, grid, "value of band 1")
        known = values[np.isfinite(values)]
        if known.size:
            below.hist(known, bins=_BINS, color=SERIES)
        below.set_xlabel("value of band 1")
        share = known.size / values.size
    show_legend(axes, [Entry(CANVAS, f"not valid, {1 - share:.1%}")] if share < 1 else [])
    job.publish(figure, trimmed=True)
    return False


def _values(paths: Sequence[Path], nodata: float | None) -> tuple[Floats, Grid]:
    """Read the first band of a raster, in pixels where it has no georeference."""
    if len(paths) > 1:
        raise InputError(paths[0], "only tiles that make a picture are drawn together", "give one of them")
    try:
        values, grid, _ = band_of(paths[0], nodata=nodata)
    except InputError:
        values, grid, _ = band_of(paths[0], nodata=nodata, unreferenced=True)
    return values, grid


def _panels(grid: Grid, caption: str) -> tuple[Figure, Axes, Axes]:
    """Return a figure of a map above and a histogram below."""
    from matplotlib.figure import Figure

    width, height = map_inches(grid)
    figure = Figure(figsize=(width + 1.0, height + _HISTOGRAM_IN + 1.4), layout="constrained")
    axes, below = figure.subplots(2, 1, height_ratios=(max(height, 1.0), _HISTOGRAM_IN))
    map_axes(axes, grid)
    show_title(axes, caption, width)
    below.set_ylabel("pixels")
    below.set_yticks([])
    plain(below)
    return figure, axes, below


def _show_channels(axes: Axes, rgb: NDArray[np.uint8]) -> None:
    """Show how often each value is, of each colour; of a grey picture once."""
    grey = bool((rgb[:, 0] == rgb[:, 1]).all() and (rgb[:, 0] == rgb[:, 2]).all())
    channels = (("grey", INK, "-"),) if grey else _CHANNELS
    for channel, (name, colour, dashes) in enumerate(channels):
        counts = np.bincount(rgb[:, channel], minlength=256)
        axes.plot(np.arange(256), counts, color=colour, ls=dashes, lw=1.3, label=name)
    axes.set_xlim(0, 255)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("value, as it is seen in 8 bits")
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
