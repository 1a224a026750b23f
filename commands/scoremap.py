"""`hrt scoremap`: classes and their scores become a map of grid cells."""

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
        "Score": "--scores --unknown-as-prior --explore",
        "No-go": "--no-go-below --no-go-share --margin",
        "Areas": "--aoi --keep-out",
        "Interest": "--interest --interest-range --interest-cell --interest-weight --interest-radius --thermal-units",
        "Terrain": "--dsm --slope-limit --rugosity-limit",
    },
    keys=("output", "up_to_date", "rows", "cols", "cell_size_m", "go_cells", "mean_score", "seconds", "notes"),
    see_also=("segment", "feedback", "plan"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif --cell 1.0
  hrt scoremap site/classes.tif -o site/inside.tif --cell 0.5 --aoi site/aoi.geojson --margin 1
  hrt scoremap site/classes.tif -o site/safe.tif --dsm site/dsm.tif
""",
)
@click.argument("classes", type=opt.CLASSES)
@opt.output("SCOREMAP.tif")
@click.option(
    "--scores",
    "scores_path",
    type=opt.SCORES,
    help="Score table: how drivable each class is. Default: 0.5 for every class.",
)
@click.option(
    "--unknown-as-prior", is_flag=True, help="Classes that the table does not name count 0.5, and are least certain."
)
@click.option(
    "--cell",
    "cell_m",
    type=opt.FiniteFloat(0, low_open=True),
    default=1.0,
    show_default=True,
    help="Side of a cell on the ground.",
)
@click.option(
    "--explore",
    type=opt.FiniteFloat(0),
    default=0.0,
    show_default=True,
    help="Add this many standard deviations to the score, so that the unknown draws the robot.",
)
@click.option(
    "--no-go-below", type=opt.FiniteFloat(0, 1), help="Cells with a lower expected score are no-go. Default: none."
)
@click.option(
    "--no-go-share",
    type=opt.FiniteFloat(0, 1),
    help="With --no-go-below: no-go are also cells of which classes that score less cover more than this share.",
)
@click.option(
    "--margin",
    "margin_m",
    type=opt.FiniteFloat(0),
    help="No-go are also cells as near as this to those of --no-go-below, as the borders of classes are not sharp, "
    "to a --keep-out and to the edge of the --aoi.",
)
@click.option(
    "--aoi", type=opt.AREA, help="No-go are cells not wholly inside the polygons of this GeoJSON or KML file."
)
@click.option("--keep-out", type=opt.AREA, multiple=True, help="No-go are cells that its polygons touch.")
@click.option("--interest", "interest_path", type=opt.RASTER, help="Raster of what the mission looks for, as heat.")
@click.option(
    "--interest-range",
    type=opt.Range(),
    help="Values of --interest that count 0 and 1. Default: median and maximum of the cells to go.",
)
@click.option(
    "--interest-cell",
    type=click.Choice(["max", "mean"]),
    help="Which of the pixels of --interest in a cell counts. Default: max.",
)
@click.option(
    "--interest-weight",
    type=opt.FiniteFloat(0, 1, low_open=True),
    help="How much of the score depends on --interest. Default: 1, all.",
)
@click.option(
    "--interest-radius",
    "interest_radius_m",
    type=opt.FiniteFloat(0, low_open=True),
    help="From how far a cell is sampled: a hot spot counts at the nearest cell to go. Default: from within.",
)
@click.option(
    "--thermal-units",
    type=click.Choice(["celsius", "kelvin", "centikelvin", "auto"]),
    help="What --interest is in: values and --interest-range are then degrees Celsius; auto takes what is certain.",
)
@click.option(
    "--dsm", "dsm_path", type=opt.DSM, help="Surface model, heights in metres: steep and rough ground scores less."
)
@click.option(
    "--slope-limit",
    "slope_limit_deg",
    type=opt.FiniteFloat(0, 90, low_open=True),
    help="With --dsm: slope from which a cell is no-go. Default: 35.",
)
@click.option(
    "--rugosity-limit",
    type=opt.FiniteFloat(0, 1, low_open=True),
    help="With --dsm: Vector Ruggedness Measure from which a cell is no-go. Default: 0.1.",
)
@opt.creation_opt
@opt.figure_opt
@opt.backdrop_opt
@opt.existing_options
@opt.console_options
def scoremap(
    classes: Path,
    output: Path,
    scores_path: Path | None,
    unknown_as_prior: bool,
    cell_m: float,
    explore: float,
    no_go_below: float | None,
    no_go_share: float | None,
    margin_m: float | None,
    aoi: Path | None,
    keep_out: tuple[Path, ...],
    interest_path: Path | None,
    interest_range: tuple[float, float] | None,
    interest_cell: Literal["max", "mean"] | None,
    interest_weight: float | None,
    interest_radius_m: float | None,
    thermal_units: Literal["celsius", "kelvin", "centikelvin", "auto"] | None,
    dsm_path: Path | None,
    slope_limit_deg: float | None,
    rugosity_limit: float | None,
    creation: tuple[tuple[str, str], ...],
    figure: Path | None,
    backdrop: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Turn a class raster and a score table into a scoremap.

    CLASSES is the output of `hrt segment`. The score of a cell is the mean of its classes' expected scores, weighted
    by the ground they cover; cells of which less than half was seen are no-go. The output has two bands: expected
    score and its standard deviation.

    With --interest the score is drivability times interest: nothing is gained where nothing is to be found, and
    where the robot may go is decided by drivability alone. Any raster of one band will do, whatever its grid.

    With --dsm the score falls with the slope and the ruggedness of the ground; cells at a limit are no-go.

    With --aoi and --keep-out no walk over the map's cells leaves the area of interest or enters a keep-out.
    """
    of_interest = (interest_range, interest_cell, interest_weight, interest_radius_m, thermal_units)
    if interest_path is None and any(given is not None for given in of_interest):
        raise click.UsageError(
            "--interest-range, --interest-cell, --interest-weight, --interest-radius and --thermal-units "
            "are for --interest: give one"
        )
    if dsm_path is None and (slope_limit_deg, rugosity_limit) != (None, None):
        raise click.UsageError("--slope-limit and --rugosity-limit are for --dsm: give one")
    from hrt_cli.drivability.interest import Interest
    from hrt_cli.drivability.limits import Limits
    from hrt_cli.drivability.stage import make_scoremap
    from hrt_cli.drivability.surface import Relief

    if no_go_share is not None and no_go_below is None:
        raise click.UsageError("--no-go-share says how much of a cell --no-go-below may hold for: give both")
    if margin_m is not None and no_go_below is None and aoi is None and not keep_out:
        raise click.UsageError(
            "--margin keeps away from what --no-go-below, --keep-out or --aoi bars: give one of these"
        )
    interest = None
    if interest_path is not None:
        weight = 1.0 if interest_weight is None else interest_weight
        interest = Interest(
            interest_path, interest_range, interest_cell or "max", weight, thermal_units, interest_radius_m
        )
    relief = None
    if dsm_path is not None:
        limits = {"slope_limit_deg": slope_limit_deg, "rugosity_limit": rugosity_limit}
        relief = Relief(dsm_path, **{name: limit for name, limit in limits.items() if limit is not None})
    with console.bar("scoremap") as progress:
        done = make_scoremap(
            classes,
            output,
            scores_path=scores_path,
            unknown_as_prior=unknown_as_prior,
            cell_m=cell_m,
            explore=explore,
            no_go_below=no_go_below,
            no_go_share=1.0 if no_go_share is None else no_go_share,
            margin_m=margin_m or 0.0,
            limits=Limits(aoi, keep_out),
            interest=interest,
            relief=relief,
            creation=dict(creation),
            existing=existing,
            progress=progress,
        )
    if figure is not None:
        from hrt_cli.report.figures.maps import draw_scoremap

        draw_scoremap(output, figure, backdrop=backdrop, existing=existing)
    if done.unknown and scores_path is not None:
        ids = ", ".join(map(str, done.unknown))
        console.note(f"Note: {scores_path}: says nothing of class {ids}, which counts as unknown: 0.5")
    elif done.unknown:
        console.note(
            "Note: no --scores given: every class counts 0.5, trees and walls too; no plan on this map is one to drive"
        )
    if done.strangers:
        ids = ", ".join(map(str, done.strangers))
        console.note(
            f"Note: {scores_path}: has scores of class {ids}, which {classes} does not have: was it written for "
            "another segmentation? Then its other numbers mean other ground as well"
        )
    if done.interest_range is not None and interest_range is None:
        low, high = done.interest_range
        console.note(
            f"Note: {interest_path}: {low:g} counts 0 and {high:g} counts 1, the median and the maximum of the cells "
            "to go; --interest-range sets others"
        )
    for note in done.notes:
        console.note(f"Note: {note}")
    if done.interest_out_of_reach:
        console.note(
            f"Note: {interest_path}: {done.interest_out_of_reach} of its spots of interest are out of reach: farther "
            f"than {interest_radius_m:g} m from every cell to go"
        )
    data = {"output": str(output), **{name: value for name, value in asdict(done).items() if value is not None}}
    told = {
        "outside the area of interest": done.aoi_cells,
        "kept out of": done.keep_out_cells,
        "steep": done.steep_cells,
        "rough": done.rough_cells,
        "of interest": done.interest_cells,
    }
    counts = "".join(f"{count} {what}, " for what, count in told.items() if count is not None)
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    console.result(
        f"{output}: {done.rows} x {done.cols} cells of {done.cell_size_m:g} m, {done.go_cells} to go, {counts}"
        f"mean score {done.mean_score:.3f} ({state})",
        data,
    )
