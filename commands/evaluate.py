"""`hrt evaluate`: measure what a stage made."""

from __future__ import annotations

from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.artifacts.stage import Existing
from hrt_cli.progress import Console


@click.group()
def evaluate() -> None:
    """Measure a segmentation or plans against the truth."""


@evaluate.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt evaluate segment site/classes.tif site/truth.tif --figure site/agreement.png
"""
)
@click.argument("classes", type=opt.PATH)
@click.argument("truth", type=opt.PATH)
@click.option(
    "--tolerance-m",
    type=opt.FiniteFloat(0),
    help="How far boundaries may lie apart, m. Default: 0.5, or one pixel where that is more; "
    "with --unreferenced in pixels, 0.75 % of the diagonal.",
)
@opt.unreferenced_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def segment(
    classes: Path,
    truth: Path,
    tolerance_m: float | None,
    unreferenced: bool,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Compare CLASSES with TRUTH, two class rasters on the same grid, whatever numbers their classes bear.

    Areas: adjusted Rand index, mutual information, accuracy and intersection over union under the best one-to-one
    matching; per class of the truth with --json, with the recall by majority vote where there are more classes than
    truths. Boundaries: the share of either that lies within the tolerance of the other, and their F-score.
    """
    from dataclasses import asdict

    from hrt_cli.evaluation.segment import evaluate_segmentation

    with console.bar("evaluate") as progress:
        found = evaluate_segmentation(
            classes, truth, tolerance_m=tolerance_m, unreferenced=unreferenced, progress=progress
        )
    areas, boundary = found.areas, found.boundary
    line = (
        f"ARI {areas.ari:.3f}, NMI {areas.nmi:.3f}, matched accuracy {areas.accuracy:.3f}, "
        f"mean IoU {areas.mean_iou:.3f}, boundary F {boundary.f:.3f} ({found.tolerance_m:.3g} "
        f"{'px' if unreferenced else 'm'})"
    )
    if figure is not None:
        from hrt_cli.report.agreement import draw_agreement

        draw_agreement(classes, truth, figure, areas, line, unreferenced=unreferenced, existing=existing)
    console.result(
        f"{classes}: {line}",
        {
            "ari": areas.ari,
            "nmi": areas.nmi,
            "accuracy": areas.accuracy,
            "mean_iou": areas.mean_iou,
            "vote_recall": areas.vote_recall,
            "boundary_f": boundary.f,
            "boundary_precision": boundary.precision,
            "boundary_recall": boundary.recall,
            "boundary_tolerance_m": found.tolerance_m,
            "per_class": [asdict(each) for each in areas.per_class],
            "matching": {str(k): v for k, v in areas.matching.items()},
            "confusion": areas.confusion.tolist(),
            "class_ids": areas.class_ids,
            "truth_ids": areas.truth_ids,
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
