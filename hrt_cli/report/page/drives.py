"""Drives as tracks that a page plays: places, headings, speeds, what happened, and how near the obstacles were."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.evaluation.drives import FARTHEST_M, DriveEvaluation
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.grid import WGS84
from hrt_cli.raster.track import no_place_on_a_map
from hrt_cli.report.page.frame import Frame

Floats = NDArray[np.float64]

MOST_RECORDS = 4000
_BIN_M = 0.1


def places_of(path: Path, log: DriveLog, frame: Frame) -> tuple[Floats, Floats]:
    """Return east and north [n] of a log's places.

    Raises
    ------
    InputError
        They have no place in the frame.
    """
    if log.own_frame is not None:
        raise no_place_on_a_map(path, log.own_frame)
    if not log.geographic and log.crs is None:
        if frame.crs is None:
            return log.place[:, 0], log.place[:, 1]
        raise InputError(path, "does not say in which coordinate reference system its places are")
    try:
        crs = WGS84 if log.geographic else CRS.from_user_input(log.crs)
        return frame.of_points(log.place[:, 0], log.place[:, 1], crs)
    except (ValueError, CRSError) as error:
        raise InputError(path, f"cannot be laid on the map: {error}") from error


def track(path: Path, name: str, frame: Frame) -> dict[str, Any]:
    """Return a drive as a track, thinned to `MOST_RECORDS`, its events and breaks kept.

    Raises
    ------
    InputError
        See `places_of` and `hrt_cli.logs.read.read_drive_log`.
    """
    log = read_drive_log(path)
    east, north = places_of(path, log, frame)
    keep = _kept(log)
    heading = np.where(np.isfinite(log.heading_deg), log.heading_deg, np.nan)
    return {
        "name": name,
        "t": _rounded(log.time_s[keep] - log.time_s[0], 3),
        "e": _rounded(east[keep], 3),
        "n": _rounded(north[keep], 3),
        "heading": _known(heading[keep], 1),
        "speed": _known(log.speed_m_s[keep], 3),
        "breaks": np.searchsorted(keep, log.breaks).tolist(),
        "events": [
            {
                "t": round(float(log.time_s[index] - log.time_s[0]), 3),
                "e": round(float(east[index]), 3),
                "n": round(float(north[index]), 3),
                "kind": kind,
            }
            for index, kind in log.events
        ],
        "robot": None if log.robot is None else {"kind": log.robot.kind, "radius_m": log.robot.radius_m},
        "end": log.end,
        "notes": list(log.notes),
        "frames": [],
    }


def _kept(log: DriveLog) -> NDArray[np.int64]:
    n = len(log.time_s)
    even = np.linspace(0, n - 1, min(n, MOST_RECORDS)).astype(np.int64)
    marked = [index for index, _ in log.events] + [at for k in log.breaks for at in (k - 1, k)]
    return np.unique(np.concatenate([even, np.array(marked, np.int64)]))


def _rounded(values: Floats, digits: int) -> list[float]:
    found: list[float] = np.round(values, digits).tolist()
    return found


def _known(values: Floats, digits: int) -> list[float | None]:
    return [round(float(value), digits) if np.isfinite(value) else None for value in values]


def clearance_chart(name: str, found: DriveEvaluation) -> dict[str, Any] | None:
    """Return how much of the time the robot was how near to the nearest obstacle, None where that is not known."""
    if not found.clearance_m.size:
        return None
    weight = found.weight_s if found.weight_s.sum() > 0 else np.ones(found.clearance_m.size)
    edges = np.arange(0.0, float(found.clearance_m.max()) + 1.5 * _BIN_M, _BIN_M)
    share, _ = np.histogram(found.clearance_m, edges, weights=weight / weight.sum())
    return {
        "type": "steps",
        "title": f"{name}: distance to the nearest obstacle",
        "x": f"metres; {FARTHEST_M:g} stands for all beyond",
        "y": "share of the time, %",
        "edges": [round(float(edge), 3) for edge in edges],
        "values": [round(100 * float(each), 3) for each in share],
        "mark": {"x": found.total.mean_clearance_m, "name": "mean"},
    }
