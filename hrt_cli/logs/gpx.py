"""GPX 1.0 and 1.1 as a drive log: the points of its tracks, with their times.

GPX 1.0 knows the speed (m/s) and the course (degrees from true north) of a point; in GPX 1.1 receivers write them as
extensions, which are found by their names whatever their namespace. Times are UTC (https://www.topografix.com/GPX/1/1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hrt_cli.artifacts.drivelog import DriveLog, Record, line_model
from hrt_cli.errors import InputError
from hrt_cli.logs.assemble import NO_HEADER, log_of_records

if TYPE_CHECKING:
    from gpxpy.gpx import GPXTrackPoint

_DECLARES = re.compile(r"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
_MOST_NESTED = 20


def read_gpx(path: Path, text: str) -> DriveLog:
    """Return the points of all tracks: Unix seconds, lon, lat, and where the file says so speed and heading.

    Raises
    ------
    InputError
        The file is no GPX with tracks, declares a document type or entities, or has a point without time or place.
    """
    if _DECLARES.search(text):
        raise InputError(path, "declares a document type or entities, which no GPX needs")
    # Imported here: most logs are not GPX.
    import gpxpy

    try:
        tracks = gpxpy.parse(text).tracks
    except Exception as error:  # gpxpy lets through whatever its XML parser and `datetime` raise
        raise InputError(path, f"is not a GPX that can be read: {' '.join(str(error).split())[:200]}") from error
    records: list[dict[str, float]] = []
    breaks: list[int] = []
    for segment in (segment for track in tracks for segment in track.segments if segment.points):
        if records:
            breaks.append(len(records))
        for point in segment.points:
            records.append(_record(path, point, len(records) + 1))
    if not records:
        raise InputError(path, "has no track with points: routes and waypoints are no drive")
    checked = [line_model(path, number, Record, each) for number, each in enumerate(records, start=1)]
    return log_of_records(path, NO_HEADER, checked, breaks=tuple(breaks))


def _record(path: Path, point: GPXTrackPoint, number: int) -> dict[str, float]:
    if point.time is None:
        raise InputError(
            path, f"track point {number} has no time that can be read", "a drive log needs the time of every point"
        )
    if not (abs(point.latitude) <= 90 and abs(point.longitude) <= 180):
        raise InputError(path, f"track point {number} is at {point.latitude:g}, {point.longitude:g}: no place on Earth")
    time = point.time if point.time.tzinfo is not None else point.time.replace(tzinfo=UTC)
    found = {"t": time.timestamp(), "lon": float(point.longitude), "lat": float(point.latitude)}
    known = dict(_extensions(point.extensions))
    # Receivers write -1 for what they do not know.
    speed = point.speed if point.speed is not None else _real(known.get("speed"))
    if speed is not None and 0 <= speed < math.inf:
        found["speed_m_s"] = float(speed)
    course = point.course if point.course is not None else _real(known.get("course"))
    if course is not None and 0 <= course <= 360:
        found["heading_deg"] = float(course)
    return found


def _extensions(elements: Any, depth: int = 0) -> Iterator[tuple[str, str]]:
    """Yield the bare name and the text of every element among extensions, nested or not."""
    for element in elements if depth < _MOST_NESTED else ():
        if isinstance(element.tag, str):  # comments have none
            yield element.tag.rpartition("}")[2].lower(), element.text or ""
        yield from _extensions(element, depth + 1)


def _real(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
