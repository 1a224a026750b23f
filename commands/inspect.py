"""`hrt inspect`: what is in a raster, a project folder or a drive log, and will it work."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.inspection.drives import LogInspection
    from hrt_cli.inspection.project import Project
    from hrt_cli.inspection.rasters import Inspection


@click.command(
    cls=Command,
    keys=("notes",),
    see_also=("segment", "scoremap", "plan", "feedback"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt inspect site/ortho.tif
  hrt inspect site
""",
)
@click.argument("rasters", type=opt.RASTER_OR_LOG, nargs=-1, required=True, metavar="RASTER...")
@opt.bands_opt
@opt.nodata_opt
@opt.unreferenced_opt
@opt.figure_opt
@opt.backdrop_opt
@opt.existing_options
@opt.console_options
def inspect(
    rasters: tuple[Path, ...],
    bands: tuple[int, ...],
    nodata: float | None,
    unreferenced: bool,
    figure: Path | None,
    backdrop: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Tell what is in a raster, whether `segment` will take it, and roughly what that will cost.

    RASTER is a file, several tiles of one orthomosaic, or a folder: of a project of OpenDroneMap or Pix4D, of tiles, or
    of any rasters. Of a folder all that is found is listed, with the commands to run on it.

    Of a drive log instead (.jsonl, .csv, .gpx, a ROS bag, ArduPilot's .bin) tell how far and how long it goes, what it
    knows, and whether `feedback` will take it.

    Exits with 0 also where `segment` would refuse the raster: the refusal is then part of the answer.
    """
    from hrt_cli.logs.kinds import is_log

    if len(rasters) == 1 and is_log(rasters[0]):
        log = _print_log(rasters[0], console)
        if figure is not None:
            _draw_log(log, rasters[0], figure, backdrop, existing)
        return
    folder = len(rasters) == 1 and rasters[0].is_dir()
    if unreferenced and (folder or len(rasters) > 1):
        raise click.UsageError("--unreferenced is for one plain image")
    if backdrop is not None:
        raise click.UsageError("--backdrop is for the figure of a drive log")
    if figure is not None and folder:
        raise click.UsageError("--figure is of one raster or log: name one of those in the folder")
    if bands and folder:
        raise click.UsageError("--bands is for rasters: name those in the folder")
    if folder:
        _print_folder(rasters[0], nodata, console)
    else:
        found = _print_raster(rasters, bands, nodata, unreferenced, console)
        if figure is not None:
            _draw_raster(found, rasters, figure, bands, nodata, unreferenced, existing)


def _print_raster(
    rasters: tuple[Path, ...], bands: tuple[int, ...], nodata: float | None, unreferenced: bool, console: Console
) -> Inspection:
    from hrt_cli.inspection.project import inspect_tiles
    from hrt_cli.inspection.rasters import inspect_raster

    if len(rasters) == 1:
        found = inspect_raster(rasters[0], bands=bands, nodata=nodata, unreferenced=unreferenced)
    else:
        found = inspect_tiles(list(rasters), named=list(rasters), bands=bands, nodata=nodata)
    console.result("\n".join(_raster_lines(found)), _raster_data(found), only_here=True)
    return found


def _draw_raster(
    found: Inspection,
    rasters: tuple[Path, ...],
    figure: Path,
    bands: tuple[int, ...],
    nodata: float | None,
    unreferenced: bool,
    existing: Existing,
) -> None:
    from hrt_cli.report.figures.look import draw_raster
    from hrt_cli.report.figures.maps import draw_classes

    facts = found.facts
    if facts["kind"] == "class raster" and len(rasters) == 1:
        draw_classes(rasters[0], figure, backdrop=None, existing=existing)
        return
    pixel = f" of {facts['pixel_m'][1]:.3g} {'m' if facts['crs'] else 'px'}" if "pixel_m" in facts else ""
    refused = "" if found.refusal is None else "; segment would refuse it"
    draw_raster(
        rasters,
        figure,
        caption=f"{facts['file']}: {_kind(facts)}, {facts['cols']} x {facts['rows']} pixels{pixel}{refused}",
        picture=found.refusal is None,
        bands=bands,
        nodata=nodata,
        unreferenced=unreferenced,
        existing=existing,
    )


def _draw_log(found: LogInspection, path: Path, figure: Path, backdrop: Path | None, existing: Existing) -> None:
    from hrt_cli.report.figures.drive import draw_drive

    facts = found.facts
    distance = "" if facts["distance_m"] is None else f"{facts['distance_m']:.0f} m in "
    caption = f"{facts['file']}: {distance}{facts['duration_s']:.0f} s, {facts['records']} records"
    draw_drive(path, figure, backdrop=backdrop, caption=caption, existing=existing)


def _print_folder(folder: Path, nodata: float | None, console: Console) -> None:
    from hrt_cli.inspection.project import inspect_folder

    project = inspect_folder(folder, nodata=nodata)
    data = {
        "folder": str(folder),
        "project": project.program,
        "found": [_raster_data(found) for found in project.found],
        "commands": project.commands,
        "notes": project.notes,
    }
    console.result("\n".join(_folder_lines(folder, project)), data, only_here=True)


def _raster_data(found: Inspection) -> dict[str, Any]:
    return {**found.facts, "notes": found.notes, "usable": found.refusal is None, "refusal": found.refusal}


def _raster_lines(found: Inspection) -> list[str]:
    facts = found.facts
    colours = ", ".join(f"{d} {c}" for d, c in zip(facts["dtypes"], facts["band_colours"], strict=True))
    tiles = f"{facts['tiles']} tiles, " if "tiles" in facts else ""
    lines = [
        f"{facts['file']}: {tiles}{facts['driver']}, {facts['cols']} x {facts['rows']} pixels "
        f"({facts['megapixels']:.1f} Mpx)",
        f"  is         {_kind(facts)}: {facts['kind_because']}",
        f"  bands      {facts['bands']}: {colours}; compression {facts['compression']}",
        f"  nodata     {facts['nodata'][0]}; alpha band {facts.get('alpha_band')}; mask {facts['mask']}",
    ]
    if facts["values"] is not None:
        low, middle, high = facts["values"]
        lines.append(f"  values     {low:.6g} to {high:.6g}, median {middle:.6g}")
    if facts["made_with"] is not None:
        lines.insert(2, f"  made with  {_maker(facts)}")
    if "pixel_m" in facts:
        row_m, col_m = facts["pixel_m"]
        unit = "m on the ground" if facts["crs"] else "px (unreferenced)"
        lines += [f"  CRS        {facts['crs']}", f"  pixel      {col_m:.4g} x {row_m:.4g} {unit}"]
        if facts["bounds_lonlat"] is not None:
            west, south, east, north = facts["bounds_lonlat"]
            lines.append(f"  lies       lon {west:.6f} to {east:.6f}, lat {south:.6f} to {north:.6f}")
    if "valid_share" in facts:
        lines.append(f"  valid      about {facts['valid_share']:.0%}")
    lines += [f"  note       {note}" for note in found.notes]
    lines += [f"  for        {use}" for use in facts["used_by"]]
    if found.refusal is None:
        cost = f"about {facts['segment_seconds']:.0f} s and {facts['segment_memory_mb']} MB"
        lines.append(f"  segment    would take it: {cost} on one core")
    else:
        lines.append(f"  segment    would refuse it: {found.refusal}")
    return lines


def _folder_lines(folder: Path, project: Project) -> list[str]:
    laid_out = f"a project of {project.program}" if project.program else "a folder of rasters"
    lines = [f"{folder}: {laid_out}"]
    for found in project.found:
        facts = found.facts
        if "rows" not in facts:
            lines.append(f"  {facts['path']}: cannot be used: {found.refusal}")
            continue
        size = f"{facts['cols']} x {facts['rows']} pixels"
        if "pixel_m" in facts and facts["crs"]:
            size += f" of {facts['pixel_m'][1]:.3g} m"
        tiles = f"{facts['tiles']} tiles of " if "tiles" in facts else ""
        made = f", made with {_maker(facts)}" if facts["made_with"] else ""
        lines.append(f"  {facts['path']}: {tiles}{_kind(facts)}, {size}{made}")
        lines += [f"    note     {note}" for note in found.notes]
        if found.refusal is not None and facts["kind"] == "orthomosaic":
            lines.append(f"    segment  would refuse it: {found.refusal}")
    lines += [f"  note       {note}" for note in project.notes]
    lines += [f"  run        {command}" for command in project.commands]
    return lines


def _kind(facts: dict[str, Any]) -> str:
    certainty = facts["kind_certainty"]
    return str(facts["kind"]) if certainty == "declared" else f"{facts['kind']} ({certainty})"


def _maker(facts: dict[str, Any]) -> str:
    by_name = " (by its name only)" if facts["made_with_by"] == "name" else ""
    return f"{facts['made_with']}{by_name}"


def _print_log(path: Path, console: Console) -> LogInspection:
    from hrt_cli.inspection.drives import inspect_log

    found = inspect_log(path)
    console.result(
        "\n".join(_log_lines(found.facts, found.notes, found.refusal)),
        {**found.facts, "notes": found.notes, "usable": found.refusal is None, "refusal": found.refusal},
        only_here=True,
    )
    return found


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
