"""`hrt evaluate`: measure what a stage made."""

from __future__ import annotations

from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.progress import Console


@click.group()
def evaluate() -> None:
    """Measure a segmentation or plans against the truth."""


@evaluate.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt evaluate segment site/classes.tif site/truth.tif
"""
)
@click.argument("classes", type=opt.PATH)
@click.argument("truth", type=opt.PATH)
@opt.unreferenced_opt
@opt.console_options
def segment(classes: Path, truth: Path, unreferenced: bool, console: Console) -> None:
    """Compare CLASSES with TRUTH, two class rasters on the same grid, whatever numbers their classes bear."""
    from hrt_cli.evaluation.segment import evaluate_segmentation

    found = evaluate_segmentation(classes, truth, unreferenced=unreferenced)
    console.result(
        f"{classes}: ARI {found.ari:.3f}, NMI {found.nmi:.3f}, matched accuracy {found.accuracy:.3f}",
        {
            "ari": found.ari,
            "nmi": found.nmi,
            "accuracy": found.accuracy,
            "matching": {str(k): v for k, v in found.matching.items()},
            "confusion": found.confusion.tolist(),
            "class_ids": found.class_ids,
            "truth_ids": found.truth_ids,
        },
        only_here=True,
    )


@evaluate.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 200
  hrt evaluate plan site/scoremap.tif site/plan.json
"""
)
@click.argument("scoremap", type=opt.PATH)
@click.argument("plans", nargs=-1, required=True, type=opt.PATH)
@opt.seed_opt
@opt.console_options
def plan(scoremap: Path, plans: tuple[Path, ...], seed: int, console: Console) -> None:
    """Value PLANS on SCOREMAP afresh, beside lawnmower, rectangle, greedy, spiral and random, and the upper bound."""
    from dataclasses import asdict

    from hrt_cli.evaluation.plans import evaluate_plans

    found = evaluate_plans(scoremap, plans, seed=seed)
    rows = [*found.plans.items(), *found.baselines.items()]
    lines = [f"{name}: score {w.score:.2f}, {w.fraction_of_bound:.1%} of the bound" for name, w in rows]
    console.result(
        "\n".join([*lines, f"upper bound {found.upper_bound:.2f}"]),
        {
            "plans": {name: asdict(w) for name, w in found.plans.items()},
            "baselines": {name: asdict(w) for name, w in found.baselines.items()},
            "upper_bound": found.upper_bound,
        },
        only_here=True,
    )
