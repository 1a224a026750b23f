from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_samples import LAWNMOWER, ZIGZAG, cells_of, sample_plan, turn_steps

from hrt_cli.artifacts.plan import Cell
from hrt_cli.missions.mission import MissionOptions, mission_of
from hrt_cli.missions.simplify import entered, simplified, visited

MOVES = [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]
SIDE = 24


@st.composite
def walks(draw: st.DrawFn) -> tuple[list[Cell], np.ndarray]:
    """A walk inside a map, and which cells of the map are open, those of the walk among them."""
    cells = [(SIDE // 2, SIDE // 2)]
    for rows, cols in draw(st.lists(st.sampled_from(MOVES), max_size=30)):
        row, col = cells[-1][0] + rows, cells[-1][1] + cols
        if 0 <= row < SIDE and 0 <= col < SIDE:
            cells.append((row, col))
    go = np.random.default_rng(draw(st.integers(0, 99))).random((SIDE, SIDE)) < draw(st.sampled_from([0.3, 0.7, 1.0]))
    return cells, go | visited(cells, (SIDE, SIDE))


def corners_of(cells: list[Cell]) -> list[int]:
    return turn_steps([(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(cells)])


def crossed(start: Cell, end: Cell) -> set[Cell]:
    """The cells whose inside a line between two cell centres meets, by trying each (shapely)."""
    line = shapely.LineString([(start[1] + 0.5, start[0] + 0.5), (end[1] + 0.5, end[0] + 0.5)])
    rows = range(min(start[0], end[0]), max(start[0], end[0]) + 1)
    cols = range(min(start[1], end[1]), max(start[1], end[1]) + 1)
    return {(r, c) for r in rows for c in cols if line.intersection(shapely.box(c, r, c + 1, r + 1)).length > 1e-9}


@given(start=st.tuples(st.integers(0, 12), st.integers(0, 12)), end=st.tuples(st.integers(0, 12), st.integers(0, 12)))
def test_the_cells_that_a_line_enters_are_those_it_crosses(start: Cell, end: Cell) -> None:
    rows, cols = entered(start, end)
    found = list(zip(rows.tolist(), cols.tolist(), strict=True))
    assert len(found) == len(set(found))
    assert set(found) == (crossed(start, end) or {start})


@settings(max_examples=60)
@given(walk=walks(), tolerance=st.sampled_from([0.5, 1.0, 2.5]))
def test_chords_stay_off_no_go_and_near_the_walk(walk: tuple[list[Cell], np.ndarray], tolerance: float) -> None:
    cells, go = walk
    corners = corners_of(cells)
    steps = simplified(cells, corners, tolerance, go)
    assert (steps[0], steps[-1]) == (corners[0], corners[-1])
    assert set(steps) <= set(corners)
    for first, last in pairwise(steps):
        assert all(go[cell] for cell in crossed(cells[first], cells[last]))
        chord = shapely.LineString([cells[first], cells[last]])
        assert max(chord.distance(shapely.Point(cell)) for cell in cells[first : last + 1]) <= tolerance + 1e-9


def test_a_staircase_becomes_one_leg_where_all_is_open() -> None:
    plan = sample_plan(ZIGZAG, start=(3, 2))
    go = np.ones((plan.grid.rows, plan.grid.cols), bool)
    mission = mission_of(plan, MissionOptions(tolerance_m=0.5), go)
    assert [stop.step for stop in mission.stops] == [0, len(ZIGZAG)]
    assert mission.length_m == pytest.approx(0.5 * math.hypot(4, 4))
    assert "simplified to 0.5 m" in mission.description


def test_without_a_scoremap_no_line_leaves_the_cells_of_the_walk() -> None:
    plan = sample_plan([(0, 1)] * 3 + [(1, 0)] * 3)
    assert [stop.step for stop in mission_of(plan, MissionOptions(tolerance_m=5.0)).stops] == [0, 3, 6]
    go = np.ones((plan.grid.rows, plan.grid.cols), bool)
    assert [stop.step for stop in mission_of(plan, MissionOptions(tolerance_m=5.0), go).stops] == [0, 6]


def test_one_no_go_cell_keeps_its_corner() -> None:
    moves = [(0, 1)] * 3 + [(1, 0)] * 3
    cells = cells_of((0, 0), moves)
    go = np.ones((4, 4), bool)
    assert simplified(cells, turn_steps(moves), 3.0, go) == [0, 6]
    go[1, 1] = False
    assert simplified(cells, turn_steps(moves), 3.0, go) == [0, 3, 6]


def test_a_larger_tolerance_leaves_fewer_waypoints() -> None:
    plan = sample_plan(LAWNMOWER * 3)
    go = np.ones((plan.grid.rows, plan.grid.cols), bool)
    counts = [len(mission_of(plan, MissionOptions(tolerance_m=t), go).stops) for t in (0.0, 0.5, 1.0, 3.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]
