"""Where a robot looks at each waypoint: towards the next one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from hrt_cli.missions.mission import Mission
from hrt_cli.raster.grid import metres_per_degree, wrapped_deg

_NO_WAY_M = 1e-6


def true_yaws_rad(mission: Mission) -> list[float]:
    """Return the direction from each waypoint to the next, counter-clockwise from true east; the last repeats.

    A waypoint without a way to the next repeats the one before; alone it looks east.
    """
    legs = []
    for before, after in pairwise(mission.points):
        east_m, north_m = metres_per_degree(np.array([(before.lat_deg + after.lat_deg) / 2]))
        across_deg = float(wrapped_deg(after.lon_deg - before.lon_deg))
        legs.append((across_deg * float(east_m[0]), (after.lat_deg - before.lat_deg) * float(north_m[0])))
    return _yaws(legs)


def local_yaws_rad(mission: Mission) -> list[float]:
    """Return the same, counter-clockwise from the x axis of the mission's local frame."""
    return _yaws((x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in pairwise(mission.xy))


def _yaws(legs: Iterable[tuple[float, float]]) -> list[float]:
    yaw = 0.0
    yaws = []
    for x, y in legs:
        if math.hypot(x, y) > _NO_WAY_M:
            yaw = math.atan2(y, x)
        yaws.append(yaw)
    return [*yaws, yaw]
