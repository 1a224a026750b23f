"""Fewer waypoints: the corners of a walk that can be left out while the robot stays near it, and off what is no-go.

A robot drives straight from one waypoint to the next. Between two corners of the walk the ones in between may go where
every cell of the walk lies within a tolerance of the straight line, and where all cells that this line passes through
may be entered. Lines and cells are those of the plan's grid, computed in whole numbers, so that a line that only
touches the corner of a cell does not enter it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_GIVE_UP = 64
"""Corners in a row that cannot be reached straight, after which none beyond them is tried."""


def simplified(cells: Sequence[tuple[int, int]], corners: Sequence[int], tolerance: float, go: Bools) -> list[int]:
    """Return those corners of a walk that are left as waypoints, its first and last among them.

    From each corner the farthest is taken that can be reached straight: the greedy choice of Imai and Iri, Polygonal
    approximations of a curve (1988), which is the smallest where reach never comes back after it was lost.

    Parameters
    ----------
    cells : sequence of (row, col)
        The walk.
    corners : sequence of int
        Steps of the walk where it starts, turns and ends, rising.
    tolerance : float
        How far a cell's centre may lie from the straight line, in cells; at least 0.
    go : bool [rows, cols]
        The cells that may be entered; those of the walk all may.

    Returns
    -------
    list of int
        Steps, rising.
    """
    walk = np.array(cells, np.int64)
    kept = [corners[0]]
    at = 0
    while at < len(corners) - 1:
        farthest = at + 1  # the walk itself leads there
        missed = 0
        for there in range(at + 2, len(corners)):
            if missed > _GIVE_UP:
                break
            if _straight(walk[corners[at] : corners[there] + 1], tolerance, go):
                farthest, missed = there, 0
            else:
                missed += 1
        at = farthest
        kept.append(corners[at])
    return kept


def entered(start: tuple[int, int], end: tuple[int, int]) -> tuple[Ints, Ints]:
    """Return the rows and columns of the cells whose inside a line passes, from cell centre to cell centre.

    Examples
    --------
    A diagonal enters no cell beside it:

    >>> [cells.tolist() for cells in entered((0, 0), (2, 2))]
    [[0, 1, 2], [0, 1, 2]]
    """
    (r0, c0), (r1, c1) = sorted([start, end])
    down, along = r1 - r0, c1 - c0
    if not down:
        cols = np.arange(min(c0, c1), max(c0, c1) + 1)
        return np.full(cols.size, r0), cols
    rows = np.arange(r0, r1 + 1)
    # Twice the way down at the upper edge of each row, and at the end; columns in units of 1 / (2 down) of a cell.
    edges = np.clip(2 * np.arange(down + 2) - 1, 0, 2 * down)
    at = (2 * c0 + 1) * down + along * edges
    low, high = np.minimum(at[:-1], at[1:]), np.maximum(at[:-1], at[1:])
    first = low // (2 * down)
    last = np.maximum(-(-high // (2 * down)) - 1, first)
    counts = last - first + 1
    within = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
    return np.repeat(rows, counts), np.repeat(first, counts) + within


def _straight(walk: Ints, tolerance: float, go: Bools) -> bool:
    """Say whether a robot may drive straight from the first to the last cell of a walk."""
    start, end = walk[0], walk[-1]
    line = (end - start).astype(np.float64)
    away = (walk - start).astype(np.float64)
    long2 = float(line @ line)
    share = np.clip(away @ line / long2, 0.0, 1.0) if long2 else np.zeros(len(walk))
    off = away - share[:, None] * line
    if (off * off).sum(axis=1).max() > tolerance * tolerance:
        return False
    return bool(go[entered(tuple(start.tolist()), tuple(end.tolist()))].all())


def passed_by(cells: Sequence[tuple[int, int]], steps: Sequence[int]) -> list[tuple[int, int]]:
    """Return the cells of a walk that the straight lines between its cells at `steps` do not enter, by row and column.

    Parameters
    ----------
    cells : sequence of (row, col)
        The walk.
    steps : sequence of int
        Steps of the walk, rising.
    """
    met = {cells[step] for step in steps}
    for before, step in pairwise(steps):
        rows, cols = entered(cells[before], cells[step])
        met |= set(zip(rows.tolist(), cols.tolist(), strict=True))
    return sorted(set(cells) - met)


def visited(cells: Sequence[tuple[int, int]], shape: tuple[int, int]) -> Bools:
    """Return the cells of a walk as a map: all that a plan by itself knows to be open to the robot."""
    rows, cols = np.array(cells, np.int64).T
    go = np.zeros(shape, np.bool_)
    go[rows, cols] = True
    return go
