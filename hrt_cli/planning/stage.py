"""The plan stage: a scoremap becomes a plan, and the train stage: maps become a policy, from file to file."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hrt_cli.artifacts import plan as artifact
from hrt_cli.artifacts.carriers import json_provenance, publish_json, read_stamped_npz
from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.planning.planner import plan
from hrt_cli.planning.policy import Policy, default_policy_sha256
from hrt_cli.planning.problem import Plan, Problem
from hrt_cli.planning.request import Spending, Start, budget_in_cells, start_cell
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

STAGE = "plan"
STAGE_VERSION = 1


@dataclass(frozen=True)
class PlanRequest:
    """What to plan; see `Problem` and `hrt_cli.planning.planner.plan` for the meaning of each."""

    start: Start
    budget: Spending
    method: str = "refined"
    objective: Literal["total", "discounted"] = "total"
    gamma: float = 0.99
    connectivity: Literal[4, 8] = 4
    return_home: bool = False
    speed_m_s: float = 1.0
    effort: float = 1.0
    samples: int = 256
    seed: int = 0


@dataclass(frozen=True)
class Planned:
    """The plan as it stands in the output, whether it was there already, and the seconds that planning took."""

    up_to_date: bool
    document: artifact.PlanDocument
    seconds: float


def plan_file(
    scoremap_path: Path,
    output: Path,
    request: PlanRequest,
    *,
    policy_path: Path | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> Planned:
    """Plan on the scoremap in `scoremap_path` and write the plan to `output`.

    Raises
    ------
    InputError
        The scoremap or the policy cannot be used.
    ArgumentError
        The request does not fit the map: a start outside it or on a no-go cell, a budget of nothing.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {"scoremap": scoremap_path} | ({"policy": policy_path} if policy_path else {})
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=inputs,
        parameters=_parameters(request, policy_path),
        outputs={output: json_provenance},
        existing=existing,
    )
    if job.up_to_date:
        return Planned(True, read_model(output, artifact.PlanDocument), 0.0)
    scoremap = read_scoremap(scoremap_path)
    policy = read_policy(policy_path) if policy_path else None
    budget = budget_in_cells(request.budget, scoremap.cell_size_m, request.speed_m_s)
    try:
        problem = Problem(
            scoremap.score,
            start_cell(request.start, scoremap),
            budget,
            connectivity=request.connectivity,
            objective=request.objective,
            gamma=request.gamma,
            return_home=request.return_home,
        )
    except ArgumentError as error:
        raise ArgumentError(f"{scoremap_path}: {error}") from error
    found = plan(
        problem,
        request.method,
        policy=policy,
        effort=request.effort,
        samples=request.samples,
        seed=request.seed,
        progress=progress,
    )
    document = _document(found, problem, scoremap, request)
    publish_json(output, document.model_dump(mode="json", exclude={"provenance"}), job.provenance)
    return Planned(False, document, found.seconds)


def read_policy(path: Path) -> Policy:
    """Read a policy.

    Raises
    ------
    InputError
        The file is no NPZ, is damaged, or does not hold a policy of a version known here.
    """
    arrays, _ = read_stamped_npz(path)
    try:
        return Policy.from_arrays(arrays)
    except ValueError as error:
        raise InputError(path, f"is not a usable policy: {error}") from error


def _parameters(request: PlanRequest, policy_path: Path | None) -> dict[str, Any]:
    start, budget = request.start, request.budget
    return {
        "policy": "given" if policy_path else default_policy_sha256(),
        "start": [start.kind, start.first, start.second],
        "budget": [budget.value, budget.unit],
        "method": request.method,
        "objective": request.objective,
        "gamma": request.gamma,
        "connectivity": request.connectivity,
        "return_home": request.return_home,
        "speed_m_s": request.speed_m_s,
        "effort": request.effort,
        "samples": request.samples,
        "seed": request.seed,
    }


def _document(found: Plan, problem: Problem, scoremap: Scoremap, request: PlanRequest) -> artifact.PlanDocument:
    grid = scoremap.grid
    cells = [(int(row), int(col)) for row, col in found.cells]
    rows, cols = found.cells[:, 0] + 0.5, found.cells[:, 1] + 0.5
    x, y = grid.xy(rows, cols)
    xy = [(float(px), float(py)) for px, py in zip(x, y, strict=True)]
    lonlat = None
    if grid.crs is not None:
        lon, lat = grid.lonlat(x, y)
        # 10 decimals of a degree are 0.01 mm: enough for any format, and free of the last bits of PROJ's arithmetic.
        lonlat = [(round(float(a), 10), round(float(b), 10)) for a, b in zip(lon, lat, strict=True)]
        length_m = float(grid.ground_length_m(rows, cols).sum())
    else:
        steps = np.diff(found.cells, axis=0)
        length_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum() * scoremap.cell_size_m)
    return artifact.PlanDocument(
        method=found.method,
        seed=request.seed,
        objective=request.objective,
        gamma=request.gamma,
        connectivity=request.connectivity,
        return_home=request.return_home,
        budget=artifact.Budget(value=request.budget.value, unit=request.budget.unit, cells=problem.budget.limit),
        grid=_grid(grid, scoremap.cell_size_m),
        start=cells[0],
        steps=len(cells) - 1,
        score=found.score,
        discounted_score=found.discounted_score,
        upper_bound=found.upper_bound,
        gap=found.gap,
        discounted_upper_bound=found.discounted_upper_bound,
        discounted_gap=found.discounted_gap,
        length_m=length_m,
        speed_m_s=request.speed_m_s,
        time_s=length_m / request.speed_m_s,
        waypoints=_waypoints(cells, xy, lonlat),
        cells=cells,
        xy=xy,
        lonlat=lonlat,
    )


def _grid(grid: Grid, cell_size_m: float) -> artifact.Grid:
    a, b, c, d, e, f = grid.transform[:6]
    fake = grid.placeholder_georeference
    return artifact.Grid(
        rows=grid.rows,
        cols=grid.cols,
        transform=(a, b, c, d, e, f),
        crs=grid.crs_text(),
        cell_size_m=cell_size_m,
        georeference="none" if grid.crs is None else "fake" if fake else "real",
    )


def _waypoints(
    cells: list[artifact.Cell], xy: list[artifact.Point], lonlat: list[artifact.Point] | None
) -> list[artifact.Waypoint]:
    """Return the start, every cell where the walk turns, and the end: driven straight between them it is the walk."""
    moves = [(r1 - r0, c1 - c0) for (r0, c0), (r1, c1) in itertools.pairwise(cells)]
    turns = [step for step in range(1, len(moves)) if moves[step] != moves[step - 1]]
    steps = sorted({0, *turns, len(cells) - 1})
    return [
        artifact.Waypoint(
            index=index,
            step=step,
            cell=cells[step],
            x=xy[step][0],
            y=xy[step][1],
            lon=lonlat[step][0] if lonlat else None,
            lat=lonlat[step][1] if lonlat else None,
        )
        for index, step in enumerate(steps)
    ]
