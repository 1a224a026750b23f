"""The way out of a place where a robot turns to and fro, or is held by what it did not see."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from world_files import ground_site

from hrt_cli.driving.course import Course
from hrt_cli.driving.detour import Detour
from hrt_cli.driving.local import Pose, wrapped
from hrt_cli.driving.simulator import Setting, first_heading, simulate
from hrt_cli.driving.steer import Steer
from hrt_cli.driving.vehicle import UGV
from hrt_cli.steering.network.net import SteeringConfig

HERE = Pose(5.0, 5.0, 0.0, 0.0, 0.0)
STEP = math.radians(20.0)
TURN = 18
"""Steps once all round."""


def never() -> float:
    raise AssertionError("nobody has to look")


def swing(detour: Detour, steps: int, pose: Pose = HERE, goal_rad: float = 0.0) -> Pose:
    """Turn to and fro between two headings; the goal stays where it is."""
    goal = pose.heading_rad + goal_rad
    for k in range(steps):
        pose = replace(pose, heading_rad=pose.heading_rad + (STEP if k % 2 == 0 else -STEP))
        if detour.spinning:
            break
        bearing = detour.bearing_rad(pose, wrapped(goal - pose.heading_rad), 0.0, never)
        assert bearing == pytest.approx(wrapped(goal - pose.heading_rad))
    return pose


def spin(detour: Detour, pose: Pose, goal: float, free: Callable[[float], bool]) -> tuple[float, Pose]:
    """Turn on while that is asked for; return the bearing told at the end."""
    bearing, looks = math.nan, 0
    while detour.spinning:
        looks += 1
        assert looks < 2 * TURN
        pose = replace(pose, heading_rad=pose.heading_rad + STEP)
        ahead = 0.1 if free(wrapped(pose.heading_rad)) else -0.9
        bearing = detour.bearing_rad(pose, wrapped(goal - pose.heading_rad), 0.0, lambda value=ahead: value)
    assert TURN <= looks <= TURN + 2, "once all round"
    return bearing, pose


def between(low: float, high: float) -> Callable[[float], bool]:
    return lambda heading: math.radians(low) < heading < math.radians(high)


def test_who_turns_about_or_gets_on_goes_where_its_goal_is() -> None:
    detour = Detour()
    swing(detour, TURN - 1)
    assert not detour.spinning
    on = Detour()
    pose = HERE
    for _ in range(20):
        pose = swing(on, TURN // 2, pose)
        pose = replace(pose, east_m=pose.east_m + 0.6)
    assert not on.spinning


def test_it_leaves_by_the_free_way_that_is_nearest_to_its_goal() -> None:
    detour = Detour()
    pose = swing(detour, 3 * TURN)
    assert detour.spinning
    # It sees the other way, on its right, first.
    bearing, pose = spin(detour, pose, 0.0, lambda way: between(90, 130)(way) or between(-150, -70)(way))
    out = wrapped(pose.heading_rad + bearing)
    assert math.degrees(out) == pytest.approx(-80.0)
    # That way for two metres, whatever its heading, then to the goal.
    for far in (0.5, 1.9):
        pose = replace(pose, east_m=HERE.east_m + far, heading_rad=pose.heading_rad + 0.3)
        assert wrapped(pose.heading_rad + detour.bearing_rad(pose, 0.7, 0.0, never)) == pytest.approx(out)
    assert detour.bearing_rad(replace(pose, east_m=HERE.east_m + 2.1), 0.7, 0.0, never) == 0.7


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_turns_to_its_way_out_on_the_spot(side: float) -> None:
    detour = Detour()
    pose = swing(detour, 3 * TURN)
    assert not detour.aligning
    bearing, pose = spin(detour, pose, 0.0, between(50, 70))
    out = wrapped(pose.heading_rad + bearing)
    assert detour.aligning
    for off, aligning in ((2.0, True), (0.35, True), (0.25, False), (0.8, False)):
        pose = replace(pose, heading_rad=out - side * off)
        assert detour.bearing_rad(pose, 3.0, 0.0, never) == pytest.approx(side * off)
        assert detour.aligning == aligning, "once it looks along it, it may steer as it sees fit"


def test_the_next_way_out_from_about_there_leads_farther() -> None:
    detour, lengths = Detour(), []
    for from_m in (0.0, 1.0, 2.0, 3.0, 40.0):
        pose = swing(detour, 3 * TURN, replace(HERE, south_m=from_m))
        _, pose = spin(detour, pose, 0.0, between(50, 70))
        far = 0.0
        while detour.bearing_rad(replace(pose, east_m=HERE.east_m + far), 3.0, 0.0, never) != 3.0:
            far += 0.25
        lengths.append(far - 0.25)
    assert lengths == [2.0, 4.0, 8.0, 8.0, 2.0]


def test_without_a_free_way_it_goes_on_as_it_did() -> None:
    detour = Detour()
    pose = swing(detour, 3 * TURN)
    bearing, pose = spin(detour, pose, 0.0, lambda way: False)
    assert bearing == pytest.approx(wrapped(0.0 - pose.heading_rad))
    swing(detour, TURN - 1, pose)
    assert not detour.spinning, "it may turn as much as before"


def test_a_way_that_leads_nowhere_is_given_up() -> None:
    detour = Detour()
    pose = swing(detour, 3 * TURN)
    _, pose = spin(detour, pose, 0.0, between(50, 70))
    assert [detour.bearing_rad(pose, 3.0, 0.0, never) == 3.0 for _ in range(62)].index(True) == 60


def told(detour: Detour, told_m: float, moved_m: float, pose: Pose = HERE, looks: int = 12) -> Pose:
    """Tell it to drive north by so much a look; return where it is when it begins to look round, or in the end."""
    for _ in range(looks):
        if detour.spinning:
            break
        detour.bearing_rad(pose, 0.0, told_m, never)
        pose = replace(pose, south_m=pose.south_m - moved_m)
    return pose


def test_who_is_told_to_drive_and_does_not_looks_round() -> None:
    held = Detour()
    told(held, 0.2, 0.0, looks=2)
    assert not held.spinning, "it may only be speeding up"
    told(held, 0.2, 0.0, looks=2)
    assert held.spinning
    for told_m, moved_m in ((0.2, 0.2), (0.2, 0.06), (0.0, 0.0), (0.04, 0.04)):
        slow = Detour()
        told(slow, told_m, moved_m, looks=40)
        assert not slow.spinning


def test_where_it_was_held_no_way_is_free() -> None:
    detour = Detour()
    pose = told(detour, 0.2, 0.0)
    # All looks free, and its goal is straight ahead.
    bearing, pose = spin(detour, pose, 0.0, lambda way: True)
    out = wrapped(pose.heading_rad + bearing)
    assert 100.0 <= math.degrees(abs(out)) < 120.0
    # Held again on that way: of all that is left the nearest to the goal.
    pose = replace(pose, heading_rad=out)
    while not detour.spinning:
        detour.bearing_rad(pose, wrapped(-pose.heading_rad), 0.2, never)
    bearing, pose = spin(detour, pose, 0.0, lambda way: True)
    second = wrapped(pose.heading_rad + bearing)
    assert all(abs(wrapped(second - way)) >= math.radians(100.0) for way in (0.0, out))
    # It gets away, and all ways are as they look again.
    east, south = pose.east_m + 9 * math.sin(second), pose.south_m - 9 * math.cos(second)
    pose = replace(pose, east_m=east, south_m=south, heading_rad=0.0)
    assert detour.bearing_rad(pose, 0.3, 1.8, never) == 0.3
    detour.bearing_rad(pose, 0.3, 0.0, never)
    pose = swing(detour, 3 * TURN, pose)
    bearing, pose = spin(detour, pose, 0.0, lambda way: True)
    assert wrapped(pose.heading_rad + bearing) == pytest.approx(0.0, abs=STEP)


def test_if_no_way_looks_free_it_goes_back_whence_it_came() -> None:
    detour = Detour()
    pose = told(detour, 0.2, 0.0)
    bearing, pose = spin(detour, pose, 0.0, lambda way: False)
    assert abs(wrapped(pose.heading_rad + bearing)) == pytest.approx(math.pi)


class Forgetful:
    """Turns away from what it sees before it, to its goal where it sees nothing: it knows the robot's pose."""

    config = SteeringConfig(outputs=("yaw",), half_classes=7, width=40, height=32, goal=True)
    thing = (5.0, 5.0)

    def __init__(self) -> None:
        self.pose = HERE

    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None) -> dict[str, NDArray]:
        assert goal is not None
        east, south = self.thing[0] - self.pose.east_m, self.thing[1] - self.pose.south_m
        to_it = wrapped(math.atan2(east, -south) - self.pose.heading_rad)
        near = math.hypot(east, south) < 1.5 and abs(to_it) < 0.7
        yaw = -math.copysign(1.0, to_it) if near else float(np.clip(goal[0] / (math.pi / 4), -1, 1))
        share = np.exp(-(((np.linspace(-1, 1, 15) - yaw) / 0.1) ** 2))
        return {"yaw": share[None] / share.sum()}


