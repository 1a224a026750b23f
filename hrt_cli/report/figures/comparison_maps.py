"""Maps of a comparison: class rasters and scoremaps side by side, walks and drives on one another."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.drives import origin_of, places_of
from hrt_cli.evaluation.compare.grids import is_same_grid
from hrt_cli.evaluation.compare.plans import read_walks, walk_places
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.classes import NODATA, ClassRaster, open_classes
from hrt_cli.raster.gate import is_plain
from hrt_cli.raster.grid import Grid, lattice_offset
from hrt_cli.raster.scoremap import Scoremap, read_scoremap
from hrt_cli.raster.style import NO_GO_COLOUR, SCORE_RAMP, class_colour, rgb_of
from hrt_cli.raster.track import plan_grid
from hrt_cli.raster.windows import Window
from hrt_cli.report.figures.canvas import show_furniture
from hrt_cli.report.figures.palette import BLUE, CANVAS, GREEN, GRID, ORANGE, PATH_EDGE, RIGHT, SOFT, VOID, WRONG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hrt_cli.evaluation.compare.result import Verdict

OF_A, OF_B = BLUE, ORANGE
"""Colours of A and B."""
PANEL_PX = 700
_SAME, _CHANGED, _VOID = RIGHT, WRONG, VOID
_BECAME_NO_GO, _BECAME_GO = PATH_EDGE, GREEN
_PANEL_INCHES = 4.6
_MAX_LABELLED = 16
_MAX_NAME = 18


def draw_classes(a: Path, b: Path, verdicts: Sequence[Verdict], caption: str) -> Figure:
    """Draw A, B in the same colours, and the pixels whose id differs where they lie on one another."""
    from matplotlib.patches import Patch

    with open_classes(a, unreferenced=is_plain(a)) as of_a, open_classes(b, unreferenced=is_plain(b)) as of_b:
        thumbnails = [_thumbnail(each) for each in (of_a, of_b)]
        grids, names = (of_a.grid, of_b.grid), (of_a.names, of_b.names)
        offset = lattice_offset(*grids)
        changed = None if offset is None else _changed(of_a, of_b, offset)
    colours = np.array([rgb_of(class_colour(k)) for k in range(NODATA)] + [rgb_of(_VOID)], np.uint8)
    figure, panels = _panels(grids[0], 2 if changed is None else 3, caption)
    for axes, ids, grid, name in zip(panels[:2], thumbnails, grids, "AB", strict=True):
        _show(axes, colours[ids], grid, name)
    handles = _class_patches(thumbnails, names)
    if changed is not None:
        ids = thumbnails[0]
        picture = np.empty((*ids.shape, 3), np.uint8)
        picture[...] = rgb_of(_SAME)
        picture[ids == NODATA] = rgb_of(_VOID)
        picture[_thicken(changed)] = rgb_of(_CHANGED)
        _show(panels[2], picture, grids[0], f"where ids differ: {_told(verdicts, 'changed', 100, '%')}")
        handles.append(Patch(facecolor=_CHANGED, edgecolor="black", lw=0.5, label="differs"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    return figure


def draw_scoremaps(a: Path, b: Path, verdicts: Sequence[Verdict], caption: str) -> Figure:
    """Draw A, B on one scale, and B less A with the cells that may or may not be entered any more."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Patch

    of_a, of_b = read_scoremap(a), read_scoremap(b)
    same = is_same_grid(a, of_a.grid, b, of_b.grid)
    figure, panels = _panels(of_a.grid, 3 if same else 2, caption)
    ramp = LinearSegmentedColormap.from_list("score", list(SCORE_RAMP)).with_extremes(bad=NO_GO_COLOUR)
    top = max(float(np.nanmax(each.score)) for each in (of_a, of_b))
    for axes, each, name in zip(panels[:2], (of_a, of_b), "AB", strict=True):
        shown = _show(axes, np.ma.masked_invalid(each.score), each.grid, name, cmap=ramp, vmin=0, vmax=max(top, 1e-9))
    bar: dict[str, Any] = {"location": "bottom", "shrink": 0.9, "pad": 0.02}
    figure.colorbar(shown, ax=list(panels[:2]), label="expected score", **{**bar, "shrink": 0.45})
    handles = [Patch(facecolor=NO_GO_COLOUR, edgecolor="black", lw=0.5, label="no-go")]
    if same:
        handles += _show_gap(figure, panels[2], of_a, of_b, verdicts, bar)
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    return figure


