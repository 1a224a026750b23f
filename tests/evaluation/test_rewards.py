"""Cumulative reward is recomputed here step by step, in plain Python."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hrt_cli.evaluation.rewards import cumulative_reward, distance_travelled, reward_at, team_reward


def wandering(rng: np.random.Generator, steps: int, shape: tuple[int, int]) -> list[tuple[int, int]]:
    cells = [(shape[0] // 2, shape[1] // 2)]
    while len(cells) <= steps:
        row, col = (int(k) for k in cells[-1] + rng.integers(-1, 2, 2))
        if (row, col) != cells[-1] and 0 <= row < shape[0] and 0 <= col < shape[1]:
            cells.append((row, col))
    return cells


@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("seed", range(3))
def test_each_cell_pays_once_when_it_is_first_entered(gamma: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    score = rng.random((6, 9)).astype(np.float32)
    cells = wandering(rng, 60, score.shape)  # type: ignore[arg-type]
    expected, paid, total = [], set(), 0.0
    for step, cell in enumerate(cells):
        if cell not in paid:
            total += gamma**step * float(score[cell])
            paid.add(cell)
        expected.append(total)
    assert len(paid) < len(cells)
    assert cumulative_reward(score, np.array(cells), gamma) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("diagonal", [1.0, math.sqrt(2)])
def test_of_a_team_a_cell_pays_who_is_there_first(gamma: float, diagonal: float) -> None:
    rng = np.random.default_rng(11)
    score = rng.random((6, 9)).astype(np.float32)
    walks = [wandering(rng, steps, score.shape) for steps in (20, 35, 5)]  # type: ignore[arg-type]
    travelled, reward = team_reward(score, [np.array(cells) for cells in walks], gamma, diagonal)
    gains, paid = [], set()
    for step in range(36):
        for cells in walks:
            if step < len(cells):
                way = distance_travelled(np.array(cells), diagonal)[step]
                gains.append((way, 0.0 if cells[step] in paid else gamma**step * float(score[cells[step]])))
                paid.add(cells[step])
    for at in (0.0, 3.5, 12.0, 60.0):
        expected = sum(gain for way, gain in gains if way <= at + 1e-9)
        assert reward_at(np.array([at]), travelled, reward)[0] == pytest.approx(expected, rel=1e-12)
    assert len(reward) == len(travelled)
    assert (np.diff(travelled) > 0).all()
    if diagonal == 1.0:
        assert travelled.tolist() == list(range(36))


@pytest.mark.parametrize("diagonal", [1.0, math.sqrt(2)])
def test_distance_counts_diagonals_as_the_budget_does(diagonal: float) -> None:
    cells = wandering(np.random.default_rng(7), 30, (5, 5))
    expected = [0.0]
    for (r0, c0), (r1, c1) in itertools.pairwise(cells):
        expected.append(expected[-1] + (diagonal if r0 != r1 and c0 != c1 else 1.0))
    assert distance_travelled(np.array(cells), diagonal) == pytest.approx(expected)
    assert distance_travelled(np.array(cells[:1])).tolist() == [0.0]


def test_reward_within_a_distance_is_that_of_the_last_cell_reached() -> None:
    travelled = np.array([0.0, 1.0, 1.0 + math.sqrt(2), 2.0 + math.sqrt(2)])
    reward = np.array([1.0, 3.0, 4.0, 6.0])
    at = np.array([0.0, 0.99, 1.0, 2.4, 2.42, 3.4, 10.0])
    assert reward_at(at, travelled, reward).tolist() == [1.0, 1.0, 3.0, 3.0, 4.0, 4.0, 6.0]
    steps = np.arange(4.0)
    assert reward_at(np.linspace(0, 3, 4), steps, reward).tolist() == reward.tolist()
