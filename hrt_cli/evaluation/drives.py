"""What a drive came to: how far, how safely, what was in view, what was collected (the paper's field figures)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.driving.motion import bottom_clearance, sample
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.evaluation.travel import metres_gone
from hrt_cli.evaluation.views import Poses, poses_on, seen_from, vehicle_of
from hrt_cli.logs.read import log_notes, read_drive_log
from hrt_cli.planning.resume import driven_cells
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.grid import WGS84
from hrt_cli.raster.scoremap import read_scoremap
from hrt_cli.world.site import Site, load_site

LOOK_EVERY_S = 1.0
"""Between two frames in which the target is looked for."""
STALLED = 0.1
"""A robot that gets on at less than this share of the commanded speed stalls."""
DRIVABLE = 0.3
"""Share of its speed that a robot holds on ground that counts as drivable."""
_COMMANDED_M_S = 0.05
FARTHEST_M = 5.0
"""Clearances are measured up to here."""


@dataclass(frozen=True)
class DriveMeasure:
    """The figures of a drive, or of several together; None where the log or the world does not say.

    Attributes
    ----------
    distance_m, duration_s : float
    collisions, interventions, stuck : int
        Events in the log.
    stalled_s : float or None
        Time in which the robot was told to drive and got on by less than a tenth of it.
    min_clearance_m, mean_clearance_m : float or None
        Distance from the robot's hull to the nearest obstacle (of an AUV, to the bottom), at most 5 m; the mean is
        over time.
    on_drivable : float or None
        Share of a ground robot's way that led over ground on which it holds at least `DRIVABLE` of its speed.
    target_in_view : float or None
        Share of the picture that the target class covers, mean over frames a second apart.
    score_collected : float or None
        Sum of the scores of the distinct cells that the robot went through.
    """

    distance_m: float
    duration_s: float
    collisions: int
    interventions: int
    stuck: int
    stalled_s: float | None
    min_clearance_m: float | None
    mean_clearance_m: float | None
    on_drivable: float | None
    target_in_view: float | None
    score_collected: float | None


@dataclass(frozen=True)
class DriveEvaluation:
    """All drives.

    Attributes
    ----------
    total : DriveMeasure
        Of all logs together: sums, means over time, and the least clearance; each cell pays once.
    drives : dict of str to DriveMeasure
        By file; `score_collected` there is that of the drive by itself.
    clearance_m : float64 [n]
        Clearance at every record where it is known; empty without a world.
    weight_s : float64 [n]
        Time that each stands for.
    view : list of (float, float)
        Metres driven, over all logs, and share of the frame that shows the target.
    notes : list of str
        What was chosen, dropped or taken for granted in reading the logs.
    """

    total: DriveMeasure
    drives: dict[str, DriveMeasure]
    clearance_m: NDArray[np.float64]
    weight_s: NDArray[np.float64]
    view: list[tuple[float, float]]
    notes: list[str]


@dataclass(frozen=True)
class _Measured:
    """One drive with what its figures are made of."""

    measure: DriveMeasure
    clearance_m: NDArray[np.float64]
    weight_s: NDArray[np.float64]
    view: list[tuple[float, float]]
    notes: list[str]


def evaluate_drives(
    logs: Sequence[Path],
    *,
    world: Path | None = None,
    site: Site | None = None,
    scoremap: Path | None = None,
    target: str | None = None,
    progress: Progress = silent,
) -> DriveEvaluation:
    """Measure drives.

    Parameters
    ----------
    logs : sequence of Path
        Of one robot, in order.
    world : Path, optional
        The site's folder, for clearances and what was in view.
    site : Site, optional
        That site, where it is loaded already.
    scoremap : Path, optional
        For the score collected.
    target : str, optional
        Name or number of the class to look for. Default: the one that the world names.

    Raises
    ------
    InputError
        A log, the world or the scoremap cannot be used, or a log lies off them.
    ArgumentError
        The target is no class of the world, or there is a target and no world.
    """
    if site is None and world is not None:
        site = load_site(world)
    if site is None and target is not None:
        raise ArgumentError("--target needs a --world to look at")
    number = None if site is None or world is None else _target(site, target, world)
    found: dict[str, _Measured] = {}
    for index, path in enumerate(logs):
        score = _collected([path], scoremap)
        found[str(path)] = _measure(path, read_drive_log(path), site, number, score)
        progress(index + 1, len(logs))
    return _together(found, _collected(logs, scoremap))


def measure_log(path: Path, log: DriveLog) -> DriveMeasure:
    """Measure one drive by its log alone; `path` is for the message of an `InputError`."""
    return _measure(path, log, None, None, None).measure


def _target(site: Site, target: str | None, world: Path) -> int | None:
    if target is None:
        return site.target
    for number, name in site.names.items():
        if target in (name, str(number)):
            return number
    known = ", ".join(site.names.values()) or "none"
    raise ArgumentError(f"{world}: has no class {target!r} to look for (it has: {known})")


def _collected(logs: Sequence[Path], scoremap_path: Path | None) -> float | None:
    if scoremap_path is None:
        return None
    scoremap = read_scoremap(scoremap_path)
    cells = {(int(row), int(col)) for path in logs for row, col in driven_cells(path, scoremap)}
    scores = [float(scoremap.score[cell]) for cell in sorted(cells)]
    return math.fsum(score for score in scores if not math.isnan(score))


def _measure(path: Path, log: DriveLog, site: Site | None, target: int | None, score: float | None) -> _Measured:
    gone_m = _gone(path, log)
    step_s = np.where(_driven(log), np.diff(log.time_s), 0.0)
    weight_s = np.append(step_s, 0.0) / 2 + np.append(0.0, step_s) / 2
    clearance, on_drivable, view = np.zeros(0), None, []
    if site is not None:
        vehicle = vehicle_of(log, site)
        poses = poses_on(path, log, site)
        clearance = _clearances(site, poses, log, vehicle)
        known = ~np.isnan(clearance)
        clearance, weight_s = clearance[known], weight_s[known]
        on_drivable = _on_drivable(site, poses, gone_m) if vehicle.kind == "ugv" else None
        if target is not None:
            view = _views(site, poses, log, vehicle, target, gone_m)
    events = [event for _, event in log.events]
    measure = DriveMeasure(
        distance_m=float(gone_m[-1]),
        duration_s=float(log.time_s[-1] - log.time_s[0]),
        collisions=events.count("collision"),
        interventions=events.count("intervention"),
        stuck=events.count("stuck"),
        stalled_s=_stalled(log),
        min_clearance_m=_least(clearance),
        mean_clearance_m=_mean(clearance, weight_s),
        on_drivable=on_drivable,
        target_in_view=float(np.mean([share for _, share in view])) if view else None,
        score_collected=score,
    )
    return _Measured(measure, clearance, weight_s[: clearance.size], view, log_notes(path, log))


def _gone(path: Path, log: DriveLog) -> NDArray[np.float64]:
    """Return the metres driven up to each record: by speed where the log has it, else between places."""
    if np.isfinite(log.speed_m_s).all():
        legs = 0.5 * (log.speed_m_s[1:] + log.speed_m_s[:-1]) * np.diff(log.time_s)
        return np.append(0.0, np.cumsum(np.where(_driven(log), legs, 0.0)))
    try:
        return metres_gone(log.place, _crs(path, log), log.breaks)
    except ValueError as error:
        raise InputError(path, f"cannot be measured: {error}") from error


def _driven(log: DriveLog) -> NDArray[np.bool_]:
    """Whether each pair of neighbouring records [n - 1] has a drive between them."""
    driven = np.ones(len(log.time_s) - 1, np.bool_)
    driven[np.array(log.breaks, np.int64) - 1] = False
    return driven


def _crs(path: Path, log: DriveLog) -> CRS | None:
    if log.geographic:
        return WGS84
    try:
        return None if log.crs is None else CRS.from_user_input(log.crs)
    except CRSError as error:
        raise InputError(path, f"names a coordinate reference system that is not known: {error}") from error


def _stalled(log: DriveLog) -> float | None:
    if not (np.isfinite(log.speed_m_s).all() and np.isfinite(log.commanded_m_s).all()):
        return None
    told = log.commanded_m_s[1:] > _COMMANDED_M_S
    stands = log.speed_m_s[1:] < STALLED * log.commanded_m_s[1:]
    return float(np.diff(log.time_s)[told & stands & _driven(log)].sum())


def _clearances(site: Site, poses: Poses, log: DriveLog, vehicle: Vehicle) -> NDArray[np.float64]:
    radius = log.robot.radius_m if log.robot is not None else vehicle.radius_m
    reach = FARTHEST_M + radius
    room = np.full(len(poses.place), np.nan)
    for k, (east, south) in enumerate(poses.place):
        if vehicle.kind == "ugv":
            room[k] = min(sample(site.clearance_m, site.pixel_m, east, south), reach)
        elif not math.isnan(poses.height_m[k]):
            room[k] = bottom_clearance(site.surface_m, site.pixel_m, east, south, poses.height_m[k], reach)
    return np.clip(room - radius, 0.0, FARTHEST_M)


def _on_drivable(site: Site, poses: Poses, gone_m: NDArray[np.float64]) -> float | None:
    cols, rows = np.floor(poses.place / site.pixel_m).astype(np.int64).T
    inside = (rows >= 0) & (rows < site.grid.rows) & (cols >= 0) & (cols < site.grid.cols)
    good = np.zeros(len(rows), np.float64)
    good[inside] = site.speed_factor[rows[inside], cols[inside]] >= DRIVABLE
    way_m = np.diff(gone_m)
    return float((0.5 * (good[1:] + good[:-1]) * way_m).sum() / way_m.sum()) if way_m.sum() > 0 else None


def _views(
    site: Site, poses: Poses, log: DriveLog, vehicle: Vehicle, target: int, gone_m: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Return metres driven and the share of the picture that the target covers, for a frame every second."""
    due, at = -math.inf, []
    for k, now in enumerate(log.time_s):
        if now >= due:
            due = now + LOOK_EVERY_S
            at.append(k)
    frames = seen_from(site, poses, vehicle, at)
    return [(float(gone_m[k]), frame.share(target)) for k, frame in zip(at, frames, strict=True)]


