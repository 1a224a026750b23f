"""What is asked of the planner and what it answers: the sampling world, the budget and the plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError

MAX_MOVES = 10_000_000
"""More moves than this is a mistyped budget, not a survey: the walk alone would take 80 MB."""

BUDGET_TOLERANCE = 1e-9
"""Slack, in cell units, that keeps rounding from forbidding a move that fits exactly."""

DEFAULT_GAMMA = 0.99

NEIGHBOURS_8 = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
"""The eight (row, column) steps, clockwise from east; the even entries are the 4-neighbours."""


class NothingLeftError(ArgumentError):
    """There is no move to plan: the budget is spent, or the robot is walled in."""


@dataclass(frozen=True)
class Budget:
    """How far the robot may go.

    Parameters
    ----------
    limit : float
        The number of moves, or the length in units of one cell.
    diagonal_cost : float
        What a diagonal move takes from `limit`: 1 when moves are counted, sqrt(2) when length is.

    Raises
    ------
    ArgumentError
        When the limit allows no move, is not finite, or exceeds `MAX_MOVES`; when the diagonal cost is not
        between 1 and 2.
    """

    limit: float
    diagonal_cost: float = 1.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.limit):
            raise ArgumentError(f"the budget must be a finite number, not {self.limit}")
        if self.limit + BUDGET_TOLERANCE < 1.0:
            raise ArgumentError(f"the budget {self.limit:g} allows no move (at least 1 is needed)")
        if self.limit > MAX_MOVES:
            raise ArgumentError(f"the budget {self.limit:g} is above {MAX_MOVES} moves; check its unit")
        if not (1.0 <= self.diagonal_cost <= 2.0):
            raise ArgumentError(f"a diagonal move must cost between 1 and 2 cells, not {self.diagonal_cost}")


@dataclass(frozen=True)
class Problem:
    """One planning problem on a grid of scores.

    Parameters
    ----------
    score : ndarray, float32 or float64 [rows, cols]
        Expected score of each cell, finite and >= 0; NaN marks a no-go cell.
    start : (int, int)
        Row and column of the first cell of the walk.
    budget : Budget
        The moves or the length allowed.
    connectivity : {4, 8}
        Whether diagonal moves exist.
    objective : {'total', 'discounted'}
        Sum of the scores of the distinct cells visited, or sum of gamma^t times the score at first visits.
    gamma : float
        Discount per move, in (0, 1]; it is also used to report the discounted score of a 'total' plan.
    end : (int, int), optional
        Row and column of the cell where the walk must end; the start for a walk that returns home.

    Raises
    ------
    ArgumentError
        When the start or the end is off the map or on a no-go cell, when the start is walled in, when a score is
        negative or infinite, or when a parameter is out of its range.
    """

    score: NDArray[np.floating]
    start: tuple[int, int]
    budget: Budget
    connectivity: int = 4
    objective: str = "total"
    gamma: float = DEFAULT_GAMMA
    end: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        self._check_parameters()
        self._check_scores()
        self._check_start()

    @property
    def neighbours(self) -> tuple[tuple[int, int], ...]:
        """The (row, column) steps a move can make."""
        return NEIGHBOURS_8 if self.connectivity == 8 else NEIGHBOURS_8[::2]

    @property
    def counts_moves(self) -> bool:
        """Whether every move costs 1, so that the budget is a number of moves."""
        return self.connectivity == 4 or self.budget.diagonal_cost == 1.0

    @property
    def limit(self) -> float:
        """The budget in cell units; a whole number where moves are counted."""
        if self.counts_moves:
            return float(math.floor(self.budget.limit + BUDGET_TOLERANCE))
        return float(self.budget.limit)

    def _check_parameters(self) -> None:
        if self.connectivity not in (4, 8):
            raise ArgumentError(f"the connectivity must be 4 or 8, not {self.connectivity}")
        if self.objective not in ("total", "discounted"):
            raise ArgumentError(f"the objective must be 'total' or 'discounted', not {self.objective!r}")
        if not (0.0 < self.gamma <= 1.0):
            raise ArgumentError(f"gamma must be above 0 and at most 1, not {self.gamma}")
        if self.end == self.start and self.limit < 2.0:
            raise ArgumentError("a budget of one move cannot leave the start and return to it")

    def _check_scores(self) -> None:
        if self.score.ndim != 2 or self.score.dtype.kind != "f":
            raise ArgumentError("the score map must be a two-dimensional array of floats")
        if self.score.size == 0:
            raise ArgumentError("the score map has no cells")
        for bad, what in ((np.isinf(self.score), "infinite"), (self.score < 0, "negative")):
            if bad.any():
                row, col = np.argwhere(bad)[0]
                raise ArgumentError(f"cell {row},{col} has the {what} score {self.score[row, col]}")

    def _check_start(self) -> None:
        for name, cell in (("start", self.start), ("end", self.end)):
            if cell is not None:
                self._check_cell(name, *cell)
        row, col = self.start
        if not any(self._can_enter(row + dr, col + dc) for dr, dc in self.neighbours):
            raise NothingLeftError(f"start cell {row},{col} is walled in: no neighbour can be entered")

    def _check_cell(self, name: str, row: int, col: int) -> None:
        rows, cols = self.score.shape
        if not (0 <= row < rows and 0 <= col < cols):
            raise ArgumentError(f"{name} cell {row},{col} is outside the map of {rows} x {cols} cells")
        if np.isnan(self.score[row, col]):
            open_cells = np.argwhere(~np.isnan(self.score))
            near = open_cells[np.hypot(*(open_cells - (row, col)).T).argmin()] if len(open_cells) else None
            remedy = "" if near is None else f"; the nearest that may be entered is cell:{near[0]},{near[1]}"
            raise ArgumentError(f"{name} cell {row},{col} is a no-go cell{remedy}")

    def _can_enter(self, row: int, col: int) -> bool:
        rows, cols = self.score.shape
        return 0 <= row < rows and 0 <= col < cols and not bool(np.isnan(self.score[row, col]))


@dataclass(frozen=True)
class Plan:
    """A walk and what it is worth.

    Attributes
    ----------
    cells : ndarray, int32 [T + 1, 2]
        Row and column of every cell of the walk, start first.
    score : float
        Sum of the scores of the distinct cells visited, start included.
    discounted_score : float
        Sum of gamma^t times the score at each cell's first visit, t = 0 at the start.
    upper_bound : float
        Proven bound on `score` of any walk, whatever the objective.
    gap : float
        1 - score / upper_bound, in [0, 1].
    discounted_upper_bound, discounted_gap : float or None
        The same for `discounted_score`, where that is the objective.
    method : str
        The method that made the walk.
    seconds : float
        Wall-clock time of the planning, the bound included.
    evaluations : int
        Walks that were tried: rollouts and proposed changes.
    """

    cells: NDArray[np.int32]
    score: float
    discounted_score: float
    upper_bound: float
    gap: float
    discounted_upper_bound: float | None
    discounted_gap: float | None
    method: str
    seconds: float
    evaluations: int


@dataclass(frozen=True)
class TeamPlan:
    """The walks of several robots and what they are worth together.

    Attributes
    ----------
    together : Plan
        Scores, bounds and cost of all walks together, each cell paying once, at its earliest visit by any robot;
        its `cells` are those of the first robot.
    cells : list of ndarray, int32 [T_r + 1, 2]
        Row and column of every cell of each robot's walk.
    shares : list of float
        What each robot adds to the score: the cells that it is the first to visit (of two at once, the first robot).
    """

    together: Plan
    cells: list[NDArray[np.int32]]
    shares: list[float]
