"""The export stage: a plan becomes a mission file, or a folder of them; the plan of a team one for each robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from hrt_cli.artifacts.plan import PlanDocument, read_plan, robot_path, team_members
from hrt_cli.artifacts.provenance import file_sha256
from hrt_cli.artifacts.publish import check_target, publishing, publishing_folder
from hrt_cli.artifacts.stage import REFUSE, Existing, freshen
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.missions.fence import NO_FENCE, fence_of
from hrt_cli.missions.formats import Format, format_for, require_room
from hrt_cli.missions.mission import Mission, MissionOptions, mission_of
from hrt_cli.missions.nav2_maps import graded
from hrt_cli.missions.simplify import Bools
from hrt_cli.raster.aoi import read_aoi
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.grid import Grid, require_same_grid
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

_WP_RADIUS_M = 2.0
"""ArduPilot Rover's default: at this distance a waypoint counts as reached."""

Content = bytes | dict[str, bytes]
"""A file, or the files of a folder by name."""


@dataclass(frozen=True)
class Exported:
    """One mission: where it was written, and what it is; `passed_by` counts the cells that `Mission` has missed."""

    output: Path
    up_to_date: bool
    waypoints: int
    length_m: float
    time_s: float
    shortest_leg_m: float
    passed_by: int


@dataclass(frozen=True)
class Export:
    """What the export stage wrote: the format, the missions (one for each robot), and what the user ought to know.

    `made` are the missions themselves, to be drawn.
    """

    format: str
    missions: list[Exported]
    notes: list[str] = field(default_factory=list)
    made: list[Mission] = field(default_factory=list)


def export_missions(
    plan_path: Path,
    output: Path,
    options: MissionOptions,
    *,
    format_name: str | None = None,
    scoremap_path: Path | None = None,
    aoi_path: Path | None = None,
    keep_out_paths: Sequence[Path] = (),
    existing: Existing = REFUSE,
) -> Export:
    """Write the plan in `plan_path` as a mission, that of a team as one for each robot (`mission-1.plan`, ...).

    Mission formats have no room for provenance, so the rule of the caching reads: a file with these very bytes is up
    to date, any other is refused unless it may be overwritten. All missions are made before the first is written.

    Raises
    ------
    InputError
        A plan, the scoremap or an area cannot be used, or does not fit the others: no leg may leave the area of
        interest or meet a keep-out.
    ArgumentError
        The format is not known.
    OutputError
        An output exists and differs, or cannot be written.
    """
    target = format_for(output, format_name)
    plan_paths = team_members(plan_path) or [plan_path]
    outputs = [output] if plan_paths == [plan_path] else [robot_path(output, k) for k in range(len(plan_paths))]
    given = [path for path in (scoremap_path, aoi_path, *keep_out_paths) if path is not None]
    inputs = [plan_path, *plan_paths, *given]
    for path in outputs:
        if not (target.is_folder(path) and path.is_dir()):
            check_target(path, inputs)
    scoremap = read_scoremap(scoremap_path) if scoremap_path else None
    aoi = read_aoi(aoi_path) if aoi_path else None
    keep_outs = [read_aoi(path) for path in keep_out_paths]
    made: list[tuple[Path, Mission, Content]] = []
    for path, robot_output in zip(plan_paths, outputs, strict=True):
        plan = read_plan(path)
        go = None if scoremap is None or scoremap_path is None else _open_cells(path, plan, scoremap_path, scoremap)
        try:
            mission = mission_of(plan, options, go)
            mission = replace(mission, fence=fence_of(mission.waypoints_lonlat, aoi, keep_outs))
            if target.stored:
                require_room(mission, go)
            made.append((robot_output, mission, target.content(robot_output, mission, scoremap)))
        except ArgumentError as error:
            raise InputError(path, str(error)) from error
    current = [_is_current(path, content, existing) for path, _, content in made]
    missions = []
    for (path, mission, content), up_to_date in zip(made, current, strict=True):
        if up_to_date:
            freshen([path], inputs)
        else:
            _publish(path, content)
        shortest_m = min(mission.legs_m, default=0.0)
        figures = len(mission.stops), mission.length_m, mission.time_s, shortest_m, len(mission.missed)
        missions.append(Exported(path, up_to_date, *figures))
    notes = _notes(target, [mission for _, mission, _ in made])
    if scoremap is not None and target.is_folder(output) and not graded(scoremap):
        notes.append(
            f"{scoremap_path}: its scores hold interest or exploration, not drivability alone: the keepout mask only"
            " bars, and there is no speed mask"
        )
    if scoremap_path is not None and target.name == "qgc":
        notes += _forgotten(scoremap_path, [path for path in (aoi_path, *keep_out_paths) if path is not None])
    return Export(target.name, missions, notes, [mission for _, mission, _ in made])


