"""MOOS-IvP: a behavior file (`.bhv`) whose waypoint behavior drives the mission in the metres of the local frame.

https://oceanai.mit.edu/ivpman. The helm's reader (lib_helmivp, lib_mbutil) takes one `name = value` a line, comments
begin with `//` or `#`, and a brace at the end of a line counts as one on a line of its own: so the points stand as
`x,y:x,y`, without braces. It reads lines beyond 5000 characters wrongly; one that ends in a backslash goes on in the
next, and so points that fill more than a line stand in several.
"""

from __future__ import annotations

import math

from rasterio.crs import CRS

from hrt_cli.errors import ArgumentError
from hrt_cli.missions.local import LocalFrame
from hrt_cli.missions.mission import Mission, fixed, printable
from hrt_cli.raster.grid import WGS84, transform_points

_METRE_DECIMALS = 3
_DEGREE_DECIMALS = 9
_MOST_IN_LINE = 4000
_POINTS_A_LINE = 6
_CAPTURE_CELLS = 0.5  # turning there, the robot does not leave the cell of the waypoint
_SLIP = 2.0  # a waypoint that was missed by so many capture radii counts as reached once it falls behind


def to_text(mission: Mission) -> str:
    """Write a mission as a behavior file: BHV_Waypoint, and for a submarine BHV_ConstantDepth beside it.

    Both run while DEPLOY is true; the last waypoint makes it false. The capture radius is that of the options, else
    half a cell.

    Raises
    ------
    ArgumentError
        The mission waits at waypoints or keeps a height above the bottom, for which these behaviors have no parameter.
    """
    options = mission.options
    if options.hold_s:
        raise ArgumentError("MOOS' waypoint behavior does not wait at waypoints: leave out --hold")
    if options.above_bottom_m is not None:
        raise ArgumentError(
            "MOOS-IvP has no behavior that keeps a height above the bottom: give --depth in place of --above-bottom"
        )
    capture_m = options.waypoint_radius_m or _CAPTURE_CELLS * mission.plan.grid.cell_size_m
    waypoint = {
        "name": "hrt_waypoints",
        "pwt": "100",
        "condition": "DEPLOY = true",
        "endflag": "DEPLOY = false",
        "speed": fixed(mission.speed_m_s, _METRE_DECIMALS),
        "capture_radius": fixed(capture_m, _METRE_DECIMALS),
        "slip_radius": fixed(_SLIP * capture_m, _METRE_DECIMALS),
        "order": "normal",
        "repeat": "0",
        "points": _points(mission),
    }
    lines = [*_comments(mission), "", "initialize DEPLOY = false", "", *_behavior("BHV_Waypoint", waypoint)]
    if options.vehicle == "submarine":
        depth = {
            "name": "hrt_depth",
            "pwt": "100",
            "condition": "DEPLOY = true",
            "duration": "no-time-limit",  # without it the behavior ends at once
            "depth": fixed(-options.altitude_m, _METRE_DECIMALS),
        }
        lines += ["", *_behavior("BHV_ConstantDepth", depth)]
    return "\n".join(lines) + "\n"


def _comments(mission: Mission) -> list[str]:
    frame = mission.frame
    about = [
        f"{mission.name}, written by hrt",
        printable(mission.description),
        "x, y are metres from the datum. Put it into the .moos file:",
        f"  LatOrigin  = {fixed(frame.lat_deg, _DEGREE_DECIMALS)}",
        f"  LongOrigin = {fixed(frame.lon_deg, _DEGREE_DECIMALS)}",
    ]
    if frame.kind == "utm":
        crs = f"EPSG:{_moos_epsg(frame)}"
        about.append(f"They are UTM ({crs}) less the datum, as MOOS built with USE_UTM (most are) has it.")
    else:
        about += [
            "They point to true east and north there. MOOS built with USE_UTM (most are) has grid east and north:",
            "only a vehicle whose NAV_X and NAV_Y come from elsewhere, in this frame, follows them rightly.",
        ]
    return [f"// {line}".encode("ascii", "replace").decode("ascii") for line in about]


def _xy(mission: Mission) -> list[tuple[float, float]]:
    """Return the waypoints in the frame; for UTM in the zone that MOOS takes (CMOOSGeodesy).

    MOOS counts zones of 6 degrees without the exceptions off Norway and at Svalbard.
    """
    frame = mission.frame
    if frame.kind != "utm" or frame.crs.to_epsg() == _moos_epsg(frame):
        return mission.xy
    lons, lats = zip(*((point.lon_deg, point.lat_deg) for point in mission.points), strict=True)
    x, y = transform_points(WGS84, CRS.from_epsg(_moos_epsg(frame)), [frame.lon_deg, *lons], [frame.lat_deg, *lats])
    return list(zip((x[1:] - x[0]).tolist(), (y[1:] - y[0]).tolist(), strict=True))


def _moos_epsg(frame: LocalFrame) -> int:
    zone = min(60, math.floor((frame.lon_deg + 180.0) / 6.0) + 1)
    return (32600 if frame.lat_deg >= 0 else 32700) + zone


def _points(mission: Mission) -> str:
    points = [f"{fixed(x, _METRE_DECIMALS)},{fixed(y, _METRE_DECIMALS)}" for x, y in _xy(mission)]
    line = ":".join(points)
    if len(line) <= _MOST_IN_LINE:
        return line
    rows = (":".join(points[at : at + _POINTS_A_LINE]) for at in range(0, len(points), _POINTS_A_LINE))
    return ":\\\n           ".join(rows)


def _behavior(kind: str, parameters: dict[str, str]) -> list[str]:
    width = max(map(len, parameters))
    return [f"Behavior = {kind}", "{", *(f"  {name:<{width}} = {value}" for name, value in parameters.items()), "}"]
