"""The table of mission formats, and the choice of one by name or by the output's suffix."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import PurePath

from hrt_cli.errors import ArgumentError
from hrt_cli.missions import geojson, gpx, kml, moos, nav2, points_csv, qgc, wpl
from hrt_cli.missions.mavlink import item_count, item_limit
from hrt_cli.missions.mission import Mission, mission_of
from hrt_cli.missions.simplify import Bools
from hrt_cli.raster.scoremap import Scoremap


@dataclass(frozen=True)
class Format:
    """A mission format.

    Attributes
    ----------
    suffixes : tuple of str
        Of its files, the usual one first.
    write : callable
        From a mission to the file's text.
    description : str
        A line for the help.
    stored : bool
        An autopilot stores the mission, which has room for so many items.
    folder : callable, optional
        From a mission, and the scoremap where it is known, to the files of a folder by name, where there are several.
    """

    name: str
    suffixes: tuple[str, ...]
    write: Callable[[Mission], str]
    description: str
    stored: bool = False
    folder: Callable[[Mission, Scoremap | None], dict[str, bytes]] | None = None

    def is_folder(self, output: PurePath) -> bool:
        """Say whether an output is a folder: one without a suffix is, where the format has more than one file."""
        return self.folder is not None and not output.suffix

    def content(self, output: PurePath, mission: Mission, scoremap: Scoremap | None) -> bytes | dict[str, bytes]:
        """Return the bytes of a mission file, or of each file of a folder by name."""
        if self.folder is not None and self.is_folder(output):
            return self.folder(mission, scoremap)
        return self.write(mission).encode("utf-8")


FORMATS: dict[str, Format] = {
    entry.name: entry
    for entry in (
        Format("qgc", (".plan",), qgc.to_text, "QGroundControl plan (ArduPilot, PX4)", stored=True),
        Format(
            "wpl", (".waypoints", ".txt"), wpl.to_text, "QGC WPL 110 waypoints (Mission Planner, MAVProxy)", stored=True
        ),
        Format("gpx", (".gpx",), gpx.to_text, "GPX 1.1 route"),
        Format("geojson", (".geojson", ".json"), geojson.to_text, "GeoJSON (RFC 7946) path and waypoints"),
        Format("kml", (".kml",), kml.to_text, "KML 2.2 path and waypoints"),
        Format("csv", (".csv",), points_csv.to_text, "CSV table of waypoints"),
        Format(
            "nav2",
            (".yaml", ".yml"),
            nav2.to_text,
            "Nav2 GPS waypoints, or a folder with path, route, datum and maps",
            folder=nav2.to_files,
        ),
        Format("moos", (".bhv",), moos.to_text, "MOOS-IvP waypoint behavior"),
    )
}

_TRIED_CELLS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0)
"""Tolerances, in cells, of which the first that makes room is named where a mission has too many items."""


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


def require_room(mission: Mission, go: Bools | None) -> None:
    """Refuse a mission of more items than the autopilot stores, and say how it becomes one of fewer.

    Raises
    ------
    ArgumentError
        It has.
    """
    options = mission.options
    limit = item_limit(options)
    if item_count(mission) <= limit:
        return
    remedy = "plan on a coarser scoremap (--cell) or with a smaller --budget"
    if options.spacing_m is not None:
        remedy = "a larger --spacing, or " + remedy
    for cells in _TRIED_CELLS:
        tolerance_m = float(f"{cells * mission.plan.grid.cell_size_m:.3g}")
        if tolerance_m <= options.tolerance_m:
            continue
        count = item_count(mission_of(mission.plan, replace(options, tolerance_m=tolerance_m), go))
        if count <= limit:
            remedy = f"--tolerance {tolerance_m:g} makes {count} of them; or {remedy}"
            break
    else:
        remedy = f"--tolerance leaves out corners; {remedy}" if go is not None else f"give --scoremap; {remedy}"
    raise ArgumentError(
        f"mission has {item_count(mission)} items (home, speed and {len(mission.stops)} waypoints), more than the"
        f" {limit} that the autopilot ({options.firmware}) stores: {remedy}; --max-items, if the board stores more"
    )
