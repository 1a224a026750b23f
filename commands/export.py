"""`hrt export`: a plan becomes a mission file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing


@click.command(
    cls=Command,
    sections={
        "Robot": "--vehicle --firmware --speed --altitude --depth --above-bottom --hold",
        "Waypoints": "--tolerance --spacing --max-items --scoremap",
        "Areas": "--aoi --keep-out",
        "Frame": "--local-frame --datum",
        "Output": "--format",
    },
    keys=("output", "format", "missions", "notes"),
    see_also=("plan",),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif
  hrt plan site/scoremap.tif -o site/plan.json --start auto --budget 200
  hrt export site/plan.json -o site/rover.plan --vehicle rover --speed 1.0
  hrt export site/plan.json -o site/nav2 --format nav2 --scoremap site/scoremap.tif
""",
)
@click.argument("plan", type=opt.PLAN)
@opt.output("MISSION")
@click.option(
    "--format",
    "format_name",
    type=click.Choice(["qgc", "wpl", "gpx", "geojson", "kml", "csv", "nav2", "moos"]),
    help="Default: by the output's suffix: .plan, .waypoints, .gpx, .geojson, .kml, .csv, .yaml (nav2), .bhv (moos).",
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
    help="What runs on its autopilot.",
)
@click.option("--speed", "speed_m_s", type=opt.FiniteFloat(0.01, 50), help="Speed to drive at. Default: the plan's.")
@click.option(
    "--altitude",
    "altitude_m",
    type=opt.FiniteFloat(-11_000, 10_000),
    help="Altitude above home; a submarine's depth is negative. Default: 0.",
)
@click.option(
    "--depth",
    "depth_m",
    type=opt.FiniteFloat(0, 11_000, low_open=True),
    help="Depth below home: the same as a negative --altitude.",
)
@click.option(
    "--above-bottom",
    "above_bottom_m",
    type=opt.FiniteFloat(0, 11_000, low_open=True),
    help="Height of a submarine above the bottom, in place of a depth: it needs a sounder.",
)
@click.option(
    "--hold",
    "hold_s",
    type=click.IntRange(0, 3600),
    default=0,
    show_default=True,
    metavar="SECONDS",
    help="Wait at each waypoint.",
)
@click.option(
    "--tolerance",
    "tolerance_m",
    type=opt.FiniteFloat(0),
    default=0.0,
    show_default=True,
    help="Leave out waypoints where the straight way stays within so many metres of the plan, and off what is no-go.",
)
@click.option(
    "--spacing",
    "spacing_m",
    type=opt.FiniteFloat(0.1),
    help="Most distance between waypoints: longer legs get more of them.",
)
@click.option("--max-items", type=click.IntRange(1), help="Most mission items. Default: what the autopilot stores.")
@click.option(
    "--scoremap",
    "scoremap_path",
    type=opt.SCOREMAP,
    help="The plan's scoremap: straight ways may lead through all of its open cells, and Nav2 gets it as maps.",
)
@click.option("--aoi", "aoi_path", type=opt.AREA, help="Area that no leg may leave (GeoJSON, KML): a .plan's geofence.")
@click.option(
    "--keep-out",
    "keep_outs",
    type=opt.AREA,
    multiple=True,
    help="Area that no leg may enter: a .plan's geofence.",
)
@click.option(
    "--local-frame",
    "frame",
    type=click.Choice(["utm", "enu"]),
    default="utm",
    show_default=True,
    help="Frame of the formats in metres (nav2, moos): UTM less the datum, or metres to its true east and north.",
)
@click.option("--datum", type=opt.LonLat(), help="Origin of the local frame. Default: the map's south-west corner.")
@opt.figure_opt
@opt.backdrop_opt
@opt.existing_options
@opt.console_options
def export(
    plan: Path,
    output: Path,
    format_name: str | None,
    vehicle: Literal["rover", "boat", "submarine"],
    firmware: Literal["ardupilot", "px4"],
    speed_m_s: float | None,
    altitude_m: float | None,
    depth_m: float | None,
    above_bottom_m: float | None,
    hold_s: int,
    tolerance_m: float,
    spacing_m: float | None,
    max_items: int | None,
    scoremap_path: Path | None,
    aoi_path: Path | None,
    keep_outs: tuple[Path, ...],
    frame: Literal["utm", "enu"],
    datum: tuple[float, float] | None,
    figure: Path | None,
    backdrop: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Write a plan as a mission that an autopilot opens.

    PLAN is the output of `hrt plan`; that of a team gives a mission for each robot. Formats: QGroundControl .plan,
    QGC WPL 110 waypoints, GPX 1.1, GeoJSON, KML 2.2, CSV, Nav2 (a .yaml file, or a folder where the output has no
    suffix), MOOS-IvP .bhv.
    """
    from hrt_cli.missions.mission import MissionOptions
    from hrt_cli.missions.stage import export_missions

    if [altitude_m, depth_m, above_bottom_m].count(None) < 2:
        raise click.UsageError("--altitude, --depth and --above-bottom say the same in three ways: give one")
    options = MissionOptions(
        name=plan.stem,
        vehicle=vehicle,
        firmware=firmware,
        speed_m_s=speed_m_s,
        altitude_m=-depth_m if depth_m is not None else altitude_m or 0.0,
        above_bottom_m=above_bottom_m,
        hold_s=hold_s,
        tolerance_m=tolerance_m,
        spacing_m=spacing_m,
        max_items=max_items,
        frame=frame,
        datum=datum,
    )
    done = export_missions(
        plan,
        output,
        options,
        format_name=format_name,
        scoremap_path=scoremap_path,
        aoi_path=aoi_path,
        keep_out_paths=keep_outs,
        existing=existing,
    )
    if figure is not None:
        from hrt_cli.report.figures.mission import draw_missions

        draw_missions(
            plan,
            done.made,
            figure,
            vehicle=vehicle,
            scoremap=scoremap_path,
            backdrop=backdrop,
            existing=existing,
        )
    for note in done.notes:
        console.note(f"Note: {note}")
    missions = [asdict(each) | {"output": str(each.output)} for each in done.missions]
    lines = [
        f"{each.output}: {done.format} mission of {each.waypoints} waypoints, {each.length_m:.0f} m "
        f"({'up to date' if each.up_to_date else 'written'})"
        for each in done.missions
    ]
    alone = missions[0] if len(missions) == 1 else {"output": str(output)}
    console.result("\n".join(lines), {**alone, "format": done.format, "missions": missions, "notes": done.notes})
