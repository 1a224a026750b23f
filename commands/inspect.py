"""`hrt inspect`: what is in a raster or a drive log, and will it work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hrt_cli import options as opt
from hrt_cli.progress import Console


@click.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt inspect site/ortho.tif
"""
)
@click.argument("raster", type=opt.PATH)
@opt.bands_opt
@opt.nodata_opt
@opt.unreferenced_opt
@opt.console_options
def inspect(raster: Path, bands: tuple[int, ...], nodata: float | None, unreferenced: bool, console: Console) -> None:
    """Tell what is in a raster, whether `segment` will take it, and roughly what that will cost.

    Of a drive log instead (.jsonl, .csv, .gpx, a ROS bag, ArduPilot's .bin) tell how far and how long it goes, what it
    knows, and whether `feedback` will take it.

    Exits with 0 also where `segment` would refuse the raster: the refusal is then part of the answer.
    """
    from hrt_cli.logs.kinds import is_log

    if is_log(raster):
        _print_log(raster, console)
        return
    from hrt_cli.raster.inspect import inspect_raster

    found = inspect_raster(raster, bands=bands, nodata=nodata, unreferenced=unreferenced)
    console.result(
        "\n".join(_lines(found.facts, found.notes, found.refusal)),
        {**found.facts, "notes": found.notes, "usable": found.refusal is None, "refusal": found.refusal},
        only_here=True,
    )


def _lines(facts: dict[str, Any], notes: list[str], refusal: str | None) -> list[str]:
    colours = ", ".join(f"{d} {c}" for d, c in zip(facts["dtypes"], facts["band_colours"], strict=True))
    lines = [
        f"{facts['file']}: {facts['driver']}, {facts['cols']} x {facts['rows']} pixels ({facts['megapixels']:.1f} Mpx)",
        f"  bands      {facts['bands']}: {colours}; compression {facts['compression']}",
        f"  nodata     {facts['nodata'][0]}; alpha band {facts.get('alpha_band')}; mask {facts['mask']}",
    ]
    if "pixel_m" in facts:
        row_m, col_m = facts["pixel_m"]
        unit = "m on the ground" if facts["crs"] else "px (unreferenced)"
        lines += [
            f"  CRS        {facts['crs']}",
            f"  pixel      {col_m:.4g} x {row_m:.4g} {unit}",
            f"  valid      about {facts['valid_share']:.0%}",
        ]
    lines += [f"  note       {note}" for note in notes]
    if refusal is None:
        cost = f"about {facts['segment_seconds']:.0f} s and {facts['segment_memory_mb']} MB"
        lines.append(f"  segment    would take it: {cost} on one core")
    else:
        lines.append(f"  segment    would refuse it: {refusal}")
    return lines


def _print_log(path: Path, console: Console) -> None:
    from hrt_cli.logs.inspect import inspect_log

    found = inspect_log(path)
    console.result(
        "\n".join(_log_lines(found.facts, found.notes, found.refusal)),
        {**found.facts, "notes": found.notes, "usable": found.refusal is None, "refusal": found.refusal},
        only_here=True,
    )


def _log_lines(facts: dict[str, Any], notes: list[str], refusal: str | None) -> list[str]:
    distance = "not known" if facts["distance_m"] is None else f"{facts['distance_m']:.1f} m"
    speed = "" if facts["mean_speed_m_s"] is None else f", {facts['mean_speed_m_s']:.2f} m/s on average"
    digits = 7 if facts["geographic"] else 2
    start, end = (f"{facts[name][0]:.{digits}f}, {facts[name][1]:.{digits}f}" for name in ("start", "end"))
    frame = "lon, lat" if facts["geographic"] else facts["own_frame"] or facts["crs"] or "x, y without a CRS"
    lines = [
        f"{facts['file']}: drive log ({facts['format']}), {facts['records']} records in {facts['duration_s']:.1f} s",
        f"  way        {distance}{speed}; {facts['segments']} {'segment' if facts['segments'] == 1 else 'segments'}",
        f"  place      from {start} to {end} ({frame})",
        f"  tells      {', '.join(facts['known']) or 'time and place only'}",
        f"  not told   {', '.join(facts['unknown']) or 'nothing'}",
    ]
    if facts["events"]:
        lines.append(f"  events     {', '.join(f'{count} {name}' for name, count in facts['events'].items())}")
    lines += [f"  topic      {each['topic']}: {each['messages']} {each['type']}" for each in facts.get("topics", ())]
    lines += [f"  note       {note}" for note in notes]
    lines.append(f"  feedback   {'would take it' if refusal is None else f'would refuse it: {refusal}'}")
    return lines
