"""QGC WPL 110: the tab-separated waypoint file of Mission Planner, APM Planner, MAVProxy and QGroundControl.

https://mavlink.io/en/file_formats/: a header, then a line per item with twelve fields: index, current, frame,
command, four parameters, latitude, longitude, altitude, autocontinue. In version 110 item 0 is home. Readers
are strict: no comments, no blank lines.
"""

from __future__ import annotations

from hrt_cli.missions.mavlink import CMD_NAV_WAYPOINT, DEGREE_DECIMALS, FRAME_GLOBAL, Item, mission_items
from hrt_cli.missions.mission import Mission, Position, fixed

HEADER = "QGC WPL 110"
_NOWHERE = Position(0.0, 0.0, 0.0)
_METRE_DECIMALS = 6


def to_text(mission: Mission) -> str:
    """Write a mission as QGC WPL 110 (parameters the autopilot may choose are 0)."""
    home = Item(FRAME_GLOBAL, CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, None), mission.home)
    rows = [_row(index, item) for index, item in enumerate([home, *mission_items(mission)])]
    return "\n".join([HEADER, *rows]) + "\n"


def _row(index: int, item: Item) -> str:
    position = item.position or _NOWHERE
    fields = [
        str(index),
        "1" if index == 0 else "0",
        str(item.frame),
        str(item.command),
        *(fixed(parameter or 0.0, _METRE_DECIMALS) for parameter in item.params),
        fixed(position.lat_deg, DEGREE_DECIMALS),
        fixed(position.lon_deg, DEGREE_DECIMALS),
        fixed(position.alt_m, _METRE_DECIMALS),
        "1",
    ]
    return "\t".join(fields)
