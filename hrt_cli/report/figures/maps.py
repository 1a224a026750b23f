"""Pictures of classes, scoremaps and plans, drawn on the orthomosaic where one is given."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import PlanDocument, TeamPlanDocument, read_plan, team_members
from hrt_cli.artifacts.png import png_provenance, publish_png
from hrt_cli.artifacts.stage import Existing, begin
from hrt_cli.errors import InputError
from hrt_cli.raster.classes import NODATA, open_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.image import open_image
from hrt_cli.raster.scoremap import Scoremap, read_scoremap
from hrt_cli.raster.style import NO_GO_COLOUR, SCORE_RAMP, class_colour, rgb_of
from hrt_cli.raster.windows import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STAGE_VERSION = 2
MAX_PX = 1400
_OVERLAY_ALPHA = 0.55
_PATH_COLOUR = "#ffffff"
_PATH_EDGE = "#111111"
_TEAM_COLOURS = ("#ffffff", "#56b4e9", "#e69f00", "#cc79a7", "#f0e442", "#009e73", "#0072b2", "#d55e00")
_PAD = 0.03


@dataclass(frozen=True)
class Backdrop:
    """The picture that a figure is drawn on: an image [rows, cols, 4] that fills `grid`."""

    grid: Grid
    rgba: NDArray[np.uint8]


def draw_classes(classes_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a class raster with its legend; return whether it was up to date."""
    with _figure("figure-classes", {"classes": classes_path}, output, backdrop, existing) as (job, behind):
        if job is None:
            return True
        with open_classes(classes_path, unreferenced=True) as raster:
            step = max(1, -(-max(raster.grid.shape) // MAX_PX))
            grid = _georeferenced(classes_path) if behind else raster.grid
            rows = [
                raster.read(Window(top, 0, min(step, raster.grid.rows - top), raster.grid.cols))[0, ::step]
                for top in range(0, raster.grid.rows, step)
            ]
            names = raster.names
        values = np.stack(rows)
        ids, counts = np.unique(values[values != NODATA], return_counts=True)
        figure, axes = _canvas(behind.grid if behind else grid, f"{len(ids)} texture classes")
        _show_backdrop(axes, behind)
        rgba = np.zeros((*values.shape, 4), np.uint8)
        for k in ids:
            rgba[values == k] = (*rgb_of(class_colour(int(k))), 255)
        axes.imshow(rgba, extent=_extent(grid, behind), alpha=_OVERLAY_ALPHA if behind else 1, interpolation="nearest")
        labels = [
            (class_colour(int(k)), f"{names[k] if int(k) < len(names) else k}  {n / counts.sum():.0%}")
            for k, n in zip(ids, counts, strict=True)
        ]
        _legend(axes, labels)
        job.publish(figure)
        return False


def draw_scoremap(scoremap_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a scoremap with its colour bar; return whether it was up to date."""
    with _figure("figure-scoremap", {"scoremap": scoremap_path}, output, backdrop, existing) as (job, behind):
        if job is None:
            return True
        scoremap = read_scoremap(scoremap_path)
        go = np.isfinite(scoremap.score)
        title = f"expected score, {scoremap.cell_size_m:g} m cells, mean {scoremap.score[go].mean():.2f}"
        figure, axes = _canvas(behind.grid if behind else scoremap.grid, title)
        _show_backdrop(axes, behind)
        _show_scores(figure, axes, scoremap, behind, _OVERLAY_ALPHA if behind else 1.0)
        _legend(axes, [(NO_GO_COLOUR, "no-go")])
        job.publish(figure)
        return False


def draw_plan(plan_path: Path, scoremap_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a plan on its scoremap, of one robot or of a team; return whether it was up to date."""
    members = team_members(plan_path)
    inputs = {"plan": plan_path, "scoremap": scoremap_path} | {f"robot/{k}": path for k, path in enumerate(members)}
    with _figure("figure-plan", inputs, output, backdrop, existing) as (job, behind):
        if job is None:
            return True
        plans = [read_plan(path) for path in members or [plan_path]]
        whole = read_model(plan_path, TeamPlanDocument) if members else plans[0]
        scoremap = read_scoremap(scoremap_path)
        title = (
            f"{whole.method}: {f'{len(plans)} robots, ' if members else ''}score {whole.score:.1f}, "
            f"{1 - whole.gap:.1%} of the bound, {whole.steps} steps, {whole.length_m:.0f} m"
        )
        figure, axes = _canvas(behind.grid if behind else scoremap.grid, title)
        _show_backdrop(axes, behind)
        _show_scores(figure, axes, scoremap, behind, 0.35 if behind else 0.9)
        for robot, plan in enumerate(plans):
            colour = _PATH_COLOUR if not members else _TEAM_COLOURS[robot % len(_TEAM_COLOURS)]
            _show_path(axes, plan, scoremap.grid, behind, colour, f"robot {robot + 1}" if members else "")
        _legend(axes, [(NO_GO_COLOUR, "no-go")])
        job.publish(figure)
        return False


@dataclass(frozen=True)
class _Job:
    output: Path
    provenance: Any

    def publish(self, figure: Figure) -> None:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
        publish_png(self.output, buffer.getvalue(), self.provenance)


@contextmanager
def _figure(
    stage: str, inputs: dict[str, Path], output: Path, backdrop: Path | None, existing: Existing
) -> Iterator[tuple[_Job | None, Backdrop | None]]:
    given = inputs | ({"backdrop": backdrop} if backdrop else {})
    outputs = {output: png_provenance}
    job = begin(stage, STAGE_VERSION, inputs=given, parameters={}, outputs=outputs, existing=existing)
    if job.up_to_date:
        yield None, None
        return
    yield _Job(output, job.provenance), _read_backdrop(backdrop) if backdrop else None


def _read_backdrop(path: Path) -> Backdrop:
    with open_image(path) as image:
        rgb, valid = image.thumbnail(MAX_PX)
        return Backdrop(image.grid, np.dstack([rgb, valid.astype(np.uint8) * 255]))


def _georeferenced(path: Path) -> Grid:
    with open_classes(path) as raster:
        return raster.grid


def _canvas(grid: Grid, title: str) -> tuple[Figure, Axes]:
    """Return a figure whose axes are ground metres from the raster's first corner, with scale bar and north arrow."""
    from matplotlib.figure import Figure

    row_m, col_m = grid.pixel_m
    height, width = grid.rows * row_m, grid.cols * col_m
    inches = np.clip(9.0 * height / width, 3.5, 14.0)
    figure = Figure(figsize=(10.5, float(inches) + 0.6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("#e8e8e8")
    axes.set_title(title, loc="left", fontsize=11)
    _scale_bar(axes, width, height, "m" if grid.crs is not None else "px")
    if grid.crs is not None:
        _north_arrow(axes, grid, width, height)
    return figure, axes


def _scale_bar(axes: Axes, width: float, height: float, unit: str) -> None:
    from matplotlib.patches import Rectangle

    length = _round_length(width / 5)
    x, y, thick = width * _PAD, height * (1 - _PAD), height * 0.008
    box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "alpha": 0.8, "edgecolor": "none"}
    axes.text(x, y - 2.5 * thick, f"{length:g} {unit}", fontsize=9, va="bottom", bbox=box, zorder=10)
    axes.add_patch(Rectangle((x, y - thick), length, thick, facecolor="black", edgecolor="white", zorder=10))


def _round_length(length: float) -> float:
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * 1.0001))


def _north_arrow(axes: Axes, grid: Grid, width: float, height: float) -> None:
    """Draw where north is; rasters may be rotated."""
    row, col = grid.rows / 2, grid.cols / 2
    lon, lat = grid.lonlat(*grid.xy(row, col))
    step = grid.rows * grid.pixel_m[0] / 4 / 111_000
    x, y = grid.xy_of_lonlat(float(lon[0]), float(lat[0]) + step)
    north_row, north_col = grid.rowcol(x, y)
    across, down = (north_col - col) * grid.pixel_m[1], (north_row - row) * grid.pixel_m[0]
    norm = float(np.hypot(across, down))
    size = 0.06 * min(width, height)
    tip = np.array([width * (1 - _PAD) - size / 2, height * _PAD + size])
    end = tip + np.array([across, down]) / norm * size
    axes.annotate(
        "N",
        xy=(float(end[0]), float(end[1])),
        xytext=(float(tip[0]), float(tip[1])),
        ha="center",
        va="center",
        fontsize=10,
        fontweight="bold",
        bbox={"boxstyle": "circle,pad=0.2", "facecolor": "white", "alpha": 0.8, "edgecolor": "none"},
        arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.5},
        zorder=10,
    )


def _extent(grid: Grid, behind: Backdrop | None) -> tuple[float, float, float, float]:
    """Where a layer lies on the canvas (left, right, bottom, top), in ground metres."""
    base = behind.grid if behind else grid
    (top, left), (bottom, right) = _place(grid, base, [0, grid.rows], [0, grid.cols])
    return left, right, bottom, top


def _place(grid: Grid, base: Grid, rows: Any, cols: Any) -> list[tuple[float, float]]:
    """Return (down, across) in ground metres on `base` of pixel positions of `grid`."""
    row_m, col_m = base.pixel_m
    if grid.crs is None or base.crs is None or grid is base:
        scale_row, scale_col = grid.pixel_m if base is grid else (1.0, 1.0)
        return [(r * scale_row, c * scale_col) for r, c in zip(rows, cols, strict=True)]
    x, y = grid.xy(rows, cols)
    placed = [base.rowcol(float(px), float(py)) for px, py in zip(x, y, strict=True)]
    return [(r * row_m, c * col_m) for r, c in placed]


def _show_backdrop(axes: Axes, behind: Backdrop | None) -> None:
    if behind is not None:
        axes.imshow(behind.rgba, extent=_extent(behind.grid, behind), interpolation="antialiased")


def _show_scores(figure: Figure, axes: Axes, scoremap: Scoremap, behind: Backdrop | None, alpha: float) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    _require_aligned(scoremap.grid, behind)
    ramp = LinearSegmentedColormap.from_list("score", list(SCORE_RAMP)).with_extremes(bad=(0, 0, 0, 0))
    top = max(1.0, float(np.nanmax(scoremap.score)))
    shown = axes.imshow(
        np.ma.masked_invalid(scoremap.score),
        extent=_extent(scoremap.grid, behind),
        cmap=ramp,
        vmin=0,
        vmax=top,
        alpha=alpha,
        interpolation="nearest",
    )
    no_go = np.zeros((*scoremap.score.shape, 4), np.uint8)
    no_go[np.isnan(scoremap.score)] = (*rgb_of(NO_GO_COLOUR), 150 if behind else 255)
    axes.imshow(no_go, extent=_extent(scoremap.grid, behind), interpolation="nearest")
    bar = figure.colorbar(shown, ax=axes, label="expected score", shrink=0.6, pad=0.01)
    if bar.solids is not None:
        bar.solids.set_alpha(1.0)


def _show_path(axes: Axes, plan: PlanDocument, grid: Grid, behind: Backdrop | None, colour: str, name: str) -> None:
    """Draw a path; one of several bears a name and its number at the start."""
    from matplotlib import patheffects

    cells = np.array(plan.cells)
    placed = np.array(_place(grid, behind.grid if behind else grid, cells[:, 0] + 0.5, cells[:, 1] + 0.5))
    edge = [patheffects.Stroke(linewidth=3.2, foreground=_PATH_EDGE), patheffects.Normal()]
    axes.plot(placed[:, 1], placed[:, 0], color=colour, lw=1.6, path_effects=edge, zorder=5, label=name or "_nolegend_")
    # A closed path ends on its start: the square goes first, so that the round mark is seen in it.
    for index, marker, fill, label in ((-1, "s", "#d62728", "end"), (0, "o", "#2ca02c", "start")):
        axes.plot(
            placed[index, 1],
            placed[index, 0],
            marker,
            color=colour if name else fill,
            ms=11 if marker == "s" else 8,
            mec="white" if not name else "#111111",
            mew=1.5,
            label="_nolegend_" if name else label,
            zorder=6,
        )


def _legend(axes: Axes, labels: list[tuple[str, str]]) -> None:
    """Put a legend below the picture, where it hides nothing, after the marks that are already drawn."""
    from matplotlib.patches import Patch

    patches = [Patch(facecolor=colour, edgecolor="black", lw=0.5, label=text) for colour, text in labels]
    marks = axes.get_legend_handles_labels()[0]
    axes.legend(
        handles=[*marks, *patches], loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=6, fontsize=9, frameon=False
    )


def _require_aligned(grid: Grid, behind: Backdrop | None) -> None:
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