def _show_gap(
    figure: Figure, axes: Axes, a: Scoremap, b: Scoremap, verdicts: Sequence[Verdict], bar: dict[str, Any]
) -> list[Any]:
    from matplotlib.patches import Patch

    gap = b.score - a.score
    reach = float(np.nanmax(np.abs(gap))) if np.isfinite(gap).any() else 0.0
    title = f"B less A: RMSE {_told(verdicts, 'rmse')}, max {_told(verdicts, 'max')}"
    limit = reach or 1.0
    shown = _show(axes, np.ma.masked_invalid(gap), a.grid, title, cmap="PuOr", vmin=-limit, vmax=limit)
    go_a, go_b = np.isfinite(a.score), np.isfinite(b.score)
    over = np.zeros((*gap.shape, 4), np.uint8)
    handles = []
    for where, colour, label in (
        (~go_a & ~go_b, NO_GO_COLOUR, ""),
        (go_a & ~go_b, _BECAME_NO_GO, "no-go in B only"),
        (go_b & ~go_a, _BECAME_GO, "no-go in A only"),
    ):
        over[where] = (*rgb_of(colour), 255)
        if label and where.any():
            text = f"{label} ({int(where.sum())} cells)"
            handles.append(Patch(facecolor=colour, edgecolor="black", lw=0.5, label=text))
    _show(axes, over, a.grid, title)
    figure.colorbar(shown, ax=axes, label="difference of the score", **bar)
    return handles


def draw_plans(a: Path, b: Path, scoremap: Path | None, caption: str) -> Figure:
    """Draw both walks on one map, on a scoremap where it is given."""
    ways: list[list[NDArray[np.float64]]] = [[], []]
    grids = [plan_grid(path, read_walks(path)[0]) for path in (a, b)]
    for index, (path, found) in enumerate(zip((a, b), ways, strict=True)):
        for plan in read_walks(path):
            if (grids[0].crs is None) != (grids[index].crs is None):
                raise InputError(b, f"cannot be drawn on one map with {a}: one has no CRS")
            found.append(walk_places(np.array(plan.cells, np.int64), plan_grid(path, plan), grids[0]))
    behind = None
    if scoremap is not None:
        behind = read_scoremap(scoremap)
        if not is_same_grid(scoremap, behind.grid, a, grids[0]):
            raise InputError(scoremap, f"is not the grid that {a} was planned on")
    return _ways(ways, (a, b), grids[0], behind, caption)


def draw_drives(a: Path, b: Path, caption: str) -> Figure:
    """Draw both tracks on one map."""
    logs = [read_drive_log(path, as_it_stands=True) for path in (a, b)]
    origin = origin_of(a, logs[0])
    if (origin is None) != (origin_of(b, logs[1]) is None):
        raise InputError(b, f"cannot be drawn on one map with {a}: only one of them has a place on it")
    ways = [[places_of(path, log, origin)] for path, log in zip((a, b), logs, strict=True)]
    return _ways(ways, (a, b), None, None, caption)


