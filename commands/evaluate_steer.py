"""`hrt evaluate steer`: how far off a steering model is, and whether it knows it."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hrt_cli import options as opt
from hrt_cli.errors import DifferenceError
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.evaluation.steering import SteerMeasure

FIGURES = ("skipped", "constant", "sessions", "reliability", "confusion")
"""Keys of the result beside those of `Measure`."""


@click.command(
    cls=Command,
    difference="a --require does not hold, or the model is no better than a constant that it is to be better than",
    keys=(
        "mae",
        "rmse",
        "accuracy",
        "nll",
        "ece",
        "constant_baseline_mae",
        "frames",
        "skipped",
        "constant",
        "sessions",
    ),
    see_also=("train-steer", "steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt drive --world site --roam 30 --local expert --disturb 0.3 --record site/frames -o site/drive.jsonl
  hrt train-steer site/frames -o site/steer.safetensors --size 64x48 --epochs 1
  hrt evaluate steer site/steer.safetensors site/frames --figure site/steer.png
""",
)
@click.argument("model", type=opt.ANY_STEERING)
@click.argument("data", nargs=-1, required=True, type=opt.FOLDER)
@click.option(
    "--require-better-than-constant",
    is_flag=True,
    help="Exit with 3 unless the error is smaller than that of always steering the median of the labels.",
)
@opt.require_opt
@opt.skip_bad_opt
@opt.correction_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def steer(
    model: Path,
    data: tuple[Path, ...],
    require_better_than_constant: bool,
    demands: tuple[tuple[str, str, float], ...],
    skip_bad: bool,
    correction: float,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Measure MODEL, a .safetensors or an exported .onnx, on the recordings in the folders DATA.

    Errors are of the expected angle, in units of full lock; the negative log-likelihood and the expected calibration
    error say how well the model knows what it does not know. Beside them stands the error of always steering one
    angle, the median of these labels: a model that is no better has learnt nothing. Data that were trained on say
    little about others.
    """
    from hrt_cli.evaluation.demands import check_names, require
    from hrt_cli.evaluation.steering import evaluate_steer
    from hrt_cli.steering.network.metrics import Measure

    check_names(demands, (*(each.name for each in fields(Measure)), *FIGURES))
    with console.bar("evaluate") as progress:
        found = evaluate_steer(
            model, data, skip_bad=skip_bad, correction=correction, progress=progress, note=console.note
        )
    if figure is not None:
        from hrt_cli.report.figures.steering import draw_steering

        inputs = {"model": model} | {f"labels/{index}": path for index, path in enumerate(found.files)}
        draw_steering(inputs, figure, found, digest=found.digest, caption=_line(found), existing=existing)
    document = _document(found)
    console.result(f"{model}: {_line(found)}", document, only_here=True)
    require(document, demands)
    mae, constant = found.total.mae, found.total.constant_baseline_mae
    if require_better_than_constant and mae >= constant:
        raise DifferenceError(
            f"{model}: the mean absolute error is {mae:.4g}, no less than that of a constant, {constant:.4g}"
        )


def _line(found: SteerMeasure) -> str:
    total = found.total
    skipped = f", {found.skipped} skipped" if found.skipped else ""
    return (
        f"MAE {total.mae:.3f} (a constant: {total.constant_baseline_mae:.3f}), RMSE {total.rmse:.3f}, "
        f"accuracy {total.accuracy:.1%}, NLL {total.nll:.2f}, ECE {total.ece:.3f}; "
        f"{total.frames} frames of {len(found.sessions)} session{'s'[: len(found.sessions) > 1]}{skipped}"
    )


def _document(found: SteerMeasure) -> dict[str, Any]:
    return {
        **asdict(found.total),
        "skipped": found.skipped,
        "constant": found.constant,
        "sessions": {name: asdict(each) for name, each in found.sessions.items()},
        "reliability": {name: each.bins() for name, each in found.reliability.items()},
        "confusion": {name: each.tolist() for name, each in found.confusion.items()},
    }
