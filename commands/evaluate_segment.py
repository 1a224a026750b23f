"""`hrt evaluate segment`: a class raster beside the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing

FIGURES = (
    "ari",
    "nmi",
    "accuracy",
    "mean_iou",
    "vote_recall",
    "boundary_f",
    "boundary_precision",
    "boundary_recall",
    "boundary_tolerance_m",
    "per_class",
    "matching",
    "confusion",
    "class_ids",
    "truth_ids",
)
"""Keys of the result."""


@click.command(
    cls=Command,
    difference="a --require does not hold",
    keys=FIGURES,
    see_also=("segment",),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt evaluate segment site/classes.tif site/truth.tif --figure site/agreement.png --require 'ari>=0.8'
""",
)
@click.argument("classes", type=opt.CLASSES)
@click.argument("truth", type=opt.CLASSES)
@click.option(
    "--tolerance-m",
    type=opt.FiniteFloat(0),
    help="How far boundaries may lie apart. Default: 0.5, or one pixel where that is more; "
    "with --unreferenced in pixels, 0.75 % of the diagonal.",
)
@opt.unreferenced_opt
@opt.require_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def segment(
    classes: Path,
    truth: Path,
    tolerance_m: float | None,
    unreferenced: bool,
    demands: tuple[tuple[str, str, float], ...],
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

    from hrt_cli.evaluation.demands import check_names, require
    from hrt_cli.evaluation.segment import evaluate_segmentation

    check_names(demands, FIGURES)
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
        from hrt_cli.report.figures.agreement import draw_agreement

        draw_agreement(classes, truth, figure, areas, line, unreferenced=unreferenced, existing=existing)
    data = {
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
    }
    console.result(f"{classes}: {line}", data, only_here=True)
    require(data, demands)
