"""`hrt evaluate plan`: plans beside other methods and the bound."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.evaluation.plans import PlanComparison
    from hrt_cli.evaluation.starts import StartsComparison

FIGURES = ("plans", "planner", "baselines", "upper_bound", "discounted_upper_bound")
"""Keys of the result without --starts."""


@click.command(
    cls=Command,
    difference="a --require does not hold",
    keys=FIGURES,
    see_also=("plan",),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 200
  hrt evaluate plan site/scoremap.tif site/plan.json --figure site/rewards.png
""",
)
@click.argument("scoremap", type=opt.SCOREMAP)
@click.argument("plans", nargs=-1, required=True, type=opt.PLAN)
@click.option(
    "--planner/--no-planner",
    default=True,
    show_default=True,
    help="Also plan the task afresh by the methods refined and policy, to compare with.",
)
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    help="Also run every method from so many starts, drawn from the cells connected to the plan's start.",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 100),
    show_default="1",
    help="With --starts: runs of each method from each of them.",
)
@opt.seed_opt
@opt.workers_opt
@opt.require_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def plan(
    scoremap: Path,
    plans: tuple[Path, ...],
    planner: bool,
    starts: int | None,
    seeds: int | None,
    seed: int,
    workers: int,
    demands: tuple[tuple[str, str, float], ...],
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Value PLANS on SCOREMAP afresh, beside the planner, lawnmower, rectangle, greedy, spiral, random and the bound.

    With --starts, every method is also run from other starts with the plans' budget and objective: the mean, the 95 %
    bootstrap interval of the mean, and the worst run. The figure shows the cumulative reward, of the plans or, with
    --starts, the mean over the starts. A figure that --require names is every plan's: 'fraction_of_bound>=0.97'.
    """
    from dataclasses import asdict, fields

    from hrt_cli.evaluation.demands import check_names, require
    from hrt_cli.evaluation.plans import Trials, Worth, evaluate_plans
    from hrt_cli.report.figures.rewards import begin_figure

    if seeds is not None and starts is None:
        raise click.UsageError("--seeds repeats the runs from each of --starts: give both")
    check_names(demands, (*(each.name for each in fields(Worth)), *FIGURES, *(("starts",) if starts else ())))
    trials = Trials(seed, planner, starts or 0, seeds or 1)
    drawing = begin_figure(scoremap, plans, figure, trials.parameters(), existing=existing) if figure else None
    with console.bar("evaluate") as progress:
        found = evaluate_plans(scoremap, plans, trials, workers=workers, progress=progress)
    if drawing is not None:
        drawing.draw(found.chart)
    data: dict[str, Any] = {
        "plans": {name: asdict(w) for name, w in found.plans.items()},
        "planner": {name: asdict(w) for name, w in found.planner.items()},
        "baselines": {name: asdict(w) for name, w in found.baselines.items()},
        "upper_bound": found.upper_bound,
        "discounted_upper_bound": found.discounted_upper_bound,
    }
    if found.starts is not None:
        methods = {name: asdict(each) for name, each in found.starts.methods.items()}
        data["starts"] = {"count": found.starts.count, "seeds": found.starts.seeds, "methods": methods}
    console.result("\n".join(_lines(found)), data, only_here=True)
    require(data, demands, within="plans")


def _lines(found: PlanComparison) -> list[str]:
    """Say what each plan and method is worth, the discounted score where that is the objective, then the table."""
    rows = [*found.plans.items(), *found.planner.items(), *found.baselines.items()]
    lines = [f"{name}: score {w.score:.2f}, {w.fraction_of_bound:.1%} of the bound" for name, w in rows]
    bound = f"upper bound {found.upper_bound:.2f}"
    if found.objective == "discounted":
        lines = [
            f"{line}; discounted score {w.discounted_score:.2f}, {w.fraction_of_discounted_bound:.1%} of its bound"
            for line, (_, w) in zip(lines, rows, strict=True)
        ]
        bound += f"; discounted {found.discounted_upper_bound:.2f}"
    return [*lines, bound, *(_table(found.starts, found.objective) if found.starts else [])]


def _table(found: StartsComparison, objective: str) -> list[str]:
    """Return the results over starts as aligned rows: of each measure the mean, its interval and the worst run."""
    share = "% of bound" if objective == "total" else "% of discounted bound"
    rows = [["", "score", "discounted score", share]]
    for name, each in found.methods.items():
        fraction = each.fraction_of_bound if objective == "total" else each.fraction_of_discounted_bound
        cells = [(each.score, 1), (each.discounted_score, 1), (fraction, 100)]
        rows.append(
            [name, *(f"{s.mean * k:.1f} [{s.low * k:.1f}, {s.high * k:.1f}] {s.worst * k:.1f}" for s, k in cells)]
        )
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    title = (
        f"{found.count} starts, {found.seeds} {'seed' if found.seeds == 1 else 'seeds'}: "
        "mean [95 % interval of the mean] worst run"
    )
    return [
        title,
        *(
            "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
            for row in rows
        ),
    ]
