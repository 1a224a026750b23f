"""What all figures share: when one is drawn and how it is published, and maps in ground metres with their furniture."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.png import png_provenance, publish_png
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.stage import Existing, begin
from hrt_cli.raster.classes import NODATA
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.image import open_image
from hrt_cli.raster.style import class_colour, rgb_of
from hrt_cli.raster.windows import Window
from hrt_cli.report.figures.palette import CANVAS, GRID

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Floats = NDArray[np.float64]

MAX_PX = 1400
_DPI = 110
_MAP_IN, _MOST_IN = 9.0, (14.0, 12.0)
_LOW_IN, _LOWEST_IN = 2.4, 0.6
"""Side of a map; of one much wider or taller than that: at most so wide and high; below this height it gets wider;
below that its scale bar has no room for a text above it."""
_CHARS_PER_IN = 11.5
_LINE_IN = 0.2
_MAX_NAME = 32
_MAX_ENTRIES = 36
_INSET_PT, _ARROW_PT = 10.0, 13.0
_BOX = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none"}


@dataclass(frozen=True)
class Drawing:
    """A figure that may be written, decided before the work: where it goes, and whether it is there already."""

    output: Path
    provenance: Provenance
    up_to_date: bool

    def publish(self, figure: Figure, *, trimmed: bool = False) -> None:
        """Publish the figure as a PNG; `trimmed` of the margin that its axes leave, as maps of any shape do."""
        buffer = io.BytesIO()
        cut: dict[str, Any] = {"bbox_inches": "tight", "pad_inches": 0.12} if trimmed else {}
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None}, **cut)
        publish_png(self.output, buffer.getvalue(), self.provenance)


def begin_drawing(
    stage: str,
    version: int,
    *,
    inputs: dict[str, Path],
    output: Path,
    existing: Existing,
    parameters: Mapping[str, Any] | None = None,
) -> Drawing:
    """Decide whether a figure has to be drawn.

    Parameters
    ----------
    stage, version, inputs, parameters
        As in `hrt_cli.artifacts.stage.begin`.
    output : Path
        The PNG to write.
    existing : Existing
        What to do where `output` exists.

    Raises
    ------
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    outputs = {output: png_provenance}
    job = begin(stage, version, inputs=inputs, parameters=dict(parameters or {}), outputs=outputs, existing=existing)
    return Drawing(output, job.provenance, job.up_to_date)


@dataclass(frozen=True)
class Backdrop:
    """The picture that a figure is drawn on: an image [rows, cols, 4] that fills `grid`."""

    grid: Grid
    rgba: NDArray[np.uint8]


def read_backdrop(path: Path) -> Backdrop:
    """Read an orthomosaic as a backdrop of at most `MAX_PX` rows and columns."""
    with open_image(path) as image:
        rgb, valid = image.thumbnail(MAX_PX)
        return Backdrop(image.grid, np.dstack([rgb, valid.astype(np.uint8) * 255]))


