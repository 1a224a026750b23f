"""The drive log artifact (`drive.jsonl`): where a robot was and when, and what happened on the way.

One JSON object a line. The first is a header, `{"format": "hrt-drive-log", "version": 1, "crs": ...}`, where `crs` is
an authority code or WKT; every other one a record with `t` (seconds, never falling) and a place: `lon, lat` (WGS 84
degrees), or `x, y` in the header's CRS. Speeds (`speed_m_s` as achieved, `commanded_m_s`), `heading_deg` (clockwise
from true north), `pitch_deg` (nose up), `roll_deg` (right side down), what an underwater robot knows besides (`depth_m`
below the surface), and an `event` may stand beside them. The readers, of this and of other formats, are in `logs`.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from hrt_cli.artifacts.carriers import checked
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
    roll_deg: float | None = Field(default=None, ge=-180, le=180)
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
    speed_m_s, commanded_m_s, heading_deg, pitch_deg, roll_deg, depth_m : ndarray, float64 [n]
        NaN where the log does not say.
    robot : Robot or None
        Who drove, where the log says so.
    end : str or None
        Why the drive ended, likewise.
    breaks : tuple of int
        Records before which nothing was logged for a while (the segments of a GPX track): no drive leads to them.
    own_frame : str or None
        Name of the robot's own frame that x, y are in, metres from where it was switched on: they have no place on a
        map. None where they have one.
    notes : tuple of str
        What was chosen, dropped or taken for granted in reading the file, a clause each.
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
    roll_deg: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    robot: Robot | None
    end: End | None
    breaks: tuple[int, ...] = ()
    own_frame: str | None = None
    notes: tuple[str, ...] = ()


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
    found = line_model(path, 1, Header, parse_strict(path, lines[0])).provenance
    return None if found is None else checked(path, found, _records_sha256(lines[1:-1]))


def _records_sha256(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def line_model(path: Path, line: int, model: type[M], value: object) -> M:
    """Return what a line of a log holds as `model`; an `InputError` names the line (counted from 1) that is none."""
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise InputError(path, f"line {line}: {describe(error)}") from error
