"""How steeply an AUV has to climb: as the expert keeps its altitude over what lies ahead."""

from __future__ import annotations

import math

from hrt_cli.driving.local import Pose
from hrt_cli.driving.motion import sample
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.world.site import Site

_AHEAD_M = (0.3, 0.6, 1.0, 1.5, 2.0, 2.6, 3.2, 4.0)
"""How far ahead over the bottom an AUV looks."""
_BESIDE_M = (0.5, 0.9)
_TURNS = tuple(k * math.pi / 6 for k in range(12))
"""How far to every side, and in which directions: it may have to turn there."""
_SHARE_BESIDE = 0.7
"""Share of its altitude that it keeps over what lies on any side."""


def climb_rad(site: Site, vehicle: Vehicle, pose: Pose) -> float:
    """Return the pitch that keeps the altitude over what lies ahead, and clear of what lies on any side."""

    def top(east_m: float, south_m: float) -> float:
        return float(sample(site.surface_m, site.pixel_m, pose.east_m + east_m, pose.south_m + south_m))

    clear = vehicle.altitude_m
    east, south = math.sin(pose.heading_rad), -math.cos(pose.heading_rad)
    steepest = -math.inf
    for ahead in _AHEAD_M:
        for aside in (-0.4, 0.0, 0.4):
            over = top(ahead * east - aside * south, ahead * south + aside * east)
            steepest = max(steepest, math.atan2(over + clear - pose.height_m, ahead + 0.5))
    beside = max(top(r * math.sin(turn), r * math.cos(turn)) for r in _BESIDE_M for turn in _TURNS)
    return max(steepest, math.atan2(beside + _SHARE_BESIDE * clear - pose.height_m, max(_BESIDE_M)))
