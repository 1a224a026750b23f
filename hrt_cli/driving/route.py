"""From a plan to the line that a robot drives: on the site, from where it stands, clear of the survey's rim."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.driving.course import Course
from hrt_cli.driving.field import inside_rim, rim_distance
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.logs.read import log_notes, read_drive_log
from hrt_cli.raster.track import no_place_on_a_map, points_on
from hrt_cli.world.site import Site

_BACK_UP_M = 0.4
"""A robot that was stuck backs up so far before it goes on."""
_FARTHEST_MOVED_M = 3.0
"""A robot put down on an obstacle is moved to free ground that is no farther away."""


def planned_course(
    plan: PlanDocument, path: Path, site: Site, vehicle: Vehicle, after: Path | None
) -> tuple[Course, list[str]]:
    """Return the line to drive, from where the robot really stands, and what the user ought to know of it.

    Parameters
    ----------
    plan, path
        A plan and its file.
    after : Path or None
        Log of the drive that this one goes on from.

    Raises
    ------
    InputError
        The plan or the log has no place on the site.
    ArgumentError
        The robot cannot be put down at the start.
    """
    points = _on_site(path, np.array(plan.xy), plan.grid.crs, site)
    wanted, notes = (points[0], []) if after is None else _left_at(after, site)
    start = _free_place(site, wanted, vehicle)
    if start is None:
        raise ArgumentError(f"{path}: its start lies on an obstacle or off the survey, and no free ground is near")
    moved = float(np.hypot(*(start - wanted)))
    notes += [f"the robot is put down {moved:.1f} m beside the start, which is blocked"] if moved > 0.5 else []
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


def _left_at(path: Path, site: Site) -> tuple[NDArray[np.float64], list[str]]:
    """Return where a drive left the robot (where that was stuck, it has backed up a little), and notes on its log."""
    log = read_drive_log(path)
    if log.own_frame is not None:
        raise no_place_on_a_map(path, log.own_frame)
    place = _on_site(path, log.place[-1:], "EPSG:4326" if log.geographic else log.crs, site)[0]
    if log.end == "stuck" and np.isfinite(log.heading_deg[-1]):
        heading = math.radians(log.heading_deg[-1]) - site.up_bearing_rad
        place = place - _BACK_UP_M * np.array([math.sin(heading), -math.cos(heading)])
    return np.asarray(place), log_notes(path, log)


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
