"""Where a robot that sees has to go: a point ahead on its course, for one that goes round what lies on it.

Pure pursuit's `Carrot` follows the course alone. A robot that goes round things leaves its course for a while, may come
back to it farther on, and may find a place that it cannot get to; then it gives that up and goes on.
"""

from __future__ import annotations

import math

import numpy as np

from hrt_cli.driving.course import Course
from hrt_cli.driving.local import Pose, wrapped

AHEAD_M = 3.0
"""How far ahead the goal is: beyond what has to be gone round, not beyond what can be seen."""
_OFF_M, _WINDOW_M, _STEP_M = 1.0, 15.0, 0.25
"""A robot farther than `_OFF_M` from its course looks so far on along it for a stretch that it is much nearer to."""
_MUCH_NEARER = 0.5
_PATIENCE, _SKIP_M, _LEAST_M = 250, 3.0, 0.5
"""One that has come no farther by `_LEAST_M` in so many decisions gives up the next `_SKIP_M` of it."""
_THERE_M = 0.4


class Goal:
    """The goal of a robot on its way along a course.

    Parameters
    ----------
    course : Course

    Attributes
    ----------
    along_m : float
        How far along the course it has come.
    aim_m : float
        How far along it the goal lies.
    """

    def __init__(self, course: Course) -> None:
        self._course = course
        self.along_m = self.aim_m = 0.0
        self._best_m, self._waited = 0.0, 0

    def bearing_rad(self, known: Pose) -> float:
        """Return the bearing of the goal in the robot's frame, in [-pi, pi), right positive.

        To be asked once at every decision, since patience is counted in them.
        """
        east, south = self._aim(known.east_m, known.south_m)
        return wrapped(math.atan2(east - known.east_m, -(south - known.south_m)) - known.heading_rad)

    def _aim(self, east_m: float, south_m: float) -> tuple[float, float]:
        course = self._course
        self.along_m = course.progress(self.along_m, east_m, south_m)
        at = course.point(self.along_m)
        off_m = math.hypot(at[0] - east_m, at[1] - south_m)
        if off_m > _OFF_M:
            self._rejoin(east_m, south_m, off_m)
        self._give_up()
        while True:
            self.aim_m = course.ahead(self.along_m, AHEAD_M)
            aim = course.point(self.aim_m)
            if self.along_m >= course.length_m or math.hypot(aim[0] - east_m, aim[1] - south_m) > _THERE_M:
                return aim
            self.along_m = self.aim_m

    def _rejoin(self, east_m: float, south_m: float, off_m: float) -> None:
        """Go on from a later stretch of the course that is much nearer."""
        along = np.arange(self.along_m, min(self.along_m + _WINDOW_M, self._course.length_m), _STEP_M)
        if along.size == 0:
            return
        points, stations = self._course.points, self._course.along_m
        away = np.hypot(
            np.interp(along, stations, points[:, 0]) - east_m, np.interp(along, stations, points[:, 1]) - south_m
        )
        nearest = int(away.argmin())
        if away[nearest] < _MUCH_NEARER * off_m:
            self.along_m = float(along[nearest])

    def _give_up(self) -> None:
        """Leave a stretch out that the robot does not get along."""
        if self.along_m > self._best_m + _LEAST_M:
            self._best_m, self._waited = self.along_m, 0
            return
        self._waited += 1
        if self._waited > _PATIENCE:
            self.along_m = min(self.along_m + _SKIP_M, self._course.length_m)
            self._best_m, self._waited = self.along_m, 0