def thinned(
    read: Callable[[Window], NDArray[Any]], shape: tuple[int, int], most: int = MAX_PX
) -> tuple[NDArray[Any], int]:
    """Read every n-th pixel of a band, so that neither side has more than `most`; return them and n."""
    rows, cols = shape
    step = max(1, -(-max(rows, cols) // most))
    return np.stack([read(Window(row, 0, 1, cols))[0, ::step] for row in range(0, rows, step)]), step


def size_m(grid: Grid) -> tuple[float, float]:
    """Return width and height of a raster in ground metres (pixels where it is unreferenced)."""
    row_m, col_m = grid.pixel_m
    return grid.cols * col_m, grid.rows * row_m


def map_canvas(grid: Grid, title: str, *, unit: str | None = None) -> tuple[Figure, Axes]:
    """Return a figure whose axes are a map as `map_axes` makes it, of a size that suits the raster's shape."""
    from matplotlib.figure import Figure

    width, height = map_inches(grid)
    figure = Figure(figsize=(max(width, _MAP_IN / 2) + 1.5, max(height, 1.0) + 0.6), layout="constrained")
    axes = figure.add_subplot()
    map_axes(axes, grid, unit=unit)
    show_title(axes, title, width + 1.0)
    return figure, axes


def map_inches(grid: Grid) -> tuple[float, float]:
    """Return width and height of the map of a raster on paper: as large as suits its shape, wide or tall."""
    width_m, height_m = size_m(grid)
    ratio = height_m / width_m
    width = _MAP_IN if ratio * _MAP_IN >= _LOW_IN else min(_MOST_IN[0], _LOW_IN / ratio)
    height = min(_MOST_IN[1], ratio * width)
    return height / ratio, height


def map_axes(axes: Axes, grid: Grid, *, unit: str | None = None) -> None:
    """Make axes a map: ground metres from the raster's first corner, with scale bar and north arrow.

    Parameters
    ----------
    grid : Grid
        What the axes show.
    unit : str, optional
        Of lengths; by default metres, and pixels where the grid is unreferenced.
    """
    width_m, height_m = size_m(grid)
    axes.set_xlim(0, width_m)
    axes.set_ylim(height_m, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(CANVAS)
    show_furniture(axes, grid, unit=unit)


def show_furniture(axes: Axes, grid: Grid, *, unit: str | None = None) -> None:
    """Draw scale bar and north arrow on axes in ground metres; see `map_axes`."""
    width_m, height_m = size_m(grid)
    length = round_length(max(width_m / 5, min(0.7 * width_m, height_m / 12)))
    _scale_bar(axes, length, unit or ("m" if grid.crs is not None else "px"), beside=map_inches(grid)[1] < _LOWEST_IN)
    if grid.crs is not None:
        _north_arrow(axes, grid)


def show_title(axes: Axes, title: str, width_in: float, *, size: float = 11.0) -> None:
    """Set a title above the left edge, wrapped to a width, for which the figure gets the room."""
    chars = max(24, int(width_in * _CHARS_PER_IN * 11.0 / size))
    lines = [part for line in title.split("\n") for part in textwrap.wrap(line, chars) or [""]]
    axes.set_title("\n".join(lines), loc="left", fontsize=size, parse_math=False)
    figure_of(axes).set_figheight(figure_of(axes).get_figheight() + len(lines) * _LINE_IN)


def show_caption(figure: Figure, caption: str, chars: int, *, size: float = 11.0) -> None:
    """Set a caption over the whole figure, wrapped."""
    lines = "\n".join(textwrap.wrap(caption, chars))
    figure.suptitle(lines, x=0.01, ha="left", fontsize=size, parse_math=False)


def _scale_bar(axes: Axes, length: float, unit: str, *, beside: bool) -> None:
    """Draw a bar above the lower left corner, as thick on any map, with its length above it or `beside` it."""
    from matplotlib import patheffects
    from matplotlib.transforms import ScaledTranslation

    inset = ScaledTranslation(_INSET_PT / 72, _INSET_PT / 72, figure_of(axes).dpi_scale_trans)
    there = axes.get_xaxis_transform() + inset
    edge = [patheffects.withStroke(linewidth=6.0, foreground="white")]
    axes.plot(
        [0, length], [0, 0], color="black", lw=4.0, solid_capstyle="butt", path_effects=edge, transform=there,
        clip_on=False, zorder=10, label="_scale",
    )  # fmt: skip
    at, offset, side = ((length, 0), (7, 0), "center") if beside else ((0, 0), (0, 7), "bottom")
    box = {"boxstyle": "round,pad=0.25", **_BOX}
    axes.annotate(
        f"{length:g} {unit}", at, offset, xycoords=there, textcoords="offset points", fontsize=9, va=side, bbox=box,
        zorder=10,
    )  # fmt: skip


def round_length(length: float) -> float:
    """Return the greatest of 1, 2, 5, 10, ... that is no more than `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * 1.0001))


def north_of(grid: Grid) -> tuple[float, float]:
    """Return where north is on the map, as a unit vector (right, down); rasters may be rotated."""
    row, col = grid.rows / 2, grid.cols / 2
    lon, lat = grid.lonlat(*grid.xy([row], [col]))
    step = grid.rows * grid.pixel_m[0] / 4 / 111_000
    x, y = grid.xy_of_lonlat(float(lon[0]), float(lat[0]) + step)
    north_row, north_col = grid.rowcol(x, y)
    across, down = (north_col - col) * grid.pixel_m[1], (north_row - row) * grid.pixel_m[0]
    norm = float(np.hypot(across, down))
    return across / norm, down / norm


def _north_arrow(axes: Axes, grid: Grid) -> None:
    from matplotlib.text import OffsetFrom

    across, down = north_of(grid)
    corner = OffsetFrom(axes.bbox, (1, 1), unit="points")
    middle = -(_INSET_PT + _ARROW_PT)
    axes.annotate(
        "N",
        xy=(middle + across * _ARROW_PT, middle - down * _ARROW_PT),
        xycoords=corner,
        xytext=(middle - across * _ARROW_PT, middle + down * _ARROW_PT),
        textcoords=corner,
        ha="center",
        va="center",
        fontsize=10,
        fontweight="bold",
        bbox={"boxstyle": "circle,pad=0.2", **_BOX},
        arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.5},
        zorder=10,
    )


@dataclass(frozen=True)
class Entry:
    """An entry of a legend: a coloured patch, hatched where `hatch` says so."""

    colour: str
    text: str
    hatch: str = ""

    def artist(self) -> Artist:
        """Return the patch."""
        from matplotlib.patches import Patch

        edge = "white" if self.hatch else "black"
        return Patch(facecolor=self.colour, edgecolor=edge, lw=0.5, hatch=self.hatch, label=" ")


def show_legend(axes: Axes, entries: Sequence[Entry] = (), *, width_in: float = _MAP_IN) -> None:
    """Put a legend below the picture, where it hides nothing: the marks that are drawn already, then the entries.

    Of more than `_MAX_ENTRIES` the rest is counted.
    """
    marks, names = axes.get_legend_handles_labels()
    handles = [*marks, *(each.artist() for each in entries)]
    texts = [shortened(text) for text in [*names, *(each.text for each in entries)]]
    if len(handles) > _MAX_ENTRIES:
        from matplotlib.patches import Patch

        texts = [*texts[: _MAX_ENTRIES - 1], f"and {len(texts) - _MAX_ENTRIES + 1} more"]
        handles = [*handles[: _MAX_ENTRIES - 1], Patch(alpha=0, label=" ")]
    if not handles:
        return
    columns = int(np.clip(width_in * _CHARS_PER_IN * 1.1 / (max(map(len, texts)) + 7), 1, 6))
    # The map is to keep its size.
    figure, rows = figure_of(axes), -(-len(handles) // columns)
    figure.set_figheight(figure.get_figheight() + rows * _LINE_IN)
    # The texts are set afterwards: a label that begins with _ would be left out.
    legend = axes.legend(
        handles=handles, labels=[" "] * len(handles), loc="upper center", bbox_to_anchor=(0.5, -0.01),
        ncols=min(columns, len(handles)), fontsize=9, frameon=False,
    )  # fmt: skip
    for shown, text in zip(legend.get_texts(), texts, strict=True):
        shown.set_parse_math(False)
        shown.set_text(text)


def class_entries(ids: NDArray[np.uint8], names: Sequence[str]) -> list[Entry]:
    """Return the legend of a class raster: the classes among `ids`, with their share of what has a class."""
    found, counts = np.unique(ids[ids != NODATA], return_counts=True)
    shares = zip(found.tolist(), (counts / max(1, counts.sum())).tolist(), strict=True)
    return [
        Entry(class_colour(k), f"{names[k] if k < len(names) and names[k] else k}  {share:.0%}") for k, share in shares
    ]


def class_picture(ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return classes in their colours [rows, cols, 4], transparent where there is none."""
    colours = np.array([(*rgb_of(class_colour(k)), 255) for k in range(NODATA)] + [(0, 0, 0, 0)], np.uint8)
    return np.asarray(colours[ids])


def shortened(text: str, most: int = _MAX_NAME) -> str:
    """Return a name that is not too long for a figure."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def plain(axes: Axes) -> None:
    """Give axes of a chart a light grid and no box."""
    axes.grid(color=GRID, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def figure_of(axes: Axes) -> Figure:
    """Return the figure that axes are drawn in."""
    from matplotlib.figure import Figure

    found = axes.get_figure(root=True)
    if not isinstance(found, Figure):
        raise TypeError("the axes are in no figure")
    return found
