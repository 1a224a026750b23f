"""`hrt train-steer`: folders of pictures and steering become a network that steers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.steering.training.stage import SteerTraining


@click.command(
    "train-steer",
    cls=Command,
    sections={
        "Start": "--weights --init",
        "Network": "--size --crop-top --half-classes --columns --spatial-dropout --goal",
        "Labels": "--sigma --cost-scale --entropy --correction",
        "Training": "--epochs --batch --learning-rate --weight-decay --patience --balance --augment",
        "Computing": "--threads --precision --seed",
        "Held out": "--validation --split --share --gap",
        "Output": "--figure --metrics",
    },
    files=".OUTPUT.hrt-checkpoint, beside the output, keeps a training that was stopped.",
    keys=(
        "output",
        "up_to_date",
        "mae",
        "rmse",
        "accuracy",
        "nll",
        "ece",
        "constant_baseline_mae",
        "frames",
        "skipped",
        "epochs",
        "best_epoch",
        "seconds",
    ),
    see_also=("drive", "record", "steer", "evaluate steer", "export-steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt drive --world site --roam 30 --local expert --disturb 0.3 --record site/frames -o site/drive.jsonl
  hrt train-steer site/frames -o site/steer.safetensors --size 64x48 --epochs 1 --figure site/steer.png
""",
)
@click.argument("data", nargs=-1, required=True, type=opt.FOLDER)
@opt.output("MODEL.safetensors")
@click.option("--validation", multiple=True, type=opt.FOLDER, help="Hold out this folder, in place of a split.")
@click.option(
    "--weights",
    type=opt.File("WEIGHTS.safetensors", ".pth", ".pt"),
    help="Begin from the file that torchvision publishes as resnet18.",
)
@click.option("--init", type=opt.STEERING, help="Begin from this steering model, of the same configuration.")
@click.option(
    "--size",
    type=opt.Size(32, 2048),
    default="160x120",
    show_default=True,
    help="Size of the picture that the network sees, pixels.",
)
@click.option(
    "--crop-top",
    type=opt.FiniteFloat(0, 0.9),
    default=0,
    show_default=True,
    help="Share of the picture cut off at its top before.",
)
@click.option(
    "--half-classes",
    type=click.IntRange(1, 127),
    default=7,
    show_default=True,
    help="M: the network chooses among 2M+1 angles.",
)
@click.option(
    "--columns",
    type=click.IntRange(1, 64),
    default=1,
    show_default=True,
    help="Parts side by side over which what is seen is averaged: from 2 on left is told from right.",
)
@click.option("--spatial-dropout", is_flag=True, help="Also drop channels before the last convolution.")
@click.option("--goal/--no-goal", default=True, show_default=True, help="Tell the network where to go, if the data do.")
@click.option(
    "--sigma",
    type=opt.FiniteFloat(0, 2),
    default=0.12,
    show_default=True,
    help="Width of smoothed labels (standard deviation), in units of full lock.",
)
@click.option(
    "--cost-scale",
    "cost_scale_s",
    type=opt.FiniteFloat(0, 1000),
    default=0.12,
    show_default=True,
    help="Seconds of turn_costs_s that leave an angle 1/e of the best's label; 0: labels of yaw alone.",
)
@click.option(
    "--entropy",
    "entropy_weight",
    type=opt.FiniteFloat(0, 10),
    default=0.05,
    show_default=True,
    help="Price of over-confidence.",
)
@click.option(
    "--epochs", type=click.IntRange(1, 100_000), default=60, show_default=True, help="Most passes over the data."
)
@click.option("--batch", type=click.IntRange(2, 65_536), default=64, show_default=True, help="Frames of a step.")
@click.option(
    "--learning-rate",
    type=opt.FiniteFloat(0, 100, low_open=True),
    default=1e-3,
    show_default=True,
    help="Learning rate at its highest.",
)
@click.option(
    "--weight-decay", type=opt.FiniteFloat(0, 100), default=1e-2, show_default=True, help="Weight decay of AdamW."
)
@click.option(
    "--patience",
    type=click.IntRange(0, 100_000),
    default=15,
    show_default=True,
    help="Epochs without getting better after which to end; 0: never.",
)
@click.option(
    "--split",
    type=click.Choice(["auto", "session", "block", "random"]),
    default="auto",
    show_default=True,
    help="What to hold out for validation.",
)
@click.option(
    "--share", type=opt.FiniteFloat(0.01, 0.9), default=0.2, show_default=True, help="Share of the data to hold out."
)
@click.option(
    "--gap",
    type=click.IntRange(0, 100_000),
    default=10,
    show_default=True,
    help="Frames left out beside those held out.",
)
@click.option(
    "--balance", type=opt.FiniteFloat(0, 1), default=0, show_default=True, help="1: every angle as often; 0: as is."
)
@click.option("--augment/--no-augment", default=True, show_default=True, help="Vary the pictures from pass to pass.")
@click.option(
    "--threads",
    type=click.IntRange(1, 1024),
    default=2,
    show_default=True,
    help="Threads of PyTorch. The result depends on it.",
)
@opt.seed_opt
@opt.correction_opt
@opt.skip_bad_opt
@click.option(
    "--precision",
    type=click.Choice(["auto", "float32", "bf16"]),
    default="auto",
    show_default=True,
    help="auto: bf16 where the machine computes it natively. The result depends on it.",
)
@click.option(
    "--figure",
    "--curve",
    "curve",
    type=opt.File("CURVE.png", writes=True),
    help="Also draw the learning curves as a PNG.",
)
@click.option(
    "--metrics", type=opt.File("METRICS.jsonl", writes=True), help="Also write the figures of each epoch as JSON Lines."
)
@opt.existing_options
@opt.console_options
def train_steer(
    data: tuple[Path, ...],
    output: Path,
    validation: tuple[Path, ...],
    weights: Path | None,
    init: Path | None,
    size: tuple[int, int],
    crop_top: float,
    half_classes: int,
    columns: int,
    spatial_dropout: bool,
    augment: bool,
    correction: float,
    skip_bad: bool,
    precision: Any,
    curve: Path | None,
    metrics: Path | None,
    existing: Existing,
    console: Console,
    **recipe: Any,
) -> None:
    """Train a network on DATA that steers from what the camera sees.

    DATA are folders: recordings of hrt (labels.csv), Donkeycar tubs, Udacity's driving_log.csv, or DroNet's. The same
    data, options and seed give the same bytes on the same kind of machine. A training that was stopped goes on where
    it was when the same command is run again; to begin anew instead, delete .OUTPUT.hrt-checkpoint.
    """
    from hrt_cli.report.figures.steering_curve import check_training_target, draw_training
    from hrt_cli.steering.network.net import SteeringConfig
    from hrt_cli.steering.training.augment import Augment
    from hrt_cli.steering.training.stage import train_steer_file
    from hrt_cli.steering.training.train import SteerSpec

    if curve is not None:
        check_training_target(curve, [each for each in (output, weights, init, metrics) if each is not None])
    config = SteeringConfig(
        width=size[0],
        height=size[1],
        crop_top=crop_top,
        half_classes=half_classes,
        columns=columns,
        spatial_dropout=spatial_dropout,
    )
    # The other options are named as the fields of the recipe.
    spec = SteerSpec(augment=Augment() if augment else Augment.none(), **recipe)
    with console.bar("train-steer") as progress:
        done = train_steer_file(
            data,
            output,
            spec,
            config,
            validation=validation,
            weights=weights,
            init=init,
            metrics=metrics,
            precision=precision,
            correction=correction,
            skip_bad=skip_bad,
            existing=existing,
            progress=progress,
            note=console.note,
        )
    record = done.record
    if curve is not None:
        caption = f"steering: {record.train_frames} training and {record.validation_frames} validation frames"
        draw_training(
            output,
            curve,
            [each.model_dump() for each in record.history],
            baseline=record.constant_baseline_mae,
            best_epoch=record.best_epoch,
            caption=f"{caption} ({record.split})",
            existing=existing,
        )
    if done.no_better_than_constant:
        console.note("Warning: the model steers no better than one constant angle would; do not drive with it")
    console.result(f"{output}: {_line(done)}", {"output": str(output), **_figures(done)})


