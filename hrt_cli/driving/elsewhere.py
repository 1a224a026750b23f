"""Other goals than the one that a robot makes for, and what each turn would cost on the way to them.

What a robot sees does not depend on where it wants to go. So one picture teaches how to get to many places (the
all-goals updates of Kaelbling 1993): a network that learns by them sees each picture once and answers for all.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrt_cli.driving.field import Cell, CostMap, is_clear, march_to
from hrt_cli.driving.goal import AHEAD_M
from hrt_cli.driving.local import Pose
from hrt_cli.driving.turns import turn_costs
from hrt_cli.driving.vehicle import Vehicle

GOALS = 8
_SPREAD_RAD, _WIDEST_RAD = 0.7, 2.6
"""Standard deviation of their bearings, and the largest."""
_NEAREST_M = 2.0
_ASIDE_M = 1.5
"""A goal where the robot may not be stands for the nearest place where it may, so far from it at most."""
_DEAREST_S, _BEYOND_S = 14.0, 3.0
"""What the way there may cost, at 1 m/s; and how much dearer than where the robot is the ways are that are found."""
_TRIES = 4

Goals = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Bearings in radians, float64 [goals], and costs in seconds, float64 [goals, turns]."""


class Elsewhere:
    """Finds goals about a robot.

    Parameters
    ----------
    costs : CostMap
    vehicle : Vehicle
    cruise_m_s : float
    """

    def __init__(self, costs: CostMap, vehicle: Vehicle, cruise_m_s: float) -> None:
        self._map, self._vehicle, self._cruise_m_s = costs, vehicle, cruise_m_s
        self._to_go = np.full(costs.cost.shape, np.inf, np.float32)

    def goals(self, pose: Pose, count: int, rng: np.random.Generator) -> Goals | None:
        """Return random goals about a pose; None where there is no way to any."""
        bearings: list[float] = []
        costs: list[NDArray[np.float64]] = []
        for bearing in random_bearings(_TRIES * count, rng):
            if len(bearings) == count:
                break
            found = self._costs(pose, bearing, rng.uniform(_NEAREST_M, AHEAD_M))
            if found is not None:
                bearings.append(bearing)
                costs.append(found)
        if not bearings:
            return None
        # Each picture has as many: where few can be reached some come again.
        again = np.arange(count) % len(bearings)
        return np.array(bearings)[again], np.array(costs)[again]

    def is_straight(self, pose: Pose, place: tuple[float, float]) -> bool:
        """Whether a robot can go straight to a place, east_m and south_m."""
        return bool(is_clear(self._map.cost, self._map.cell_m, pose.east_m, pose.south_m, *place))

    def _costs(self, pose: Pose, bearing_rad: float, away_m: float) -> NDArray[np.float64] | None:
        costs = self._map
        cell = costs.nearest_passable(*place_at(pose, bearing_rad, away_m), _ASIDE_M)
        return None if cell is None else self.costs(pose, cell, _DEAREST_S)

    def costs(self, pose: Pose, cell: Cell, limit_s: float) -> NDArray[np.float64] | None:
        """Return what each turn costs on the way to a cell; None where no way costs less than a limit, at 1 m/s."""
        costs = self._map
        here = costs.nearest_passable(pose.east_m, pose.south_m, _ASIDE_M)
        if here is None:
            return None
        cost = march_to(costs.cost, costs.cell_m, *cell, *here, limit_s, _BEYOND_S, self._to_go)
        if not math.isfinite(cost):
            return None
        return turn_costs(costs, self._to_go, self._vehicle, self._cruise_m_s, pose)


def place_at(pose: Pose, bearing_rad: float, away_m: float) -> tuple[float, float]:
    """Return the place so far off in a direction seen from the robot, east_m and south_m."""
    heading = pose.heading_rad + bearing_rad
    return pose.east_m + away_m * math.sin(heading), pose.south_m - away_m * math.cos(heading)


def random_bearings(count: int, rng: np.random.Generator) -> list[float]:
    """Return bearings of goals, in radians: mostly ahead."""
    drawn = rng.normal(0.0, _SPREAD_RAD, count).clip(-_WIDEST_RAD, _WIDEST_RAD)
    return [float(each) for each in drawn]
