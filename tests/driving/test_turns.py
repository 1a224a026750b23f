"""What each turn would cost."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hrt_cli.driving.field import CostMap, march_to
from hrt_cli.driving.local import Pose
from hrt_cli.driving.turns import ANGLES, WORST_S, turn_costs
from hrt_cli.driving.vehicle import UGV

CELL_M, SIDE = 0.2, 60  # 12 m
GOAL = (6.1, 2.1)


def costs_from(
    east: float,
    south: float,
    heading_deg: float,
    blocked: NDArray[np.bool_] | None = None,
    goal: tuple[float, float] = GOAL,
    ground: float = 1.0,
) -> NDArray[np.float64]:
    cost = np.full((SIDE, SIDE), ground, np.float32)
    if blocked is not None:
        cost[blocked] = np.inf
    made, to_go = CostMap(cost, CELL_M), np.empty_like(cost)
    here = made.cell(east, south)
    assert math.isfinite(march_to(cost, CELL_M, *made.cell(*goal), *here, 99.0, 4.0, to_go)) or blocked is not None
    return turn_costs(made, to_go, UGV, 1.0, Pose(east, south, 0.0, math.radians(heading_deg), 0.0))


def test_straight_on_is_best_towards_the_goal_and_both_sides_are_alike() -> None:
    found = costs_from(6.1, 9.0, 0.0)
    assert found.shape == (15,)
    assert found.min() == 0.0
    assert int(found.argmin()) == 7
    np.testing.assert_allclose(found, found[::-1], atol=0.15)
    assert (np.diff(found[7:]) > 0).all(), "the farther off, the dearer"


@pytest.mark.parametrize(("heading_deg", "side"), [(-60.0, 1.0), (60.0, -1.0)])
def test_it_turns_to_the_side_of_the_goal(heading_deg: float, side: float) -> None:
    found = costs_from(6.1, 9.0, heading_deg)
    assert side * ANGLES[int(found.argmin())] > 0.4
    assert found[0 if side > 0 else -1] > 1.0


@pytest.mark.parametrize("bearing_deg", [-70.0, -20.0, 0.0, 35.0])
def test_on_open_ground_it_does_not_depend_on_the_compass(bearing_deg: float) -> None:
    found = []
    for heading_deg in range(0, 360, 15):
        to = math.radians(heading_deg + bearing_deg)
        # The goal is the middle of a cell.
        east, south = 6.1 - 3.0 * math.sin(to), 6.1 + 3.0 * math.cos(to)
        found.append(costs_from(east, south, heading_deg, goal=(6.1, 6.1)))
    spread = np.ptp(np.array(found), axis=0)
    assert spread.max() < 0.25
    assert np.median(spread) < 0.1
    best = ANGLES[np.mean(found, axis=0).argmin()]
    assert best == 0.0 if bearing_deg == 0 else best * bearing_deg > 0


def test_what_leads_into_an_obstacle_is_dear_and_left_is_as_good_as_right() -> None:
    blocked = np.zeros((SIDE, SIDE), np.bool_)
    blocked[36:42, 27:34] = True  # 0.6 m ahead, 1.4 m wide
    found = costs_from(6.1, 9.0, 0.0, blocked)
    assert found[7] > 4.0
    assert found[:3].min() < 0.5
    assert found[-3:].min() < 0.5


def test_one_that_stands_where_it_may_not_be_is_led_out_of_there() -> None:
    blocked = np.zeros((SIDE, SIDE), np.bool_)
    blocked[:, :31] = True
    found = costs_from(6.1, 9.0, 0.0, blocked, goal=(9.0, 9.0))
    assert ANGLES[int(found.argmin())] > 0.2
    assert found[0] > found[-1]


def test_time_where_it_may_not_be_is_paid_for() -> None:
    blocked = np.zeros((SIDE, SIDE), np.bool_)
    blocked[:, :31] = True
    # 0.3 m from the edge, and looking at it: straight on it is out soon, turning on the spot it stays for 1.2 s.
    found = costs_from(5.9, 9.0, 90.0, blocked, goal=(9.0, 9.0))
    assert found[7] == 0.0
    assert found[0] > 6.0
    assert found[4] > 1.5, "half a turn, and out a little later"


def test_bad_ground_all_over_does_not_make_standing_cheaper() -> None:
    good, bad = (costs_from(6.1, 9.0, 0.0, ground=ground) for ground in (1.0, 3.0))
    assert bad[0] == pytest.approx(good[0], abs=0.25)


def test_costs_have_a_bound() -> None:
    blocked = np.ones((SIDE, SIDE), np.bool_)
    found = costs_from(6.1, 9.0, 0.0, blocked)
    assert np.isfinite(found).all()
    assert found.max() <= WORST_S