def _open_cells(path: Path, plan: PlanDocument, scoremap_path: Path, scoremap: Scoremap) -> Bools:
    """Return which cells of a plan's scoremap may be entered.

    Raises
    ------
    InputError
        The scoremap has another grid, or the plan enters a cell that is no-go on it.
    """
    grid = plan.grid
    crs = None if grid.crs is None else CRS.from_user_input(grid.crs)
    require_same_grid(path, Grid(grid.rows, grid.cols, Affine(*grid.transform), crs), scoremap_path, scoremap.grid)
    go = np.isfinite(scoremap.score)
    go[plan.start] = True  # where the robot stands, whatever is known of it by now
    for row, col in plan.cells:
        if not go[row, col]:
            raise InputError(path, f"enters cell {row},{col}, which is no-go on {scoremap_path}", "plan again on it")
    for row, col in plan.blocked:
        go[row, col] = False
    return go


def _is_current(path: Path, content: Content, existing: Existing) -> bool:
    """Say whether an output holds these very bytes already; refuse to replace others unasked."""
    if not path.exists() or existing.force:
        return False
    if _read(path) == content:
        return True
    if not existing.overwrite:
        raise OutputError(f"{path}: exists and differs; use --overwrite to replace it")
    return False


def _read(path: Path) -> Content:
    if not path.is_dir():
        return path.read_bytes()
    return {each.name: each.read_bytes() if each.is_file() else b"" for each in path.iterdir()}


def _publish(path: Path, content: Content) -> None:
    def check(draft: Path) -> None:
        if _read(draft) != content:
            raise OutputError(f"{path}: did not read back as it was written (is the disk full?)")

    if isinstance(content, bytes):
        with publishing(path, check) as draft:
            draft.write_bytes(content)
        return
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is a file; give the name of a folder")
    with publishing_folder(path, check) as draft:
        for name, each in content.items():
            (draft / name).write_bytes(each)


def _notes(target: Format, missions: Sequence[Mission]) -> list[str]:
    """Say what the robot makes of the missions that their author may not expect."""
    notes = []
    shortest_m = min((leg for mission in missions for leg in mission.legs_m), default=math.inf)
    if target.stored and missions[0].options.firmware == "ardupilot" and shortest_m < _WP_RADIUS_M:
        notes.append(
            f"waypoints are as little as {shortest_m:.2g} m apart: set WP_RADIUS (by default {_WP_RADIUS_M:g} m) below"
            " that, or the robot cuts corners; "
            f"{'a larger' if missions[0].options.tolerance_m else 'a'} --tolerance makes fewer and longer legs"
        )
    missed = sum(len(mission.missed) for mission in missions)
    if missed:
        notes.append(f"{missed} cells of the plan are passed within the tolerance, not entered")
    if target.name != "qgc" and any(mission.fence != NO_FENCE for mission in missions):
        notes.append(
            f"{target.name} holds no geofence: the areas were only checked; export a .plan to have them loaded"
        )
    return notes


def _forgotten(scoremap_path: Path, areas: Sequence[Path]) -> list[str]:
    """Say so where a scoremap was made with areas that the mission is not given."""
    provenance = cog_provenance(scoremap_path) if scoremap_path.suffix.lower() != ".npz" else None
    if provenance is None:
        return []
    known = {file_sha256(path) for path in areas}
    return [
        f"the scoremap was made with {each.name}, which is not given: no geofence of it"
        f" (--{'aoi' if each.role == 'aoi' else 'keep-out'})"
        for each in provenance.inputs
        if (each.role == "aoi" or each.role.startswith("keep_out/")) and each.sha256 not in known
    ]
