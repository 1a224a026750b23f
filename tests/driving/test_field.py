"""The cheapest ways over a cost map, against SciPy's Dijkstra, and what is made of a site."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import lil_array
from scipy.sparse.csgraph import dijkstra
from world_files import ground_site

from hrt_cli.driving.field import cost_map, follow, is_clear, march_to, ways_to

CELL_M = 0.2
EIGHT = [step for step in itertools.product((-1, 0, 1), repeat=2) if step != (0, 0)]


def random_cost(seed: int, rows: int, cols: int, blocked: float) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    cost = rng.uniform(1.0, 8.0, (rows, cols)).astype(np.float32)
    cost[rng.random(cost.shape) < blocked] = np.inf
    return cost


def ways(cost: NDArray[np.float32], to: tuple[int, int], until=(-1, -1), limit=math.inf) -> NDArray[np.float32]:
    out = np.empty_like(cost)
    ways_to(cost, CELL_M, *to, *until, limit, out)
    return out


def moves(cost: NDArray[np.float32], row: int, col: int) -> list[tuple[int, int]]:
    """Free cells that a free cell leads to: a diagonal passes no blocked corner."""
    found = []
    for dr, dc in EIGHT:
        r, c = row + dr, col + dc
        if not (0 <= r < cost.shape[0] and 0 <= c < cost.shape[1]) or np.isinf(cost[r, c]):
            continue
        if not (np.isinf(cost[row, c]) or np.isinf(cost[r, col])):
            found.append((r, c))
    return found


def by_scipy(cost: NDArray[np.float32], to: tuple[int, int]) -> NDArray[np.float64]:
    rows, cols = cost.shape
    graph = lil_array((cost.size, cost.size))
    for row, col in np.argwhere(np.isfinite(cost)):
        for r, c in moves(cost, row, col):
            length = CELL_M * math.hypot(r - row, c - col)
            graph[row * cols + col, r * cols + c] = 0.5 * (cost[row, col] + cost[r, c]) * length
    return dijkstra(graph.tocsr(), indices=to[0] * cols + to[1]).reshape(rows, cols)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 9999), rows=st.integers(1, 9), cols=st.integers(1, 9), blocked=st.sampled_from([0, 0.2, 0.5])
)
def test_costs_are_those_of_dijkstra(seed: int, rows: int, cols: int, blocked: float) -> None:
    cost = random_cost(seed, rows, cols, blocked)
    free = np.argwhere(np.isfinite(cost))
    if not len(free):
        return
    to = tuple(map(int, free[seed % len(free)]))
    np.testing.assert_allclose(ways(cost, to), by_scipy(cost, to), rtol=1e-4)


def march(cost: NDArray[np.float32], to: tuple[int, int], until=(-1, -1), limit=math.inf, margin=0.0):
    out = np.empty_like(cost)
    return march_to(cost, CELL_M, *to, *until, limit, margin, out), out


def test_a_march_over_level_ground_is_as_the_crow_flies() -> None:
    _, found = march(np.full((61, 61), 2.0, np.float32), (30, 30))
    row, col = np.mgrid[:61, :61] - 30
    away = 2.0 * CELL_M * np.hypot(row, col)
    far = np.hypot(row, col) >= 5
    error = (found - away)[far] / away[far]
    assert error.min() > -1e-5
    assert error.max() < 0.01
    assert (by_scipy(np.ones((61, 61), np.float32), (30, 30))[far] * 2 / away[far]).max() > 1.08


def test_a_march_round_a_wall_takes_the_shortest_way() -> None:
    cost = np.ones((41, 41), np.float32)
    cost[20, 5:36] = np.inf
    _, found = march(cost, (10, 20))
    shortest = CELL_M * (math.hypot(10, 16) + math.hypot(10, 16))  # round the wall's end, to the mirrored place
    assert shortest <= found[30, 20] < 1.06 * shortest
    assert np.isinf(found[20, 5:36]).all()


@settings(max_examples=40)
@given(seed=st.integers(0, 9999), blocked=st.sampled_from([0, 0.2, 0.5]))
def test_a_march_gets_where_four_neighbours_lead_and_is_never_longer(seed: int, blocked: float) -> None:
    cost = random_cost(seed, 12, 14, blocked)
    free = np.argwhere(np.isfinite(cost))
    to = tuple(map(int, free[seed % len(free)]))
    _, found = march(cost, to)
    pieces, _ = ndimage.label(np.isfinite(cost))
    np.testing.assert_array_equal(np.isfinite(found), pieces == pieces[to])
    least = np.nanmin(np.where(np.isfinite(cost), cost, np.nan))
    away = CELL_M * np.hypot(*(np.indices(cost.shape) - np.array(to)[:, None, None]))
    reached = np.isfinite(found)
    assert (found[reached] >= least * away[reached] * (1 - 1e-5)).all()
    # Along rows and columns alone, each step at the cost of where it leads, it is no shorter.
    steps = lil_array((cost.size, cost.size))
    for row, col in np.argwhere(np.isfinite(cost)):
        for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            r, c = row + dr, col + dc
            if 0 <= r < cost.shape[0] and 0 <= c < cost.shape[1] and np.isfinite(cost[r, c]):
                steps[row * cost.shape[1] + col, r * cost.shape[1] + c] = CELL_M * cost[r, c]
    by_steps = dijkstra(steps.tocsr(), indices=to[0] * cost.shape[1] + to[1]).reshape(cost.shape)
    assert (found[reached] <= by_steps[reached] + 8.0 * 3 * CELL_M).all()


def test_a_march_ends_at_its_limit_and_beyond_what_was_asked_for_at_its_margin() -> None:
    cost = np.ones((9, 60), np.float32)
    asked, found = march(cost, (4, 5), (4, 20), margin=0.5)
    assert asked == pytest.approx(3.0, rel=0.01)
    assert np.isfinite(found[4, 22])
    assert np.isinf(found[4, 25])
    for to in ((4, 8), (4, 30)):  # among the straight ways of the beginning, and beyond
        assert math.isinf(march(cost, (4, 5), to, limit=0.5)[0])


def test_a_march_ends_in_a_robot_on_blocked_ground() -> None:
    cost = np.ones((31, 31), np.float32)
    cost[13:18, 13:18] = np.inf
    cost[14, 15] = 1.0
    cost[13, 15] = 1.0
    asked, found = march(cost, (5, 15), (15, 15))
    assert math.isfinite(asked)
    assert np.isinf(found[16, 15])


@settings(max_examples=40)
@given(seed=st.integers(0, 9999), blocked=st.sampled_from([0.1, 0.3]))
def test_following_leads_down_to_the_place(seed: int, blocked: float) -> None:
    cost = random_cost(seed, 10, 12, blocked)
    free = [tuple(map(int, each)) for each in np.argwhere(np.isfinite(cost))]
    to = free[seed % len(free)]
    to_go = ways(cost, to)
    for cell in free:
        if np.isinf(to_go[cell]):
            assert follow(to_go, cost, *cell, 5) == cell
            continue
        at = cell
        for _ in range(len(free)):
            nxt = follow(to_go, cost, *at, 1)
            if nxt == at:
                break
            assert nxt in moves(cost, *at)
            assert to_go[nxt] < to_go[at]
            at = nxt
        assert at == to
        assert follow(to_go, cost, *cell, 1000) == to


def test_the_search_ends_at_what_was_asked_for_and_at_its_limit() -> None:
    cost = np.ones((1, 50), np.float32)
    to_go = np.empty_like(cost)
    assert ways_to(cost, CELL_M, 0, 0, 0, 10, math.inf, to_go) == pytest.approx(2.0, rel=1e-5)
    assert np.isinf(to_go[0, 12:]).all()
    assert math.isinf(ways_to(cost, CELL_M, 0, 0, 0, 49, 3.0, to_go))
    assert np.isfinite(to_go[0, :15]).all()


def test_a_robot_on_blocked_ground_finds_out_of_it() -> None:
    cost = np.ones((9, 9), np.float32)
    cost[4, 4] = np.inf
    to_go = np.empty_like(cost)
    assert math.isfinite(ways_to(cost, CELL_M, 0, 4, 4, 4, math.inf, to_go))
    assert follow(to_go, cost, 4, 4, 1) != (4, 4)


@settings(max_examples=60)
@given(seed=st.integers(0, 9999), a=st.tuples(st.floats(0.01, 1.99), st.floats(0.01, 1.99)), b=st.integers(0, 99))
def test_a_clear_way_crosses_no_blocked_cell(seed: int, a: tuple[float, float], b: int) -> None:
    cost = random_cost(seed, 10, 10, 0.1)
    end = ((b % 10 + 0.5) * CELL_M, (b // 10 + 0.5) * CELL_M)
    steps = np.linspace(0, 1, 2001)
    cells = {
        (int((a[1] + k * (end[1] - a[1])) / CELL_M), int((a[0] + k * (end[0] - a[0])) / CELL_M)) for k in steps
    } - {(int(a[1] / CELL_M), int(a[0] / CELL_M))}
    through = [cell for cell in cells if np.isinf(cost[cell])]
    found = is_clear(cost, CELL_M, *a, *end)
    if not through:
        assert found
    elif found:  # it samples: a corner may be cut by less than a quarter of a cell
        for cell in through:
            inside = [
                k for k in steps
                if (int((a[1] + k * (end[1] - a[1])) / CELL_M), int((a[0] + k * (end[0] - a[0])) / CELL_M)) == cell
            ]  # fmt: skip
            assert (inside[-1] - inside[0]) * math.dist(a, end) <= 0.25 * CELL_M + 1e-3


def test_a_way_off_the_map_is_not_clear() -> None:
    cost = np.ones((10, 10), np.float32)
    assert is_clear(cost, CELL_M, 1.0, 1.0, 1.9, 0.1)
    assert not is_clear(cost, CELL_M, 1.0, 1.0, 2.1, 1.0)
    assert not is_clear(cost, CELL_M, 1.0, 1.0, -0.1, 1.0)


def test_what_a_site_costs() -> None:
    obstacle = np.zeros((100, 120), np.bool_)
    obstacle[40:60, 50:60] = True
    factor = np.ones(obstacle.shape, np.float32)
    factor[:, 90:] = 0.5
    factor[80:, :30] = 0.0
    seen = np.ones(obstacle.shape, np.bool_)
    seen[:, 110:] = False
    made = cost_map(ground_site(obstacle, factor=factor, seen=seen), 0.35)
    assert made.cell_m == pytest.approx(0.2)
    assert made.cost.shape == (50, 60)
    assert made.cost.dtype == np.float32
    assert made.passable(2.0, 2.0)
    assert not made.passable(5.5, 5.0), "in an obstacle"
    assert not made.passable(6.2, 5.0), "nearer to it than the radius"
    assert made.passable(6.8, 5.0)
    assert not made.passable(1.5, 9.0), "on ground on which it stands still"
    assert not made.passable(10.9, 2.0), "at the rim of the survey"
    assert not made.passable(11.5, 2.0)
    assert not made.passable(0.1, 2.0), "at the edge of the raster"
    near, far = made.cost[made.cell(6.8, 5.0)], made.cost[made.cell(8.5, 5.0)]
    assert near > far == pytest.approx(1.0, abs=0.05)
    assert made.cost[made.cell(9.9, 5.0)] >= 2 * far - 1e-3
    assert made.cell(-5.0, 500.0) == (49, 0)


def test_an_odd_number_of_pixels_is_covered() -> None:
    made = cost_map(ground_site(np.zeros((31, 33), np.bool_)), 0.35)
    assert made.cost.shape == (16, 17)
    assert np.isinf(made.cost[-1]).all()
    assert np.isinf(made.cost[:, -1]).all()
    assert np.isfinite(made.cost[5:10, 5:10]).all()
