"""`hrt synth`: a sample site."""

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
    keys=("output", "up_to_date", "scene", "files", "classes", "rows", "cols"),
    see_also=("init", "segment", "drive"),
    epilog="""\b
Example:
  hrt synth site --scene wildfire --size 40 --seed 3
""",
)
@click.argument("folder", type=opt.File("FOLDER", writes=True))
@click.option(
    "--scene",
    type=click.Choice(["meadow", "wildfire", "reef"]),
    default="meadow",
    show_default=True,
    help="What grows, burns or lives there.",
)
@click.option(
    "--size", "size_m", type=opt.FiniteFloat(5, 500), default=60.0, show_default=True, help="Side of the site."
)
@click.option(
    "--pixel", "pixel_m", type=opt.FiniteFloat(0.01, 0.5), default=0.05, show_default=True, help="Side of a pixel."
)
@opt.seed_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def synth(
    folder: Path,
    scene: str,
    size_m: float,
    pixel_m: float,
    seed: int,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Make a sample site in FOLDER that looks like an aerial photograph.

    Writes ortho.tif, truth.tif (the true classes), dsm.tif, aoi.geojson, world.json (the true drivability, which only
    a simulator may know), and for the wildfire thermal.tif in degrees Celsius.
    """
    from hrt_cli.world.stage import synthesize
    from hrt_cli.world.synth import SiteSpec

    with console.bar("synth") as progress:
        done = synthesize(
            folder, SiteSpec(scene, (size_m, size_m), pixel_m, seed), existing=existing, progress=progress
        )
    if figure is not None:
        from hrt_cli.report.figures.site import draw_site

        caption = f"sample site: {scene}, {size_m:g} x {size_m:g} m, pixels of {pixel_m:g} m, seed {seed}"
        draw_site(done.files, figure, caption=caption, existing=existing)
    rows, cols = done.shape
    state = "up to date" if done.up_to_date else f"{rows} x {cols} pixels"
    console.result(
        f"{folder}: {scene}, {', '.join(done.class_names)} ({state})",
        {
            "output": str(folder),
            "up_to_date": done.up_to_date,
            "scene": scene,
            "files": {role: str(path) for role, path in done.files.items()},
            "classes": list(done.class_names),
            "rows": rows,
            "cols": cols,
        },
    )
