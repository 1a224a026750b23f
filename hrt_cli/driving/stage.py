"""The drive stage: a plan and a site become the log of a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.drivelog import Header, Robot, drive_provenance, publish_drive_log, read_drive_log
from hrt_cli.artifacts.plan import PlanDocument, read_plan
from hrt_cli.artifacts.publish import output_error
from hrt_cli.artifacts.stage import REFUSE, Existing, ReadProvenance, begin
from hrt_cli.driving.course import Course
from hrt_cli.driving.expert import GroundExpert, WaterExpert
from hrt_cli.driving.field import inside_rim, rim_distance
from hrt_cli.driving.local import LocalPlanner, Pursuit
from hrt_cli.driving.record import ABOUT, Recorder, prepare_folder
from hrt_cli.driving.simulator import Drive, Setting, first_heading, simulate, unwatched
from hrt_cli.driving.vehicle import VEHICLES, Vehicle
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.track import points_on
from hrt_cli.world.site import Site, load_site, site_files

STAGE = "drive"
STAGE_VERSION = 3

LOCAL_PLANNERS = ("pursuit", "expert")

_BACK_UP_M = 0.4
"""A robot that was stuck backs up so far before it goes on."""
_FARTHEST_MOVED_M = 3.0
"""A robot put down on an obstacle is moved to free ground that is no farther away."""


@dataclass(frozen=True)
class DriveRequest:
    """How to drive.

    Attributes
    ----------
    local : 'pursuit' or 'expert'
    vehicle : 'ugv', 'auv' or None
        None: the AUV under water, else the UGV.
    time_limit_s : float or None
        The drive ends after so long. None: the plan's budget where that is in minutes, else never.
    seed : int
    """

    local: str = "pursuit"
    vehicle: str | None = None
    time_limit_s: float | None = None
    seed: int = 0


@dataclass(frozen=True)
class DriveSummary:
    """What a drive came to.

    Attributes
    ----------
    up_to_date : bool
    end : str
        'arrived', 'stuck' or 'out of time'.
    place : (float, float)
        Where it ended, x and y in the site's CRS.
    distance_m, duration_s : float
    collisions, interventions : int
    notes : list of str
    """

    up_to_date: bool
    end: str
    place: tuple[float, float]
    distance_m: float
    duration_s: float
    collisions: int
    interventions: int
    notes: list[str]


def drive_file(
    plan_path: Path,
    world: Path,
    output: Path,
    request: DriveRequest,
    *,
    after: Path | None = None,
    record: Path | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> DriveSummary:
    """Drive a plan on a site and write the log.

    Parameters
    ----------
    plan_path, world, output : Path
        The plan of one robot, the folder of the site, and the log (`.jsonl`).
    request : DriveRequest
    after : Path, optional
        Log of the drive that this one goes on from: the robot begins where that ended.
    record : Path, optional
        Folder for what the camera saw, with the expert's steering (`driving.record`).

    Raises
    ------
    InputError
        The plan or the site cannot be used, or do not belong together.
    ArgumentError
        The robot cannot be put down at the start.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    _check_name(output)
    files = site_files(world)
    inputs = {"plan": plan_path, **files} | ({"after": after} if after else {})
    parameters: dict[str, Any] = {
        "local": request.local,
        "vehicle": request.vehicle,
        "time_limit_s": request.time_limit_s,
        "seed": request.seed,
    }
    outputs: dict[Path, ReadProvenance] = {output: drive_provenance}
    if record is not None:
        outputs[record / ABOUT] = json_provenance
        parameters["record"] = True
        try:
            record.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(record, error) from error
    job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs=outputs, existing=existing)
    plan = read_plan(plan_path)
    notes: list[str] = []
    if not job.up_to_date:
        site = load_site(world)
        vehicle = VEHICLES[request.vehicle or ("auv" if site.under_water else "ugv")]
        course, notes = _course(plan, plan_path, site, vehicle, after)
        setting = Setting(
            site=site,
            vehicle=vehicle,
            course=course,
            cruise_m_s=plan.speed_m_s,
            limit_s=_limit_s(plan, request),
            heading_rad=first_heading(course),
            seed=request.seed,
        )
        watch, recorder = unwatched, None
        if record is not None:
            prepare_folder(record, list(inputs.values()), overwrite=existing.overwrite or existing.force)
            recorder = Recorder(setting, local_planner("expert", setting), record)
            watch = recorder.watch
        drive = simulate(setting, local_planner(request.local, setting), watch=watch, progress=progress)
        robot = Robot(kind=vehicle.kind, radius_m=vehicle.radius_m)
        header = Header(format="hrt-drive-log", crs=site.grid.crs_text(), robot=robot, end=drive.end)
        if recorder is not None:
            recorder.finish(f"{output.stem}-{request.seed}", job.provenance)
        publish_drive_log(output, header, _records(drive, site, vehicle), job.provenance)
    return _summary(output, job.up_to_date, notes)