def _together(found: dict[str, _Measured], score: float | None) -> DriveEvaluation:
    parts = list(found.values())
    measures = [each.measure for each in parts]
    clearance = np.concatenate([each.clearance_m for each in parts])
    weight = np.concatenate([each.weight_s for each in parts])
    view, before = [], 0.0
    for each in parts:
        view += [(before + gone, share) for gone, share in each.view]
        before += each.measure.distance_m
    stalls = [each.stalled_s for each in measures]
    total = DriveMeasure(
        distance_m=math.fsum(each.distance_m for each in measures),
        duration_s=math.fsum(each.duration_s for each in measures),
        collisions=sum(each.collisions for each in measures),
        interventions=sum(each.interventions for each in measures),
        stuck=sum(each.stuck for each in measures),
        stalled_s=None if None in stalls else math.fsum(each for each in stalls if each is not None),
        min_clearance_m=_least(clearance),
        mean_clearance_m=_mean(clearance, weight),
        on_drivable=_drivable_together(measures),
        target_in_view=float(np.mean([share for _, share in view])) if view else None,
        score_collected=score,
    )
    notes = [note for each in parts for note in each.notes]
    return DriveEvaluation(total, {name: each.measure for name, each in found.items()}, clearance, weight, view, notes)


def _drivable_together(measures: list[DriveMeasure]) -> float | None:
    """Return the share of all the way that is known, weighed by the metres of each drive."""
    known = [(each.on_drivable, each.distance_m) for each in measures if each.on_drivable is not None]
    way_m = math.fsum(metres for _, metres in known)
    return math.fsum(share * metres for share, metres in known) / way_m if way_m > 0 else None


def _least(clearance: NDArray[np.float64]) -> float | None:
    return float(clearance.min()) if clearance.size else None


def _mean(clearance: NDArray[np.float64], weight_s: NDArray[np.float64]) -> float | None:
    if not clearance.size:
        return None
    return float(np.average(clearance, weights=weight_s) if weight_s.sum() > 0 else clearance.mean())
