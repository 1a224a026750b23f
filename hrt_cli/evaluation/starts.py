"""How methods compare over many starts and seeds, not on one start alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.evaluation.rewards import Floats, cumulative_reward, distance_travelled, reward_at
from hrt_cli.planning.planner import bound_of, find_walks
from hrt_cli.planning.problem import Problem

RESAMPLES = 2000
"""Resamples of the bootstrap."""

INTERVAL = (2.5, 97.5)
"""Percentiles of the resampled means that span the interval of the mean."""

BAND = (5.0, 95.0)
"""Percentiles of the starts that span the band of a curve."""

MOST_POINTS = 401
"""Points of a mean curve at most."""

_START_STREAM, _BOOTSTRAP_STREAM = 1, 2

_Key = TypeVar("_Key")
_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Spread:
    """A measure over starts: its mean over all runs, the worst run, and the 95 % interval of the mean."""

    mean: float
    worst: float
    low: float
    high: float


@dataclass(frozen=True)
class MethodSpread:
    """What the walks of one method collect, over starts and seeds; the keys are those of `Worth`."""

    score: Spread
    discounted_score: Spread
    fraction_of_bound: Spread
    fraction_of_discounted_bound: Spread


@dataclass(frozen=True)
class MeanCurve:
    """Mean cumulative reward, float64 [k], and the percentiles `BAND` of the starts."""

    mean: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True)
class StartsComparison:
    """Methods over `count` starts, `seeds` runs from each.

    Attributes
    ----------
    methods : dict of str to MethodSpread
        Every method's results.
    travelled : ndarray, float64 [k]
        Where the curves are sampled, in units of one cell, from 0 to the budget.
    curves : dict of str to MeanCurve
        Cumulative reward, discounted where that is the objective.
    bound : float
        Mean over the starts of the bound on what the curves can reach.
    """

    count: int
    seeds: int
    methods: dict[str, MethodSpread]
    travelled: Floats
    curves: dict[str, MeanCurve]
    bound: float


@dataclass(frozen=True)
class _Run:
    """What every method collects from one start with one seed: float64 [methods], the curves [methods, k]."""

    score: Floats
    discounted: Floats
    curves: Floats


def draw_starts(
    score: NDArray[np.floating], start: tuple[int, int], connectivity: int, count: int, seed: int
) -> NDArray[np.int64]:
    """Draw distinct cells at random, each as likely, of the region that can be reached from `start`.

    Parameters
    ----------
    score : ndarray, float [rows, cols]
        NaN marks a no-go cell.
    start : (int, int)
        Row and column of a cell that is not no-go.
    connectivity : {4, 8}
        Whether diagonal moves exist.
    count : int
        Cells to draw, > 0; the first of more are the same cells.
    seed : int
        Random seed, >= 0.

    Returns
    -------
    ndarray, int64 [count, 2]
        Rows and columns.

    Raises
    ------
    ArgumentError
        The region has fewer cells.
    """
    from scipy import ndimage

    labels, _ = ndimage.label(~np.isnan(score), ndimage.generate_binary_structure(2, connectivity // 4))
    cells = np.argwhere(labels == labels[start])
    if count > len(cells):
        raise ArgumentError(f"{count} starts cannot be drawn: only {len(cells)} cells are connected to the plan's")
    return np.random.default_rng([seed, _START_STREAM]).permutation(cells)[:count]


def compare_over_starts(
    problem: Problem,
    methods: tuple[str, ...],
    starts: NDArray[np.int64],
    *,
    seed: int = 0,
    seeds: int = 1,
    workers: int = 1,
    tick: Callable[[], None] = lambda: None,
) -> StartsComparison:
    """Run every method from every start with the seeds `seed`, `seed` + 1, ...

    Parameters
    ----------
    problem : Problem
        The task; its start is replaced.
    methods : tuple of str
        Of `hrt_cli.planning.planner.METHODS`.
    starts : ndarray, int64 [count, 2]
        Rows and columns.
    seed, seeds : int
        The first seed and how many; each method draws at random, if only between equals.
    workers : int
        Threads; the result is the same.
    tick : callable
        Called `count` * (`seeds` + 1) times, from this thread.

    Raises
    ------
    ArgumentError
        A start does not fit the problem.
    """
    home = problem.end == problem.start
    cells = [(int(row), int(col)) for row, col in starts]
    problems = [replace(problem, start=cell, end=cell if home else problem.end) for cell in cells]
    at = np.linspace(0.0, problem.limit, min(int(problem.limit) + 1, MOST_POINTS))
    picks = [(each, seed + k) for each in problems for k in range(seeds)]
    shape = len(problems), seeds, len(methods)
    score, discounted = np.empty(shape), np.empty(shape)
    curves = np.zeros((len(problems), len(methods), at.size))
    for index, run in enumerate(_each(lambda pick: _run(pick[0], methods, pick[1], at), picks, workers, tick)):
        which = divmod(index, seeds)
        score[which], discounted[which] = run.score, run.discounted
        curves[which[0]] += run.curves / seeds
    found = _each(
        lambda index: task_bounds([problems[index]], score[index].max(), discounted[index].max()),
        range(len(problems)),
        workers,
        tick,
    )
    bounds = np.array(list(found))
    rng = np.random.default_rng([seed, _BOOTSTRAP_STREAM])
    resamples = rng.integers(0, len(problems), (RESAMPLES, len(problems)))
    measures = (score, discounted, _fraction(score, bounds[:, 0]), _fraction(discounted, bounds[:, 1]))
    spreads = {
        name: MethodSpread(*(spread(measure[:, :, k], resamples) for measure in measures))
        for k, name in enumerate(methods)
    }
    mean, (low, high) = curves.mean(axis=0), np.percentile(curves, BAND, axis=0)
    return StartsComparison(
        len(problems),
        seeds,
        spreads,
        at,
        {name: MeanCurve(mean[k], low[k], high[k]) for k, name in enumerate(methods)},
        float(bounds[:, 1 if problem.objective == "discounted" else 0].mean()),
    )


def task_bounds(problems: Sequence[Problem], score: float, discounted: float) -> tuple[float, float]:
    """Return proven bounds on a team's score and discounted score, given the best known of each."""
    bounds = bound_of(problems, float(score), float(discounted))
    return bounds.score, bounds.score if bounds.discounted is None else bounds.discounted


