"""The expert as a teacher: what it does depends on the goal that a learner is told, and on what lies about."""

from __future__ import annotations

import math

import numpy as np
import pytest
from world_files import ground_site

from hrt_cli.driving.course import Course
from hrt_cli.driving.local import Pose
from hrt_cli.driving.simulator import Setting, first_heading, simulate
from hrt_cli.driving.teacher import teacher_of
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.world.site import Site

EAST = math.pi / 2


def setting(site: Site, *points: tuple[float, float], seed: int = 0) -> Setting:
    course = Course(np.array(points, float))
    vehicle = AUV if site.under_water else UGV
    return Setting(site, vehicle, course, vehicle.cruise_m_s, 600.0, first_heading(course), seed)


def open_ground(side: int = 200) -> Site:
    return ground_site(np.zeros((side, side), np.bool_))


@pytest.mark.parametrize("heading_deg", [60.0, 90.0, 115.0])
def test_on_open_ground_it_steers_to_the_goal(heading_deg: float) -> None:
    teacher = teacher_of(setting(open_ground(), (3.0, 10.0), (17.0, 10.0)))
    pose = Pose(6.0, 10.0, 0.0, math.radians(heading_deg), 0.0)
    command = teacher.decide(pose, pose)
    assert command is not None
    assert teacher.bearing_rad == pytest.approx(math.radians(90.0 - heading_deg), abs=0.02)
    assert command.yaw == pytest.approx(teacher.bearing_rad / (math.pi / 4), abs=0.03)


def test_on_open_ground_it_goes_straight_whatever_the_compass() -> None:
    """A grid of cells has eight directions; what it teaches must not."""
    site = open_ground(300)
    for bearing_deg in range(0, 360, 7):
        turn = math.radians(bearing_deg)
        east, south = math.sin(turn), -math.cos(turn)
        start, end = (15.0 - 9 * east, 15.0 - 9 * south), (15.0 + 9 * east, 15.0 + 9 * south)
        teacher = teacher_of(setting(site, start, end))
        pose = Pose(15.0 - 5 * east, 15.0 - 5 * south, 0.0, turn, 0.0)
        command = teacher.decide(pose, pose)
        assert command is not None
        assert command.yaw == pytest.approx(0.0, abs=0.03), bearing_deg


@pytest.mark.parametrize("side", [-1, 1])
def test_what_is_in_the_way_is_gone_round_on_the_shorter_side(side: int) -> None:
    obstacle = np.zeros((200, 200), np.bool_)
    obstacle[100 - side * 6 - 10 : 100 - side * 6 + 10, 80:90] = True  # more of it on the one side of the course
    teacher = teacher_of(setting(ground_site(obstacle), (3.0, 10.0), (17.0, 10.0)))
    pose = Pose(6.4, 10.0, 0.0, EAST, 0.0)
    command = teacher.decide(pose, pose)
    assert command is not None
    assert abs(teacher.bearing_rad) < 0.02
    assert side * command.yaw > 0.3


def test_it_is_told_the_place_as_measured_and_steers_from_where_the_robot_is() -> None:
    teacher = teacher_of(setting(open_ground(), (3.0, 10.0), (17.0, 10.0)))
    true = Pose(6.0, 10.0, 0.0, EAST, 0.0)
    command = teacher.decide(Pose(6.0, 10.5, 0.0, EAST, 0.0), true)
    assert command is not None
    assert teacher.bearing_rad < -0.1
    assert command.yaw == pytest.approx(0.0, abs=0.15)


def test_a_goal_on_an_obstacle_stands_for_the_next_place_beyond() -> None:
    obstacle = np.zeros((200, 200), np.bool_)
    obstacle[85:115, 90:125] = True
    found = simulate(s := setting(ground_site(obstacle), (3.0, 10.0), (18.0, 10.0)), teacher_of(s))
    assert found.end == "arrived"
    assert not found.events


def test_an_auv_keeps_its_height_over_a_rising_bottom() -> None:
    bottom = np.broadcast_to(np.linspace(-9.0, -4.0, 300), (200, 300))
    site = ground_site(np.zeros((200, 300), np.bool_), bottom_m=bottom, under_water=True)
    s = setting(site, (3.0, 10.0), (26.0, 10.0))
    pitches = []
    found = simulate(s, teacher_of(s), watch=lambda t, known, true, command: pitches.append(command.pitch))
    assert found.end == "arrived"
    assert not found.events
    assert np.mean(pitches) > 0.1


def test_in_the_midst_of_an_obstacle_it_knows_no_way() -> None:
    obstacle = np.zeros((200, 200), np.bool_)
    obstacle[:, 100:] = True
    teacher = teacher_of(setting(ground_site(obstacle), (3.0, 10.0), (17.0, 10.0)))
    pose = Pose(15.0, 10.0, 0.0, EAST, 0.0)
    assert teacher.decide(pose, pose) is None


def test_on_the_edge_of_an_obstacle_it_shows_the_way_off() -> None:
    obstacle = np.zeros((200, 200), np.bool_)
    obstacle[:, 100:] = True
    teacher = teacher_of(setting(ground_site(obstacle), (3.0, 10.0), (9.0, 10.0), (3.0, 10.0)))
    pose = Pose(9.9, 10.0, 0.0, 0.0, 0.0)
    command = teacher.decide(pose, pose)
    assert command is not None
    assert command.yaw < -0.9
