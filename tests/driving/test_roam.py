"""Courses without a plan."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from world_files import ground_site

from hrt_cli.driving.roam import Grounds, Leg, roam_course
from hrt_cli.driving.vehicle import UGV
from hrt_cli.errors import ArgumentError

SIDE = 300  # 30 m


def test_its_places_are_free_and_its_length_is_as_asked() -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[100:200, 140:160] = True
    site = ground_site(obstacle)
    course = roam_course(site, UGV, 200.0, 3)
    assert 200.0 <= course.length_m < 230.0
    rows, cols = np.floor(course.points[:, ::-1] / site.pixel_m).astype(int).T
    assert (site.clearance_m[rows, cols] > UGV.radius_m + 0.2).all()
    inside = np.minimum(course.points, 30.0 - course.points).min()
    assert inside > UGV.radius_m + 0.2
    assert np.hypot(*np.diff(course.points, axis=0).T).max() < 33.0


def test_all_of_it_lies_on_one_side_of_a_wall_without_a_gap() -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[:, 190:200] = True
    points = roam_course(ground_site(obstacle), UGV, 300.0, 1).points
    assert (points[:, 0] < 19.0).all(), "the larger side"


@pytest.mark.parametrize(("crossing", "least", "most"), [(0.75, 0.6, 1.0), (0.0, 0.0, 0.1), (None, 0.1, 0.6)])
def test_as_many_legs_as_asked_for_lead_across_something_and_none_off_the_survey(
    crossing: float | None, least: float, most: float
) -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    for row in range(40, 280, 60):
        for col in range(40, 280, 60):
            obstacle[row : row + 12, col : col + 12] = True
    seen = np.ones((SIDE, SIDE), np.bool_)
    seen[:120, 150:] = False
    site = ground_site(obstacle, seen=seen)
    points = roam_course(site, UGV, 900.0, 4, crossing=crossing).points
    blocked = 0
    for start, end in pairwise(points):
        cols, rows = np.floor(np.linspace(start, end, 400) / site.pixel_m).astype(int).T
        assert seen[rows, cols].all()
        blocked += bool((site.clearance_m[rows, cols] < UGV.radius_m + 0.25).any())
    assert least <= blocked / (len(points) - 1) <= most


def boxed(*boxes: tuple[int, int, int, int]) -> Grounds:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    for top, left, bottom, right in boxes:
        obstacle[top:bottom, left:right] = True
    return Grounds(ground_site(obstacle), UGV)


def test_legs_lead_only_across_what_can_be_gone_round_close_by() -> None:
    start, end = np.array([10.0, 15.0]), np.array([20.0, 15.0])
    assert boxed().leg(start, end) is Leg.CLEAR
    assert boxed((145, 145, 155, 155)).leg(start, end) is Leg.ROUND
    # Too wide along the leg, a wall across it, a place to end that is none.
    assert boxed((145, 130, 155, 160)).leg(start, end) is Leg.NO
    assert boxed((60, 148, 240, 152)).leg(start, end) is Leg.NO
    assert boxed((145, 195, 155, 205)).leg(start, end) is Leg.NO
    # A wall with its end a little off: gone round there.
    assert boxed((60, 148, 155, 152)).leg(start, end) is Leg.ROUND


def test_no_leg_comes_near_the_rim() -> None:
    grounds = boxed()
    assert grounds.leg(np.array([3.0, 15.0]), np.array([27.0, 15.0])) is Leg.CLEAR
    assert grounds.leg(np.array([3.0, 15.0]), np.array([28.5, 15.0])) is Leg.NO
    assert grounds.places.min() > 2.0


def test_a_site_that_leads_nowhere_is_refused() -> None:
    obstacle = np.ones((SIDE, SIDE), np.bool_)
    obstacle[140:160, 140:160] = False
    with pytest.raises(ArgumentError, match="no room to roam for 50 m"):
        roam_course(ground_site(obstacle), UGV, 50.0, 0)


def test_seeds_differ_and_repeat() -> None:
    site = ground_site(np.zeros((SIDE, SIDE), np.bool_))
    one, same, other = (roam_course(site, UGV, 80.0, seed).points for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one[:2], other[:2])


def test_a_site_without_room_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"no place with 0\.6 m of free ground"):
        roam_course(ground_site(np.ones((SIDE, SIDE), np.bool_)), UGV, 50.0, 0)
