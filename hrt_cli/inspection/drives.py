"""What is in a drive log: how far, how long, where, and what it tells of the robot besides."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.logs.assemble import MEASURES
from hrt_cli.logs.bag import topics_of
from hrt_cli.logs.kinds import BAG, FOLDER, MCAP, SQLITE, files_of, kind_of
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.grid import WGS84, Grid, wrapped_deg
from hrt_cli.raster.track import no_place_on_a_map


@dataclass(frozen=True)
class LogInspection:
    """What `inspect` found in a drive log.

    Attributes
    ----------
    facts : dict
        JSON values by name, as `hrt inspect --json` prints them; None where the log does not tell.
    notes : list of str
        What was chosen, dropped or taken for granted in reading it.
    refusal : str or None
        Why no command can lay the log on a raster, as `feedback` does; None if they can.
    """

    facts: dict[str, Any]
    notes: list[str]
    refusal: str | None


def inspect_log(path: Path) -> LogInspection:
    """Look at a drive log as `feedback` would, and tell what is known of it.

    Distances are sums of ground metres between consecutive places, none from one segment of a log to the next; where
    a log names neither degrees nor a CRS its units are taken to be metres. Bounds are least and greatest x and y
    (longitude, latitude); the least longitude is the larger number where a drive crosses 180°.

    Raises
    ------
    InputError
        The log cannot be read.
    """
    kind, log = kind_of(path), read_drive_log(path)
    duration_s = float(log.time_s[-1] - log.time_s[0])
    distance_m, refusal = _distance(path, log)
    counts = Counter(event for _, event in log.events)
    known = [name for name in MEASURES if np.isfinite(getattr(log, name)).any()] + (["events"] if counts else [])
    notes = list(log.notes)
    if not log.geographic and log.crs is None and log.own_frame is None:
        notes.append("names no CRS: its x, y are taken to be metres, and to be in that of the raster it is laid on")
    facts = {
        "file": path.name,
        "bytes": sum(each.stat().st_size for each in files_of("", path).values()),
        "format": kind.name,
        "records": int(log.time_s.size),
        "begins_s": float(log.time_s[0]),
        "duration_s": duration_s,
        "distance_m": distance_m,
        "mean_speed_m_s": distance_m / duration_s if distance_m is not None and duration_s > 0 else None,
        "geographic": log.geographic,
        "crs": log.crs,
        "own_frame": log.own_frame,
        "start": log.place[0].tolist(),
        "end": log.place[-1].tolist(),
        "bounds": _bounds(log),
        "segments": len(log.breaks) + 1,
        "robot": log.robot.kind if log.robot else None,
        "ended": log.end,
        "known": known,
        "unknown": [name for name in (*MEASURES, "events") if name not in known],
        "events": dict(sorted(counts.items())),
    }
    if kind in (BAG, FOLDER, MCAP, SQLITE):
        facts["topics"] = topics_of(path, kind)
    return LogInspection(facts, notes, refusal)


def _distance(path: Path, log: DriveLog) -> tuple[float | None, str | None]:
    """Return the metres driven, and why the log has no place on a raster."""
    if log.own_frame is not None:
        return _sum(Grid(1, 1, Affine.identity(), None), log), str(no_place_on_a_map(path, log.own_frame))
    try:
        crs = WGS84 if log.geographic else None if log.crs is None else CRS.from_user_input(log.crs)
        return _sum(Grid(1, 1, Affine.identity(), crs), log), None
    except (CRSError, ValueError) as error:
        return None, f"{path}: cannot be laid on a raster: {error}"


def _sum(grid: Grid, log: DriveLog) -> float:
    # Pixels of one unit with their origin at 0, 0: places are pixel positions, and lengths ground metres.
    legs: NDArray[np.float64] = grid.ground_length_m(log.place[:, 1], log.place[:, 0])
    legs[np.array(log.breaks, np.int64) - 1] = 0.0
    return float(legs.sum())


def _bounds(log: DriveLog) -> list[float]:
    x = np.unwrap(log.place[:, 0], period=360.0) if log.geographic else log.place[:, 0]
    found = [x.min(), log.place[:, 1].min(), x.max(), log.place[:, 1].max()]
    if log.geographic:
        found[::2] = [each if abs(each) <= 180 else float(wrapped_deg(each)) for each in found[::2]]
    return [float(each) for each in found]
