"""`hrt train-plan`: score maps become a planning policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing

FAMILIES = ("gaussians", "noise", "classes", "obstacles", "speckle", "islands", "trails")


@click.command(
    "train-plan",
    cls=Command,
    sections={
        "Maps": "--family --map-side --maps-per-iteration --eight",
        "Training": "--estimator --features --iterations --rollouts --budget --learning-rate --trace-decay --seed",
        "Output": "--figure",
    },
    files=".OUTPUT.hrt-checkpoint, beside the output, keeps a training that was stopped.",
    keys=(
        "output",
        "up_to_date",
        "resumed_at",
        "steps",
        "steps_per_second",
        "seconds",
        "final_share",
        "learning_curve",
    ),
    see_also=("plan",),
    epilog="""\b
Example:
  hrt train-plan -o policy.npz --iterations 20 --seed 1 --figure curve.png
""",
)
@click.argument("scoremaps", nargs=-1, type=opt.SCOREMAP)
@opt.output("POLICY.npz")
@click.option(
    "--estimator",
    type=click.Choice(["gpomdp", "reinforce"]),
    default="gpomdp",
    show_default=True,
    help="Gradient estimator: rewards to go against a baseline per time step, or whole returns.",
)
@click.option(
    "--features",
    type=click.Choice(["network", "rings", "manjanna24"]),
    default="network",
    show_default=True,
    help="Multi-resolution features: ours with hinge units, our plain ones, or the 24 of Manjanna and Dudek.",
)
@click.option(
    "--iterations", type=click.IntRange(1, 1_000_000), default=300, show_default=True, help="Steps of the optimiser."
)
@click.option(
    "--maps-per-iteration",
    type=click.IntRange(1, 10_000),
    default=8,
    show_default=True,
    help="Maps of an iteration, each with its own start.",
)
@click.option("--rollouts", type=click.IntRange(2, 10_000), default=16, show_default=True, help="Rollouts on each map.")
@click.option("--budget", type=click.IntRange(1, 100_000), default=250, show_default=True, help="Moves of a rollout.")
@click.option(
    "--learning-rate",
    type=opt.FiniteFloat(0, 100, low_open=True),
    default=0.1,
    show_default=True,
    help="Adam's step at the start.",
)
@click.option(
    "--trace-decay",
    type=opt.FiniteFloat(0, 1, low_open=True),
    default=0.98,
    show_default=True,
    help="Weight, per time step, of later rewards (gpomdp): 1 is unbiased, less varies less.",
)
@click.option(
    "--eight",
    type=opt.FiniteFloat(0, 1),
    default=0.25,
    show_default=True,
    help="Share of the maps on which diagonal moves are allowed.",
)
@click.option(
    "--family",
    "families",
    multiple=True,
    type=click.Choice(FAMILIES),
    help="Kind of generated maps. Default: all.",
)
@click.option("--map-side", type=click.IntRange(4, 1024), help="Cells across a generated map. Default: 64.")
@opt.seed_opt
@click.option(
    "--figure",
    "--curve",
    "curve",
    type=opt.File("CURVE.png", ".json", writes=True),
    help="Also write the learning curve: a figure (.png) or its numbers (.json).",
)
@opt.existing_options
@opt.console_options
def train_plan(
    scoremaps: tuple[Path, ...],
    output: Path,
    estimator: str,
    features: str,
    iterations: int,
    maps_per_iteration: int,
    rollouts: int,
    budget: int,
    learning_rate: float,
    trace_decay: float,
    eight: float,
    families: tuple[str, ...],
    map_side: int | None,
    seed: int,
    curve: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Train a planning policy by policy gradients, on SCOREMAPS or on generated maps where none is given.

    The same seed gives the same bytes. The policies that ship with hrt are what this command writes by default, and
    with --features manjanna24. A training that was stopped goes on where it was when the same command is run again;
    to begin anew instead, delete .OUTPUT.hrt-checkpoint.
    """
    if scoremaps and (families or map_side is not None):
        raise click.UsageError("--family and --map-side are for generated maps, and SCOREMAPS are given")
    from hrt_cli.planning.train import TrainSpec
    from hrt_cli.planning.training import train_file
    from hrt_cli.report.figures.curve import check_curve_target, draw_curve

    if curve is not None:
        check_curve_target(curve, [*scoremaps])
    spec = TrainSpec(
        estimator=estimator,
        layout=features,
        iterations=iterations,
        maps_per_iteration=maps_per_iteration,
        rollouts=rollouts,
        moves=budget,
        learning_rate=learning_rate,
        trace_decay=trace_decay,
        eight=eight,
        seed=seed,
        families=families or FAMILIES,
        map_side=map_side or 64,
    )
    with console.bar("train-plan") as progress:
        done = train_file(scoremaps, output, spec, existing=existing, progress=progress, note=console.note)
    if curve is not None:
        on = f"{len(scoremaps)} scoremap{'s'[: len(scoremaps) > 1]}" if scoremaps else "generated maps"
        caption = f"learning curve: {estimator}, features {features}, {on}, seed {seed}"
        draw_curve(output, curve, steps=done.steps, last=done.last, caption=caption, existing=existing)
    speed = done.steps_per_second
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    state += "" if speed is None else f", {speed / 1e6:.2f} M steps/s"
    state += f", from iteration {done.resumed_at} on" if done.resumed_at else ""
    console.result(
        f"{output}: collects {done.final_share:.1%} of the best cells in training ({state})",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "resumed_at": done.resumed_at,
            "steps": done.steps,
            "steps_per_second": speed,
            "seconds": done.seconds,
            "final_share": done.final_share,
            "learning_curve": [float(value) for value in done.learning_curve],
        },
    )
