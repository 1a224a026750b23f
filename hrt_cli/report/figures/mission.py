"""A picture of a mission as it is exported: numbered waypoints, home, geofence, and the cells that it passes by."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.artifacts.stage import Existing
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import read_scoremap
from hrt_cli.report.figures.canvas import begin_drawing, map_canvas, read_backdrop, show_legend
from hrt_cli.report.figures.layers import (
    NO_GO,
    explain_ends,
    lonlat_on,
    place_on,
    require_aligned,
    show_ends,
    show_no_go,
    show_path,
    show_picture,
)
from hrt_cli.report.figures.palette import KEEP_IN, KEEP_OUT, PATH_EDGE, SOFT, robot_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    Floats = NDArray[np.float64]
    Ring = Sequence[tuple[float, float]]

STAGE_VERSION = 1
_ENDS = ("home and first waypoint", "last waypoint")
_APART = 1 / 32
"""Least way between two numbers, of the map's greater side."""


class Fence(Protocol):
    """Polygons to stay in and out of, as longitude and latitude."""

    @property
    def keep_in(self) -> Sequence[Ring]: ...  # noqa: D102
    @property
    def keep_out(self) -> Sequence[Ring]: ...  # noqa: D102


class Mission(Protocol):
    """What is drawn; see `hrt_cli.missions.mission.Mission`."""

    @property
    def plan(self) -> PlanDocument: ...  # noqa: D102
    @property
    def waypoints_lonlat(self) -> list[tuple[float, float]]: ...  # noqa: D102
    @property
    def missed(self) -> Sequence[tuple[int, int]]: ...  # noqa: D102
    @property
    def fence(self) -> Fence: ...  # noqa: D102
    @property
    def length_m(self) -> float: ...  # noqa: D102
    @property
    def time_s(self) -> float: ...  # noqa: D102
    @property
    def speed_m_s(self) -> float: ...  # noqa: D102


def draw_missions(
    plan_path: Path,
    missions: Sequence[Mission],
    output: Path,
    *,
    vehicle: str,
    scoremap: Path | None = None,
    backdrop: Path | None = None,
    existing: Existing,
) -> bool:
    """Draw the missions of a plan, one for each robot; the same for every format.

    Parameters
    ----------
    plan_path : Path
        The plan.
    missions : sequence of Mission
    output : Path
        The PNG to write.
    vehicle : str
        What drives, for the title.
    scoremap : Path, optional
        The plan's, to show what is no-go.
    backdrop : Path, optional
        The orthomosaic to draw on; without one the plan's grid is shown.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        The backdrop cannot be used; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {"plan": plan_path}
    inputs |= {role: path for role, path in (("scoremap", scoremap), ("backdrop", backdrop)) if path}
    parameters = {"missions": _digest(missions), "vehicle": vehicle}
    job = begin_drawing(
        "figure-mission", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    behind = read_backdrop(backdrop) if backdrop else None
    base = behind.grid if behind else _grid(missions[0].plan)
    figure, axes = map_canvas(base, _title(missions, vehicle))
    entries = []
    if behind is not None:
        require_aligned(_grid(missions[0].plan), behind)
        show_picture(axes, behind)
    if scoremap is not None:
        show_no_go(axes, read_scoremap(scoremap), base, faint=behind is not None)
        entries.append(NO_GO)
    alone = len(missions) == 1
    for robot, mission in enumerate(missions):
        right, down = lonlat_on(plan_path, base, mission.waypoints_lonlat)
        colour, dashes = robot_line(robot)
        name = "mission" if alone else f"robot {robot + 1}"
        show_path(axes, right, down, color=colour, ls=dashes, label=name)
        axes.plot(right, down, ".", color=PATH_EDGE, ms=5, zorder=5.5, label="_waypoints")
        show_ends(axes, right, down, colour=None if alone else colour, labels=_ENDS if alone else ("_start", "_end"))
        _number(axes, right, down)
    if not alone:
        explain_ends(axes, _ENDS)
    _show_missed(axes, missions, base)
    _show_fence(axes, plan_path, missions[0].fence, base)
    show_legend(axes, entries)
    job.publish(figure, trimmed=True)
    return False


def _title(missions: Sequence[Mission], vehicle: str) -> str:
    points = sum(len(each.waypoints_lonlat) for each in missions)
    longest = max(each.time_s for each in missions)
    parts = [
        vehicle if len(missions) == 1 else f"{len(missions)} {vehicle}s",
        f"{points} {'waypoint' if points == 1 else 'waypoints'}",
        f"{sum(each.length_m for each in missions):.0f} m",
        f"{longest:.0f} s at {missions[0].speed_m_s:g} m/s",
    ]
    missed = sum(len(each.missed) for each in missions)
    return ", ".join(parts + ([f"{missed} cells passed by"] if missed else []))


def _digest(missions: Sequence[Mission]) -> str:
    """Hash all that is drawn."""
    drawn: list[Any] = [
        [each.waypoints_lonlat, each.missed, each.fence.keep_in, each.fence.keep_out, each.length_m, each.time_s]
        for each in missions
    ]
    return hashlib.sha256(json.dumps(drawn).encode()).hexdigest()


def _grid(plan: PlanDocument) -> Grid:
    found = plan.grid
    crs = None if found.crs is None else CRS.from_user_input(found.crs)
    return Grid(found.rows, found.cols, Affine(*found.transform), crs)


def _show_fence(axes: Axes, plan_path: Path, fence: Fence, base: Grid) -> None:
    """Show what to stay in and out of; the robots of a team have one fence."""
    for rings, colour, hatch, name in (
        (fence.keep_in, KEEP_IN, "", "stay within"),
        (fence.keep_out, KEEP_OUT, "xx", "keep out"),
    ):
        for index, ring in enumerate(rings):
            right, down = lonlat_on(plan_path, base, [*ring, ring[0]])
            label = name if index == 0 else f"_{name}"
            axes.fill(right, down, fill=False, edgecolor=colour, hatch=hatch, lw=2.0, zorder=3, label=label)


def _show_missed(axes: Axes, missions: Sequence[Mission], base: Grid) -> None:
    """Mark the cells that are passed by within the tolerance."""
    cells = np.array([cell for each in missions for cell in each.missed], np.float64).reshape(-1, 2)
    if len(cells):
        right, down = place_on(_grid(missions[0].plan), base, cells[:, 0] + 0.5, cells[:, 1] + 0.5)
        axes.plot(right, down, "s", color="white", mec=SOFT, ms=4, ls="none", zorder=4, label="cell passed by")


def _number(axes: Axes, right: Floats, down: Floats) -> None:
    """Write the numbers of waypoints, from 1, where they do not stand on one another; the last has its own always."""
    from matplotlib import patheffects

    (left, most), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    apart = _APART * max(abs(most - left), abs(bottom - top))
    halo = [patheffects.withStroke(linewidth=2.5, foreground="white")]
    taken = np.empty((0, 2))
    places = np.column_stack([right, down])
    for index in [len(places) - 1, *range(len(places) - 1)]:
        if len(taken) and np.hypot(*(taken - places[index]).T).min() < apart:
            continue
        taken = np.vstack([taken, places[index]])
        axes.annotate(
            str(index + 1), places[index], (5, 5), textcoords="offset points", fontsize=8, zorder=9, path_effects=halo
        )
