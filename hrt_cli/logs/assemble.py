"""What the readers found, as a drive log: the checks that hold for every format."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog, Header, Record
from hrt_cli.errors import InputError

Floats = NDArray[np.float64]

NO_HEADER = Header(format="hrt-drive-log")
"""What a file without one says of the drive: nothing."""

MEASURES: dict[str, tuple[float, float]] = {
    "speed_m_s": (0.0, math.inf),
    "commanded_m_s": (0.0, math.inf),
    "heading_deg": (-360.0, 360.0),
    "pitch_deg": (-90.0, 90.0),
    "roll_deg": (-180.0, 180.0),
    "depth_m": (-math.inf, math.inf),
}
"""What a log may tell of each record besides time and place, and between which values."""


def log_of_records(
    path: Path,
    header: Header,
    records: Sequence[Record],
    *,
    breaks: tuple[int, ...] = (),
    notes: Sequence[str] = (),
) -> DriveLog:
    """Return records as a drive log.

    Raises
    ------
    InputError
        There are no records, time goes backwards, or some places are in degrees and some are not.
    """
    if not records:
        raise InputError(path, "has no records")
    geographic = records[0].lon is not None
    time = np.array([record.t for record in records])
    _check_time(path, time)
    if any((record.lon is not None) != geographic for record in records):
        raise InputError(path, "mixes places in lon, lat with places in x, y")
    place = [(r.lon, r.lat) if geographic else (r.x, r.y) for r in records]
    return DriveLog(
        time_s=time,
        place=np.array(place, np.float64),
        geographic=geographic,
        crs=header.crs,
        events=tuple((index, record.event) for index, record in enumerate(records) if record.event is not None),
        speed_m_s=_column(r.speed_m_s for r in records),
        commanded_m_s=_column(r.commanded_m_s for r in records),
        heading_deg=_column(r.heading_deg for r in records),
        pitch_deg=_column(r.pitch_deg for r in records),
        roll_deg=_column(r.roll_deg for r in records),
        depth_m=_column(r.depth_m for r in records),
        robot=header.robot,
        end=header.end,
        breaks=breaks,
        notes=tuple(notes),
    )


def log_of_columns(
    path: Path,
    time_s: Floats,
    place: Floats,
    known: dict[str, Floats],
    *,
    own_frame: str | None = None,
    notes: Sequence[str] = (),
) -> DriveLog:
    """Return arrays as a drive log.

    Parameters
    ----------
    time_s : float64 [n]
        Seconds.
    place : float64 [n, 2]
        Longitude and latitude, or with `own_frame` x and y in metres.
    known : dict of str to float64 [n]
        Members of the log that the file tells, from `speed_m_s` to `roll_deg`.

    Raises
    ------
    InputError
        There are no records, time goes backwards, or a value is out of its range.
    """
    if not time_s.size:
        raise InputError(path, "has no records")
    if not (np.isfinite(time_s).all() and np.isfinite(place).all()):
        raise InputError(path, "has times or places that are not finite numbers")
    _check_time(path, time_s)
    if own_frame is None and (np.abs(place) > (180.0, 90.0)).any():
        at = int(np.flatnonzero((np.abs(place) > (180.0, 90.0)).any(axis=1))[0])
        raise InputError(path, f"record {at + 1} is at {place[at, 1]:g}, {place[at, 0]:g}: no place on Earth")
    unknown = np.full(time_s.size, np.nan)
    told = {name: known.get(name, unknown) for name in MEASURES}
    for name, (low, high) in MEASURES.items():
        wrong = np.isinf(told[name]) | (told[name] < low) | (told[name] > high)
        if wrong.any():
            at = int(np.flatnonzero(wrong)[0])
            raise InputError(path, f"record {at + 1}: {name} is {told[name][at]:g}, not from {low:g} to {high:g}")
    return DriveLog(
        time_s=time_s,
        place=place,
        geographic=own_frame is None,
        crs=None,
        events=(),
        speed_m_s=told["speed_m_s"],
        commanded_m_s=told["commanded_m_s"],
        heading_deg=told["heading_deg"],
        pitch_deg=told["pitch_deg"],
        roll_deg=told["roll_deg"],
        depth_m=told["depth_m"],
        robot=None,
        end=None,
        own_frame=own_frame,
        notes=tuple(notes),
    )


def _check_time(path: Path, time_s: Floats) -> None:
    falls = np.flatnonzero(np.diff(time_s) < 0)
    if falls.size:
        at = int(falls[0]) + 1
        raise InputError(path, f"time goes backwards at record {at + 1} ({time_s[at - 1]:g} s, then {time_s[at]:g} s)")


def _column(values: Iterable[float | None]) -> Floats:
    return np.array([math.nan if value is None else value for value in values], np.float64)
