"""`hrt export`: a plan becomes a mission file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Literal

import click

from hrt_cli import options as opt
from hrt_cli.artifacts.stage import Existing
from hrt_cli.progress import Console


@click.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 200
  hrt export site/plan.json -o site/rover.plan --vehicle rover --speed 1.0
"""
)
@click.argument("plan", type=opt.PATH)
@opt.output_opt
@click.option(
    "--format",
    "format_name",
    type=click.Choice(["qgc", "wpl", "gpx", "geojson"]),
    help="Mission format. Default: by the output's suffix (.plan, .waypoints, .gpx, .geojson).",
)
@click.option(
    "--vehicle",
    type=click.Choice(["rover", "boat", "submarine"]),
    default="rover",
    show_default=True,
    help="What the autopilot drives.",
)
@click.option(
    "--firmware",
    type=click.Choice(["ardupilot", "px4"]),
    default="ardupilot",
    show_default=True,
    help="What runs on it.",
)
@click.option("--speed", "speed_m_s", type=opt.FiniteFloat(0.01, 50), help="Speed in m/s. Default: the plan's.")
@click.option(
    "--altitude",
    "altitude_m",
    type=opt.FiniteFloat(-11_000, 10_000),
    default=0.0,
    show_default=True,
    help="Altitude above home in metres; a submarine's depth is negative.",
)
@click.option("--hold", "hold_s", type=click.IntRange(0, 3600), default=0, show_default=True, help="Wait, s.")
@click.option("--max-items", type=click.IntRange(1), help="Most mission items. Default: what the autopilot stores.")
@opt.existing_options
@opt.console_options
def export(
    plan: Path,
    output: Path,
    format_name: str | None,
    vehicle: Literal["rover", "boat", "submarine"],
    firmware: Literal["ardupilot", "px4"],
    speed_m_s: float | None,
    altitude_m: float,
    hold_s: int,
    max_items: int | None,
    existing: Existing,
    console: Console,
) -> None:
    """Write a plan as a mission that an autopilot opens.

    PLAN is the output of `hrt plan`. Formats: QGroundControl .plan, QGC WPL 110 waypoints, GPX 1.1, GeoJSON.
    """
    from hrt_cli.missions.mission import MissionOptions
    from hrt_cli.missions.stage import export_file

    mission = MissionOptions(
        name=plan.stem,
        vehicle=vehicle,
        firmware=firmware,
        speed_m_s=speed_m_s,
        altitude_m=altitude_m,
        hold_s=hold_s,
        max_items=max_items,
    )
    done = export_file(plan, output, mission, format_name=format_name, existing=existing)
    state = "up to date" if done.up_to_date else "written"
    console.result(
        f"{output}: {done.format} mission of {done.waypoints} waypoints, {done.length_m:.0f} m ({state})",
        {"output": str(output), **asdict(done)},
    )
