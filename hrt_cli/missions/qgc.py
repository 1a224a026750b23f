"""QGroundControl `.plan`: JSON, file version 1, mission version 2, geofence and rally points version 2.

https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html, and stricter where the
program's loader is: geofence and rally points are required, home has three numbers, every item has seven
parameters, and an item with one altitude member has all three.
"""

from __future__ import annotations

import json
from typing import Any

from hrt_cli.missions.fence import Fence
from hrt_cli.missions.mavlink import (
    DEGREE_DECIMALS,
    FRAME_GLOBAL_TERRAIN_ALT,
    MAV_AUTOPILOT,
    MAV_TYPE,
    Item,
    mission_items,
)
from hrt_cli.missions.mission import Mission, Position, rounded

_ALTITUDE_RELATIVE = 1
_ALTITUDE_TERRAIN = 4


def to_text(mission: Mission) -> str:
    """Write a mission as a QGroundControl plan."""
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": MAV_AUTOPILOT[mission.options.firmware],
            "vehicleType": MAV_TYPE[mission.options.vehicle],
            "cruiseSpeed": mission.speed_m_s,
            "hoverSpeed": mission.speed_m_s,
            "globalPlanAltitudeMode": _ALTITUDE_RELATIVE
            if mission.options.above_bottom_m is None
            else _ALTITUDE_TERRAIN,
            "plannedHomePosition": _place(mission.home),
            "items": [_item(index, item) for index, item in enumerate(mission_items(mission), start=1)],
        },
        "geoFence": {"version": 2, "circles": [], "polygons": _fence(mission.fence)},
        "rallyPoints": {"version": 2, "points": []},
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _item(index: int, item: Item) -> dict[str, Any]:
    simple: dict[str, Any] = {
        "type": "SimpleItem",
        "doJumpId": index,
        "frame": item.frame,
        "command": item.command,
        "params": [*item.params, *([0.0, 0.0, 0.0] if item.position is None else _place(item.position))],
        "autoContinue": True,
    }
    if item.position is not None:
        simple |= {
            "AltitudeMode": _ALTITUDE_TERRAIN if item.frame == FRAME_GLOBAL_TERRAIN_ALT else _ALTITUDE_RELATIVE,
            "Altitude": rounded(item.position.alt_m, DEGREE_DECIMALS),
            "AMSLAltAboveTerrain": None,
        }
    return simple


def _fence(fence: Fence) -> list[dict[str, Any]]:
    return [
        {"version": 1, "inclusion": inclusion, "polygon": [[_degrees(lat), _degrees(lon)] for lon, lat in ring]}
        for inclusion, rings in ((True, fence.keep_in), (False, fence.keep_out))
        for ring in rings
    ]


def _degrees(value: float) -> float:
    return rounded(value, DEGREE_DECIMALS)


def _place(position: Position) -> list[float]:
    return [rounded(value, DEGREE_DECIMALS) for value in position]
