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
