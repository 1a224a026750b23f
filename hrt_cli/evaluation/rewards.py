"""Cumulative reward: what a walk has collected by the time it has gone so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """Cumulative reward of one walk, or its mean over the starts.

    Attributes
    ----------
    name : str
        The file of a plan, else the method.
    role : {'plan', 'planner', 'baseline'}
        Whose walk it is.
    travelled : ndarray, float64 [k]
        Where the curve is known, rising, in the unit of the chart.
    reward : ndarray, float64 [k]
        What has been collected there.
    low, high : ndarray, float64 [k], or None
        The band within which 90 % of the starts lie.
    """

    name: str
    role: Literal["plan", "planner", "baseline"]
    travelled: Floats
    reward: Floats
    low: Floats | None = None
    high: Floats | None = None


@dataclass(frozen=True)
class RewardChart:
    """Curves of one task, and the bound on where any of them can end.

    Attributes
    ----------
    title : str
        What is compared, in words.
    unit : {'steps', 'm'}
        Unit of `travelled` and of `limit`, the budget.
    discounted : bool
        Whether the reward is the discounted score.
    bound : float
        Upper bound on the reward at the budget; the mean of the starts' where the curves are means.
    """

    title: str
    unit: Literal["steps", "m"]
    limit: float
    discounted: bool
    bound: float
    curves: list[Curve]


def cumulative_reward(score: NDArray[np.floating], cells: NDArray[np.integer], gamma: float = 1.0) -> Floats:
    """Return the reward collected up to each cell of a walk: a cell pays once, gamma^t times its score at first visit.

    Parameters
    ----------
    score : ndarray, float [rows, cols]
        Score of each cell; finite where the walk goes.
    cells : ndarray, int [T + 1, 2]
        Row and column of every cell of the walk, start first.
    gamma : float
        Discount per step, in (0, 1].

    Returns
    -------
    ndarray, float64 [T + 1]
    """
    return team_reward(score, [cells], gamma)[1]


def team_reward(
    score: NDArray[np.floating], walks: Sequence[NDArray[np.integer]], gamma: float = 1.0, diagonal_cost: float = 1.0
) -> tuple[Floats, Floats]:
    """Return what robots that set out together have collected by the time each of them has gone so far.

    A cell pays once, to the robot that is there first, by the number of steps; among several the first of `walks`.

    Parameters
    ----------
    score : ndarray, float [rows, cols]
        Score of each cell; finite where the walks go.
    walks : sequence of ndarray, int [T + 1, 2]
        Row and column of every cell of each robot's walk, start first.
    gamma : float
        Discount per step, in (0, 1].
    diagonal_cost : float
        See `distance_travelled`.

    Returns
    -------
    travelled, reward : ndarray, float64 [k]
        Distances in units of one cell, rising from 0, and the reward within each.
    """
    step = np.concatenate([np.arange(len(cells)) for cells in walks])
    order = np.argsort(step, kind="stable")
    step, cells = step[order], np.concatenate([np.asarray(cells) for cells in walks])[order]
    first = np.unique(cells[:, 0].astype(np.int64) * score.shape[1] + cells[:, 1], return_index=True)[1]
    gain = np.zeros(step.size)
    gain[first] = score[cells[first, 0], cells[first, 1]] * gamma ** step[first]
    travelled = np.concatenate([distance_travelled(cells, diagonal_cost) for cells in walks])[order]
    by_distance = np.argsort(travelled, kind="stable")
    travelled, reward = travelled[by_distance], np.cumsum(gain[by_distance])
    last = np.append(np.diff(travelled) > 0.0, True)
    return travelled[last], reward[last]


def distance_travelled(cells: NDArray[np.integer], diagonal_cost: float = 1.0) -> Floats:
    """Return what the walk to each cell costs, in units of one cell: float64 [T + 1], 0 at the start.

    Parameters
    ----------
    cells : ndarray, int [T + 1, 2]
        The walk.
    diagonal_cost : float
        What a diagonal step costs: 1 where steps are counted, sqrt(2) where length is.
    """
    diagonal = np.abs(np.diff(np.asarray(cells, np.int64), axis=0)).sum(axis=1) == 2
    return np.concatenate([[0.0], np.cumsum(np.where(diagonal, diagonal_cost, 1.0))])


def reward_at(at: Floats, travelled: Floats, reward: Floats) -> Floats:
    """Return the reward collected within each of the distances `at`; a walk that has ended keeps what it has.

    Parameters
    ----------
    at : ndarray, float64 [k]
        Distances >= 0.
    travelled, reward : ndarray, float64 [T + 1]
        A walk's, `travelled` rising from 0.

    Returns
    -------
    ndarray, float64 [k]
    """
    # Sums of square roots of two differ in the last bits from the distance that is asked for.
    return reward[np.searchsorted(travelled, at + 1e-9 * (1.0 + at), side="right") - 1]
