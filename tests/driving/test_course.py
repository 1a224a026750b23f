"""Progress along a course and the carrot on it: monotone, into every dead end, and never at a stand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli.driving.course import Carrot, Course

POINTS = st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), min_size=1, max_size=12)
MOVES = st.lists(st.sampled_from([(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (-1, 1)]), min_size=1, max_size=25)


def walk(moves: list[tuple[int, int]]) -> Course:
    """A course as plans have them: moves of a metre between neighbours, back and forth."""
    return Course(np.cumsum([(20, 20), *moves], axis=0).astype(float))


def drive(course: Course, ahead_m: float, step_m: float = 0.1) -> tuple[np.ndarray, list[float], bool]:
    """A point that moves straight to the aim: its track, its progress, and whether it arrived."""
    carrot = Carrot(course, ahead_m)
    at, track, along = course.points[0].copy(), [], []
    for _ in range(int(course.length_m / step_m * 6) + 100):
        aim = np.array(carrot.aim(*at))
        track.append(at.copy())
        along.append(carrot.along_m)
        if carrot.along_m >= course.length_m - 0.05 and np.hypot(*(course.points[-1] - at)) < 0.2:
            return np.array(track), along, True
        way = aim - at
        length = float(np.hypot(*way))
        if length > 0:
            at = at + way * min(1.0, step_m / length)
    return np.array(track), along, False


def test_points_and_length() -> None:
    course = Course(np.array([[0, 0], [0, 0], [3, 0], [3, 4], [3, 4.0]]))
    assert course.points.tolist() == [[0, 0], [3, 0], [3, 4]]
    assert course.length_m == 7.0
    assert course.point(-1.0) == (0.0, 0.0)
    assert course.point(1.5) == (1.5, 0.0)
    assert course.point(5.0) == (3.0, 2.0)
    assert course.point(99.0) == (3.0, 4.0)


@pytest.mark.parametrize("points", [[[2.0, 3.0]], [[2.0, 3.0], [2.0, 3.0]]])
def test_a_course_of_one_point_is_driven_at_once(points: list[list[float]]) -> None:
    course = Course(np.array(points))
    assert course.length_m == 0.0
    assert course.point(1.0) == (2.0, 3.0)
    assert course.progress(0.0, 9.0, 9.0) == 0.0
    assert Carrot(course, 0.7).aim(9.0, 9.0) == (2.0, 3.0)
    assert drive(course, 0.7)[2]


def test_progress_is_the_nearest_place_ahead() -> None:
    course = Course(np.array([[0, 0], [10, 0], [10, 10.0]]))
    assert course.progress(0.0, 4.0, 0.5) == pytest.approx(4.0, abs=0.05)
    assert course.progress(6.0, 4.0, 0.5) == 6.0, "it goes back"
    assert course.progress(9.5, 10.1, 0.3) == pytest.approx(10.3, abs=0.06)
    assert course.progress(19.0, 10.0, 12.0) == 20.0


@settings(max_examples=80)
@given(points=POINTS, ahead=st.floats(0.4, 2.0))
def test_a_point_that_goes_for_the_aim_arrives(points: list[tuple[int, int]], ahead: float) -> None:
    _, along, arrived = drive(Course(np.array(points, float)), ahead)
    assert arrived
    assert all(b >= a for a, b in itertools.pairwise(along))


@settings(max_examples=80)
@given(moves=MOVES, ahead=st.sampled_from([0.7, 1.4]))
def test_no_part_of_a_walk_is_left_out(moves: list[tuple[int, int]], ahead: float) -> None:
    """Whatever is doubled back over, the robot comes near every point of the walk, and in their order."""
    course = walk(moves)
    track, along, arrived = drive(course, ahead)
    assert arrived
    near_m = ahead / 2 + 0.35
    first = 0
    for point in course.points:
        close = np.flatnonzero(np.hypot(*(track[first:] - point).T) < near_m)
        assert close.size, f"{point} is left out"
        first += int(close[0])
    assert max(np.diff(along), default=0.0) <= 2 * ahead + 0.6, "progress jumps over a part"


@pytest.mark.parametrize("depth", [1, 3, 6])
def test_a_dead_end_is_driven_to_its_tip(depth: int) -> None:
    course = walk([(1, 0)] * 3 + [(0, 1)] * depth + [(0, -1)] * depth + [(1, 0)] * 3)
    track, _, arrived = drive(course, 0.7)
    assert arrived
    assert track[:, 1].max() > 20 + depth - 0.5


def test_a_robot_beside_the_way_back_takes_no_short_cut() -> None:
    course = walk([(0, 1)] * 8 + [(1, 0)] + [(0, -1)] * 8)
    along = 0.0
    for step in range(70):
        along = course.progress(along, 20.45, 20 + 0.1 * step)
    assert along == pytest.approx(6.9, abs=0.1)


def test_the_aim_lies_ahead() -> None:
    carrot = Carrot(Course(np.array([[0, 0], [10, 0.0]])), 0.7)
    assert carrot.aim(3.0, 0.2) == pytest.approx((3.7, 0.0), abs=0.06)
    assert carrot.aim(9.6, 0.0) == (10.0, 0.0)
    assert carrot.along_m == pytest.approx(9.6, abs=0.06)