def spread(values: Floats, resamples: NDArray[np.int64]) -> Spread:
    """Summarise a measure, the more the better, with the percentile bootstrap over starts (Efron 1979).

    Parameters
    ----------
    values : ndarray, float64 [starts, seeds]
        The measure of each run.
    resamples : ndarray, int64 [resamples, starts]
        Indices of the starts of each resample; the same for all methods, so that their intervals go together.
    """
    per_start = values.mean(axis=1)
    low, high = np.percentile(per_start[resamples].mean(axis=1), INTERVAL)
    return Spread(float(per_start.mean()), float(values.min()), float(low), float(high))


def _run(problem: Problem, methods: tuple[str, ...], seed: int, at: Floats) -> _Run:
    score, discounted, curves = [], [], []
    for method in methods:
        cells = find_walks([problem], method, seed=seed)[0]
        reward = cumulative_reward(problem.score, cells)
        paid = cumulative_reward(problem.score, cells, problem.gamma)
        score.append(reward[-1])
        discounted.append(paid[-1])
        travelled = distance_travelled(cells, problem.budget.diagonal_cost)
        curves.append(reward_at(at, travelled, paid if problem.objective == "discounted" else reward))
    return _Run(np.array(score), np.array(discounted), np.array(curves))


def _fraction(values: Floats, bounds: Floats) -> Floats:
    """Divide values [starts, seeds, methods] by the bounds [starts]; where nothing can be had, all of it was."""
    whole = np.broadcast_to(bounds[:, None, None], values.shape)
    return np.divide(values, whole, out=np.ones_like(values), where=whole > 0)


def _each(
    function: Callable[[_Key], _Found], keys: Iterable[_Key], workers: int, tick: Callable[[], None]
) -> Iterator[_Found]:
    """Map in order, `workers` at a time; stopped, what has not begun is not begun."""
    pool = ThreadPoolExecutor(workers)
    try:
        for each in pool.map(function, keys):
            tick()
            yield each
    finally:
        pool.shutdown(cancel_futures=True)
