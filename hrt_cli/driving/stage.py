"""The drive stage: a plan and a site become the log of a drive."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.drivelog import Header, Robot, drive_provenance, publish_drive_log
from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.publish import output_error
from hrt_cli.artifacts.stage import REFUSE, Existing, ReadProvenance, begin
from hrt_cli.driving.album import ABOUT, prepare_folder
from hrt_cli.driving.disturb import Disturbed
from hrt_cli.driving.expert import GroundExpert, WaterExpert
from hrt_cli.driving.local import LocalPlanner, Pursuit
from hrt_cli.driving.record import Recorder
from hrt_cli.driving.rescue import Rescued
from hrt_cli.driving.roam import roam_course
from hrt_cli.driving.route import planned_course
from hrt_cli.driving.simulator import Drive, Setting, first_heading, simulate, unwatched
from hrt_cli.driving.teacher import teacher_of
from hrt_cli.driving.vehicle import VEHICLES, Vehicle
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.logs.kinds import files_of, reading
from hrt_cli.logs.read import log_notes, read_drive_log
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.track import no_place_on_a_map
from hrt_cli.world.site import Site, load_site, site_files

STAGE = "drive"
STAGE_VERSION = 11

LOCAL_PLANNERS = ("pursuit", "expert", "teacher", "steer")


@dataclass(frozen=True)
class DriveRequest:
    """How to drive.

    Attributes
    ----------
    local : 'pursuit', 'expert', 'teacher' or 'steer'
    model : Path or None
        The steering model of 'steer'.
    vehicle : 'ugv', 'auv' or None
        None: the AUV under water, else the UGV.
    roam_m : float or None
        Without a plan: how long the course of random legs is (`driving.roam`).
    disturb : float
        Share of the time that the robot is pushed off its way, in [0, 1) (`driving.disturb`).
    rescue : bool
        The teacher helps the learnt planner on where it gets no farther (`driving.rescue`).
    time_limit_s : float or None
        The drive ends after so long. None: the plan's budget where that is in minutes, else never.
    seed : int
    """

    local: str = "pursuit"
    model: Path | None = None
    vehicle: str | None = None
    roam_m: float | None = None
    disturb: float = 0.0
    rescue: bool = False
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
    plan_path: Path | None,
    world: Path,
    output: Path,
    request: DriveRequest,
    *,
    after: Path | None = None,
    record: Path | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> DriveSummary:
    """Drive on a site and write the log.

    Parameters
    ----------
    plan_path : Path or None
        The plan of one robot; None to roam.
    world, output : Path
        The folder of the site, and the log (`.jsonl`).
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
    _check_request(request, plan_path, after)
    before = {} if after is None else files_of("after", after)
    given = {"plan": plan_path, **site_files(world), **before, "model": request.model}
    inputs = {role: path for role, path in given.items() if path is not None}
    parameters: dict[str, Any] = {key: value for key, value in asdict(request).items() if key != "model"}
    parameters |= reading(() if after is None else (after,))
    outputs: dict[Path, ReadProvenance] = {output: drive_provenance}
    if record is not None:
        outputs[record / ABOUT] = json_provenance
        parameters["record"] = True
        try:
            record.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(record, error) from error
    job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs=outputs, existing=existing)
    notes: list[str] = []
    if not job.up_to_date:
        site = load_site(world)
        setting, notes = _setting(plan_path, site, request, after)
        vehicle = setting.vehicle
        local = local_planner(request.local, setting, request.model)
        if request.rescue:
            local = Rescued(local, teacher_of(setting))
        if request.disturb > 0:
            local = Disturbed(local, request.disturb, request.seed)
        watch, recorder = unwatched, None
        if record is not None:
            prepare_folder(record, list(inputs.values()), overwrite=existing.overwrite or existing.force)
            recorder = Recorder(setting, teacher_of(setting), record, f"{output.stem}-{request.seed}")
            watch = recorder.watch
        drive = simulate(setting, local, watch=watch, progress=progress)
        robot = Robot(kind=vehicle.kind, radius_m=vehicle.radius_m)
        header = Header(format="hrt-drive-log", crs=site.grid.crs_text(), robot=robot, end=drive.end)
        if recorder is not None:
            recorder.finish(job.provenance)
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
    inputs = {"plan": plan_path} | (files_of("after", after) if after else {})
    parameters = {"stay": True} | reading((after,) if after else ())
    outputs: dict[Path, ReadProvenance] = {output: drive_provenance}
    job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs=outputs, existing=existing)
    notes: list[str] = []
    if not job.up_to_date:
        plan = read_plan(plan_path)
        place, names, crs, robot = plan.xy[0], ("x", "y"), plan.grid.crs, None
        if after is not None:
            log = read_drive_log(after)
            if log.own_frame is not None:
                raise no_place_on_a_map(after, log.own_frame)
            notes = log_notes(after, log)
            place, robot = (float(log.place[-1, 0]), float(log.place[-1, 1])), log.robot
            names, crs = (("lon", "lat"), None) if log.geographic else (("x", "y"), log.crs)
        header = Header(format="hrt-drive-log", crs=crs, robot=robot, end="arrived")
        record = {"t": 0.0, **dict(zip(names, place, strict=True)), "speed_m_s": 0.0, "commanded_m_s": 0.0}
        publish_drive_log(output, header, [record], job.provenance)
    return _summary(output, job.up_to_date, notes)


