"""Driven straight from waypoint to waypoint, the robot walks the planned cells and no others."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.planning.document import waypoints_of

MOVES = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


def walk(moves: list[tuple[int, int]]) -> list[tuple[int, int]]:
    cells = [(0, 0)]
    for down, right in moves:
        cells.append((cells[-1][0] + down, cells[-1][1] + right))
    return cells


def sign(value: int) -> int:
    return (value > 0) - (value < 0)


@given(st.lists(st.sampled_from(MOVES), max_size=40))
def test_straight_legs_between_waypoints_are_the_walk(moves: list[tuple[int, int]]) -> None:
    cells = walk(moves)
    found = waypoints_of(cells, [(float(c), float(-r)) for r, c in cells], None)
    driven = [found[0].cell]
    for waypoint in found[1:]:
        while driven[-1] != waypoint.cell:
            (row, col), (to_row, to_col) = driven[-1], waypoint.cell
            driven.append((row + sign(to_row - row), col + sign(to_col - col)))
    assert driven == cells
    assert [w.index for w in found] == list(range(len(found)))
    assert all(cells[w.step] == w.cell for w in found)


def test_a_turn_at_the_first_step_and_a_reversal_are_kept() -> None:
    cells = [(0, 0), (0, 1), (1, 1), (1, 2), (1, 1)]
    assert [w.step for w in waypoints_of(cells, [(0.0, 0.0)] * 5, None)] == [0, 1, 2, 3, 4]
