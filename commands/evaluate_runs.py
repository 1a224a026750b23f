"""`hrt evaluate runs`: many plans in one table, and what the seeds of one task make of its bound."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.evaluation.runs import Spread, Task


@click.command(
    cls=Command,
    keys=("plans", "tasks"),
    see_also=("plan", "evaluate plan", "compare"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan-0.json --start auto --budget 200 --seed 0
  hrt plan site/scoremap.tif -o site/plan-1.json --start auto --budget 200 --seed 1
  hrt evaluate runs site/plan-0.json site/plan-1.json --table site/runs.csv
""",
)
@click.argument("plans", nargs=-1, required=True, type=opt.PLAN)
@click.option("--table", type=opt.File("TABLE.csv", writes=True), help="Also write a row for each plan (.csv).")
@opt.figure_opt
@opt.existing_options
@opt.console_options
def runs(
    plans: tuple[Path, ...], table: Path | None, figure: Path | None, existing: Existing, console: Console
) -> None:
    """Put PLANS of several sites and seeds side by side.

    Plans that differ in nothing but the seed are of one task: for each is told what its seeds make of the least bound
    that they prove. The figures are those in the plans, as hrt plan wrote them; no map is needed.
    """
    from dataclasses import asdict

    from hrt_cli.evaluation.runs import compare_runs, write_table

    found = compare_runs(plans)
    if table is not None:
        write_table(found, table, existing=existing)
    if figure is not None:
        from hrt_cli.report.figures.runs import draw_runs

        draw_runs(found, figure, existing=existing)
    console.result("\n".join(_line(task) for task in found.tasks), asdict(found), only_here=True)


def _line(task: Task) -> str:
    plans = f"{len(task.plans)} {'plan' if len(task.plans) == 1 else 'plans'}"
    shares = task.fraction_of_discounted_bound if task.objective == "discounted" else task.fraction_of_bound
    bound = "discounted bound" if task.objective == "discounted" else "bound"
    share = f", {_percent(shares)} of the {bound}" if shares else ""
    return (
        f"{task.name}: {plans} by {task.method}: score {_range(task.score)}{share}, "
        f"{_range(task.length_m)} m; best {task.best}"
    )


def _range(figure: Spread) -> str:
    return f"{figure.mean:.2f}" + ("" if figure.sd is None else f" ({figure.min:.2f} to {figure.max:.2f})")


def _percent(figure: Spread) -> str:
    return f"{figure.mean:.1%}" + ("" if figure.sd is None else f" ({figure.min:.1%} to {figure.max:.1%})")
