"""The drive log artifact (`drive.jsonl`): where a robot was and when, and what happened on the way.

One JSON object a line. The first is a header, `{"format": "hrt-drive-log", "version": 1, "crs": ...}`, where `crs` is
an authority code or WKT; every other one a record with `t` (seconds, never falling) and a place: `lon, lat` (WGS 84
degrees), or `x, y` in the header's CRS. Speeds (`speed_m_s` as achieved, `commanded_m_s`), `heading_deg` (clockwise
from true north), what an underwater robot knows besides (`pitch_deg`, nose up; `depth_m` below the surface), and an
`event` may stand beside them. A CSV with columns of these names is read as well, and the tracks of a GPX.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from hrt_cli.artifacts.carriers import checked
from hrt_cli.artifacts.gpxlog import read_gpx
from hrt_cli.artifacts.jsonio import Document, describe, parse_strict, read_text
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError

MAX_BYTES = 256 * 1024 * 1024

M = TypeVar("M", bound=Document)

Event = Literal["stuck", "collision", "intervention"]
End = Literal["arrived", "stuck", "out of time"]
"""Why a drive ended."""


class Robot(Document):
    """Who drove: a ground (`ugv`) or underwater (`auv`) robot that fits into a circle of `radius_m`."""

    kind: Literal["ugv", "auv"]
    radius_m: float = Field(gt=0, le=100)


class Header(Document):
    """The first line of a log."""

    format: Literal["hrt-drive-log"]
    version: Literal[1] = 1
    crs: str | None = None
    robot: Robot | None = None
    end: End | None = None
    provenance: Provenance | None = None


_HEADER = Header(format="hrt-drive-log")
"""What a file without one says of the drive: nothing."""


class Record(Document):
    """One moment of a drive."""

    t: float = Field(allow_inf_nan=False)
    x: float | None = Field(default=None, allow_inf_nan=False)
    y: float | None = Field(default=None, allow_inf_nan=False)
    lon: float | None = Field(default=None, ge=-180, le=180)
    lat: float | None = Field(default=None, ge=-90, le=90)
    speed_m_s: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    commanded_m_s: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    heading_deg: float | None = Field(default=None, ge=-360, le=360)
    pitch_deg: float | None = Field(default=None, ge=-90, le=90)
    depth_m: float | None = Field(default=None, allow_inf_nan=False)
    event: Event | None = None

    @model_validator(mode="after")
    def _placed(self) -> Record:
        plane = (self.x is not None) + (self.y is not None)
        globe = (self.lon is not None) + (self.lat is not None)
        if (plane, globe) not in ((2, 0), (0, 2)):
            raise ValueError("a record needs either x and y, or lon and lat")
        return self


@dataclass(frozen=True)
class DriveLog:
    """A drive.

    Attributes
    ----------
    time_s : ndarray, float64 [n]
        Seconds, never falling.
    place : ndarray, float64 [n, 2]
        lon, lat in degrees where `geographic`, else x, y in `crs`.
    geographic : bool
        Which of the two.
    crs : str or None
        CRS of x, y; None where the log does not say.
    events : tuple of (int, str)
        Index of the record, and what happened there.
    speed_m_s, commanded_m_s, heading_deg, pitch_deg, depth_m : ndarray, float64 [n]
        NaN where the log does not say.
    robot : Robot or None
        Who drove, where the log says so.
    end : str or None
        Why the drive ended, likewise.
    breaks : tuple of int
        Records before which nothing was logged for a while (the segments of a GPX track): no drive leads to them.
    """

    time_s: NDArray[np.float64]
    place: NDArray[np.float64]
    geographic: bool
    crs: str | None
    events: tuple[tuple[int, str], ...]
    speed_m_s: NDArray[np.float64]
    commanded_m_s: NDArray[np.float64]
    heading_deg: NDArray[np.float64]
    pitch_deg: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    robot: Robot | None
    end: End | None
    breaks: tuple[int, ...] = ()


def read_drive_log(path: Path) -> DriveLog:
    """Read a drive log, `.jsonl`, `.csv` or `.gpx`. One with provenance is checked against it.

    Raises
    ------
    InputError
        The file is no log, its last line is cut, time goes backwards, or a record has no place.
    """
    text = read_text(path, MAX_BYTES)
    if not text.strip():
        raise InputError(path, "is empty")
    suffix = path.suffix.lower()
    if suffix != ".gpx" and not text.endswith("\n"):
        # A number cut in its digits still reads as a number: the missing end of line is the only sign.
        raise InputError(path, "ends within a line: the log was cut off", "drop its last line if that is all")
    breaks: tuple[int, ...] = ()
    if suffix == ".gpx":
        found, breaks = read_gpx(path, text)
        header, records = _HEADER, [_model(path, number, Record, each) for number, each in enumerate(found, start=1)]
    else:
        header, records = _from_csv(path, text) if suffix == ".csv" else _from_lines(path, text)
    if not records:
        raise InputError(path, "has no records")
    geographic = records[0].lon is not None
    time = np.array([record.t for record in records])
    falls = np.flatnonzero(np.diff(time) < 0)
    if falls.size:
        at = int(falls[0]) + 1
        raise InputError(path, f"time goes backwards at record {at + 1} ({time[at - 1]:g} s, then {time[at]:g} s)")
    if any((record.lon is not None) != geographic for record in records):
        raise InputError(path, "mixes places in lon, lat with places in x, y")
    place = [(r.lon, r.lat) if geographic else (r.x, r.y) for r in records]
    events = tuple((index, record.event) for index, record in enumerate(records) if record.event is not None)
    return DriveLog(
        time_s=time,
        place=np.array(place, np.float64),
        geographic=geographic,
        crs=header.crs,
        events=events,
        speed_m_s=_column(r.speed_m_s for r in records),
        commanded_m_s=_column(r.commanded_m_s for r in records),
        heading_deg=_column(r.heading_deg for r in records),
        pitch_deg=_column(r.pitch_deg for r in records),
        depth_m=_column(r.depth_m for r in records),
        robot=header.robot,
        end=header.end,
        breaks=breaks,
    )


def publish_drive_log(target: Path, header: Header, records: list[dict[str, Any]], provenance: Provenance) -> None:
    """Publish a drive log of canonical JSON lines; records hold the members of `Record` that are known."""
    lines = [json.dumps(record, allow_nan=False) for record in records]
    stamped = provenance.with_content(_records_sha256(lines))
    first = header.model_copy(update={"provenance": stamped}).model_dump(mode="json", exclude_none=True)
    with publishing(target, drive_provenance) as draft:
        draft.write_text("\n".join([json.dumps(first), *lines]) + "\n", encoding="utf-8")


def drive_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a drive log and check its records against it."""
    lines = read_text(path, MAX_BYTES).split("\n")
    found = _model(path, 1, Header, parse_strict(path, lines[0])).provenance
    return None if found is None else checked(path, found, _records_sha256(lines[1:-1]))


