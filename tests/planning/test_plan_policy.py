from __future__ import annotations

import io
import math
from dataclasses import replace

import numpy as np
import pytest

from hrt_cli.planning.features import LAYOUTS, build_blocks, weight_count
from hrt_cli.planning.policy import Policy, default_policies, roll_best, roll_many
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.train import explore
from hrt_cli.planning.walk import build_field, to_cells

RING = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)]


def block_mean(grid, row, col, size, outside):
    half = size // 2
    total = 0.0
    for r in range(row - half, row + half + 1):
        for c in range(col - half, col + half + 1):
            inside = 0 <= r < grid.shape[0] and 0 <= c < grid.shape[1]
            total += grid[r, c] if inside else outside
    return total / size**2


def region_means(remaining, free, row, col):
    means = []
    for dr, dc in RING:
        rows = {-1: range(row - 4), 0: range(max(row - 4, 0), row + 5), 1: range(row + 5, len(free))}[dr]
        cols = {-1: range(col - 4), 0: range(max(col - 4, 0), col + 5), 1: range(col + 5, len(free[0]))}[dc]
        cells = [(r, c) for r in rows for c in cols if 0 <= r < len(free) and 0 <= c < len(free[0])]
        count = sum(bool(free[cell]) for cell in cells)
        means.append(sum(remaining[cell] for cell in cells) / count if count else 0.0)
    return means


def trail_rings(score_rings, cells, n):
    """Logarithms of the mean scores, visited cells around, and the way of the last move."""
    row, col = cells[n - 1]
    rings = [[1 + math.log(max(mean, 0.0) + 1e-3) / math.log(1000) for mean in ring] for ring in score_rings]
    rings.append([float((row + dr, col + dc) in cells[:n]) for dr, dc in RING])
    step = (row - cells[n - 2][0], col - cells[n - 2][1]) if n > 1 else None
    rings.append([float(step == direction) for direction in RING])
    return rings


def pull_of_the_rest(remaining, row, col, in_sight):
    """Each direction's share of the scores over their squared distances, where next to nothing is in sight."""
    pull = np.zeros(8)
    if in_sight >= 1e-3:
        return pull
    for i in range(-20, 21):
        for j in range(-20, 21):
            score = 81 * block_mean(remaining, row + 9 * i, col + 9 * j, 9, 0.0)
            if score > 1e-3 and (i, j) != (0, 0):
                down = int(np.sign(i)) if abs(i) > abs(j) / 2 else 0
                right = int(np.sign(j)) if abs(j) > abs(i) / 2 else 0
                pull[RING.index((down, right))] += score / (i * i + j * j)
    return pull / pull.sum() if pull.any() else pull


def features_by_hand(problem, layout, scale, cells, n, heading):
    """The tied features after the first n cells of a walk of equally long moves, straight from the definition."""
    free = ~np.isnan(problem.score)
    remaining = np.where(free, np.nan_to_num(problem.score), 0.0) / scale
    for cell in cells[:n]:
        remaining[cell] = 0.0
    row, col = cells[n - 1]
    sizes = (1, 3) if layout == "manjanna24" else (1, 3, 9, 27)
    rings = [[block_mean(remaining, row + s * dr, col + s * dc, s, 0.0) for dr, dc in RING] for s in sizes]
    if layout != "manjanna24":
        blocked = 1.0 - free
        score_rings = rings
        rings = rings + [[block_mean(blocked, row + s * dr, col + s * dc, s, 1.0) for dr, dc in RING] for s in sizes]
    else:
        rings.append(region_means(remaining, free, row, col))
    if layout == "network":
        rings += trail_rings(score_rings, cells, n)
        for size, away in ((1, 2), (3, 1), (9, 4)):
            rings.append([block_mean(remaining, row + away * dr, col + away * dc, size, 0.0) for dr, dc in RING])
        rings.append(pull_of_the_rest(remaining, row, col, sum(score_rings[-1])))
    tied = []
    for ring in rings:
        tied.append(ring[heading])
        tied += [ring[(heading + k) % 8] + ring[(heading - k) % 8] for k in (1, 2, 3)]
        tied.append(ring[(heading + 4) % 8])
    if layout == "network":
        tied += [1.0 - (n - 1) / problem.limit, 1.0]
    return np.array(tied)


def logit_and_slope(weights, features):
    """The preference of a move from its features, and its gradient by the weights."""
    linear, *hinges = weights.reshape(-1, features.size)
    signs = [1.0 if h < len(hinges) / 2 else -1.0 for h in range(len(hinges))]
    active = [sign * (hinge @ features > 0.0) for sign, hinge in zip(signs, hinges, strict=True)]
    logit = linear @ features + sum(a * (hinge @ features) for a, hinge in zip(active, hinges, strict=True))
    return logit, np.concatenate([features, *(a * features for a in active)])


def near_world():
    score = np.random.default_rng(2).random((17, 14))
    score[3:9, 5] = score[12, :6] = np.nan
    return Problem(score, (8, 7), Budget(60.0))


