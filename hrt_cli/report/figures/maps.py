"""Pictures of classes, scoremaps and plans, drawn on the orthomosaic where one is given."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import PlanDocument, TeamPlanDocument, read_plan, team_members
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import InputError
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import read_scoremap
from hrt_cli.report.figures.canvas import (
    Backdrop,
    Drawing,
    begin_drawing,
    class_entries,
    class_picture,
    map_canvas,
    read_backdrop,
    show_legend,
    thinned,
)
from hrt_cli.report.figures.layers import (
    NO_GO,
    explain_ends,
    extent_on,
    place_on,
    require_aligned,
    show_ends,
    show_path,
    show_picture,
    show_scores,
    show_shading,
)
from hrt_cli.report.figures.palette import robot_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STAGE_VERSION = 3
_CLASS_SHADING, _SCORE_SHADING, _SCORE_TINT = 0.4, 0.25, 0.35
"""How strongly the orthomosaic shades classes, and scores, whose own lightness counts; how strongly scores tint it."""


def draw_classes(classes_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a class raster with its legend; return whether it was up to date."""
    job, behind = _begin("figure-classes", {"classes": classes_path}, output, backdrop, existing)
    if job.up_to_date:
        return True
    with open_classes(classes_path, unreferenced=True) as raster:
        grid = _georeferenced(classes_path) or raster.grid
        values, _ = thinned(raster.read, grid.shape)
        names = raster.names
    base = behind.grid if behind else grid
    entries = class_entries(values, names)
    figure, axes = map_canvas(base, f"{len(entries)} texture {'class' if len(entries) == 1 else 'classes'}")
    axes.imshow(class_picture(values), extent=extent_on(grid, base), interpolation="nearest")
    show_shading(axes, behind, _CLASS_SHADING)
    show_legend(axes, entries)
    job.publish(figure, trimmed=True)
    return False


def draw_scoremap(scoremap_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a scoremap with its colour bar; return whether it was up to date."""
    job, behind = _begin("figure-scoremap", {"scoremap": scoremap_path}, output, backdrop, existing)
    if job.up_to_date:
        return True
    scoremap = read_scoremap(scoremap_path)
    go = np.isfinite(scoremap.score)
    base = _base(scoremap.grid, behind)
    title = f"expected score, {scoremap.cell_size_m:g} m cells, mean {scoremap.score[go].mean():.2f}"
    figure, axes = map_canvas(base, title)
    show_scores(figure, axes, scoremap, base)
    show_shading(axes, behind, _SCORE_SHADING)
    show_legend(axes, [NO_GO] if not go.all() else [])
    job.publish(figure, trimmed=True)
    return False


def draw_plan(plan_path: Path, scoremap_path: Path, output: Path, *, backdrop: Path | None, existing: Existing) -> bool:
    """Draw a plan on its scoremap, of one robot or of a team; return whether it was up to date."""
    members = team_members(plan_path)
    inputs = {"plan": plan_path, "scoremap": scoremap_path} | {f"robot/{k}": path for k, path in enumerate(members)}
    job, behind = _begin("figure-plan", inputs, output, backdrop, existing)
    if job.up_to_date:
        return True
    plans = [read_plan(path) for path in members or [plan_path]]
    whole = read_model(plan_path, TeamPlanDocument) if members else plans[0]
    scoremap = read_scoremap(scoremap_path)
    base = _base(scoremap.grid, behind)
    title = (
        f"{whole.method}: {f'{len(plans)} robots, ' if members else ''}score {whole.score:.1f}, "
        f"{1 - whole.gap:.1%} of the bound, {whole.steps} steps, {whole.length_m:.0f} m"
    )
    figure, axes = map_canvas(base, title)
    if behind is not None:
        show_picture(axes, behind)
    show_scores(figure, axes, scoremap, base, tint=None if behind is None else _SCORE_TINT)
    for robot, plan in enumerate(plans):
        _show_plan(axes, plan, scoremap.grid, base, robot if members else None)
    if members:
        explain_ends(axes)
    show_legend(axes, [NO_GO] if np.isnan(scoremap.score).any() else [])
    job.publish(figure, trimmed=True)
    return False


def _begin(
    stage: str, inputs: dict[str, Path], output: Path, backdrop: Path | None, existing: Existing
) -> tuple[Drawing, Backdrop | None]:
    given = inputs | ({"backdrop": backdrop} if backdrop else {})
    job = begin_drawing(stage, STAGE_VERSION, inputs=given, output=output, existing=existing)
    return job, None if job.up_to_date or backdrop is None else read_backdrop(backdrop)


def _georeferenced(path: Path) -> Grid | None:
    try:
        with open_classes(path) as raster:
            return raster.grid
    except InputError:
        return None


def _base(grid: Grid, behind: Backdrop | None) -> Grid:
    require_aligned(grid, behind)
    return behind.grid if behind else grid


def _show_plan(axes: Axes, plan: PlanDocument, grid: Grid, base: Grid, robot: int | None) -> None:
    """Draw the path of a plan; one of several bears its robot's number and colour."""
    cells = np.array(plan.cells)
    right, down = place_on(grid, base, cells[:, 0] + 0.5, cells[:, 1] + 0.5)
    if robot is None:
        show_path(axes, right, down, label="_path")
        show_ends(axes, right, down)
        return
    colour, dashes = robot_line(robot)
    show_path(axes, right, down, color=colour, ls=dashes, label=f"robot {robot + 1}")
    show_ends(axes, right, down, colour=colour, labels=("_start", "_end"))
