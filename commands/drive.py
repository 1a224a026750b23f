"""`hrt drive`: a simulated robot drives a plan on a site."""

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
    sections={
        "Way": "--world --roam --after --stay --time-limit",
        "Robot": "--vehicle --local --model --rescue --disturb --seed",
        "Output": "--record",
    },
    keys=("output", "up_to_date", "end", "place", "distance_m", "duration_s", "collisions", "interventions", "notes"),
    see_also=("plan", "evaluate drive", "feedback", "train-steer"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 30
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 2min
  hrt drive site/plan.json --world site -o site/drive.jsonl --local expert
  hrt drive --world site --roam 30 --local expert --disturb 0.3 --record site/frames -o site/roam.jsonl
""",
)
@click.argument("plan", type=opt.PLAN, required=False)
@click.option(
    "--world",
    type=opt.FOLDER,
    help="Folder of the site: ortho.tif, dsm.tif and, where the truth is known, truth.tif and world.json.",
)
@opt.output("DRIVE.jsonl")
@click.option(
    "--local",
    type=click.Choice(["pursuit", "expert", "teacher", "steer"]),
    default="pursuit",
    show_default=True,
    help="Who steers between waypoints: pursuit follows the path and sees nothing, the expert sees the site as it is, "
    "the teacher does, too, and makes for the point ahead that a learner is told, steer has a camera and a --model.",
)
@click.option("--model", type=opt.STEERING, help="Steering model of --local steer (hrt train-steer).")
@click.option(
    "--roam",
    "roam_m",
    type=opt.FiniteFloat(1, 100_000),
    help="Without a PLAN: drive so many metres between random places of the site (by --seed).",
)
@click.option(
    "--disturb",
    type=opt.FiniteFloat(0, 0.9),
    default=0.0,
    show_default=True,
    help="Share of the time that the robot is pushed off its way: a --record then shows how to get back.",
)
@click.option(
    "--rescue", is_flag=True, help="Where --local steer gets no farther, the teacher drives a little: for a --record."
)
@click.option(
    "--vehicle",
    type=click.Choice(["ugv", "auv"]),
    help="ugv drives on the ground, auv swims. Default: auv where the site is under water, else ugv.",
)
@click.option("--after", type=opt.LOG, help="Log of the drive that this one goes on from: it begins where that ended.")
@click.option(
    "--record",
    type=opt.File("FOLDER", writes=True),
    help="Folder for what the camera saw: frames, and labels.csv with the expert's steering, to train on.",
)
@click.option(
    "--time-limit",
    "time_limit_s",
    type=opt.FiniteFloat(0, low_open=True),
    help="End after so many seconds. Default: the plan's budget where that is in minutes.",
)
@click.option(
    "--stay", is_flag=True, help="Do not drive: log that the robot stays where it is. Takes no --world, only --after."
)
@opt.seed_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def drive(
    plan: Path | None,
    world: Path | None,
    output: Path,
    local: str,
    model: Path | None,
    roam_m: float | None,
    disturb: float,
    rescue: bool,
    vehicle: str | None,
    after: Path | None,
    record: Path | None,
    time_limit_s: float | None,
    stay: bool,
    seed: int,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Drive PLAN on a site in simulation and log what the robot would have logged, never the truth.

    Without a PLAN it roams (--roam). The drive ends at the end of its way, when the robot is stuck, or when its time
    is over.
    """
    if stay == (world is not None):
        raise click.UsageError("give the --world that the robot drives on, or say --stay: one of the two")
    if (plan is None) == (roam_m is None):
        raise click.UsageError("give a PLAN to drive, or --roam METRES: one of the two")
    if plan is None and (stay or after):
        raise click.UsageError("--stay and --after are of a PLAN")
    if (local == "steer") != (model is not None):
        raise click.UsageError("--local steer needs a --model, and no other takes one")
    if figure is not None and world is None:
        raise click.UsageError("--figure is of a drive on a --world")
    if rescue and local != "steer":
        raise click.UsageError("--rescue is for --local steer")
    from hrt_cli.driving.stage import DriveRequest, drive_file, stay_file

    if world is None:
        assert plan is not None
        done = stay_file(plan, output, after=after, existing=existing)
    else:
        request = DriveRequest(local, model, vehicle, roam_m, disturb, rescue, time_limit_s, seed)
        with console.bar("drive") as progress:
            done = drive_file(
                plan, world, output, request, after=after, record=record, existing=existing, progress=progress
            )
    if figure is not None and world is not None:
        from hrt_cli.report.figures.drive import draw_drive
        from hrt_cli.world.site import site_files

        caption = (
            f"{local}: {done.end} after {done.distance_m:.0f} m and {done.duration_s:.0f} s, "
            f"{done.collisions} collision{'s' * (done.collisions != 1)}, "
            f"{done.interventions} intervention{'s' * (done.interventions != 1)}"
        )
        draw_drive(output, figure, plan=plan, backdrop=site_files(world)["ortho"], caption=caption, existing=existing)
    for note in done.notes:
        console.note(f"Note: {note}")
    state = " (up to date)" if done.up_to_date else ""
    console.result(
        f"{output}: {done.end} at {done.place[0]:.2f}, {done.place[1]:.2f} after {done.distance_m:.0f} m and "
        f"{done.duration_s:.0f} s, {done.collisions} collisions, {done.interventions} interventions{state}",
        {"output": str(output), **asdict(done)},
    )
