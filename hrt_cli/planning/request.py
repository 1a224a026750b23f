"""What the user asks of a plan, as text: where it starts and what it may cost."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.problem import Budget, NothingLeftError
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap

# Narrower than `float`, which also takes 1_000, nan and digits of other scripts.
_NUMBER = r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*"
_START = re.compile(f"(cell|lonlat|xy):{_NUMBER},{_NUMBER}")
_BUDGET = re.compile(f"{_NUMBER}(steps?|m|min)?")
# A cell's side is measured on the Earth and differs from what it was asked to be in the seventh digit: 40 m are 40
# cells of 1 m, not 39.999996.
_WHOLE = 1e-5
_MAX_VALUE = 1e9


@dataclass(frozen=True)
class Start:
    """A start as it was given: `kind` says what the two numbers are."""

    kind: Literal["cell", "lonlat", "xy", "auto"]
    first: float = 0.0
    second: float = 0.0


@dataclass(frozen=True)
class Spending:
    """A budget as it was given."""

    value: float
    unit: Literal["steps", "m", "min"]


def parse_start(text: str, option: str = "--start") -> Start:
    """Read `cell:ROW,COL`, `lonlat:LON,LAT`, `xy:X,Y` or `auto`, given as `option`.

    Raises
    ------
    ArgumentError
        The text is none of these.
    """
    if text == "auto":
        return Start("auto")
    found = _START.fullmatch(text.strip())
    forms = "cell:ROW,COL, lonlat:LON,LAT, xy:X,Y or auto"
    if not found:
        raise ArgumentError(f"{option} {text!r} is none of {forms}")
    kind = found[1]
    numbers = [float(found[2]), float(found[3])]
    if not all(map(math.isfinite, numbers)):
        raise ArgumentError(f"{option} {text!r} is not a place")
    if kind == "cell":
        if any(number != math.floor(number) for number in numbers):
            raise ArgumentError(f"{option} {text!r}: a cell's row and column are whole numbers")
        return Start("cell", *numbers)
    if kind == "lonlat":
        if abs(numbers[0]) > 180 or abs(numbers[1]) > 90:
            raise ArgumentError(f"{option} {text!r}: longitude is -180 to 180 and latitude -90 to 90, in this order")
        return Start("lonlat", *numbers)
    return Start("xy", *numbers)


def parse_budget(text: str) -> Spending:
    """Read a budget: steps (`250`), metres (`400m`) or minutes (`15min`).

    Raises
    ------
    ArgumentError
        The text is no budget, or not a positive finite number.
    """
    found = _BUDGET.fullmatch(text.strip())
    if found is None:
        raise ArgumentError(f"--budget {text!r} is no budget such as 250 (steps), 400m or 15min")
    value = float(found[1])
    if not 0 < value <= _MAX_VALUE:
        raise ArgumentError(f"--budget {text!r} must be more than 0 and at most {_MAX_VALUE:g}")
    unit: Literal["steps", "m", "min"] = "m" if found[2] == "m" else "min" if found[2] == "min" else "steps"
    if unit == "steps" and value != math.floor(value):
        raise ArgumentError(f"--budget {text!r}: steps are whole numbers")
    return Spending(value, unit)


def budget_in_cells(spending: Spending, cell_size_m: float, speed_m_s: float) -> Budget:
    """Turn a budget into cells of travel; in steps every move costs one, in metres and minutes a diagonal costs √2."""
    if spending.unit == "steps":
        return Budget(spending.value, 1.0)
    metres = spending.value if spending.unit == "m" else spending.value * 60.0 * speed_m_s
    cells = metres / cell_size_m
    if abs(cells - round(cells)) < _WHOLE * cells:
        cells = float(round(cells))
    if cells < 1:
        raise NothingLeftError(f"the budget of {metres:g} m does not reach the next cell ({cell_size_m:g} m away)")
    return Budget(cells, math.sqrt(2.0))


def start_cell(start: Start, scoremap: Scoremap, what: str = "start") -> tuple[int, int]:
    """Find the cell of a start, or of another place that `what` names.

    Raises
    ------
    ArgumentError
        The place lies outside the map, or needs a georeference that the map has not.
    """
    grid = scoremap.grid
    if start.kind == "auto":
        return middle_of_largest_region(scoremap.score)
    if start.kind == "cell":
        row, col = int(start.first), int(start.second)
    else:
        row, col = _placed(start, grid, what)
    if not (0 <= row < grid.rows and 0 <= col < grid.cols):
        swapped = ""
        if start.kind == "lonlat" and _is_inside(Start("lonlat", start.second, start.first), grid):
            swapped = "; with longitude and latitude exchanged it would be inside"
        given = f"{start.kind}:{start.first:.10g},{start.second:.10g}"
        raise ArgumentError(f"the {what} {given} is outside the map of {grid.rows} x {grid.cols} cells{swapped}")
    return row, col


def middle_of_largest_region(score: NDArray[np.float32]) -> tuple[int, int]:
    """Return the cell of the largest connected region of go cells that is deepest inside it (ties: the first)."""
    from scipy import ndimage

    go = ~np.isnan(score)
    labels, count = ndimage.label(go)
    if count == 0:
        raise ArgumentError("the map has no cell that may be entered")
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    inside = np.pad(labels == largest, 1)
    depth = ndimage.distance_transform_cdt(inside, metric="taxicab")[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(depth)), score.shape)
    return int(row), int(col)


def _placed(start: Start, grid: Grid, what: str = "start") -> tuple[int, int]:
    if grid.crs is None:
        raise ArgumentError(f"the scoremap has no georeference: give the {what} as cell:ROW,COL, not {start.kind}")
    try:
        x, y = (start.first, start.second)
        if start.kind == "lonlat":
            x, y = grid.xy_of_lonlat(x, y)
    except ValueError as error:
        raise ArgumentError(
            f"the {what} has no place in the scoremap's coordinate reference system: {error}"
        ) from error
    row, col = grid.rowcol(x, y)
    # Far outside, the inverse transform may not even be a number that fits an index.
    if not (math.isfinite(row) and math.isfinite(col) and abs(row) < _MAX_VALUE and abs(col) < _MAX_VALUE):
        return -1, -1
    return math.floor(row), math.floor(col)


def _is_inside(start: Start, grid: Grid) -> bool:
    if abs(start.second) > 90:
        return False
    try:
        row, col = _placed(start, grid)
    except ArgumentError:
        return False
    return 0 <= row < grid.rows and 0 <= col < grid.cols


@dataclass(frozen=True)
class PlanRequest:
    """What to plan; see `Problem` and `hrt_cli.planning.planner.plan` for the meaning of each.

    `starts` and `ends` hold one place for all robots or one for each; without `starts` the robots stand where their
    earlier drives ended, without `ends` they may end anywhere. With `or_stay` one robot for which no move is left gets
    the plan of staying where it is, instead of being refused.
    """

    starts: tuple[Start, ...]
    budget: Spending
    method: str = "refined"
    objective: Literal["total", "discounted"] = "total"
    gamma: float = 0.99
    connectivity: Literal[4, 8] = 4
    return_home: bool = False
    ends: tuple[Start, ...] = ()
    robots: int = 1
    speed_m_s: float = 1.0
    effort: float = 1.0
    samples: int = 256
    seed: int = 0
    or_stay: bool = False