def stay_file(plan_path: Path, output: Path, *, after: Path | None = None, existing: Existing = REFUSE) -> DriveSummary:
    """Write the log of a robot that does not drive its plan: one record, where it stands.

    Parameters
    ----------
    plan_path, output : Path
        The plan of one robot, and the log (`.jsonl`).
    after : Path, optional
        Log of the drive before: the robot stands where that ended. Else it stands at the plan's start.

    Raises
    ------
    InputError
        The plan or the log before cannot be used.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    _check_name(output)
    inputs = {"plan": plan_path} | ({"after": after} if after else {})
    outputs: dict[Path, ReadProvenance] = {output: drive_provenance}
    job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters={"stay": True}, outputs=outputs, existing=existing)
    if not job.up_to_date:
        plan = read_plan(plan_path)
        place, names, crs, robot = plan.xy[0], ("x", "y"), plan.grid.crs, None
        if after is not None:
            log = read_drive_log(after)
            place, robot = (float(log.place[-1, 0]), float(log.place[-1, 1])), log.robot
            names, crs = (("lon", "lat"), None) if log.geographic else (("x", "y"), log.crs)
        header = Header(format="hrt-drive-log", crs=crs, robot=robot, end="arrived")
        record = {"t": 0.0, **dict(zip(names, place, strict=True)), "speed_m_s": 0.0, "commanded_m_s": 0.0}
        publish_drive_log(output, header, [record], job.provenance)
    return _summary(output, job.up_to_date, [])


def _check_name(output: Path) -> None:
    if output.suffix.lower() != ".jsonl":
        raise ArgumentError(f"{output}: a drive log is written as .jsonl")


def local_planner(name: str, setting: Setting) -> LocalPlanner:
    """Return the local planner of a name.

    Raises
    ------
    ArgumentError
        There is none.
    """
    if name not in LOCAL_PLANNERS:
        raise ArgumentError(f"there is no local planner {name!r}, only {', '.join(LOCAL_PLANNERS)}")
    if name == "pursuit":
        return Pursuit(setting.course, setting.vehicle)
    expert = GroundExpert if setting.vehicle.kind == "ugv" else WaterExpert
    return expert(setting.site, setting.course, setting.vehicle)


def _limit_s(plan: PlanDocument, request: DriveRequest) -> float:
    if request.time_limit_s is not None:
        return request.time_limit_s
    if plan.budget.unit == "min":
        return plan.budget.cells * plan.grid.cell_size_m / plan.speed_m_s
    return math.inf


def _course(
    plan: PlanDocument, path: Path, site: Site, vehicle: Vehicle, after: Path | None
) -> tuple[Course, list[str]]:
    """Return the line to drive, from where the robot really stands, and what the user ought to know of it."""
    points = _on_site(path, np.array(plan.xy), plan.grid.crs, site)
    wanted = points[0] if after is None else _left_at(after, site)
    start = _free_place(site, wanted, vehicle)
    if start is None:
        raise ArgumentError(f"{path}: its start lies on an obstacle or off the survey, and no free ground is near")
    moved = float(np.hypot(*(start - wanted)))
    notes = [f"the robot is put down {moved:.1f} m beside the start, which is blocked"] if moved > 0.5 else []
    places, more = _off_the_rim(points[1:] if len(points) > 1 else points, plan.grid.cell_size_m, site, vehicle)
    return Course(np.vstack([start, places])), notes + more


def _off_the_rim(
    places: NDArray[np.float64], reach_m: float, site: Site, vehicle: Vehicle
) -> tuple[NDArray[np.float64], list[str]]:
    """Return places to drive to, those at the rim of the survey moved inside, and notes of it.

    A robot keeps its radius from what the survey did not see: it is stopped there. What has no such ground within
    `reach_m` is left out.
    """
    inside = inside_rim(site, vehicle.radius_m)
    kept, moved = [], 0
    for place in places:
        nearest = _nearest(inside, place, reach_m, site)
        if nearest is not None:
            kept.append(nearest)
            moved += nearest is not place
    notes = []
    if moved:
        notes.append(f"{moved} of {len(places)} places lie at the rim of the survey: moved inside")
    if len(kept) < len(places):
        notes.append(f"{len(places) - len(kept)} of {len(places)} places lie off the survey: left out")
    return np.array(kept).reshape(-1, 2), notes


def _left_at(path: Path, site: Site) -> NDArray[np.float64]:
    """Return where a drive left the robot; where that was stuck, it has backed up a little."""
    log = read_drive_log(path)
    place = _on_site(path, log.place[-1:], "EPSG:4326" if log.geographic else log.crs, site)[0]
    if log.end == "stuck" and np.isfinite(log.heading_deg[-1]):
        heading = math.radians(log.heading_deg[-1]) - site.up_bearing_rad
        place = place - _BACK_UP_M * np.array([math.sin(heading), -math.cos(heading)])
    return np.asarray(place)


def _on_site(path: Path, xy: NDArray[np.float64], crs: str | None, site: Site) -> NDArray[np.float64]:
    if crs is None:
        raise InputError(path, "has no coordinate reference system, so it has no place on a site")
    rows, cols = points_on(path, xy, crs, site.grid, "site")
    if not ((rows >= 0) & (rows <= site.grid.rows) & (cols >= 0) & (cols <= site.grid.cols)).any():
        raise InputError(path, "lies wholly off the site")
    return np.stack([cols, rows], axis=1) * site.pixel_m


def _free_place(site: Site, wanted: NDArray[np.float64], vehicle: Vehicle) -> NDArray[np.float64] | None:
    """Return the place nearest to `wanted` where the robot touches nothing, if there is one near."""
    room = rim_distance(site)
    if vehicle.kind == "ugv":
        room = np.minimum(room, site.clearance_m)
    return _nearest(room > vehicle.radius_m + site.pixel_m, wanted, _FARTHEST_MOVED_M, site)


def _nearest(
    free: NDArray[np.bool_], wanted: NDArray[np.float64], reach_m: float, site: Site
) -> NDArray[np.float64] | None:
    """Return `wanted` itself where its pixel is free, else the nearest middle of one that is, at most `reach_m` away.

    Parameters
    ----------
    free : bool [rows, cols]
    """
    row, col = site.pixel(float(wanted[0]), float(wanted[1]))
    if 0 <= row < free.shape[0] and 0 <= col < free.shape[1] and free[row, col]:
        return wanted
    reach = math.ceil(reach_m / site.pixel_m)
    r0, c0 = max(row - reach, 0), max(col - reach, 0)
    rows, cols = np.nonzero(free[r0 : max(row + reach + 1, 0), c0 : max(col + reach + 1, 0)])
    places = np.stack([cols + c0 + 0.5, rows + r0 + 0.5], axis=1) * site.pixel_m
    away = np.hypot(*(places - wanted).T)
    return places[int(away.argmin())] if away.min(initial=np.inf) <= reach_m else None


def _records(drive: Drive, site: Site, vehicle: Vehicle) -> list[dict[str, Any]]:
    """Return the records of a log: what a robot knows, in the site's CRS."""
    x, y = site.map_xy(drive.records[:, 1:3])
    happened = dict(drive.events)
    up = site.up_bearing_rad
    digits = 8 if site.grid.crs is not None and site.grid.crs.is_geographic else 3
    records = []
    for k, (t, _, _, heading, pitch, height, speed, commanded) in enumerate(drive.records.tolist()):
        record: dict[str, Any] = {
            "t": round(t, 2),
            "x": round(float(x[k]), digits),
            "y": round(float(y[k]), digits),
            "speed_m_s": round(speed, 3),
            "commanded_m_s": round(commanded, 3),
            "heading_deg": round(math.degrees(heading + up) % 360.0, 1),
        }
        if vehicle.kind == "auv":
            record |= {"pitch_deg": round(math.degrees(pitch), 1), "depth_m": round(-height, 3)}
        if k in happened:
            record["event"] = happened[k]
        records.append(record)
    return records


def _summary(path: Path, up_to_date: bool, notes: list[str]) -> DriveSummary:
    """Say what a log comes to."""
    log = read_drive_log(path)
    events = [event for _, event in log.events]
    speed = 0.5 * (log.speed_m_s[1:] + log.speed_m_s[:-1])
    return DriveSummary(
        up_to_date=up_to_date,
        end=log.end or "unknown",
        place=(float(log.place[-1, 0]), float(log.place[-1, 1])),
        distance_m=float((speed * np.diff(log.time_s)).sum()),
        duration_s=float(log.time_s[-1] - log.time_s[0]),
        collisions=events.count("collision"),
        interventions=events.count("intervention"),
        notes=notes,
    )
