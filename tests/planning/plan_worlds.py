"""Plain-Python twins of the planner's notions, and random worlds to try them on."""

from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import strategies as st

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.problem import Budget, Problem

STEPS_4 = [(0, 1), (1, 0), (0, -1), (-1, 0)]
STEPS_8 = [*STEPS_4, (1, 1), (1, -1), (-1, 1), (-1, -1)]
SLACK = 1e-6


def steps_of(problem):
    return STEPS_8 if problem.connectivity == 8 else STEPS_4


def cost_of(problem, a, b):
    step = (b[0] - a[0], b[1] - a[1])
    assert step in steps_of(problem), f"{a} -> {b} is no move"
    return problem.budget.diagonal_cost if step[0] and step[1] and problem.connectivity == 8 else 1.0


def total_score(problem, cells):
    return sum(float(problem.score[cell]) for cell in set(cells))


def discounted_score(problem, cells):
    seen, total = set(), 0.0
    for t, cell in enumerate(cells):
        if cell not in seen:
            seen.add(cell)
            total += problem.gamma**t * float(problem.score[cell])
    return total


def is_open(problem, cell):
    rows, cols = problem.score.shape
    return 0 <= cell[0] < rows and 0 <= cell[1] < cols and not math.isnan(problem.score[cell])


def optimum(problem):
    """The best value of any walk within the budget, by exhaustive search over (cell, visited set).

    A walk of counted moves makes them all; without an end that is no matter, for it may go on for nothing.
    """
    discounted = problem.objective == "discounted"
    start = problem.start
    states = {(start, frozenset([start]), 0.0): float(problem.score[start])}
    shortest = all_moves(problem) if problem.counts_moves and problem.end is not None else 0
    best = float(problem.score[start]) if shortest == 0 else 0.0
    t = 0
    while states:
        t += 1
        after = {}
        for (cell, seen, spent), value in states.items():
            for dr, dc in steps_of(problem):
                to = (cell[0] + dr, cell[1] + dc)
                if not is_open(problem, to):
                    continue
                cost = round(spent + cost_of(problem, cell, to), 9)
                if cost > problem.limit + 1e-9:
                    continue
                gain = 0.0 if to in seen else float(problem.score[to]) * (problem.gamma**t if discounted else 1)
                key = (to, seen | {to}, cost)
                after[key] = max(after.get(key, -1.0), value + gain)
        for (cell, _, _), value in after.items():
            if problem.end in (None, cell) and t >= shortest:
                best = max(best, value)
        states = after
    return best


def collectable(problem):
    """Every set of cells that some walk within the budget visits."""
    states = {(problem.start, frozenset([problem.start]), 0.0)}
    found = {frozenset([problem.start])}
    while states:
        after = set()
        for cell, seen, spent in states:
            for dr, dc in steps_of(problem):
                to = (cell[0] + dr, cell[1] + dc)
                if is_open(problem, to):
                    cost = round(spent + cost_of(problem, cell, to), 9)
                    if cost <= problem.limit + 1e-9:
                        after.add((to, seen | {to}, cost))
        found |= {seen for _, seen, _ in after}
        states = after
    return found


def walk_to_the_end_exists(problem, moves):
    """Whether a walk of exactly `moves` moves leads from the start to the end."""
    layer = {problem.start}
    for _ in range(moves):
        layer = {
            (r + dr, c + dc) for r, c in layer for dr, dc in steps_of(problem) if is_open(problem, (r + dr, c + dc))
        }
    return problem.end in layer


def all_moves(problem):
    """How many moves a walk of counted moves makes: all, or one less where the end wants it."""
    moves = int(problem.limit)
    return moves - 1 if problem.end is not None and not walk_to_the_end_exists(problem, moves) else moves


def end_is_near(problem):
    """Whether the end can be reached within the budget, by relaxing every move until nothing changes."""
    cost = {problem.start: 0.0}
    changed = True
    while changed:
        changed = False
        for (r, c), so_far in list(cost.items()):
            for dr, dc in steps_of(problem):
                to = (r + dr, c + dc)
                if is_open(problem, to):
                    reached = so_far + cost_of(problem, (r, c), to)
                    if reached < cost.get(to, math.inf) - 1e-12:
                        cost[to] = reached
                        changed = True
    return cost.get(problem.end, math.inf) <= problem.limit + 1e-9


def check_walk(problem, cells):
    """The laws of every walk: start, neighbours, no-go, budget, end."""
    cells = [(int(r), int(c)) for r, c in cells]
    assert cells[0] == problem.start
    assert all(is_open(problem, cell) for cell in cells)
    cost = sum(cost_of(problem, a, b) for a, b in itertools.pairwise(cells))
    if problem.end is not None:
        assert cells[-1] == problem.end
    if problem.counts_moves:
        assert len(cells) == all_moves(problem) + 1
    else:
        assert cost <= problem.limit + SLACK
        assert_no_more_fits(problem, cells, problem.limit - cost)
    return cells


def assert_no_more_fits(problem, cells, left):
    end = cells[-1]
    near = [(end[0] + dr, end[1] + dc) for dr, dc in steps_of(problem)]
    least = min(cost_of(problem, end, cell) for cell in near if is_open(problem, cell))
    assert left < least * (1.0 if problem.end is None else 2.0) + SLACK


@st.composite
def worlds(draw, most_side=9, most_moves=30, most_cells=1000):
    """Random problems of every kind; walled-in starts are passed over."""
    rows = draw(st.integers(1, most_side))
    cols = draw(st.integers(1, max(1, min(most_side, most_cells // rows))))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    score = rng.random((rows, cols)) * draw(st.sampled_from([0.0, 1.0, 1.0, 1.0, 40.0]))
    if draw(st.booleans()):
        score = np.round(score * 2) / 2
    score[rng.random((rows, cols)) < draw(st.sampled_from([0.0, 0.1, 0.3]))] = np.nan
    limit = draw(st.integers(1, most_moves)) + draw(st.sampled_from([0.0, 0.0, 0.4]))
    budget = Budget(limit, draw(st.sampled_from([1.0, 1.0, math.sqrt(2)])))
    kind = {
        "connectivity": draw(st.sampled_from([4, 8])),
        "objective": draw(st.sampled_from(["total", "discounted"])),
        "gamma": draw(st.sampled_from([0.8, 0.99, 1.0])),
    }
    ending = draw(st.sampled_from(["anywhere", "anywhere", "home", "home", "elsewhere"]))
    free = np.argwhere(~np.isnan(score))
    for index in rng.permutation(len(free)):
        start = (int(free[index, 0]), int(free[index, 1]))
        other = tuple(int(x) for x in free[rng.integers(len(free))])
        end = {"anywhere": None, "home": start, "elsewhere": other}[ending]
        try:
            found = Problem(score, start, budget, end=end, **kind)
        except ArgumentError:
            continue
        if end is None or end_is_near(found):
            return found
    return Problem(np.ones((2, 2)), (0, 0), Budget(2.0))