def far_world():
    score = np.zeros((60, 75))
    score[:9, 60:] = score[50:, 70:] = 1.0
    return Problem(score, (55, 3), Budget(200.0))


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("world", [near_world, far_world])
def test_gradient_of_log_pi_equals_the_definition(layout, connectivity, world):
    problem = replace(world(), connectivity=connectivity)
    score = problem.score
    field = build_field(problem)
    blocks = build_blocks(field, layout)
    weights = np.random.default_rng(1).normal(0, 0.3, weight_count(layout))
    paths, lengths = roll_many(field, blocks, weights, 1, 7)
    rewards, scores = explore(field, blocks, weights, 1, 7)
    cells = [tuple(int(x) for x in cell) for cell in to_cells(field, paths[0, : lengths[0]])]
    actions = RING[::2] if connectivity == 4 else RING
    for n in range(1, min(len(cells), 40)):
        logits, slopes, allowed = [], [], []
        for a, (dr, dc) in enumerate(actions):
            after = (cells[n - 1][0] + dr, cells[n - 1][1] + dc)
            inside = 0 <= after[0] < score.shape[0] and 0 <= after[1] < score.shape[1]
            allowed.append(inside and not math.isnan(score[after]))
            phi = features_by_hand(problem, layout, blocks.scale, cells, n, a * 8 // len(actions))
            logit, slope = logit_and_slope(weights, phi)
            logits.append(logit)
            slopes.append(slope)
        logits, slopes = np.where(allowed, logits, -np.inf), np.array(slopes)
        share = np.exp(logits - logits.max())
        share /= share.sum()
        step = (cells[n][0] - cells[n - 1][0], cells[n][1] - cells[n - 1][1])
        expected = slopes[actions.index(step)] - share @ slopes
        np.testing.assert_allclose(scores[0, n - 1], expected, atol=2e-5)
        gain = score[cells[n]] / blocks.scale if cells[n] not in cells[:n] else 0.0
        assert rewards[0, n - 1] == pytest.approx(gain)


def test_actions_are_drawn_with_their_softmax_shares():
    score = np.zeros((5, 5))
    score[2, 3] = 1.0
    field = build_field(Problem(score, (2, 2), Budget(1.0)))
    weights = np.zeros(weight_count("rings"))
    weights[0] = 1.0
    paths, _ = roll_many(field, build_blocks(field, "rings"), weights, 4000, 3)
    share = np.mean(paths[:, 1] == field.start + 1)
    ahead = math.exp(1.0 / build_blocks(field, "rings").scale)
    assert share == pytest.approx(ahead / (ahead + 3.0), abs=0.03)


@pytest.mark.parametrize("policy", default_policies(), ids=lambda policy: policy.layout)
def test_policy_turns_and_mirrors_with_the_map(policy):
    score = np.random.default_rng(5).random((31, 31))

    def walk(grid):
        field = build_field(Problem(grid, (15, 15), Budget(60.0)))
        return to_cells(field, roll_best(field, build_blocks(field, policy.layout), policy.weights, 0))

    plain = walk(score)
    np.testing.assert_array_equal(walk(score[::-1].copy()), plain * [1, 1] * [-1, 1] + [30, 0])
    np.testing.assert_array_equal(walk(score.T.copy()), plain[:, ::-1])


@pytest.mark.parametrize("policy", default_policies(), ids=lambda policy: policy.layout)
def test_rolling_leaves_the_blocks_as_they_were(policy):
    field = build_field(Problem(np.random.default_rng(0).random((20, 20)), (3, 3), Budget(50.0)))
    blocks = build_blocks(field, policy.layout)
    before = blocks.sums.copy()
    roll_many(field, blocks, policy.weights, 3, 0)
    np.testing.assert_array_equal(blocks.sums, before)


def test_arrays_round_trip_through_an_npz_without_objects():
    policy = Policy(np.arange(40.0), "rings", {"seed": 3, "learning_rate": 0.5, "families": "a,b"})
    buffer = io.BytesIO()
    np.savez(buffer, **policy.to_arrays())
    buffer.seek(0)
    with np.load(buffer, allow_pickle=False) as arrays:
        again = Policy.from_arrays(dict(arrays))
    np.testing.assert_array_equal(again.weights, policy.weights)
    assert again.layout == policy.layout
    assert again.recipe == policy.recipe


@pytest.mark.parametrize(
    "change",
    [
        {"weights": None},
        {"layout": np.array("spiral")},
        {"layout": np.array(3)},
        {"weights": np.zeros(39)},
        {"weights": np.zeros(40, np.float32)},
        {"weights": np.full(40, np.nan)},
        {"weights": np.zeros((40, 1))},
        {"recipe_names": np.array(["a", "b"])},
        {"recipe_names": np.array([1])},
        {"recipe_values": np.array(["float:x"])},
        {"recipe_values": np.array(["bytes:1"])},
    ],
)
def test_arrays_that_are_no_policy_are_refused(change):
    arrays = {**Policy(np.zeros(40), "rings", {"seed": 1}).to_arrays(), **change}
    arrays = {name: value for name, value in arrays.items() if value is not None}
    with pytest.raises(ValueError, match=r"policy|weights|layout|float"):
        Policy.from_arrays(arrays)


def test_default_policies_are_trained():
    for policy in default_policies():
        assert policy.weights.any()
        assert policy.recipe["maps"] == "generated"
        assert policy.recipe["iterations"] >= 100
