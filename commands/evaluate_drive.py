"""`hrt evaluate drive`: how far, how safely, what was in view, what was collected."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.completion import class_names
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.evaluation.drives import DriveMeasure


@click.command(
    cls=Command,
    difference="a --require does not hold",
    keys=(
        "distance_m",
        "duration_s",
        "collisions",
        "interventions",
        "min_clearance_m",
        "mean_clearance_m",
        "target_in_view",
        "score_collected",
        "drives",
        "notes",
    ),
    see_also=("drive", "feedback"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 3min
  hrt drive site/plan.json --world site -o site/drive.jsonl --local expert
  hrt evaluate drive site/drive.jsonl --world site --scoremap site/scoremap.tif --target grass
""",
)
@click.argument("logs", nargs=-1, required=True, type=opt.LOG)
@click.option("--world", type=opt.FOLDER, help="Folder of the site, for clearances and what was in view.")
@click.option("--scoremap", type=opt.SCOREMAP, help="Scoremap, for the score collected.")
@click.option(
    "--target",
    metavar="CLASS",
    shell_complete=class_names,
    help="Class to look for: its name or number. Default: the one that the world names.",
)
@opt.require_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def drive(
    logs: tuple[Path, ...],
    world: Path | None,
    scoremap: Path | None,
    target: str | None,
    demands: tuple[tuple[str, str, float], ...],
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Measure the drives in LOGS, in order, of one robot.

    Distance, duration and events come from the logs; clearances and the share of the camera's picture that shows the
    target from the --world; the score of the cells that the robot went through from the --scoremap.
    """
    from hrt_cli.evaluation.demands import check_names, require
    from hrt_cli.evaluation.drives import DriveMeasure, evaluate_drives

    check_names(demands, (*(each.name for each in fields(DriveMeasure)), "target_curve", "drives"))
    with console.bar("evaluate") as progress:
        found = evaluate_drives(logs, world=world, scoremap=scoremap, target=target, progress=progress)
    for note in found.notes:
        console.note(f"Note: {note}")
    if figure is not None:
        from hrt_cli.logs.kinds import files_of
        from hrt_cli.report.figures.drives import draw_drives
        from hrt_cli.world.site import site_files

        inputs = {
            role: file for index, path in enumerate(logs) for role, file in files_of(f"log/{index}", path).items()
        }
        inputs |= site_files(world) if world else {}
        draw_drives(
            inputs, figure, found.clearance_m, found.weight_s, found.view, caption=_line(found.total), existing=existing
        )
    name = str(logs[0]) if len(logs) == 1 else f"{len(logs)} drives"
    data = {
        **asdict(found.total),
        "target_curve": [list(point) for point in found.view],
        "drives": {name: asdict(each) for name, each in found.drives.items()},
        "notes": found.notes,
    }
    console.result(f"{name}: {_line(found.total)}", data, only_here=True)
    require(data, demands)


def _line(total: DriveMeasure) -> str:
    parts = [
        f"{total.distance_m:.0f} m in {total.duration_s:.0f} s",
        f"{total.collisions} collisions",
        f"{total.interventions} interventions",
    ]
    if total.stalled_s is not None:
        parts.append(f"stalled {total.stalled_s:.0f} s")
    if total.min_clearance_m is not None:
        parts.append(f"clearance {total.min_clearance_m:.2f} m at least, {total.mean_clearance_m:.2f} m on average")
    if total.on_drivable is not None:
        parts.append(f"{total.on_drivable:.1%} on drivable ground")
    if total.target_in_view is not None:
        parts.append(f"target on {total.target_in_view:.1%} of the picture")
    if total.score_collected is not None:
        parts.append(f"score {total.score_collected:.1f}")
    return ", ".join(parts)
