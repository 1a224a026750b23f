"""Walks on a grid in plain Python, independent of hrt: what one is worth, and how a tour of cells becomes one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

FAR_LOOK = 12
"""Moves ahead that the rest of a budget is spent by."""


@dataclass(frozen=True)
class Task:
    """One map to walk on, 4-connected: score float64 [rows, cols] with NaN for no-go cells, start, moves allowed."""

    family: str
    index: int
    score: np.ndarray
    start: tuple[int, int]
    moves: int


def walk_score(task: Task, cells: Sequence[Sequence[int]] | np.ndarray, gamma: float = 1.0) -> float:
    """Return what a walk collects, each distinct cell once; a RuntimeError if it breaks a rule."""
    walk = [(int(row), int(col)) for row, col in cells]
    rows, cols = task.score.shape
    if walk[0] != task.start:
        raise RuntimeError(f"{task.family} {task.index}: the walk starts at {walk[0]}, not at {task.start}")
    if len(walk) - 1 > task.moves:
        raise RuntimeError(f"{task.family} {task.index}: {len(walk) - 1} moves, {task.moves} allowed")
    seen: set[tuple[int, int]] = set()
    total = 0.0
    for t, (row, col) in enumerate(walk):
        if not (0 <= row < rows and 0 <= col < cols) or math.isnan(task.score[row, col]):
            raise RuntimeError(f"{task.family} {task.index}: cell {row},{col} at move {t} cannot be entered")
        if t > 0 and abs(row - walk[t - 1][0]) + abs(col - walk[t - 1][1]) != 1:
            raise RuntimeError(f"{task.family} {task.index}: {walk[t - 1]} and {row, col} are not neighbours")
        if (row, col) not in seen:
            seen.add((row, col))
            total += gamma**t * float(task.score[row, col])
    return total


class Grid:
    """Neighbours, distances and richest shortest paths between the cells of a map, numbered row by row."""

    def __init__(self, score: np.ndarray) -> None:
        self.rows, self.cols = score.shape
        self.value = [float(x) for x in score.ravel()]

    def neighbours(self, cell: int) -> Iterator[int]:
        row, col = divmod(cell, self.cols)
        for r, c in ((row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col)):
            if 0 <= r < self.rows and 0 <= c < self.cols and not math.isnan(self.value[r * self.cols + c]):
                yield r * self.cols + c

    def distances(self, source: int, limit: int, target: int = -1) -> dict[int, int]:
        """Return the fewest moves from `source` to each cell up to `limit`; no farther than to `target`."""
        steps = {source: 0}
        queue = deque([source])
        while queue and target not in steps:
            cell = queue.popleft()
            if steps[cell] == limit:
                break
            for after in self.neighbours(cell):
                if after not in steps:
                    steps[after] = steps[cell] + 1
                    queue.append(after)
        return steps

    def richest_path(self, source: int, target: int, seen: set[int]) -> list[int]:
        """Return the cells after `source` of the shortest path to `target` that collects most from unseen cells."""
        left = self.distances(target, len(self.value), source)
        layers: list[dict[int, tuple[float, int]]] = [{source: (0.0, -1)}]
        for remaining in range(left[source] - 1, -1, -1):
            layer: dict[int, tuple[float, int]] = {}
            for cell, (collected, _) in layers[-1].items():
                for after in self.neighbours(cell):
                    if left.get(after) == remaining:
                        worth = collected + (0.0 if after in seen else self.value[after])
                        if after not in layer or worth > layer[after][0]:
                            layer[after] = (worth, cell)
            layers.append(layer)
        path: list[int] = []
        cell = target
        for layer in reversed(layers[1:]):
            path.append(cell)
            cell = layer[cell][1]
        return path[::-1]


def expand_tour(task: Task, tour: Sequence[int]) -> np.ndarray:
    """Return the walk, int [n, 2], through the cells of a tour in their order.

    It takes the richest shortest path to each, leaves out those that it has passed already, and spends what that
    spares on the unvisited cells that pay most per move. All of this is in favour of the tour.
    """
    grid = Grid(task.score)
    walk = [task.start[0] * grid.cols + task.start[1]]
    seen = set(walk)

    def go(target: int) -> bool:
        path = grid.richest_path(walk[-1], target, seen)
        if len(walk) - 1 + len(path) > task.moves:
            return False
        walk.extend(path)
        seen.update(path)
        return True

    for target in tour:
        if target not in seen and not go(target):
            break
    while len(walk) - 1 < task.moves:
        steps = grid.distances(walk[-1], min(task.moves + 1 - len(walk), FAR_LOOK))
        fresh = [cell for cell in steps if cell not in seen]
        go(max(fresh, key=lambda cell: grid.value[cell] / steps[cell]) if fresh else next(grid.neighbours(walk[-1])))
    return np.array([divmod(cell, grid.cols) for cell in walk])
