"""Pushes off the way: as many as asked, the same for the same seed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hrt_cli.driving.disturb import Disturbed
from hrt_cli.driving.local import Command, Pose

POSE = Pose(0.0, 0.0, 0.0, 0.0, 0.0)


class Straight:
    name, along_m = "straight", 3.0

    def __init__(self, ends_at: int = 10**9) -> None:
        self.asked, self._ends_at = 0, ends_at

    def decide(self, known: Pose, true: Pose) -> Command | None:
        self.asked += 1
        return Command(0.0, 0.0, 1.0) if self.asked < self._ends_at else None


def commands(share: float, seed: int, count: int = 60_000) -> np.ndarray:
    planner = Disturbed(Straight(), share, seed)
    found = [planner.decide(POSE, POSE) for _ in range(count)]
    return np.array([(each.yaw, each.pitch, each.speed) for each in found if each is not None])


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_it_pushes_for_the_share_of_the_time_that_is_asked(share: float) -> None:
    pushed = commands(share, 1)[:, 0] != 0.0
    assert pushed.mean() == pytest.approx(share, rel=0.1)


def test_pushes_go_to_both_sides_hard_and_last() -> None:
    yaw = commands(0.3, 2)[:, 0]
    hard = yaw[yaw != 0.0]
    assert (np.abs(hard) >= 0.5).all()
    assert (np.abs(hard) <= 1.0).all()
    assert 0.4 < (hard > 0).mean() < 0.6
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], yaw, [0.0]])))
    runs = [b - a for a, b in pairwise(edges) if yaw[a] != 0.0]
    assert min(runs) >= 6
    assert np.mean(runs) == pytest.approx(12.0, rel=0.15)


def test_it_depends_on_the_seed_alone() -> None:
    assert np.array_equal(commands(0.3, 5, 500), commands(0.3, 5, 500))
    assert not np.array_equal(commands(0.3, 5, 500), commands(0.3, 6, 500))


def test_the_planner_inside_is_asked_all_the_same_and_ends_the_drive() -> None:
    inner = Straight(ends_at=100)
    planner = Disturbed(inner, 0.5, 0)
    for _ in range(99):
        assert planner.decide(POSE, POSE) is not None
    assert planner.decide(POSE, POSE) is None
    assert (inner.asked, planner.along_m, planner.name) == (100, 3.0, "straight")
