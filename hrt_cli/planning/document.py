"""What the planner found as the documents that are written: the plan of a robot, of one that stays, of a team."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from hrt_cli.artifacts import plan as artifact
from hrt_cli.planning.problem import Plan, TeamPlan
from hrt_cli.planning.request import PlanRequest, start_cell
from hrt_cli.planning.resume import Driven
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap


def plan_document(
    found: Plan,
    budget_cells: float,
    end: artifact.Cell | None,
    scoremap: Scoremap,
    request: PlanRequest,
    collected: list[artifact.Cell],
    blocked: list[artifact.Cell],
) -> artifact.PlanDocument:
    """Return the plan of one robot that had `budget_cells` left, and had to end in `end` if that is given."""
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
        budget=artifact.Budget(value=request.budget.value, unit=request.budget.unit, cells=budget_cells),
        grid=_grid(grid, scoremap.cell_size_m),
        start=cells[0],
        end=end,
        collected=collected,
        blocked=blocked,
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
        waypoints=waypoints_of(cells, xy, lonlat),
        cells=cells,
        xy=xy,
        lonlat=lonlat,
    )


def staying_document(scoremap: Scoremap, request: PlanRequest, driven: list[Driven]) -> artifact.PlanDocument | None:
    """Return the plan of a robot that stays where it is, with nothing more to collect.

    None where it has to end elsewhere.
    """
    start = start_cell(request.starts[0], scoremap) if request.starts else driven[0].stands
    end = start if request.return_home else None
    if request.ends:
        end = start_cell(request.ends[0], scoremap, "end")
    if end not in (None, start):
        return None
    collected = sorted({(int(row), int(col)) for each in driven for row, col in each.cells})
    score = 0.0 if start in collected else float(np.nan_to_num(scoremap.score[start]))
    discounted = request.objective == "discounted"
    stays = Plan(
        cells=np.array([start], np.int32),
        score=score,
        discounted_score=score,
        upper_bound=score,
        gap=0.0,
        discounted_upper_bound=score if discounted else None,
        discounted_gap=0.0 if discounted else None,
        method="stay",
        seconds=0.0,
        evaluations=0,
    )
    blocked = sorted({cell for each in driven for cell in each.blocked})
    return plan_document(stays, 0.0, end, scoremap, request, collected, blocked)


def team_document(
    found: TeamPlan, robots: list[artifact.PlanDocument], files: list[Path], request: PlanRequest
) -> artifact.TeamPlanDocument:
    """Return the plan of a team, whose robots have their plans in `files`."""
    together = found.together
    members = [
        artifact.TeamMember(
            plan=path.name,
            start=each.start,
            end=each.end,
            score=share,
            steps=each.steps,
            length_m=each.length_m,
            time_s=each.time_s,
            waypoints=len(each.waypoints),
        )
        for path, each, share in zip(files, robots, found.shares, strict=True)
    ]
    return artifact.TeamPlanDocument(
        method=together.method,
        seed=request.seed,
        objective=request.objective,
        gamma=request.gamma,
        connectivity=request.connectivity,
        score=together.score,
        discounted_score=together.discounted_score,
        upper_bound=together.upper_bound,
        gap=together.gap,
        discounted_upper_bound=together.discounted_upper_bound,
        discounted_gap=together.discounted_gap,
        steps=sum(each.steps for each in robots),
        length_m=float(sum(each.length_m for each in robots)),
        time_s=max(each.time_s for each in robots),
        robots=members,
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


def waypoints_of(
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
