"""`hrt hello`: say hello at every waypoint of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command

if TYPE_CHECKING:
    from pathlib import Path

    from hrt_cli.progress import Console


@click.command(
    cls=Command,
    keys=("plan", "waypoints"),
    see_also=("plan",),
    epilog="""\b
Example:
  hrt hello plan.json
""",
)
@click.argument("plan", type=opt.PLAN)
@opt.console_options
def hello(plan: Path, console: Console) -> None:
    """Say hello at every waypoint of PLAN.

    PLAN is the output of `hrt plan`, for one robot.
    """
    from hrt_cli.artifacts.plan import read_plan

    found = read_plan(plan)
    lines = [f"step {each.step}: hello, cell {each.cell}" for each in found.waypoints]
    console.result("\n".join(lines), {"plan": str(plan), "waypoints": len(lines)}, only_here=True)