def _ways(
    ways: list[list[NDArray[np.float64]]],
    paths: tuple[Path, Path],
    grid: Grid | None,
    behind: Scoremap | None,
    caption: str,
) -> Figure:
    """Draw ways in metres east and north: A thick, B thin and dashed on it, so that both show where they are one."""
    from matplotlib import patheffects
    from matplotlib.figure import Figure

    places = np.concatenate([way for ways_of in ways for way in ways_of])
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.06 * max(float((high - low).max()), 1.0)
    wide, tall = high - low + 2 * margin
    inches = 8.0 if behind is not None else float(np.clip(8.5 * tall / wide, 2.5, 9.0)) + 1.3
    figure = Figure(figsize=(9.5, inches), layout="constrained")
    figure.suptitle(caption, x=0.01, ha="left", fontsize=10, parse_math=False)
    axes = figure.add_subplot()
    if behind is not None:
        _behind(figure, axes, behind)
    for found, path, colour, name in zip(ways, paths, (OF_A, OF_B), "AB", strict=True):
        label = f"{name}: {_name(path)}"
        width, style = (5.0, "-") if name == "A" else (2.0, (0, (4, 1.5)))
        edge = [patheffects.Stroke(linewidth=width + 1.6, foreground="white"), patheffects.Normal()]
        for way in found:
            axes.plot(*way.T, color=colour, lw=width, ls=style, path_effects=edge, label=label, zorder=4)
            size = 12 if name == "A" else 7
            axes.plot(*way[-1], "s", color=colour, ms=size, mec="white", mew=1.2, zorder=6)
            axes.plot(*way[0], "o", color=colour, ms=size, mec="white", mew=1.2, zorder=6)
            label = "_nolegend_"
    axes.plot([], [], "o", color=SOFT, ms=8, label="start")
    axes.plot([], [], "s", color=SOFT, ms=8, label="end")
    if behind is None:
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_facecolor(CANVAS)
    axes.tick_params(labelsize=9)
    axes.set_xlabel("east, m" if grid is None or grid.crs is not None else "x, m")
    axes.set_ylabel("north, m" if grid is None or grid.crs is not None else "y, m")
    axes.grid(color=GRID, lw=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    return figure


def _behind(figure: Figure, axes: Axes, scoremap: Scoremap) -> None:
    """Draw the cells of a scoremap where they lie, be the grid turned or not."""
    from matplotlib.colors import LinearSegmentedColormap

    grid = scoremap.grid
    rows, cols = np.mgrid[: grid.rows + 1, : grid.cols + 1]
    corners = np.stack([rows.ravel(), cols.ravel()], axis=1) - 0.5
    placed = walk_places(corners, grid, grid).reshape(grid.rows + 1, grid.cols + 1, 2)
    ramp = LinearSegmentedColormap.from_list("score", list(SCORE_RAMP)).with_extremes(bad=NO_GO_COLOUR)
    top = max(1.0, float(np.nanmax(scoremap.score)))
    score = np.ma.masked_invalid(scoremap.score)
    mesh = axes.pcolormesh(*np.moveaxis(placed, -1, 0), score, cmap=ramp, vmin=0, vmax=top, zorder=1)
    figure.colorbar(mesh, ax=axes, label="expected score", shrink=0.6, pad=0.01)


def _panels(grid: Grid, count: int, caption: str) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    row_m, col_m = grid.pixel_m
    inches = float(np.clip(_PANEL_INCHES * grid.rows * row_m / (grid.cols * col_m), 2.2, 9.0))
    figure = Figure(figsize=(count * _PANEL_INCHES + 0.4, inches + 1.7), layout="constrained")
    figure.suptitle(caption, x=0.01, ha="left", fontsize=10, parse_math=False)
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def _show(axes: Axes, picture: Any, grid: Grid, title: str, **style: Any) -> Any:
    """Draw a picture of a whole raster in ground metres, with scale bar and north arrow."""
    row_m, col_m = grid.pixel_m
    height, width = grid.rows * row_m, grid.cols * col_m
    shown = axes.imshow(picture, extent=(0.0, width, height, 0.0), interpolation="nearest", **style)
    axes.set_xticks([])
    axes.set_yticks([])
    if axes.get_title(loc="left"):
        return shown
    axes.set_title(title, loc="left", fontsize=10)
    show_furniture(axes, grid)
    return shown


def _step(grid: Grid) -> int:
    return max(1, -(-max(grid.shape) // PANEL_PX))


def _thumbnail(raster: ClassRaster) -> NDArray[np.uint8]:
    rows, cols = raster.grid.shape
    step = _step(raster.grid)
    return np.stack([raster.read(Window(row, 0, 1, cols))[0, ::step] for row in range(0, rows, step)])


def _changed(a: ClassRaster, b: ClassRaster, offset: tuple[int, int]) -> NDArray[np.bool_]:
    """Return for each pixel of A's thumbnail whether any id that it stands for differs in B."""
    (rows, cols), step, (down, right) = a.grid.shape, _step(a.grid), offset
    found = []
    for top in range(0, rows, step):
        here = Window(top, 0, min(step, rows - top), cols)
        ids = np.full((here.height, cols), NODATA, np.uint8)
        there = Window(top + down, right, here.height, cols).clipped(b.grid.shape)
        if there.height and there.width:
            ids[Window(there.row - top - down, there.col - right, there.height, there.width).slices] = b.read(there)
        found.append(np.logical_or.reduceat((a.read(here) != ids).any(axis=0), np.arange(0, cols, step)))
    return np.stack(found)


def _thicken(changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Grow lone pixels of a large map to three, as they would not be seen."""
    if max(changed.shape) < PANEL_PX // 2 or changed.mean() > 0.01:
        return changed
    grown = changed.copy()
    for axis in (0, 1):
        for move in (-1, 1):
            grown |= np.roll(changed, move, axis)
    return grown


def _class_patches(thumbnails: list[NDArray[np.uint8]], names: tuple[list[str], list[str]]) -> list[Any]:
    from matplotlib.patches import Patch

    ids = [int(k) for k in np.unique(np.concatenate([each.ravel() for each in thumbnails])) if k != NODATA]
    handles = []
    for k in ids[:_MAX_LABELLED]:
        called = [each[k] for each in names if k < len(each) and each[k]]
        label = called[0][:_MAX_NAME] if called else f"class {k}"
        handles.append(Patch(facecolor=class_colour(k), edgecolor="black", lw=0.5, label=label))
    return handles


def _told(verdicts: Sequence[Verdict], name: str, scale: float = 1.0, unit: str = "") -> str:
    for verdict in verdicts:
        if verdict.figure.name == name and verdict.figure.difference is not None:
            return f"{verdict.figure.difference * scale:.3g}{f' {unit}' if unit else ''}"
    return "unknown"


def _name(path: Path) -> str:
    name = os.fsencode(path.name).decode("utf-8", "backslashreplace")
    return name if len(name) <= 2 * _MAX_NAME else f"{name[: 2 * _MAX_NAME]}…"
