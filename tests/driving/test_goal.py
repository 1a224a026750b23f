"""Where a robot that goes round things is told to go."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hrt_cli.driving.course import Course
from hrt_cli.driving.goal import AHEAD_M, Goal
from hrt_cli.driving.local import Pose

EAST = math.pi / 2


def pose(east: float, south: float, heading: float = EAST) -> Pose:
    return Pose(east, south, 0.0, heading, 0.0)


def line(*points: tuple[float, float]) -> Course:
    return Course(np.array(points, float))


def test_on_a_straight_course_the_goal_is_dead_ahead() -> None:
    goal = Goal(line((0, 0), (20, 0)))
    assert goal.bearing_rad(pose(4.0, 0.0)) == pytest.approx(0.0, abs=1e-9)
    assert goal.along_m == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize(("south", "heading", "wanted"), [(0.8, EAST, -1), (-0.8, EAST, 1), (0.0, EAST + 0.3, -1)])
def test_right_is_positive(south: float, heading: float, wanted: int) -> None:
    """A robot beside its course, or turned away from it, is told the way back."""
    goal = Goal(line((0, 0), (20, 0)))
    bearing = goal.bearing_rad(pose(4.0, south, heading))
    assert math.copysign(1, bearing) == wanted
    assert bearing == pytest.approx(math.atan2(-south, AHEAD_M) - (heading - EAST), abs=0.02)


def test_it_goes_on_from_where_a_robot_comes_back_to_the_course() -> None:
    """Round a corner cut by 6 m, the goal is not left behind at the corner."""
    goal = Goal(line((0, 0), (10, 0), (10, 10)))
    goal.bearing_rad(pose(7.0, 0.0))
    for k in range(40):  # from (7, 0) straight to (10, 6), past a corner that it cannot get to
        goal.bearing_rad(pose(7.0 + 3.0 * k / 40, 6.0 * k / 40))
    assert goal.along_m == pytest.approx(15.7, abs=0.8)


def test_a_robot_that_follows_lanes_does_not_jump_to_the_next() -> None:
    """Lanes lie 1.5 m apart: a robot .5 m beside its own stays with it."""
    lanes = [(0.0, 0.0), (12.0, 0.0), (12.0, 1.5), (0.0, 1.5)]
    goal = Goal(line(*lanes))
    for east in np.arange(0.0, 11.0, 0.1):
        goal.bearing_rad(pose(float(east), 0.5))
        assert goal.along_m <= east + 0.3


def test_what_cannot_be_reached_is_given_up() -> None:
    goal = Goal(line((0, 0), (20, 0)))
    seen = []
    for _ in range(800):
        goal.bearing_rad(pose(5.0, 0.0))
        seen.append(goal.along_m)
    assert seen[200] == pytest.approx(5.0, abs=0.05)
    assert seen[300] > 7.5
    assert seen[-1] > 12.0


def test_at_the_end_it_points_to_the_end() -> None:
    goal = Goal(line((0, 0), (5, 0)))
    for east in np.arange(0, 8.0, 0.1):
        bearing = goal.bearing_rad(pose(float(east), 0.0))
    assert abs(bearing) == pytest.approx(math.pi)
    assert goal.along_m == pytest.approx(5.0)
