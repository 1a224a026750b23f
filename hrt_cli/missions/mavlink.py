"""The mission as MAVLink items: what the formats for autopilots share.

Numbers are those of the MAVLink common message set (MAV_CMD, MAV_FRAME, MAV_TYPE, MAV_AUTOPILOT).
"""

from __future__ import annotations

from typing import NamedTuple

from hrt_cli.missions.mission import Firmware, Mission, MissionOptions, Position, Vehicle

CMD_NAV_WAYPOINT = 16
CMD_DO_CHANGE_SPEED = 178

FRAME_GLOBAL = 0
FRAME_MISSION = 2
FRAME_GLOBAL_RELATIVE_ALT = 3
FRAME_GLOBAL_TERRAIN_ALT = 10

MAV_TYPE: dict[Vehicle, int] = {"rover": 10, "boat": 11, "submarine": 12}
MAV_AUTOPILOT: dict[Firmware, int] = {"ardupilot": 3, "px4": 12}

ITEM_LIMIT: dict[Firmware, int] = {"ardupilot": 718, "px4": 500}
"""Items the usual boards store, home included. Beyond it ArduPilot replaces the last item without a word."""

DEGREE_DECIMALS = 8  # 1.1 mm; MAVLink itself carries 7 decimals

_GROUND_SPEED = 1.0
_THROTTLE_UNCHANGED = -1.0
_BEFORE_WAYPOINTS = 2


class Item(NamedTuple):
    """A mission item: `params` are parameters 1 to 4 (None is the autopilot's own choice), then the place."""

    frame: int
    command: int
    params: tuple[float, float, float, float | None]
    position: Position | None


def mission_items(mission: Mission) -> list[Item]:
    """Return the items after home: the speed, then every waypoint."""
    options = mission.options
    frame = FRAME_GLOBAL_RELATIVE_ALT if options.above_bottom_m is None else FRAME_GLOBAL_TERRAIN_ALT
    speed = (_GROUND_SPEED, mission.speed_m_s, _THROTTLE_UNCHANGED, 0.0)
    waypoint = (float(options.hold_s), options.waypoint_radius_m, 0.0, None)
    return [
        Item(FRAME_MISSION, CMD_DO_CHANGE_SPEED, speed, None),
        *(Item(frame, CMD_NAV_WAYPOINT, waypoint, point) for point in mission.points),
    ]


def item_limit(options: MissionOptions) -> int:
    """Return how many items the autopilot stores, home included."""
    return ITEM_LIMIT[options.firmware] if options.max_items is None else options.max_items


def item_count(mission: Mission) -> int:
    """Return how many items a mission has: home, the speed and the waypoints."""
    return len(mission.stops) + _BEFORE_WAYPOINTS