def _check_name(output: Path) -> None:
    if output.suffix.lower() != ".jsonl":
        raise ArgumentError(f"{output}: a drive log is written as .jsonl")


def _check_request(request: DriveRequest, plan_path: Path | None, after: Path | None) -> None:
    if (plan_path is None) == (request.roam_m is None):
        raise ArgumentError("a drive follows a plan or roams: give one of the two")
    if plan_path is None and after is not None:
        raise ArgumentError("a drive that roams goes on from no other: leave --after out, or give a plan")
    if (request.local == "steer") != (request.model is not None):
        raise ArgumentError("the local planner steer needs a --model, and no other takes one")
    if request.rescue and request.local != "steer":
        raise ArgumentError("only the local planner steer is helped on: leave --rescue out")


def _setting(
    plan_path: Path | None, site: Site, request: DriveRequest, after: Path | None
) -> tuple[Setting, list[str]]:
    """Return what the drive depends on besides who steers, and what the user ought to know of it."""
    vehicle = VEHICLES[request.vehicle or ("auv" if site.under_water else "ugv")]
    limit_s = math.inf if request.time_limit_s is None else request.time_limit_s
    notes: list[str] = []
    if plan_path is None:
        course, cruise_m_s = roam_course(site, vehicle, request.roam_m or 0.0, request.seed), vehicle.cruise_m_s
    else:
        plan = read_plan(plan_path)
        course, notes = planned_course(plan, plan_path, site, vehicle, after)
        cruise_m_s = plan.speed_m_s
        if request.time_limit_s is None and plan.budget.unit == "min":
            limit_s = plan.budget.cells * plan.grid.cell_size_m / plan.speed_m_s
    heading = first_heading(course)
    return Setting(site, vehicle, course, cruise_m_s, limit_s, heading, request.seed), notes


def local_planner(name: str, setting: Setting, model: Path | None = None) -> LocalPlanner:
    """Return the local planner of a name; 'steer' by its model.

    Raises
    ------
    ArgumentError
        There is none, or the model was not made for this robot.
    InputError
        The model cannot be used.
    """
    if name not in LOCAL_PLANNERS:
        raise ArgumentError(f"there is no local planner {name!r}, only {', '.join(LOCAL_PLANNERS)}")
    if name == "steer":
        if model is None:
            raise ArgumentError("the local planner steer needs a model")
        return _steer(model, setting)
    if name == "pursuit":
        return Pursuit(setting.course, setting.vehicle)
    if name == "teacher":
        return teacher_of(setting)
    expert = GroundExpert if setting.vehicle.kind == "ugv" else WaterExpert
    return expert(setting.site, setting.course, setting.vehicle)


def _steer(model: Path, setting: Setting) -> LocalPlanner:
    # Only here: PyTorch takes a second to import.
    from hrt_cli.driving.steer import Steer
    from hrt_cli.steering.prediction.load import load_predictor
    from hrt_cli.steering.recordings.samples import check_lens

    predictor = load_predictor(model, threads=1)
    swims = setting.vehicle.kind == "auv"
    if swims != ("pitch" in predictor.config.outputs):
        raise InputError(model, f"steers {' and '.join(predictor.config.outputs)}: made for another kind of robot")
    check_lens(model, predictor.config.hfov_deg, setting.vehicle.lens_hfov_deg)
    return Steer(predictor, setting)


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
