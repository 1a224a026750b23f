"""The expert as a teacher: it makes for the very goal that a learner is told, by the cheapest way over the true ground.

An expert that follows the course in its own way turns where a learner cannot know why. What it does on the way to a
goal depends on what lies about the robot, and that a camera sees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.driving.course import Course
from hrt_cli.driving.elsewhere import GOALS, Elsewhere, Goals
from hrt_cli.driving.expert import LONGEST_DETOUR_S, MUCH_DEARER, GroundExpert, WaterExpert
from hrt_cli.driving.field import Cell, is_clear
from hrt_cli.driving.goal import Goal
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.simulator import Setting
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.world.site import Site

_BEYOND_M, _STEP_M = 15.0, 0.2
"""A goal that cannot be reached stands for the next place on the course that can."""


class GroundTeacher(GroundExpert):
    """Makes for the goal of a robot on the ground.

    It aims farther down its way than the expert, and so turns earlier and less: a learner that is late, or wrong by a
    little, gets by.

    Attributes
    ----------
    bearing_rad : float
        What the learner is told at the last decision (`goal.Goal`).
    """

    name = "teacher"
    reach_cells = (12, 10, 8, 6, 5, 4, 3, 2, 1)

    def __init__(self, site: Site, course: Course, vehicle: Vehicle, cruise_m_s: float) -> None:
        super().__init__(site, course, vehicle)
        self._goal = Goal(course)
        self._elsewhere = Elsewhere(self._map, vehicle, cruise_m_s)
        self.bearing_rad = 0.0

    def follow(self, known: Pose) -> None:
        """Take in where the robot is; to be called at every decision."""
        self.bearing_rad = self._goal.bearing_rad(known)
        self.along_m = self._goal.along_m

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`."""
        self.follow(known)
        return self.steer(true)

    def advise(self, pose: Pose) -> tuple[Command, NDArray[np.float64]] | None:
        """Return the command at a true pose and what each turn would cost (`turns.turn_costs`); None: no way on."""
        command = self.steer(pose)
        if command is None:
            return None
        assert self._target is not None
        costs = self._elsewhere.costs(pose, self._map.cell(*self._target), LONGEST_DETOUR_S)
        return None if costs is None else (command, costs)

    def others(self, pose: Pose, rng: np.random.Generator) -> Goals | None:
        """Return other goals, and what turns cost on the way to them; None: no way to any."""
        return self._elsewhere.goals(pose, GOALS, rng)

    def _has_target(self, pose: Pose, here: Cell) -> bool:
        first, end = self._goal.aim_m, self._course.length_m
        for at in np.arange(first, min(first + _BEYOND_M, end) + _STEP_M, _STEP_M).clip(max=end).tolist():
            place = self._course.point(at)
            if self._map.passable(*place) and self._take(at, here):
                return True
        return False

    def _aim(self, pose: Pose, here: Cell) -> tuple[float, float]:
        # Steps from cell to cell turn by 45 degrees; on open ground the way leads straight there, whatever the compass.
        assert self._target is not None
        costs = self._map
        dearest = MUCH_DEARER * max(costs.cost[here], costs.cost[costs.cell(*self._target)])
        if is_clear(costs.cost, costs.cell_m, pose.east_m, pose.south_m, *self._target, dearest):
            return self._target
        return super()._aim(pose, here)


class WaterTeacher(GroundTeacher, WaterExpert):
    """Likewise under water, at the depth that the expert keeps."""


def teacher_of(setting: Setting) -> GroundTeacher:
    """Return the teacher for a drive."""
    kind = WaterTeacher if setting.vehicle.kind == "auv" else GroundTeacher
    return kind(setting.site, setting.course, setting.vehicle, setting.cruise_m_s)
