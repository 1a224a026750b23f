"""Plans as lines and waypoints of a page's map, and what they are worth beside other ways to spend the budget."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.plan import PlanDocument, read_plan, team_members
from hrt_cli.evaluation.plans import Trials, evaluate_plans
from hrt_cli.evaluation.rewards import RewardChart
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.track import plan_grid
from hrt_cli.report.figures.palette import METHODS, SOFT, robot_line
from hrt_cli.report.page.charts import points
from hrt_cli.report.page.frame import Frame

_BASELINES = Trials(planner=False)


def grid_of(path: Path, plan: PlanDocument) -> Grid:
    """Return the grid that a plan lies on; none of it is on the Earth where its georeference is made up."""
    grid = plan_grid(path, plan)
    return grid if plan.grid.georeference == "real" else replace(grid, crs=None)


def plan_lines(path: Path, name: str, frame: Frame) -> list[dict[str, Any]]:
    """Return the plan of a robot, or those of each robot of a team, as lines with their waypoints.

    Raises
    ------
    InputError
        It is no plan, or was edited; of a team, a robot's plan is not there.
    ValueError
        It has no place in the frame.
    """
    members = team_members(path)
    lines = []
    for robot, member in enumerate(members or [path]):
        plan = read_plan(member)
        label = f"{name}, robot {robot + 1}" if members else name
        lines.append(_line(member, plan, label, frame) | {"colour": robot_line(robot)[0] if members else ""})
    return lines


def _line(path: Path, plan: PlanDocument, name: str, frame: Frame) -> dict[str, Any]:
    grid = grid_of(path, plan)
    cells = np.array(plan.cells, np.float64) + 0.5
    east, north = frame.of_cells(grid, cells[:, 0], cells[:, 1])
    waypoints = []
    for point in plan.waypoints:
        told = [f"step {point.step}, cell {point.cell[0]},{point.cell[1]}"]
        if point.lat is not None and point.lon is not None:
            told.append(f"{point.lat:.7f}, {point.lon:.7f}")
        told.append(f"x {point.x:.2f}, y {point.y:.2f}")
        waypoints.append(
            {
                "index": point.index,
                "e": round(float(east[point.step]), 3),
                "n": round(float(north[point.step]), 3),
                "lon": point.lon,
                "lat": point.lat,
                "x": point.x,
                "y": point.y,
                "told": told,
            }
        )
    return {
        "name": name,
        "path": np.round(np.stack([east, north], axis=1), 3).tolist(),
        "waypoints": waypoints,
        "crs": plan.grid.crs if plan.grid.crs is not None and len(plan.grid.crs) < 20 else "the scoremap's CRS",
        "length_m": plan.length_m,
        "steps": plan.steps,
    }


def reward_chart(scoremap: Path, plan: Path, name: str) -> tuple[dict[str, Any], float, float]:
    """Return what a plan collects on its way beside baselines and bound; its score, and its share of the bound.

    All is computed anew from the plan's cells and the scoremap that it was made from.

    Raises
    ------
    InputError
        See `hrt_cli.evaluation.plans.evaluate_plans`.
    """
    found = evaluate_plans(scoremap, (plan,), _BASELINES)
    worth = found.plans[str(plan)]
    return _chart(found.chart, name), worth.score, worth.fraction_of_bound


def _chart(chart: RewardChart, name: str) -> dict[str, Any]:
    series = [
        {
            "name": name if curve.role == "plan" else curve.name,
            "role": curve.role,
            "colour": "" if curve.role == "plan" else METHODS.get(curve.name, SOFT),
            "points": points(curve.travelled, curve.reward),
        }
        for curve in chart.curves
    ]
    return {
        "type": "lines",
        "title": f"{name}: {chart.title}",
        "x": "steps" if chart.unit == "steps" else "metres driven",
        "y": "discounted score" if chart.discounted else "score collected",
        "series": series,
        "levels": [{"y": chart.bound, "name": "upper bound"}],
    }
