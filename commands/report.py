"""`hrt report`: one offline page of whatever a folder holds."""

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
    sections={"Page": "--title --world --detail --frames"},
    keys=("output", "up_to_date", "bytes", "sites", "layers", "plans", "drives", "charts", "problems"),
    see_also=("evaluate", "verify"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 100
  hrt drive site/plan.json --world site -o site/drive.jsonl
  hrt report site -o report.html
""",
)
@click.argument("paths", nargs=-1, required=True, type=opt.PATH)
@opt.output("REPORT.html")
@click.option("--title", default="", help="Title of the page. Default: the folder's name.")
@click.option(
    "--world",
    type=opt.FOLDER,
    help="Site (ortho.tif, dsm.tif) on which to show what a robot saw whose own is not here.",
)
@click.option(
    "--detail",
    type=click.IntRange(256, 8192),
    default=2048,
    show_default=True,
    metavar="PX",
    help="Most rows and columns of a layer: what is larger is thinned out.",
)
@click.option(
    "--frames",
    type=click.IntRange(0, 2000),
    default=240,
    show_default=True,
    help="Most camera frames, of all drives together; 0 for none.",
)
@opt.existing_options
@opt.console_options
def report(
    paths: tuple[Path, ...],
    output: Path,
    title: str,
    world: Path | None,
    detail: int,
    frames: int,
    existing: Existing,
    console: Console,
) -> None:
    """Write one page of all that PATHS, files and folders, hold: maps, drives, charts, provenance.

    The page needs no network and no other file. On the map: orthomosaic, classes, scoremap, its standard deviation,
    no-go, heat, heights, areas, plans with their waypoints, drives with what happened on them and what the camera saw.
    Below: rewards beside baselines and bound, scores before and after, learning curves, reliability, every figure in
    the folder, and where each file comes from. Files are told by their content; what cannot be shown is named.
    """
    from hrt_cli.report.page.content import Detail
    from hrt_cli.report.page.stage import report_files

    with console.bar("report") as progress:
        done = report_files(
            paths,
            output,
            title=title,
            world=world,
            detail=Detail(detail, frames),
            existing=existing,
            progress=progress,
        )
    for problem in done.problems:
        console.note(f"Note: {problem}")
    state = "up to date" if done.up_to_date else f"{done.layers} layers, {done.plans} plans, {done.drives} drives"
    console.result(
        f"{output}: {state}, {done.size / 1e6:.1f} MB",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "bytes": done.size,
            "sites": done.sites,
            "layers": done.layers,
            "plans": done.plans,
            "drives": done.drives,
            "charts": done.charts,
            "problems": list(done.problems),
        },
    )