def _line(done: SteerTraining) -> str:
    record, best = done.record, done.record.best
    beside = "NO BETTER than" if done.no_better_than_constant else "beside"
    parts = [
        f"MAE {best.mae:.3f}, {beside} {record.constant_baseline_mae:.3f} of one constant angle",
        f"accuracy {best.accuracy:.1%}, NLL {best.nll:.2f}, ECE {best.ece:.3f}",
        f"{record.validation_frames} validation frames",
        f"epoch {record.best_epoch} of {len(record.history)}",
    ]
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    state += "" if done.images_per_second is None else f", {done.images_per_second:.0f} images/s"
    state += f", from step {done.resumed_at} on" if done.resumed_at else ""
    return f"{'; '.join(parts)} ({state})"


def _figures(done: SteerTraining) -> dict[str, Any]:
    record, best = done.record, done.record.best
    return {
        "up_to_date": done.up_to_date,
        "resumed_at": done.resumed_at,
        "mae": best.mae,
        "rmse": best.rmse,
        "accuracy": best.accuracy,
        "nll": best.nll,
        "ece": best.ece,
        "constant_baseline_mae": record.constant_baseline_mae,
        "outputs": best.outputs,
        "temperature": best.temperature,
        "dropout": best.dropout,
        "frames": record.train_frames + record.validation_frames,
        "skipped": record.skipped,
        "train_frames": record.train_frames,
        "validation_frames": record.validation_frames,
        "sessions": record.sessions,
        "split": record.split,
        "epochs": len(record.history),
        "best_epoch": record.best_epoch,
        "seconds": done.seconds,
        "images_per_second": done.images_per_second,
        "device": done.arithmetic.device,
        "precision": done.arithmetic.precision,
    }