def _records_sha256(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _column(values: Iterable[float | None]) -> NDArray[np.float64]:
    return np.array([math.nan if value is None else value for value in values], np.float64)


def _from_lines(path: Path, text: str) -> tuple[Header, list[Record]]:
    lines = text.splitlines()
    header = _model(path, 1, Header, parse_strict(path, lines[0]))
    if header.provenance is not None:
        drive_provenance(path)
    return header, [
        _model(path, number, Record, parse_strict(path, line))
        for number, line in enumerate(lines[1:], start=2)
        if line.strip()
    ]


def _from_csv(path: Path, text: str) -> tuple[Header, list[Record]]:
    reader = csv.DictReader(io.StringIO(text))
    known = set(Record.model_fields)
    names = [name.strip() for name in reader.fieldnames or []]
    if "t" not in names:
        raise InputError(path, f"has no column t (it has: {', '.join(names) or 'none'})")
    if len(set(names)) != len(names):
        raise InputError(path, "names a column twice")
    records = []
    for row in reader:
        number = reader.line_num
        values = {name.strip(): text for name, text in row.items() if name is not None and text}
        if None in row:
            raise InputError(path, f"line {number} has more fields than the first line names")
        record: dict[str, float | str] = {}
        for name in known & set(values):
            record[name] = values[name] if name == "event" else _number(path, number, name, values[name])
        records.append(_model(path, number, Record, record))
    return _HEADER, records


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, f"line {line}: {name} is {text.strip()!r}, not a finite number")
    return value


def _model(path: Path, line: int, model: type[M], value: object) -> M:
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise InputError(path, f"line {line}: {describe(error)}") from error
