"""`hrt scoremap`: classes and their scores become a map of grid cells."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.artifacts.stage import Existing
from hrt_cli.progress import Console


@click.command(
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt scoremap site/classes.tif -o site/scoremap.tif --cell 1.0
"""
)
@click.argument("classes", type=opt.PATH)
@opt.output_opt
@click.option("--scores", "scores_path", type=opt.PATH, help="Score table (JSON). Default: 0.5 for every class.")
@click.option(
    "--unknown-as-prior", is_flag=True, help="Classes that the table does not name count 0.5, and are least certain."
)
@click.option(
    "--cell", "cell_m", type=opt.FiniteFloat(0, low_open=True), default=1.0, show_default=True, help="Cell side, m."
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
    """
    from hrt_cli.drivability.stage import make_scoremap

    with console.bar("scoremap") as progress:
        done = make_scoremap(
            classes,
            output,
            scores_path=scores_path,
            unknown_as_prior=unknown_as_prior,
            cell_m=cell_m,
            explore=explore,
            no_go_below=no_go_below,
            creation=dict(creation),
            existing=existing,
            progress=progress,
        )
    if figure is not None:
        from hrt_cli.report.overlay import draw_scoremap

        draw_scoremap(output, figure, backdrop=backdrop, existing=existing)
    if done.unknown and scores_path is not None:
        ids = ", ".join(map(str, done.unknown))
        console.note(f"Note: {scores_path}: says nothing of class {ids}, which counts as unknown: 0.5")
    elif done.unknown:
        console.note("Note: no --scores given: every class counts 0.5, so the map says only where the robot may go")
    state = "up to date" if done.up_to_date else f"{done.seconds:.1f} s"
    console.result(
        f"{output}: {done.rows} x {done.cols} cells of {done.cell_size_m:g} m, {done.go_cells} to go, "
        f"mean score {done.mean_score:.3f} ({state})",
        {"output": str(output), **asdict(done)},
    )
