"""The table of mission formats, and the choice of one by name or by the output's suffix."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions import geojson, gpx, qgc, wpl
from hrt_cli.missions.mission import Mission, MissionOptions, mission_of


@dataclass(frozen=True)
class Format:
    """A mission format: its file suffixes (the usual one first), its writer and a line for the help."""

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[Mission], str]
    description: str


FORMATS: dict[str, Format] = {
    entry.name: entry
    for entry in (
        Format("qgc", (".plan",), qgc.to_text, "QGroundControl plan (ArduPilot, PX4)"),
        Format("wpl", (".waypoints", ".txt"), wpl.to_text, "QGC WPL 110 waypoints (Mission Planner, MAVProxy)"),
        Format("gpx", (".gpx",), gpx.to_text, "GPX 1.1 route"),
        Format("geojson", (".geojson", ".json"), geojson.to_text, "GeoJSON (RFC 7946) path and waypoints"),
    )
}


def format_for(path: str | os.PathLike[str], name: str | None = None) -> Format:
    """Return the format called `name`, or, where that is None, the one that `path`'s suffix stands for.

    Raises
    ------
    ArgumentError
        There is no such format, or no format has that suffix.
    """
    if name is not None:
        if name not in FORMATS:
            raise ArgumentError(f"there is no mission format {name!r}; there are {', '.join(FORMATS)}")
        return FORMATS[name]
    suffix = PurePath(path).suffix.lower()
    for entry in FORMATS.values():
        if suffix in entry.suffixes:
            return entry
    known = ", ".join(f"{entry.name} ({' '.join(entry.suffixes)})" for entry in FORMATS.values())
    raise ArgumentError(f"{os.fspath(path)}: its suffix names no mission format; use --format or one of {known}")


def export_text(plan: PlanDocument, options: MissionOptions, target: Format) -> str:
    """Write a plan in a mission format (the text ends with a newline; the same plan gives the same bytes).

    Raises
    ------
    ArgumentError
        The plan cannot be driven as a mission (`mission_of`), or has more items than the autopilot stores.
    """
    return target.write(mission_of(plan, options))
