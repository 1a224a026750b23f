"""`hrt record`: a site becomes steering data without a drive."""

from __future__ import annotations

from dataclasses import asdict
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
    keys=("output", "up_to_date", "frames", "near", "resumed_at"),
    see_also=("drive", "train-steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt record site -o site/glances --frames 200
""",
)
@click.argument("world", type=opt.FOLDER)
@opt.output("FOLDER", "Folder for frames and labels.csv, to train on.")
@click.option("--frames", type=click.IntRange(1, 1_000_000), default=10_000, show_default=True, help="Frames to make.")
@click.option(
    "--near",
    type=opt.FiniteFloat(0, 1),
    default=0.8,
    show_default=True,
    help="Share of the frames with something in the way: a drive shows mostly open ground.",
)
@click.option(
    "--vehicle",
    type=click.Choice(["ugv", "auv"]),
    help="ugv drives on the ground, auv swims. Default: auv where the site is under water, else ugv.",
)
@opt.seed_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def record(
    world: Path,
    output: Path,
    frames: int,
    near: float,
    vehicle: str | None,
    seed: int,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Look from random places of a site and tell how to steer there: steering data without a drive.

    WORLD is a folder with ortho.tif and dsm.tif. Each frame comes with what every turn would cost there on the way to
    several goals. A recording that was stopped or killed goes on where it was when the same command is run again.
    """
    from hrt_cli.driving.glance_stage import GlanceRequest, record_folder

    with console.bar("record") as progress:
        done = record_folder(
            world,
            output,
            GlanceRequest(frames, near, vehicle, seed),
            existing=existing,
            progress=progress,
            note=console.note,
        )
    if figure is not None:
        from hrt_cli.report.figures.frames import draw_frames
        from hrt_cli.steering.recordings.labels import read_labels

        caption = f"{done.frames} frames, {done.near} with something in the way; seed {seed}"
        seen = read_labels(output).frames
        draw_frames(output / "recording.json", seen, figure, caption=caption, existing=existing)
    state = " (up to date)" if done.up_to_date else ""
    console.result(
        f"{output}: {done.frames} frames, {done.near} with something in the way{state}",
        {"output": str(output), **asdict(done)},
    )
