from __future__ import annotations

import itertools

import numpy as np
import pytest

from hrt_cli.artifacts.npz import write_npz
from hrt_cli.errors import ArgumentError
from hrt_cli.planning.families import FAMILIES, make_map
from hrt_cli.planning.features import build_blocks, feature_count
from hrt_cli.planning.planner import plan
from hrt_cli.planning.policy import Policy
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.train import TrainSpec, explore, gpomdp_gradient, reinforce_gradient, train
from hrt_cli.planning.walk import build_field

MOVES = 3


def tiny_world():
    score = np.array([[0.2, 1.0, 0.1], [0.6, 0.3, np.nan], [0.0, 0.9, 0.5]])
    field = build_field(Problem(score, (1, 1), Budget(float(MOVES))))
    return field, build_blocks(field, "rings")


def exact_gradient(field, blocks, weights):
    """Gradient of the expected reward from the distribution over all walks, collected by sampling each once."""

    def expected(w):
        rewards, chance = walks_with_chances(field, blocks, w)
        return float(chance @ rewards.sum(axis=1))

    step = 1e-4
    unit = np.eye(weights.size)
    return np.array([(expected(weights + step * e) - expected(weights - step * e)) / (2 * step) for e in unit])


def walks_with_chances(field, blocks, weights):
    """Rewards and chances of every walk, from a plain softmax over features read off `explore`'s gradients."""
    phi, reward = feature_table(field, blocks)
    rewards, chances = [], []
    for walk in itertools.product(range(4), repeat=MOVES):
        if walk not in reward:
            continue
        chance = 1.0
        for t in range(MOVES):
            rows = phi[walk[:t]]
            logits = {a: rows[a] @ weights for a in rows}
            top = max(logits.values())
            total = sum(np.exp(v - top) for v in logits.values())
            chance *= np.exp(logits[walk[t]] - top) / total
        rewards.append(reward[walk])
        chances.append(chance)
    return np.array(rewards), np.array(chances)


def feature_table(field, blocks, memo={}):  # noqa: B006
    """Features (up to a common shift) of each action after each prefix, and rewards of each walk."""
    if memo:
        return memo["phi"], memo["reward"]
    from hrt_cli.planning.policy import roll_many

    zero = np.zeros(feature_count("rings"))
    paths, _ = roll_many(field, blocks, zero, 3000, 1)
    rewards, scores = explore(field, blocks, zero, 3000, 1)
    phi, reward = {}, {}
    offsets = field.offsets.tolist()
    for i in range(len(paths)):
        walk = tuple(offsets.index(int(step)) for step in np.diff(paths[i]))
        reward[walk] = rewards[i]
        for t in range(MOVES):
            phi.setdefault(walk[:t], {})[walk[t]] = scores[i, t]
    memo.update(phi=phi, reward=reward)
    return phi, reward


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("estimator", ["gpomdp", "reinforce"])
def test_gradient_estimates_agree_with_exact_enumeration(estimator, seed):
    field, blocks = tiny_world()
    weights = np.random.default_rng(seed).normal(0, 0.5, feature_count("rings"))
    _, chances = walks_with_chances(field, blocks, weights)
    assert chances.sum() == pytest.approx(1.0, abs=1e-9)
    exact = exact_gradient(field, blocks, weights)
    estimates = []
    for batch in range(4000):
        sample = explore(field, blocks, weights, 4, 1000 + batch)
        estimates.append(gpomdp_gradient(*sample) if estimator == "gpomdp" else reinforce_gradient(*sample))
    mean = np.mean(estimates, axis=0)
    error = np.std(estimates, axis=0) / np.sqrt(len(estimates))
    assert np.all(np.abs(mean - exact) < 5 * error + 1e-6)
    assert np.linalg.norm(mean - exact) < 0.12 * np.linalg.norm(exact)


def test_baseline_of_the_other_rollouts_lowers_the_variance():
    field, blocks = tiny_world()
    weights = np.zeros(feature_count("rings"))
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
    policy, curve = train(spec)
    again, curve_again = train(spec)
    np.testing.assert_array_equal(policy.weights, again.weights)
    np.testing.assert_array_equal(curve, curve_again)
    assert curve[-10:].mean() > 1.3 * curve[:5].mean()
    assert policy.recipe["estimator"] == estimator
    assert policy.recipe["families"] == ",".join(FAMILIES)


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
    assert plan(Problem(maps[0], (2, 2), Budget(20.0)), "policy", policy).score > 0


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
    policy = Policy(np.zeros(40))
    found = plan(Problem(np.ones((9, 9)), (4, 4), Budget(30.0)), "policy-sample", policy, samples=4)
    assert len(found.cells) == 31
