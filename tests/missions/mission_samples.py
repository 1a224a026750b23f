"""Plans for the mission tests, and where their cells really are (pyproj, from the transform alone)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pyproj import Geod, Transformer

from hrt_cli.artifacts.plan import Cell, PlanDocument

TOLERANCE_M = 0.02
WGS84 = Geod(ellps="WGS84")

UTM_SOUTH = "EPSG:32754"
WEB_MERCATOR = "EPSG:3857"
ADELAIDE = (138.6012345, -34.9287654)

LAWNMOWER = [(0, 1)] * 5 + [(1, 0)] + [(0, -1)] * 5 + [(1, 0)] + [(0, 1)] * 3
SQUARE = [(0, 1)] * 4 + [(1, 0)] * 4 + [(0, -1)] * 4 + [(-1, 0)] * 4
DIAGONAL = [(1, 1)] * 3 + [(0, 1)] * 2 + [(-1, 1)] * 2 + [(1, -1)]
ZIGZAG = [(0, 1), (1, 0)] * 4


def cells_of(start: Cell, moves: Sequence[Cell]) -> list[Cell]:
    cells = [start]
    for rows, cols in moves:
        cells.append((cells[-1][0] + rows, cells[-1][1] + cols))
    return cells


def turn_steps(moves: Sequence[Cell]) -> list[int]:
    turns = [step for step in range(1, len(moves)) if moves[step] != moves[step - 1]]
    return sorted({0, *turns, len(moves)})


def transform_at(crs: str, lonlat: tuple[float, float], cell: float, turn_deg: float = 0.0) -> tuple[float, ...]:
    """The affine transform of a grid whose corner is at `lonlat`, turned by `turn_deg`."""
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(*lonlat)
    c, s = cell * math.cos(math.radians(turn_deg)), cell * math.sin(math.radians(turn_deg))
    return (c, s, x, s, -c, y)


def plan_members(
    moves: Sequence[Cell] = LAWNMOWER,
    *,
    crs: str = UTM_SOUTH,
    lonlat: tuple[float, float] = ADELAIDE,
    cell: float = 0.5,
    turn_deg: float = 0.0,
    start: Cell = (3, 2),
    **changes: Any,
) -> dict[str, Any]:
    """The members of a plan that walks `moves`; `changes` replace members."""
    a, b, c, d, e, f = transform = transform_at(crs, lonlat, cell, turn_deg)
    cells = cells_of(start, moves)
    xy = [(a * (col + 0.5) + b * (row + 0.5) + c, d * (col + 0.5) + e * (row + 0.5) + f) for row, col in cells]
    to_degrees = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    degrees = [to_degrees.transform(x, y) for x, y in xy]
    length_m = cell * sum(math.hypot(*move) for move in moves)
    waypoints = [
        {
            "index": index,
            "step": step,
            "cell": cells[step],
            "x": xy[step][0],
            "y": xy[step][1],
            "lon": degrees[step][0],
            "lat": degrees[step][1],
        }
        for index, step in enumerate(turn_steps(moves))
    ]
    members = {
        "method": "policy+refine",
        "seed": 7,
        "objective": "total",
        "gamma": 0.98,
        "connectivity": 8,
        "return_home": False,
        "budget": {"value": 40.0, "unit": "m", "cells": 80.0},
        "grid": {
            "rows": 5000,
            "cols": 5000,
            "transform": transform,
            "crs": crs,
            "cell_size_m": cell,
            "georeference": "real",
        },
        "start": cells[0],
        "steps": len(moves),
        "score": 12.25,
        "discounted_score": 9.5,
        "upper_bound": 13.0,
        "gap": 1 - 12.25 / 13.0,
        "length_m": length_m,
        "speed_m_s": 0.8,
        "time_s": length_m / 0.8,
        "waypoints": waypoints,
        "cells": cells,
        "xy": xy,
        "lonlat": degrees,
    }
    return members | changes


def sample_plan(moves: Sequence[Cell] = LAWNMOWER, **options: Any) -> PlanDocument:
    return PlanDocument.model_validate(plan_members(moves, **options))


def ungeoreferenced_plan(georeference: str = "none") -> PlanDocument:
    members = plan_members()
    members["grid"] |= {"crs": None, "georeference": georeference}
    members["lonlat"] = None
    members["waypoints"] = [w | {"lon": None, "lat": None} for w in members["waypoints"]]
    return PlanDocument.model_validate(members)


def distance_m(first: tuple[float, float], second: tuple[float, float]) -> float:
    """Geodesic metres between two (lon, lat)."""
    return float(WGS84.inv(*first, *second)[2])


def true_lonlat(plan: PlanDocument, cell: Cell) -> tuple[float, float]:
    """Where the centre of a cell is: transform, then CRS, by pyproj."""
    a, b, c, d, e, f = plan.grid.transform
    col, row = cell[1] + 0.5, cell[0] + 0.5
    to_degrees = Transformer.from_crs(plan.grid.crs, "EPSG:4326", always_xy=True)
    lon, lat = to_degrees.transform(a * col + b * row + c, d * col + e * row + f)
    return lon, lat


def assert_at_cells(plan: PlanDocument, positions: Sequence[tuple[float, float]], cells: Sequence[Cell]) -> None:
    """Each (lon, lat) lies within the tolerance of its cell's centre."""
    assert len(positions) == len(cells)
    for position, cell in zip(positions, cells, strict=True):
        assert distance_m(position, true_lonlat(plan, cell)) <= TOLERANCE_M


def waypoint_cells(plan: PlanDocument) -> list[Cell]:
    return [waypoint.cell for waypoint in plan.waypoints]
