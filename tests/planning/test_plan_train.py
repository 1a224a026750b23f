from __future__ import annotations

import math

import numpy as np
import pytest

from hrt_cli.artifacts.npz import write_npz
from hrt_cli.errors import ArgumentError
from hrt_cli.planning.families import FAMILIES, make_map
from hrt_cli.planning.features import build_blocks, weight_count
from hrt_cli.planning.planner import plan
from hrt_cli.planning.policy import Policy
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.train import TrainSpec, _map_seeds, _try_map, explore, first_weights, gpomdp_gradient, train
from hrt_cli.planning.walk import build_field

MOVES = 3


def tiny_world():
    score = np.array([[0.2, 1.0, 0.1], [0.6, 0.3, np.nan], [0.0, 0.9, 0.5]])
    field = build_field(Problem(score, (1, 1), Budget(float(MOVES))))
    return field, build_blocks(field, "rings")


def test_baseline_of_the_other_rollouts_lowers_the_variance():
    field, blocks = tiny_world()
    weights = np.zeros(weight_count("rings"))
    with_baseline, without = [], []
    for batch in range(300):
        rewards, scores = explore(field, blocks, weights, 8, batch)
        with_baseline.append(gpomdp_gradient(rewards, scores))
        to_go = rewards[:, ::-1].cumsum(axis=1)[:, ::-1]
        without.append(np.einsum("it,itk->k", to_go, scores) / 8)
    assert np.var(with_baseline, axis=0).sum() < 0.8 * np.var(without, axis=0).sum()


SMALL = {"maps_per_iteration": 4, "rollouts": 8, "map_side": 20, "moves": 40}


@pytest.mark.parametrize("estimator", ["gpomdp", "reinforce"])
def test_training_learns_and_repeats_itself(estimator):
    spec = TrainSpec(estimator=estimator, iterations=40, **SMALL)
    maps = [make_map("gaussians", (20, 20), np.random.default_rng(i)) for i in range(4)]
    policy, curve = train(spec, maps)
    again, curve_again = train(spec, maps)
    np.testing.assert_array_equal(policy.weights, again.weights)
    np.testing.assert_array_equal(curve, curve_again)
    assert curve[-10:].mean() > 2.0 * curve[0]
    assert policy.recipe["estimator"] == estimator
    assert policy.recipe["families"] == ",".join(FAMILIES)


def test_the_optimiser_is_adam_with_a_step_that_falls_to_a_tenth():
    spec = TrainSpec(iterations=5, learning_rate=0.3, **SMALL)
    states = []
    policy, curve = train(spec, keep=states.append)
    weights, first, second = first_weights(spec.layout, spec.seed), 0.0, 0.0
    for t in range(1, 6):
        tried = [_try_map(spec, None, weights, seed) for seed in _map_seeds(spec, t - 1)]
        gradient = sum(each[0] for each in tried) / spec.maps_per_iteration
        assert curve[t - 1] == pytest.approx(sum(each[1] for each in tried) / spec.maps_per_iteration)
        first, second = 0.9 * first + 0.1 * gradient, 0.99 * second + 0.01 * gradient**2
        rate = 0.3 * (0.1 + 0.9 * (1 + math.cos(math.pi * (t - 1) / 5)) / 2)
        weights = weights + rate * (first / (1 - 0.9**t)) / (np.sqrt(second / (1 - 0.99**t)) + 1e-8)
        np.testing.assert_allclose(states[t - 1].weights, weights, rtol=1e-9, atol=1e-12)
        weights = states[t - 1].weights
    np.testing.assert_array_equal(policy.weights, weights)


def test_same_seed_writes_the_same_bytes(tmp_path):
    for name in ("first", "second"):
        policy, _ = train(TrainSpec(iterations=3, **SMALL))
        write_npz(tmp_path / name, policy.to_arrays())
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


def test_training_on_given_maps_and_the_other_layout():
    maps = [make_map("gaussians", (15, 15), np.random.default_rng(i)) for i in range(3)]
    done = []
    policy, curve = train(TrainSpec(iterations=3, layout="manjanna24", **SMALL), maps, lambda i, n: done.append((i, n)))
    assert policy.weights.shape == (15,)
    assert policy.recipe["maps"] == 3
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert np.isfinite(curve).all()
    assert plan(Problem(maps[0], (2, 2), Budget(20.0)), "policy", [policy]).score > 0


@pytest.mark.parametrize(
    "change",
    [
        {"estimator": "ppo"},
        {"layout": "hexagons"},
        {"families": ("moon",)},
        {"families": ()},
        {"rollouts": 1},
        {"iterations": 0},
        {"moves": 0},
        {"seed": -1},
        {"trace_decay": 0.0},
        {"trace_decay": float("nan")},
        {"learning_rate": float("inf")},
        {"eight": 1.5},
    ],
)
def test_bad_hyper_parameters_are_refused(change):
    with pytest.raises(ArgumentError):
        TrainSpec(**change)


def test_a_map_without_a_place_to_start_is_refused():
    with pytest.raises(ArgumentError, match="no cell"):
        train(TrainSpec(iterations=1, **SMALL), [np.full((5, 5), np.nan)])


@pytest.mark.parametrize("family", FAMILIES)
def test_families_are_seeded_and_in_range(family):
    first, again = (make_map(family, (24, 33), np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.shape == (24, 33)
    free = first[~np.isnan(first)]
    assert free.size > 0.5 * first.size
    assert free.min() >= 0.0
    assert free.max() <= 1.0
    assert make_map(family, (4, 5), np.random.default_rng(1)).shape == (4, 5)


def test_an_untrained_policy_walks_at_random():
    policy = Policy(np.zeros(40), "rings")
    found = plan(Problem(np.ones((9, 9)), (4, 4), Budget(30.0)), "policy-sample", [policy], samples=4)
    assert len(found.cells) == 31
