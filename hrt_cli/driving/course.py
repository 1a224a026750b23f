"""The path to drive: a line through places, and how far along it a robot has come."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

kernel: Any = njit(cache=True, nogil=True)


_TURNS_BACK = -0.5
"""Cosine of the turn from which on a corner counts as the tip of a dead end."""
_THERE_M = 0.3


class Course:
    """A line through places.

    Parameters
    ----------
    points : float64 [n, 2]
        (east_m, south_m), n >= 1; points that repeat the one before are dropped.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        kept = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1e-6)
        self.points = np.ascontiguousarray(points[kept], np.float64)
        legs = np.diff(self.points, axis=0)
        self.along_m = np.append(0.0, np.cumsum(np.hypot(*legs.T)))
        turns = (legs[:-1] * legs[1:]).sum(axis=1) / (np.hypot(*legs[:-1].T) * np.hypot(*legs[1:].T))
        self._tips_m = self.along_m[1:-1][turns < _TURNS_BACK]

    @property
    def length_m(self) -> float:
        """Length of the line."""
        return float(self.along_m[-1])

    def point(self, along_m: float) -> tuple[float, float]:
        """Return the place `along_m` from its start; beyond its end, its end."""
        return (
            float(np.interp(along_m, self.along_m, self.points[:, 0])),
            float(np.interp(along_m, self.along_m, self.points[:, 1])),
        )

    def ahead(self, along_m: float, ahead_m: float) -> float:
        """Return where a robot at `along_m` looks: `ahead_m` farther along, but not round the tip of a dead end."""
        next_tip = int(np.searchsorted(self._tips_m, along_m + 1e-6))
        tip = float(self._tips_m[next_tip]) if next_tip < len(self._tips_m) else self.length_m
        return min(along_m + ahead_m, tip, self.length_m)

    def is_tip(self, along_m: float) -> bool:
        """Whether the course turns back there."""
        return bool(np.any(np.abs(self._tips_m - along_m) < 1e-6))

    def progress(self, along_m: float, east_m: float, south_m: float) -> float:
        """Return how far along the robot is that was at `along_m`: on while the line comes nearer to it.

        The line is followed only downhill, so that a robot on its way into a dead end does not take the way back, a
        step beside it, for its own.
        """
        return float(_progress(self.points, self.along_m, along_m, east_m, south_m))


class Carrot:
    """The point ahead on a course that a robot aims at (pure pursuit: Coulter 1992).

    Attributes
    ----------
    along_m : float
        How far along the course the robot has come.
    """

    def __init__(self, course: Course, ahead_m: float) -> None:
        self._course, self._ahead_m = course, ahead_m
        self.along_m = 0.0

    def aim(self, east_m: float, south_m: float) -> tuple[float, float]:
        """Return where to aim from a place."""
        self.along_m = self._course.progress(self.along_m, east_m, south_m)
        while True:
            at = self._course.ahead(self.along_m, self._ahead_m)
            aim = self._course.point(at)
            # A robot that stands on the point it aims at has been there.
            if self.along_m >= self._course.length_m or np.hypot(aim[0] - east_m, aim[1] - south_m) > _THERE_M:
                return aim
            self.along_m = at


_STEP_M = 0.05
_DIP_M = 0.4
"""How far the search looks beyond a place where the line comes no nearer (a corner)."""


@kernel
def _progress(
    points: NDArray[np.float64], along: NDArray[np.float64], start_m: float, east_m: float, south_m: float
) -> float:
    n = len(along)
    leg = 0
    while leg < n - 2 and along[leg + 1] <= start_m:
        leg += 1
    best, best_m = np.inf, start_m
    at = start_m
    while True:
        while leg < n - 2 and along[leg + 1] < at:
            leg += 1
        if n == 1:
            return 0.0
        part = (at - along[leg]) / (along[leg + 1] - along[leg])
        x = points[leg, 0] + part * (points[leg + 1, 0] - points[leg, 0])
        y = points[leg, 1] + part * (points[leg + 1, 1] - points[leg, 1])
        far = (x - east_m) ** 2 + (y - south_m) ** 2
        if far < best:
            best, best_m = far, at
        if at >= along[n - 1] or at > best_m + _DIP_M:
            return best_m
        at = min(at + _STEP_M, along[n - 1])
