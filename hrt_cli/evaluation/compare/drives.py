"""Two drive logs: how far, how long, what happened, and how far apart the robots were at equal times."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.result import Figure, Found, apart, number, text
from hrt_cli.evaluation.compare.tracks import Floats, ground_metres
from hrt_cli.evaluation.drives import measure_log
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.grid import WGS84, transform_points, wrapped_deg

_MEASURES = {
    "distance_m": "m",
    "duration_s": "s",
    "collisions": "",
    "interventions": "",
    "stuck": "",
    "stalled_s": "s",
}
_COLUMNS = {
    "speed_m_s": "m/s",
    "commanded_m_s": "m/s",
    "heading_deg": "deg",
    "pitch_deg": "deg",
    "roll_deg": "deg",
    "depth_m": "m",
}


def compare_drives(path_a: Path, path_b: Path) -> Found:
    """Compare two drive logs.

    `apart_m` is the largest distance between the robots, in ground metres, at equal times since each log began: at
    every record of either, between whose places a robot goes straight; the one whose log is over stands where it ended.
    Logs of as many records are compared record by record besides: `times_s`, and each column that both have.
    `events` counts those that only one has at that time, `breaks` the records that no drive leads to in only one.

    Raises
    ------
    InputError
        A log cannot be used, or names a CRS that is not known.
    """
    a, b = (read_drive_log(path, as_it_stands=True) for path in (path_a, path_b))
    measure_a, measure_b = measure_log(path_a, a), measure_log(path_b, b)
    figures = [_tracks(path_a, a, path_b, b)]
    figures += [
        number(name, getattr(measure_a, name), getattr(measure_b, name), unit) for name, unit in _MEASURES.items()
    ]
    events_a, events_b = (
        Counter((float(log.time_s[k] - log.time_s[0]), what) for k, what in log.events) for log in (a, b)
    )
    only = sorted((events_a - events_b).elements()), sorted((events_b - events_a).elements())
    figures += [
        number("records", len(a.time_s), len(b.time_s)),
        apart("events", float(len(only[0]) + len(only[1]))),
        *(_by_record(a, b) if len(a.time_s) == len(b.time_s) else []),
        text("frame", _frame(a), _frame(b), counts=origin_of(path_a, a) is None or origin_of(path_b, b) is None),
        text("end", a.end or "unknown", b.end or "unknown"),
        text("robot", _robot(a), _robot(b)),
        apart("breaks", float(len(set(a.breaks) ^ set(b.breaks)))),
    ]
    lines = [
        f"{what} after {at_s:.6g} s in {name} only"
        for name, found in zip("AB", only, strict=True)
        for at_s, what in found
    ]
    detail = {
        "notes": {"a": list(a.notes), "b": list(b.notes)},
        "events": {name: [list(each) for each in found] for name, found in zip("ab", only, strict=True)},
    }
    return Found(figures, lines, detail)


def places_of(path: Path, log: DriveLog, origin_deg: tuple[float, float] | None) -> Floats:
    """Return the places [n, 2] of a log in metres (east, north) from an origin; its own, where its frame has none."""
    if origin_deg is None:
        return log.place
    return ground_metres(*_lonlat(path, log), origin_deg)


def origin_of(path: Path, log: DriveLog) -> tuple[float, float] | None:
    """Return where a log begins, longitude and latitude; None where its places are not on the map."""
    if not log.geographic and (log.crs is None or log.own_frame is not None):
        return None
    lon, lat = _lonlat(path, log)
    return float(lon[0]), float(lat[0])


def _lonlat(path: Path, log: DriveLog) -> tuple[Floats, Floats]:
    if log.geographic:
        return log.place[:, 0], log.place[:, 1]
    try:
        return transform_points(CRS.from_user_input(log.crs), WGS84, log.place[:, 0], log.place[:, 1])
    except (CRSError, ValueError) as error:
        raise InputError(path, f"has no place on the Earth: {error}") from error


def _tracks(path_a: Path, a: DriveLog, path_b: Path, b: DriveLog) -> Figure:
    origin = origin_of(path_a, a)
    if (origin is None) != (origin_of(path_b, b) is None) or a.own_frame != b.own_frame:
        return apart("apart_m", None, "m")
    place_a, place_b = places_of(path_a, a, origin), places_of(path_b, b, origin)
    gone_a, gone_b = a.time_s - a.time_s[0], b.time_s - b.time_s[0]
    if np.array_equal(gone_a, gone_b):  # also where several records have one time
        return apart("apart_m", float(np.hypot(*(place_a - place_b).T).max()), "m")
    times = np.union1d(gone_a, gone_b)
    at_a, at_b = (
        np.stack([np.interp(times, gone, place[:, axis]) for axis in (0, 1)], axis=1)
        for gone, place in ((gone_a, place_a), (gone_b, place_b))
    )
    return apart("apart_m", float(np.hypot(*(at_a - at_b).T).max()), "m")


def _by_record(a: DriveLog, b: DriveLog) -> list[Figure]:
    gap_s = np.abs((a.time_s - a.time_s[0]) - (b.time_s - b.time_s[0]))
    figures = [apart("times_s", float(gap_s.max()), "s")]
    for name, unit in _COLUMNS.items():
        of_a, of_b = getattr(a, name), getattr(b, name)
        if np.isnan(of_a).all() and np.isnan(of_b).all():
            continue
        gap = np.abs(wrapped_deg(of_a - of_b) if name == "heading_deg" else of_a - of_b)
        known = ~(np.isnan(of_a) & np.isnan(of_b))
        most = float(gap[known].max())  # NaN where only one knows it
        figures.append(apart(name, None if np.isnan(most) else most, unit))
    return figures


def _frame(log: DriveLog) -> str:
    if log.own_frame is not None:
        return f"own: {log.own_frame}"
    return "WGS 84" if log.geographic else log.crs or "unknown"


def _robot(log: DriveLog) -> str:
    return "unknown" if log.robot is None else f"{log.robot.kind}, radius {log.robot.radius_m:g} m"
