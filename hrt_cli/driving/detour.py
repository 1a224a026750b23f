"""The way out of a place where a robot that sees turns to and fro, or where something that it did not see holds it.

One that goes by a picture and a goal alone forgets what it saw a moment ago. In front of a thing that has to be gone
round it turns left, sees the goal on its right, turns right, and sees the thing. What helps is what navigation stacks
call a recovery behaviour (Nav2: spin): it looks once all round, notes where the way is free, and drives a few metres
that way before it makes for its goal again. The same helps where it is told to drive and does not get on: there no way
is free that leads about where it was held.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hrt_cli.driving.local import Pose, wrapped

_PLACE_M = 0.5
"""A robot that has not left a circle of this radius is still at the same place."""
_TO_AND_FRO_RAD = 2 * math.pi
"""Whoever has turned by so much at one place does not get on: a turn about takes half of it."""
_FREE = 0.3
"""The way ahead is free where one with a goal straight ahead steers by less than this."""
_FIRST_M, _LONGEST_M = 2.0, 8.0
"""How far a first way out leads; each further one from about there leads twice as far."""
_ABOUT_THERE_M = 3.0
"""Places are about the same that lie no farther apart than this and the way out of the first."""
_PATIENCE = 60
"""A way out is given up after so many looks."""
_TOLD_M, _HELD = 0.6, 0.2
"""A robot is held where it was told to drive so far, and came no farther than this share of it."""
_ALIGNED_RAD = 0.3
"""A way out is taken once the robot looks along it so closely."""
_BLOCKED_RAD = math.radians(100.0)
"""Ways nearer than this to one on which it was held are not free, however they look: it may touch a wall askew."""


class Detour:
    """Where a robot makes for that may have to leave a place first."""

    def __init__(self) -> None:
        self._place = self._last_place = (math.inf, math.inf)
        self._heading_rad = self._turned_rad = 0.0
        self._free: list[float] | None = None
        self._out_rad: float | None = None
        self._aligned = False
        self._far_m, self._looks = _FIRST_M, 0
        self._told_m = 0.0
        self._told_from: tuple[float, float] | None = None
        self._blocked: list[float] = []

    @property
    def spinning(self) -> bool:
        """Whether the robot has to turn on the spot now, whatever it sees: it looks all round."""
        return self._free is not None

    @property
    def aligning(self) -> bool:
        """Whether it does not look along its way out yet: for a curve there may be no room."""
        return self._out_rad is not None and not self._aligned

    def bearing_rad(self, known: Pose, goal_rad: float, told_m: float, ahead: Callable[[], float]) -> float:
        """Return the bearing to make for, in [-pi, pi), right positive; to be asked at every look.

        Parameters
        ----------
        known : Pose
        goal_rad : float
            Bearing of the goal in the robot's frame.
        told_m : float
            How far the robot was told to drive since the last look.
        ahead : callable
            Tells how the robot would steer, in [-1, 1], if its goal were straight ahead.
        """
        here = (known.east_m, known.south_m)
        self._turned_rad += abs(wrapped(known.heading_rad - self._heading_rad))
        self._heading_rad = known.heading_rad
        if self._is_held(here, told_m):
            self._blocked.append(wrapped(known.heading_rad))
            self._free, self._out_rad, self._turned_rad = [], None, 0.0
            return goal_rad
        if self._out_rad is not None:
            return self._leave(here, goal_rad, self._out_rad)
        if self._free is not None:
            return self._look_round(here, goal_rad, ahead, self._free)
        if math.dist(here, self._place) > _PLACE_M:
            self._place, self._turned_rad = here, 0.0
        elif self._turned_rad > _TO_AND_FRO_RAD:
            self._free, self._turned_rad = [], 0.0
        return goal_rad

    def _is_held(self, here: tuple[float, float], told_m: float) -> bool:
        self._told_m += told_m
        if self._told_from is not None and self._told_m < _TOLD_M:
            return False
        held = self._told_from is not None and math.dist(here, self._told_from) < _HELD * self._told_m
        self._told_m, self._told_from = 0.0, here
        return held

    def _look_round(
        self, here: tuple[float, float], goal_rad: float, ahead: Callable[[], float], free: list[float]
    ) -> float:
        if abs(ahead()) < _FREE and not any(
            abs(wrapped(self._heading_rad - way)) < _BLOCKED_RAD for way in self._blocked
        ):
            free.append(self._heading_rad)
        if self._turned_rad < 2 * math.pi:
            return goal_rad
        to_goal = self._heading_rad + goal_rad
        # Whence it came it can go, if nowhere else.
        back = [wrapped(way + math.pi) for way in self._blocked[-1:]]
        out = min(free or back, key=lambda way: abs(wrapped(way - to_goal)), default=None)
        again = math.dist(here, self._last_place) < _ABOUT_THERE_M + self._far_m
        self._far_m = min(2 * self._far_m, _LONGEST_M) if again else _FIRST_M
        self._place, self._last_place, self._free, self._out_rad, self._aligned = here, here, None, out, False
        self._turned_rad, self._looks = 0.0, 0
        return goal_rad if out is None else wrapped(out - self._heading_rad)

    def _leave(self, here: tuple[float, float], goal_rad: float, out_rad: float) -> float:
        self._looks += 1
        self._aligned |= abs(wrapped(out_rad - self._heading_rad)) < _ALIGNED_RAD
        far = math.dist(here, self._place) > self._far_m
        if far or self._looks > _PATIENCE:
            self._out_rad, self._place, self._turned_rad = None, here, 0.0
            if far:
                self._blocked.clear()
            return goal_rad
        return wrapped(out_rad - self._heading_rad)
