"""Other goals about a robot, and what turns cost on the way to them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hrt_cli.driving.elsewhere import Elsewhere, place_at
from hrt_cli.driving.field import CostMap
from hrt_cli.driving.local import Pose
from hrt_cli.driving.turns import ANGLES
from hrt_cli.driving.vehicle import UGV

CELL_M, SIDE = 0.2, 60  # 12 m
MIDDLE = Pose(6.1, 6.1, 0.0, 0.0, 0.0)


def elsewhere(blocked: tuple[slice, slice] | None = None) -> Elsewhere:
    cost = np.ones((SIDE, SIDE), np.float32)
    if blocked is not None:
        cost[blocked] = np.inf
    return Elsewhere(CostMap(cost, CELL_M), UGV, 1.0)


@pytest.mark.parametrize("count", [1, 5, 40])
def test_on_open_ground_the_best_turn_is_towards_each_goal(count: int) -> None:
    found = elsewhere().goals(MIDDLE, count, np.random.default_rng(1))
    assert found is not None
    bearings, costs = found
    assert bearings.shape == (count,)
    assert costs.shape == (count, ANGLES.size)
    assert (costs.min(axis=1) == 0).all()
    for bearing, each in zip(bearings, costs, strict=True):
        if abs(bearing) > 0.4:
            assert np.sign(ANGLES[int(each.argmin())]) == np.sign(bearing)
    if count == 40:
        assert 0.4 < bearings.std() < 1.0
        assert abs(bearings.mean()) < 0.4


def test_the_robot_looks_where_it_heads() -> None:
    """A wall in the east: who heads there cannot go straight on, who heads west can."""
    walled = elsewhere((slice(0, SIDE), slice(38, 42)))
    for turn, straight in ((1, False), (-1, True)):
        pose = Pose(6.1, 6.1, 0.0, turn * math.pi / 2, 0.0)
        assert place_at(pose, 0.0, 3.0) == pytest.approx((6.1 + 3 * turn, 6.1))
        assert place_at(pose, math.pi / 2, 2.0) == pytest.approx((6.1, 6.1 + 2 * turn))
        assert walled.is_straight(pose, place_at(pose, 0.0, 3.0)) == straight
        assert elsewhere().is_straight(pose, place_at(pose, 0.0, 3.0))


def test_a_goal_behind_a_wall_is_gone_round_to() -> None:
    blocked = elsewhere((slice(24, 26), slice(20, 40)))  # 1 m ahead, 4 m wide
    found = blocked.goals(MIDDLE, 30, np.random.default_rng(2))
    assert found is not None
    ahead = np.abs(found[0]) < 0.2
    assert ahead.any()
    assert (found[1][ahead, 7] > 3.0).all(), "straight on leads into it"


def test_where_few_goals_can_be_reached_some_come_again() -> None:
    """It may be on 0.8 m ahead alone: only what lies near that can be gone to."""
    cost = np.full((SIDE, SIDE), np.inf, np.float32)
    cost[27:31, 30] = 1.0
    found = Elsewhere(CostMap(cost, CELL_M), UGV, 1.0).goals(MIDDLE, 12, np.random.default_rng(3))
    assert found is not None
    assert len(found[0]) == 12
    assert len(set(found[0].tolist())) < 12
    assert np.abs(found[0]).max() < 1.0


def test_where_there_is_no_way_there_are_no_goals() -> None:
    cost = np.full((SIDE, SIDE), np.inf, np.float32)
    assert Elsewhere(CostMap(cost, CELL_M), UGV, 1.0).goals(MIDDLE, 4, np.random.default_rng(0)) is None
    cost[30, 30] = 1.0  # it stands there and all its goals lie beyond
    assert Elsewhere(CostMap(cost, CELL_M), UGV, 1.0).goals(MIDDLE, 4, np.random.default_rng(0)) is None
