"""`hrt feedback`: the robot's own drives teach how drivable each class is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hrt_cli import options as opt
from hrt_cli.errors import ArgumentError
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.drivability.feedback import Curve
    from hrt_cli.drivability.feedback_stage import FeedbackSummary


def _curve(ctx: click.Context, param: click.Parameter, value: str) -> Curve:
    from hrt_cli.drivability.feedback import Curve

    try:
        return Curve.parse(value)
    except ArgumentError as error:
        raise click.BadParameter(str(error)) from error


F = TypeVar("F", bound=Callable[..., Any])


def _positive(name: str, unit: str, default: float | None, text: str) -> Callable[[F], F]:
    kind = opt.FiniteFloat(0, low_open=True)
    return click.option(name, type=kind, metavar=unit, default=default, show_default=default is not None, help=text)


@click.command(
    cls=Command,
    sections={
        "Evidence": "--commanded --curve --event-weight --robot-radius --gap --forget-m",
        "Terrain": "--dsm --slope-limit --rugosity-limit",
    },
    keys=("output", "up_to_date", "scores", "logs", "evidence_m", "off_map_m", "events", "notes"),
    see_also=("drive", "scoremap", "inspect"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 3min
  hrt drive site/plan.json --world site -o site/drive.jsonl
  hrt feedback site/drive.jsonl --classes site/classes.tif -o site/scores.json
""",
)
@click.argument("logs", nargs=-1, required=True, type=opt.LOG)
@click.option("--classes", required=True, type=opt.CLASSES, help="The class raster that was driven over.")
@click.option("--scores", "scores_path", type=opt.SCORES, help="Score table to go on from. Default: nothing is known.")
@opt.output("SCORES.json")
@click.option("--dsm", type=opt.DSM, help="Surface model, heights in metres: steep and rough ground counts less.")
@_positive(
    "--commanded", "M/S", None, "Commanded speed, where a log does not tell it. Default: estimated from the log."
)
@click.option(
    "--curve",
    default="0:0,1:1",
    show_default=True,
    metavar="RATIO:PROGRESS,...",
    callback=_curve,
    help="Progress for each ratio of achieved to commanded speed; straight in between.",
)
@click.option(
    "--event-weight",
    metavar="METRES",
    type=opt.FiniteFloat(0),
    default=5.0,
    show_default=True,
    help="How far without progress a collision or a standstill counts, however long it lasts.",
)
@_positive("--robot-radius", "METRES", 0.35, "Radius of the robot, where a log does not tell it.")
@_positive("--gap", "SECONDS", 10.0, "Records farther apart have no drive between them.")
@_positive("--slope-limit", "DEGREES", 35.0, "With --dsm: slope on which progress counts nothing.")
@_positive("--rugosity-limit", "METRES", 0.3, "With --dsm: deviation of heights at which progress counts nothing.")
@_positive(
    "--forget-m", "METRES", None, "Older evidence of a class counts half after so many metres of new. Default: never."
)
@opt.figure_opt
@opt.existing_options
@opt.console_options
def feedback(
    logs: tuple[Path, ...],
    classes: Path,
    scores_path: Path | None,
    output: Path,
    dsm: Path | None,
    commanded: float | None,
    curve: Curve,
    event_weight: float,
    robot_radius: float,
    gap: float,
    slope_limit: float,
    rugosity_limit: float,
    forget_m: float | None,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Learn from drives how drivable each class is.

    LOGS are drives (JSON lines, CSV, GPX, ROS bags, ArduPilot's .bin) over the ground of --classes. The speed that was
    achieved of what was commanded is evidence for the classes under the robot; a collision or a standstill is evidence
    against what lies ahead of it, once a square metre of ground over all LOGS. The output is a score table for
    `hrt scoremap`.
    """
    from hrt_cli.drivability.feedback import FeedbackSettings
    from hrt_cli.drivability.feedback_stage import learn_scores

    settings = FeedbackSettings(
        curve, commanded, event_weight, robot_radius, gap, slope_limit, rugosity_limit, forget_m
    )
    with console.bar("feedback") as progress:
        done = learn_scores(
            logs,
            classes,
            output,
            settings,
            scores_path=scores_path,
            dsm_path=dsm,
            existing=existing,
            progress=progress,
        )
    if figure is not None:
        from hrt_cli.report.figures.scores import draw_scores

        draw_scores(output, scores_path, figure, existing=existing)
    for note in done.notes:
        console.note(f"Note: {note}")
    console.result("\n".join(_lines(output, done)), {"output": str(output), **_data(done)})


def _data(done: FeedbackSummary) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "up_to_date": done.up_to_date,
        "scores": {
            str(k): {
                "name": s.name,
                "before": done.before[k].mean,
                "mean": s.mean,
                "sd": s.sd,
                "evidence_m": s.evidence_m,
            }
            for k, s in done.after.items()
        },
        "logs": None if done.logs is None else [asdict(each) for each in done.logs],
        **done.totals(),
        "notes": done.notes,
    }


def _lines(output: Path, done: FeedbackSummary) -> list[str]:
    """Say what was learnt, then the beliefs as aligned rows."""
    total = done.totals()
    if done.logs is None:
        title = f"{output}: up to date"
    else:
        title = (
            f"{output}: {total['evidence_m']:.1f} m of evidence and {total['events']} "
            f"{'event' if total['events'] == 1 else 'events'} from {len(done.logs)} "
            f"{'log' if len(done.logs) == 1 else 'logs'}, {total['off_map_m']:.1f} m off the classes"
        )
    rows = [["class", "name", "mean", "sd", "evidence m"]]
    for k, s in done.after.items():
        change = f"{done.before[k].mean:.3f} -> {s.mean:.3f}"
        rows.append([str(k), s.name, change, f"{s.sd:.3f}", f"{s.evidence_m:.1f}"])
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return [title, *("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)]
