"""CSV: a row per waypoint, in degrees and in the metres of the local frame, for spreadsheets and one's own programs."""

from __future__ import annotations

import math
from itertools import accumulate

from hrt_cli.missions.heading import true_yaws_rad
from hrt_cli.missions.mission import Mission, fixed, rounded, rounded_longitude

_DEGREE_DECIMALS = 8
_METRE_DECIMALS = 3
_HEADING_DECIMALS = 2


def to_text(mission: Mission) -> str:
    """Write a mission as CSV: a header, then the waypoints.

    `x_m`, `y_m` are in the local frame; `distance_m` is the way driven so far; `heading_deg` is clockwise from true
    north to the next waypoint, that of the last the same as before, empty where there is but one. `step`, `row` and
    `col` are empty at a waypoint set between two cells where the plan turns.
    """
    options = mission.options
    height = "above_bottom_m" if options.above_bottom_m is not None else "altitude_m"
    header = f"index,lat,lon,{height},x_m,y_m,distance_m,heading_deg,speed_m_s,hold_s,step,row,col"
    distances_m = accumulate(mission.legs_m, initial=0.0)
    headings = [_heading(yaw) for yaw in true_yaws_rad(mission)] if len(mission.stops) > 1 else [""]
    rows = []
    for index, (stop, (x, y), distance_m, heading) in enumerate(
        zip(mission.stops, mission.xy, distances_m, headings, strict=True)
    ):
        point = stop.position
        row, col = ("", "") if stop.cell is None else stop.cell
        fields = [
            str(index),
            fixed(point.lat_deg, _DEGREE_DECIMALS),
            fixed(rounded_longitude(point.lon_deg, _DEGREE_DECIMALS), _DEGREE_DECIMALS),
            *(fixed(metres, _METRE_DECIMALS) for metres in (point.alt_m, x, y, distance_m)),
            heading,
            fixed(mission.speed_m_s, _METRE_DECIMALS),
            str(int(options.hold_s)),
            "" if stop.step is None else str(stop.step),
            str(row),
            str(col),
        ]
        rows.append(",".join(fields))
    return "\n".join([header, *rows]) + "\n"


def _heading(yaw_rad: float) -> str:
    return fixed(rounded(90.0 - math.degrees(yaw_rad), _HEADING_DECIMALS) % 360.0, _HEADING_DECIMALS)
