"""The expert: a local planner that sees the site as it is, to drive well and to show a learner what it ought to do."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrt_cli.driving.climb import climb_rad
from hrt_cli.driving.course import Course
from hrt_cli.driving.field import Cell, CostMap, cost_map, follow, is_clear, water_map, ways_to
from hrt_cli.driving.local import Command, Pose, steer_to
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.world.site import Site

_TARGET_M = 1.3
"""How far ahead on the course the expert looks for its next place."""
_REACHED_M = 0.35
_DEAR, _LONGEST_SKIP_M = 8.0, 8.0
"""Ground that costs more a metre (slower than an eighth, or along an obstacle) is gone round, if it is no wider."""
LONGEST_DETOUR_S = 150.0
"""Cost, in seconds at 1 m/s, beyond which it leaves a place out and goes for a later one."""
MUCH_DEARER = 2.0
"""It does not go straight over ground so many times dearer than where it is and where it goes."""
_ESCAPE_M = 1.0
"""How far off the nearest cell may be that it may be in, when it is in none."""

_SLOWEST = 0.45
"""Share of its speed that an AUV keeps: enough to make way against a current."""
_SLOPE_IS_STEEP = 0.8
"""Share of the steepest pitch from which on an AUV slows down."""


class GroundExpert:
    """Go to the next place on the course by the cheapest way over the ground as it is.

    Obstacles are kept clear of, good ground is preferred, and places of the course that cannot be reached are left
    out.
    """

    name = "expert"
    reach_cells: tuple[int, ...] = (5, 4, 3, 2, 1)
    """How far down its way it aims: the farthest of these that it can go straight to."""

    def __init__(self, site: Site, course: Course, vehicle: Vehicle) -> None:
        self._course = course
        self._map: CostMap = self._costs(site, vehicle)
        self._to_go = np.full(self._map.cost.shape, np.inf, np.float32)
        self._target: tuple[float, float] | None = None
        self._target_m = 0.0
        self.along_m = 0.0

    @staticmethod
    def _costs(site: Site, vehicle: Vehicle) -> CostMap:
        return cost_map(site, vehicle.radius_m)

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`; it goes by the true pose."""
        return self.steer(true)

    def steer(self, pose: Pose) -> Command | None:
        """Return the command at a true pose."""
        here = self._map.nearest_passable(pose.east_m, pose.south_m, _ESCAPE_M)
        if here is None or not self._has_target(pose, here):
            return None
        if here != self._map.cell(pose.east_m, pose.south_m):
            return steer_to(pose, *self._map.middle(here))  # too near to an obstacle, or on it: away from it first
        return steer_to(pose, *self._aim(pose, here))

    def _has_target(self, pose: Pose, here: Cell) -> bool:
        """Keep the target until it is reached, then take another, or say that there is none."""
        if self._target is not None:
            left = math.hypot(self._target[0] - pose.east_m, self._target[1] - pose.south_m)
            exact = self._target_m >= self._course.length_m or self._course.is_tip(self._target_m)
            if left < (_REACHED_M if exact else _TARGET_M / 2):
                self.along_m = self._target_m
                self._target = None
        return (self._target is not None and math.isfinite(float(self._to_go[here]))) or self._choose(here)

    def _choose(self, here: Cell) -> bool:
        """Take the next place on the course that can be reached, or say that there is none."""
        end = self._course.length_m
        at = self._course.ahead(self.along_m, _TARGET_M)
        if self._cost(at) > _DEAR:
            # Rather than through bad ground, go round it to where the course leaves it, if that is not far.
            far = min(at + _LONGEST_SKIP_M, end)
            beyond = next((m for m in np.arange(at, far, self._map.cell_m) if self._cost(float(m)) <= _DEAR), None)
            if beyond is not None and self._take(float(beyond), here):
                return True
        reach = None
        while True:
            cell = self._map.cell(*self._course.point(at))
            if math.isfinite(self._map.cost[cell]) and (reach is None or math.isfinite(reach[cell])):
                if self._take(at, here):
                    return True
                if reach is None:  # rather than search from each of the places beyond, which may be thousands
                    reach = self._reach(here)
            if at >= end:
                return False
            at = min(at + self._map.cell_m, end)

    def _cost(self, at: float) -> float:
        """Return what a metre costs at a place on the course."""
        return float(self._map.cost[self._map.cell(*self._course.point(at))])

    def _take(self, at: float, here: Cell) -> bool:
        """Go for a place on the course if it can be reached."""
        place = self._course.point(at)
        if not self._search(self._map.cell(*place), here):
            return False
        self._target, self._target_m = place, at
        return True

    def _search(self, cell: Cell, here: Cell) -> bool:
        """Find the ways to a cell, as far as the robot, or say that there is none from where it is."""
        cost = ways_to(self._map.cost, self._map.cell_m, *cell, *here, LONGEST_DETOUR_S, self._to_go)
        return math.isfinite(cost)

    def _reach(self, here: Cell) -> NDArray[np.float32]:
        """Return what it costs to get to each cell, infinite where it cannot be reached."""
        found = np.empty_like(self._to_go)
        ways_to(self._map.cost, self._map.cell_m, *here, -1, -1, LONGEST_DETOUR_S, found)
        return found

    def _aim(self, pose: Pose, here: Cell) -> tuple[float, float]:
        assert self._target is not None
        cell_m = self._map.cell_m
        if math.hypot(self._target[0] - pose.east_m, self._target[1] - pose.south_m) < 2.0 * cell_m:
            return self._target
        for cells in self.reach_cells:
            row, col = follow(self._to_go, self._map.cost, here[0], here[1], cells)
            east, south = self._map.middle((row, col))
            # Straight on, but not across worse ground than the way leads over.
            dearest = MUCH_DEARER * max(self._map.cost[here], self._map.cost[row, col])
            if cells == 1 or is_clear(self._map.cost, cell_m, pose.east_m, pose.south_m, east, south, dearest):
                return east, south
        return self._target


class WaterExpert(GroundExpert):
    """Go along the course likewise, round what is too shallow, at `altitude_m` over the bottom.

    It climbs early enough for what rises ahead, and slows down where it cannot.
    """

    def __init__(self, site: Site, course: Course, vehicle: Vehicle) -> None:
        super().__init__(site, course, vehicle)
        self._site, self._vehicle = site, vehicle

    @staticmethod
    def _costs(site: Site, vehicle: Vehicle) -> CostMap:
        return water_map(site, vehicle.radius_m)

    def steer(self, pose: Pose) -> Command | None:
        """See `GroundExpert`."""
        command = super().steer(pose)
        if command is None:
            return None
        climb, limit = climb_rad(self._site, self._vehicle, pose), self._vehicle.pitch_limit_rad
        steep = min(1.0, max(0.0, climb / limit - _SLOPE_IS_STEEP) / (1.0 - _SLOPE_IS_STEEP))
        speed = command.speed * max(_SLOWEST, 1.0 - steep)
        return Command(command.yaw, max(-1.0, min(1.0, climb / limit)), speed)
