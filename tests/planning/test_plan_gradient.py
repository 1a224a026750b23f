"""The gradients that training follows, against a world so small that everything in it can be written down.

Walks, features, chances and rewards are worked out here from their definitions, in plain Python and double precision.
The gradient of the expected reward is then exact: by the derivative along an imaginary step, which loses no digits.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from test_plan_policy import RING, features_by_hand

from hrt_cli.planning.features import LAYOUTS, build_blocks, feature_count, weight_count
from hrt_cli.planning.policy import roll_many
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.train import explore, gpomdp_gradient, reinforce_gradient
from hrt_cli.planning.walk import build_field, to_cells

TINY = np.array([[0.2, 1.0, 0.1], [0.6, 0.3, 0.8]])
MOVES = 3
ESTIMATORS = {"gpomdp": gpomdp_gradient, "reinforce": reinforce_gradient}
LINEAR = [layout for layout in LAYOUTS if weight_count(layout) == feature_count(layout)]
KINDS = [(layout, connectivity) for layout in LINEAR for connectivity in (4, 8)]
"""The layouts without hinges; the gradient through those is held to its definition in `test_plan_policy`."""


@dataclass
class Situation:
    """The moves open to a robot that has made a walk: the cells they lead to and their features [moves, weights]."""

    after: list
    phi: np.ndarray


class World:
    """A problem, and all that can happen in it."""

    def __init__(self, score, start, moves, layout, connectivity):
        self.problem = Problem(score, start, Budget(float(moves)), connectivity)
        self.layout, self.moves = layout, moves
        self.scale = np.sort(score[~np.isnan(score)])[::-1][: moves + 1].mean()
        self.actions = RING if connectivity == 8 else RING[::2]
        self.situations = {}

    def situation(self, cells):
        if cells not in self.situations:
            score, (row, col) = self.problem.score, cells[-1]
            after, phi = [], []
            for k, (dr, dc) in enumerate(self.actions):
                to = (row + dr, col + dc)
                if 0 <= to[0] < score.shape[0] and 0 <= to[1] < score.shape[1] and not np.isnan(score[to]):
                    heading = k * 8 // len(self.actions)
                    after.append(to)
                    phi.append(
                        features_by_hand(self.problem, self.layout, self.scale, list(cells), len(cells), heading)
                    )
            self.situations[cells] = Situation(after, np.array(phi))
        return self.situations[cells]

    def shares(self, cells, weights):
        """Chances of the moves after a walk; `weights` may be complex."""
        logits = self.situation(cells).phi @ weights
        chances = np.exp(logits - logits.real.max())
        return chances / chances.sum()

    def walks(self):
        done = [(self.problem.start,)]
        for _ in range(self.moves):
            done = [(*cells, to) for cells in done for to in self.situation(cells).after]
        return done

    def chance(self, walk, weights):
        product = 1.0
        for n in range(1, len(walk)):
            product *= self.shares(walk[:n], weights)[self.situation(walk[:n]).after.index(walk[n])]
        return product

    def rewards(self, walk):
        return np.array(
            [0.0 if walk[n] in walk[:n] else self.problem.score[walk[n]] / self.scale for n in range(1, len(walk))]
        )

    def scores(self, walk, weights):
        """Gradient of log pi at each move, [moves, weights], again along imaginary steps."""
        rows = []
        for n in range(1, len(walk)):
            k = self.situation(walk[:n]).after.index(walk[n])
            rows.append(derivative(lambda w, n=n, k=k: np.log(self.shares(walk[:n], w)[k]), weights))
        return np.array(rows)


def derivative(function, weights):
    """Squire and Trapp (1998): Im f(w + ih)/h, exact to rounding for analytic f."""
    step = 1e-30
    return np.array([function(weights + 1j * step * unit).imag / step for unit in np.eye(weights.size)])


def central_differences(function, weights, step=1e-5):
    units = step * np.eye(weights.size)
    return np.array([(function(weights + unit) - function(weights - unit)) / (2 * step) for unit in units])


def weights_for(layout, seed=0):
    return np.random.default_rng(seed).normal(0, 0.7, feature_count(layout))


def tiny(layout="rings", connectivity=4):
    world = World(TINY, (0, 0), MOVES, layout, connectivity)
    field = build_field(world.problem)
    return world, field, build_blocks(field, layout)


def exact_gradient(world, weights):
    return derivative(
        lambda w: sum(world.chance(walk, w) * world.rewards(walk).sum() for walk in world.walks()), weights
    )


def expected_estimate(estimator, world, weights, count):
    """The mean of an estimator over every `count` rollouts that there can be, by their chances."""
    walks = world.walks()
    chances = [world.chance(walk, weights) for walk in walks]
    rewards = np.array([world.rewards(walk) for walk in walks])
    scores = np.array([world.scores(walk, weights) for walk in walks])
    total = np.zeros(weights.size)
    for which in itertools.product(range(len(walks)), repeat=count):
        chance = np.prod([chances[i] for i in which])
        total += chance * estimator(rewards[list(which)], scores[list(which)])
    return total


@pytest.mark.parametrize(("layout", "connectivity"), KINDS)
def test_gradient_of_log_pi_agrees_with_central_differences(layout, connectivity):
    score = np.random.default_rng(2).random((8, 7))
    score[1:4, 2] = score[6, :3] = np.nan
    world = World(score, (4, 3), 14, layout, connectivity)
    field = build_field(world.problem)
    blocks = build_blocks(field, layout)
    world.scale = blocks.scale  # of the cells in reach
    weights = weights_for(layout, 1)
    paths, _ = roll_many(field, blocks, weights, 2, 7)
    rewards, scores = explore(field, blocks, weights, 2, 7)
    for i in range(2):
        walk = tuple((int(row), int(col)) for row, col in to_cells(field, paths[i]))
        np.testing.assert_allclose(rewards[i], world.rewards(walk), atol=1e-12)
        for n in range(1, len(walk)):
            k = world.situation(walk[:n]).after.index(walk[n])
            by_differences = central_differences(lambda w, n=n, k=k: np.log(world.shares(walk[:n], w)[k]), weights)  # noqa: B023
            np.testing.assert_allclose(scores[i, n - 1], by_differences, atol=2e-5)


@pytest.mark.parametrize(("layout", "connectivity"), KINDS)
def test_the_tiny_world_is_the_one_that_the_kernels_walk(layout, connectivity):
    world, field, blocks = tiny(layout, connectivity)
    weights = weights_for(layout)
    walks = world.walks()
    chances = np.array([world.chance(walk, weights) for walk in walks])
    assert chances.sum() == pytest.approx(1.0, abs=1e-12)
    assert blocks.scale == pytest.approx(world.scale)
    count = 20_000
    paths, _ = roll_many(field, blocks, weights, count, 3)
    rewards, scores = explore(field, blocks, weights, count, 3)
    seen = {}
    for i, path in enumerate(paths):
        seen.setdefault(tuple(path), []).append(i)
    found = {tuple((int(r), int(c)) for r, c in to_cells(field, np.array(path))): at for path, at in seen.items()}
    assert set(found) <= set(walks)
    for walk, chance in zip(walks, chances, strict=True):
        share = len(found.get(walk, ())) / count
        assert abs(share - chance) < 5 * np.sqrt(chance * (1 - chance) / count) + 1 / count
        if walk in found:
            np.testing.assert_allclose(rewards[found[walk][0]], world.rewards(walk), atol=1e-12)
            np.testing.assert_allclose(scores[found[walk][0]], world.scores(walk, weights), atol=2e-5)


def test_the_exact_gradient_is_that_of_the_exact_expected_reward():
    world, _, _ = tiny()
    weights = weights_for("rings")

    def expected(w):
        return sum(world.chance(walk, w) * world.rewards(walk).sum() for walk in world.walks())

    np.testing.assert_allclose(exact_gradient(world, weights), central_differences(expected, weights), atol=1e-8)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_estimators_are_unbiased_over_every_set_of_rollouts(estimator, count):
    world, _, _ = tiny()
    weights = weights_for("rings")
    exact = exact_gradient(world, weights)
    assert np.abs(exact).max() > 0.01
    expected = expected_estimate(ESTIMATORS[estimator], world, weights, count)
    np.testing.assert_allclose(expected, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_estimators_are_unbiased_with_diagonal_moves_and_the_other_features(estimator):
    world, _, _ = tiny("manjanna24", 8)
    weights = weights_for("manjanna24")
    expected = expected_estimate(ESTIMATORS[estimator], world, weights, 2)
    np.testing.assert_allclose(expected, exact_gradient(world, weights), rtol=0, atol=1e-9)


def with_its_own_rollout(estimator):
    """The same estimator with the mean over *all* rollouts as the baseline."""

    def biased(rewards, scores):
        mean = rewards.mean(axis=0)
        if estimator == "gpomdp":
            to_go = (rewards - mean)[:, ::-1].cumsum(axis=1)[:, ::-1]
            return np.einsum("it,itk->k", to_go, scores) / len(rewards)
        return np.einsum("i,itk->k", (rewards - mean).sum(axis=1), scores) / len(rewards)

    return biased


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_baseline_that_holds_its_own_rollout_would_be_noticed(estimator, count):
    world, _, _ = tiny()
    weights = weights_for("rings")
    exact = exact_gradient(world, weights)
    expected = expected_estimate(with_its_own_rollout(estimator), world, weights, count)
    np.testing.assert_allclose(expected, exact * (count - 1) / count, rtol=0, atol=1e-9)
    assert np.abs(expected - exact).max() > 1e-3


def test_a_trace_that_decays_is_biased_and_one_that_does_not_is_not():
    world, _, _ = tiny()
    weights = weights_for("rings")
    decayed = expected_estimate(lambda r, s: gpomdp_gradient(r, s, 0.5), world, weights, 2)
    assert np.abs(decayed - exact_gradient(world, weights)).max() > 1e-3


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_sampled_estimates_lie_around_the_exact_gradient(estimator, connectivity):
    world, field, blocks = tiny("rings", connectivity)
    weights = weights_for("rings")
    estimates = np.array([ESTIMATORS[estimator](*explore(field, blocks, weights, 4, 1000 + i)) for i in range(4000)])
    error = estimates.std(axis=0) / np.sqrt(len(estimates))
    exact = exact_gradient(world, weights)
    assert np.all(np.abs(estimates.mean(axis=0) - exact) < 4 * error + 1e-6)
    assert np.linalg.norm(4 * error) < 0.5 * np.linalg.norm(exact)
