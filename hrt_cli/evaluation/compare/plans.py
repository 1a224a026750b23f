"""Two plans, of one robot or of a team: what they are worth, where they lead, in which order, and what was asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import Cell, PlanDocument, TeamPlanDocument, team_members
from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.grids import compare_grids, is_same_grid
from hrt_cli.evaluation.compare.result import Figure, Found, alike, apart, number
from hrt_cli.evaluation.compare.tracks import Floats, frechet, ground_metres, metres_of
from hrt_cli.raster.grid import Grid, lattice_offset
from hrt_cli.raster.track import plan_grid

_WORTH = ("score", "discounted_score", "upper_bound", "gap", "discounted_upper_bound", "discounted_gap")
_LENGTHS = {"length_m": "m", "time_s": "s"}
_NOISE = 1e-9
"""Relative difference of lengths that grids which are the same may have."""
_ON_ITS_CELL = 0.01
"""How far a coordinate may lie from its cell, in cells: as far as grids that are the same."""


def compare_plans(path_a: Path, path_b: Path) -> Found:
    """Compare two plans of one robot each, or of two teams, robot by robot.

    `apart_m` is the largest discrete Fréchet distance between two walks, in ground metres; `overlap` the Jaccard index
    of the cells visited; `order` that of the moves, each as often as it is made, by which a walk differs from its
    reverse; `start_m` and `end_m` how far apart they begin and end; `coordinates_m` the farthest that a coordinate or
    waypoint lies from the cell that it is of, where the two files differ in them; `waypoints` and `settings` how many
    waypoints only one has, and how many settings differ.

    Raises
    ------
    InputError
        A plan, or that of one of its robots, cannot be used.
    """
    (whole_a, plans_a), (whole_b, plans_b) = _read(path_a), _read(path_b)
    grids = [(plan_grid(path_a, a), plan_grid(path_b, b)) for a, b in zip(plans_a, plans_b, strict=False)]
    figures = [number(name, getattr(whole_a, name), getattr(whole_b, name)) for name in _WORTH]
    figures += [_length(name, getattr(whole_a, name), getattr(whole_b, name), unit) for name, unit in _LENGTHS.items()]
    figures += [number("steps", whole_a.steps, whole_b.steps)]
    walks = _compare_walks(plans_a, plans_b, grids)
    off = [_off(path_a, path_b, a, b, *pair) for a, b, pair in zip(plans_a, plans_b, grids, strict=False)]
    turns = sum(len(_turns(a) ^ _turns(b)) for a, b in zip(plans_a, plans_b, strict=False))
    settings = _differing(_settings(whole_a, plans_a), _settings(whole_b, plans_b))
    place = compare_grids(path_a, grids[0][0], path_b, grids[0][1])
    figures += [
        *walks,
        apart("coordinates_m", max(off), "m"),
        apart("waypoints", float(turns)),
        number("robots", len(plans_a), len(plans_b)),
        apart("settings", float(len(settings))),
        *place,
    ]
    lines = [f"{name}: {_short(a)} in A, {_short(b)} in B" for name, (a, b) in settings.items()]
    detail = {"settings": {name: {"a": a, "b": b} for name, (a, b) in settings.items()}}
    return Found(figures, lines, detail)


def read_walks(path: Path) -> list[PlanDocument]:
    """Return the plan in a file, or those of the robots of a team, as they stand, whatever their provenance says."""
    return _read(path)[1]


def _read(path: Path) -> tuple[PlanDocument | TeamPlanDocument, list[PlanDocument]]:
    members = team_members(path)
    if not members:
        plan = _read_one(path)
        return plan, [plan]
    return read_model(path, TeamPlanDocument), [_read_one(member) for member in members]


def _read_one(path: Path) -> PlanDocument:
    plan = read_model(path, PlanDocument)
    for waypoint in plan.waypoints:
        if waypoint.step > plan.steps:
            raise InputError(path, f"its waypoint {waypoint.index} stands at step {waypoint.step} of {plan.steps}")
    return plan


def _length(name: str, a: float, b: float, unit: str) -> Figure:
    return number(name, a, a if abs(a - b) <= _NOISE * max(a, b) else b, unit)


def _compare_walks(a: list[PlanDocument], b: list[PlanDocument], grids: list[tuple[Grid, Grid]]) -> list[Figure]:
    leads, starts, ends = [0.0], [0.0], [0.0]
    cells_a: set[tuple[int, ...]] = set()
    cells_b: set[tuple[int, ...]] = set()
    moves_a: Counter[tuple[Any, ...]] = Counter()
    moves_b: Counter[tuple[Any, ...]] = Counter()
    comparable = True
    for robot, (one, other, (grid_a, grid_b)) in enumerate(zip(a, b, grids, strict=False)):
        offset = lattice_offset(grid_a, grid_b)
        comparable = comparable and offset is not None
        down, right = offset or (0, 0)
        walk_a, walk_b = _cells(one), _cells(other) - (down, right)
        if offset is not None:
            placed = [walk_places(each, grid_a, grid_a) for each in (walk_a, walk_b)]
        elif (grid_a.crs is None) == (grid_b.crs is None):
            placed = [walk_places(walk_a, grid_a, grid_a), walk_places(walk_b, grid_b, grid_a)]
        else:
            continue
        leads.append(frechet(*placed))
        starts.append(float(np.hypot(*(placed[0][0] - placed[1][0]))))
        ends.append(float(np.hypot(*(placed[0][-1] - placed[1][-1]))))
        for walk, cells, moves in ((walk_a, cells_a, moves_a), (walk_b, cells_b, moves_b)):
            steps = [(int(row), int(col)) for row, col in walk]
            cells.update(steps)
            moves.update((robot, *pair) for pair in pairwise(steps))
    known = len(leads) > 1
    figures = [
        apart("apart_m", max(leads) if known else None, "m", family="walk"),
        apart("start_m", max(starts) if known else None, "m"),
        apart("end_m", max(ends) if known else None, "m"),
    ]
    if not comparable:
        return figures
    made, both = sum((moves_a | moves_b).values()), sum((moves_a & moves_b).values())
    return [
        *figures[:1],
        alike("overlap", len(cells_a & cells_b) / len(cells_a | cells_b), family="walk"),
        alike("order", both / made if made else 1.0, family="walk"),
        *figures[1:],
    ]


def walk_places(cells: NDArray[Any], grid: Grid, base: Grid) -> Floats:
    """Return the middles of cells [n, 2] in metres (east, north) from the first corner of `base`."""
    x, y = grid.xy(cells[:, 0] + 0.5, cells[:, 1] + 0.5)
    return metres_of(grid, x, y, _origin(base))


def _origin(grid: Grid) -> tuple[float, float]:
    if grid.crs is None:
        return 0.0, 0.0
    lon, lat = grid.lonlat(*grid.xy(0.0, 0.0))
    return float(lon[0]), float(lat[0])


def _cells(plan: PlanDocument) -> NDArray[np.int64]:
    return np.array(plan.cells, np.int64)


def _turns(plan: PlanDocument) -> set[tuple[int, Cell]]:
    return {(each.step, each.cell) for each in plan.waypoints}


def _off(path_a: Path, path_b: Path, a: PlanDocument, b: PlanDocument, grid_a: Grid, grid_b: Grid) -> float:
    """Return how far the coordinates in either plan lie from its cells, 0 where both plans say the same ones."""
    same = is_same_grid(path_a, grid_a, path_b, grid_b)
    if same and (a.xy, a.lonlat, a.waypoints) == (b.xy, b.lonlat, b.waypoints):
        return 0.0
    return max(_off_cells(a, grid_a), _off_cells(b, grid_b))


def _off_cells(plan: PlanDocument, grid: Grid) -> float:
    cells, origin = _cells(plan), _origin(grid)
    turns = np.array([each.cell for each in plan.waypoints], np.int64)
    steps = [each.step for each in plan.waypoints]
    wanted, at_turns = walk_places(cells, grid, grid), walk_places(cells[steps], grid, grid)
    said = [
        (metres_of(grid, *_columns(plan.xy), origin), wanted),
        (metres_of(grid, *_columns([(each.x, each.y) for each in plan.waypoints]), origin), at_turns),
        (walk_places(turns, grid, grid), at_turns),
    ]
    if grid.crs is not None:
        told = [(each.lon, each.lat) for each in plan.waypoints if each.lon is not None and each.lat is not None]
        rows = [k for k, each in enumerate(plan.waypoints) if each.lon is not None and each.lat is not None]
        said += [(ground_metres(*_columns(plan.lonlat), origin), wanted)] if plan.lonlat else []
        said += [(ground_metres(*_columns(told), origin), at_turns[rows])] if told else []
    farthest = max(float(np.hypot(*(one - other).T).max()) for one, other in said)
    return farthest if farthest > _ON_ITS_CELL * plan.grid.cell_size_m else 0.0


def _columns(points: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    x, y = np.array(points, np.float64).T
    return x, y


def _settings(whole: PlanDocument | TeamPlanDocument, plans: list[PlanDocument]) -> dict[str, Any]:
    """Return what a plan was asked for and says besides its walk, as JSON values."""
    told: dict[str, Any] = {"method": whole.method, "seed": whole.seed, "objective": whole.objective}
    told |= {"gamma": whole.gamma, "connectivity": whole.connectivity}
    for robot, plan in enumerate(plans, start=1):
        plain = plan.model_dump(mode="json")
        names = ("budget", "return_home", "end", "collected", "blocked", "speed_m_s")
        mine = {name: plain[name] for name in names}
        mine |= {"cell_size_m": round(plan.grid.cell_size_m, 6), "georeference": plan.grid.georeference}
        mine |= {"lonlat": "none" if plan.lonlat is None else "given"}
        told |= {(f"robot {robot}: {name}" if len(plans) > 1 else name): value for name, value in mine.items()}
    if isinstance(whole, TeamPlanDocument):
        for robot, member in enumerate(whole.robots, start=1):
            told[f"robot {robot}"] = member.model_dump(mode="json", exclude={"plan", "length_m", "time_s"})
    return told


def _differing(a: dict[str, Any], b: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    return {name: (a.get(name), b.get(name)) for name in dict.fromkeys([*a, *b]) if a.get(name) != b.get(name)}


def _short(value: Any, most: int = 60) -> str:
    told = str(value)
    return told if len(told) <= most else f"{told[:most]}…"
