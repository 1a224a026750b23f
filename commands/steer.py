"""`hrt steer`: pictures become steering, by a trained network."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing


@click.command(
    cls=Command,
    sections={
        "Output": "--overlay --saliency",
    },
    keys=(
        "output",
        "overlay",
        "up_to_date",
        "frames",
        "skipped",
        "passes",
        "two_ways",
        "mean",
        "mean_spread",
        "seconds",
    ),
    see_also=("train-steer", "evaluate steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt drive --world site --roam 30 --local expert --disturb 0.3 --record site/frames -o site/drive.jsonl
  hrt train-steer site/frames -o site/steer.safetensors --size 64x48 --epochs 1
  hrt steer site/steer.safetensors site/frames -o site/steering.json --overlay site/seen --saliency
""",
)
@click.argument("model", type=opt.ANY_STEERING)
@click.argument("inputs", nargs=-1, required=True, type=opt.PATH)
@opt.output("STEERING.json")
@click.option(
    "--overlay", type=opt.File("FOLDER", writes=True), help="Folder for each frame with its prediction drawn in."
)
@click.option("--saliency", is_flag=True, help="With --overlay: show what in the picture turned yaw left and right.")
@click.option(
    "--passes",
    type=click.IntRange(0, 10_000),
    default=50,
    show_default=True,
    help="Networks drawn by dropout, for the uncertainty; 0 for none.",
)
@click.option(
    "--goal",
    "goal_deg",
    type=opt.FiniteFloat(-180, 180),
    help="Bearing to go to, right positive, for frames whose labels give none.",
)
@click.option(
    "--every", type=click.IntRange(1, 1_000_000), default=1, show_default=True, help="Of videos, take each Nth frame."
)
@click.option(
    "--batch",
    type=click.IntRange(1, 1024),
    default=16,
    show_default=True,
    help="Pictures that the network sees at a time.",
)
@opt.skip_bad_opt
@opt.seed_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def steer(
    model: Path,
    inputs: tuple[Path, ...],
    output: Path,
    overlay: Path | None,
    saliency: bool,
    passes: int,
    goal_deg: float | None,
    every: int,
    batch: int,
    skip_bad: bool,
    seed: int,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Predict with MODEL how to steer in INPUTS: pictures, folders of pictures, recordings or videos.

    Writes for each frame the angle, in [-1, 1] with right and up positive, the whole distribution over the angles and
    how sure it is. Where the network sees two ways round an obstacle the mean angle leads into it: such frames are
    counted, and their likeliest angle stands in the file as yaw_mode.
    """
    if saliency and overlay is None:
        raise click.UsageError("--saliency is drawn into overlays: give --overlay FOLDER")
    from hrt_cli.steering.prediction.stage import SteerRequest, steer_files

    request = SteerRequest(passes, every, goal_deg, batch, skip_bad, seed)
    with console.bar("steer") as progress:
        done = steer_files(
            model,
            inputs,
            output,
            request,
            overlay=overlay,
            saliency=saliency,
            existing=existing,
            progress=progress,
            note=console.note,
        )
    if figure is not None:
        from hrt_cli.report.figures.predictions import draw_predictions
        from hrt_cli.steering.prediction.predictions import read_predictions

        found = read_predictions(output)
        caption = f"{model.name}: {done.frames} frames, {done.two_ways} in which it sees two ways"
        draw_predictions(output, found.frames, found.model.outputs, figure, caption=caption, existing=existing)
    rate = done.frames / done.seconds if done.seconds > 0 else None
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    angles = ", ".join(f"{name} {mean:+.3f} (sd {done.mean_spread[name]:.3f})" for name, mean in done.mean.items())
    skipped = f", {done.skipped} left out" if done.skipped else ""
    console.result(
        f"{output}: {done.frames} frames{skipped}, on average {angles} ({state})",
        {
            "output": str(output),
            "overlay": None if overlay is None else str(overlay),
            "up_to_date": done.up_to_date,
            "frames": done.frames,
            "skipped": done.skipped,
            "passes": done.passes,
            "two_ways": done.two_ways,
            "mean": done.mean,
            "mean_spread": done.mean_spread,
            "seconds": done.seconds,
            "frames_per_second": rate,
        },
    )
    if done.two_ways:
        console.note(
            f"Note: in {done.two_ways} frames the network sees two ways: their mean lies between, yaw_mode is likelier"
        )
