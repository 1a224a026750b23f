"""`hrt train-plan`: score maps become a planning policy."""

from __future__ import annotations

from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.artifacts.stage import Existing
from hrt_cli.progress import Console


@click.command(
    "train-plan",
    epilog="""\b
Example:
  hrt train-plan -o policy.npz --iterations 20 --seed 1
""",
)
@click.argument("scoremaps", nargs=-1, type=opt.PATH)
@opt.output_opt
@click.option(
    "--estimator",
    type=click.Choice(["gpomdp", "reinforce"]),
    default="gpomdp",
    show_default=True,
    help="Gradient estimator: rewards to go against a baseline per time step, or whole returns.",
)
@click.option(
    "--features",
    type=click.Choice(["rings", "manjanna24"]),
    default="rings",
    show_default=True,
    help="Multi-resolution features: ours, or the 24 of Manjanna and Dudek.",
)
@click.option(
    "--iterations", type=click.IntRange(1, 1_000_000), default=300, show_default=True, help="Steps of the optimiser."
)
@click.option("--rollouts", type=click.IntRange(2, 10_000), default=16, show_default=True, help="On each map.")
@click.option("--budget", type=click.IntRange(1, 100_000), default=250, show_default=True, help="Steps of a rollout.")
@opt.seed_opt
@opt.existing_options
@opt.console_options
def train_plan(
    scoremaps: tuple[Path, ...],
    output: Path,
    estimator: str,
    features: str,
    iterations: int,
    rollouts: int,
    budget: int,
    seed: int,
    existing: Existing,
    console: Console,
) -> None:
    """Train a planning policy by policy gradients, on SCOREMAPS or on generated maps where none is given.

    The same seed gives the same bytes. The policy that ships with hrt is what this command writes by default.
    """
    from hrt_cli.planning.train import TrainSpec
    from hrt_cli.planning.training import train_file

    spec = TrainSpec(
        estimator=estimator, layout=features, iterations=iterations, rollouts=rollouts, moves=budget, seed=seed
    )
    with console.bar("train-plan") as progress:
        done = train_file(scoremaps, output, spec, existing=existing, progress=progress)
    speed = done.steps / done.seconds if done.seconds else None
    last = float(done.learning_curve[-10:].mean())
    state = "up to date" if speed is None else f"{done.seconds:.1f} s, {speed / 1e6:.2f} M steps/s"
    console.result(
        f"{output}: collects {last:.1%} of the best cells in training ({state})",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "steps": done.steps,
            "steps_per_second": speed,
            "seconds": done.seconds,
            "learning_curve": [float(value) for value in done.learning_curve],
        },
    )