class Blind(Forgetful):
    """Makes for its goal, whatever is in the way."""

    thing = (99.0, 99.0)


def test_a_robot_that_does_not_see_a_thing_gets_round_it_once_it_ran_into_it() -> None:
    course = Course(np.array([[5.0, 8.5], [5.0, 1.0]]))
    blocked = np.zeros((100, 100), np.bool_)
    blocked[48:52, 48:52] = True
    setting = Setting(ground_site(blocked), UGV, course, UGV.cruise_m_s, 150.0, first_heading(course), 3)
    found = simulate(setting, Steer(Blind(), setting))  # type: ignore[arg-type]
    assert found.end == "arrived"
    assert 1 <= sum(event == "collision" for _, event in found.events) <= 2


def test_a_robot_that_forgets_what_it_saw_gets_round_a_thing(monkeypatch: pytest.MonkeyPatch) -> None:
    course = Course(np.array([[5.0, 8.5], [5.0, 1.0]]))
    blocked = np.zeros((100, 100), np.bool_)
    blocked[48:52, 48:52] = True
    setting = Setting(ground_site(blocked), UGV, course, UGV.cruise_m_s, 150.0, first_heading(course), 3)

    def drive() -> tuple[str, int]:
        model = Forgetful()

        def watch(time_s: float, known: Pose, true: Pose, command: object) -> None:
            model.pose = true

        found = simulate(setting, Steer(model, setting), watch=watch)  # type: ignore[arg-type]
        return found.end, sum(event == "collision" for _, event in found.events)

    assert drive() == ("arrived", 0)
    monkeypatch.setattr(Detour, "bearing_rad", lambda self, known, goal_rad, told_m, ahead: goal_rad)
    assert drive() != ("arrived", 0), "or else nothing was shown"
