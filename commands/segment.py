"""`hrt segment`: an orthomosaic becomes texture classes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.texture.stage import Segmentation


@click.command(
    cls=Command,
    sections={
        "Model": "--model --grow --model-out",
        "Texture": "--features --rotation --scale-invariant --wavelengths --seed",
        "Input": "--aoi --bands --nodata --unreferenced",
        "Computing": "--workers --dask --block",
    },
    files="CLASSES.qml, beside the output, gives the classes their colours in QGIS.",
    keys=(
        "output",
        "up_to_date",
        "classes",
        "class_fractions",
        "pixels",
        "valid_pixels",
        "seconds",
        "megapixels_per_second",
        "notes",
    ),
    see_also=("inspect", "scoremap", "evaluate segment"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5 --figure site/classes.png
""",
)
@click.argument("ortho", type=opt.RASTER, nargs=-1, required=True)
@opt.output("CLASSES.tif")
@click.option("-K", "--classes", type=opt.ClassCount(), help="Number of texture classes; auto chooses from 2 to 12.")
@click.option(
    "--model", "model_path", type=opt.File("MODEL.npz"), help="Apply this texture model instead of fitting one."
)
@click.option("--grow", is_flag=True, help="With --model: what it has never seen becomes new classes after its own.")
@click.option(
    "--model-out",
    type=opt.File("MODEL.npz", writes=True),
    help="Also write the texture model that was fitted or grown.",
)
@click.option(
    "--features",
    type=click.Choice(["site", "paper", "texture"]),
    default="site",
    show_default=True,
    help="site: colour, lightness and texture. paper: Gabor order statistics and hue. texture: Gabor alone.",
)
@click.option(
    "--rotation",
    type=click.Choice(["invariant", "aware", "sorted"]),
    default="invariant",
    show_default=True,
    help="invariant: a texture turned is the same texture. aware: it is another. sorted: the same, by ranks.",
)
@click.option("--scale-invariant", is_flag=True, help="A texture seen larger is the same texture.")
@click.option(
    "--wavelengths",
    metavar="METRES,...",
    callback=lambda ctx, param, value: _lengths(value),
    help="Wavelengths of the Gabor filters on the ground. Default: 4, 8, 16 and 32 pixels.",
)
@click.option("--aoi", type=opt.AREA, help="Clip to the polygons of this GeoJSON or KML file.")
@opt.bands_opt
@opt.nodata_opt
@opt.unreferenced_opt
@opt.seed_opt
@opt.workers_opt
@click.option("--dask", metavar="ADDRESS", help="Measure on the Dask cluster of this scheduler (tcp://HOST:PORT).")
@click.option(
    "--block",
    type=click.IntRange(64, 4096),
    default=1024,
    show_default=True,
    help="Side of the blocks worked on at a time, pixels. The result does not depend on it.",
)
@opt.creation_opt
@opt.figure_opt
@opt.existing_options
@opt.console_options
def segment(
    ortho: tuple[Path, ...],
    output: Path,
    classes: int | Literal["auto"] | None,
    model_path: Path | None,
    grow: bool,
    model_out: Path | None,
    features: str,
    rotation: str,
    scale_invariant: bool,
    wavelengths: tuple[float, ...] | None,
    aoi: Path | None,
    bands: tuple[int, ...],
    nodata: float | None,
    unreferenced: bool,
    seed: int,
    workers: int,
    dask: str | None,
    block: int,
    creation: tuple[tuple[str, str], ...],
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Segment an orthomosaic into texture classes.

    ORTHO is a georeferenced RGB GeoTIFF or VRT (alpha, mask or nodata are honoured), or several tiles of one
    orthomosaic, or a folder of them. The output is a one-band class raster on the same grid, 255 where there is no
    data, with a QGIS style beside it.
    """
    if (classes is None) == (model_path is None):
        raise click.UsageError("give either --classes, to fit a model, or --model, to apply one")
    if model_path is None and grow:
        raise click.UsageError("--grow adds classes to a model: give one by --model")
    if model_path is not None and model_out is not None and not grow:
        raise click.UsageError("--model-out keeps a model that was fitted or grown; with --model alone none is")
    from hrt_cli.texture.segment import SegmentSpec
    from hrt_cli.texture.stage import ImageOptions, Wanted, Work, segment_file

    spec = None
    if classes is not None:
        spec = SegmentSpec(
            None if classes == "auto" else classes,
            features=features,
            rotation=rotation,
            wavelengths_m=wavelengths,
            seed=seed,
            scale_invariant=scale_invariant,
        )
    with console.bar("segment") as progress:
        done = segment_file(
            ortho,
            output,
            Wanted(spec, model_path, grow, model_out, dict(creation)),
            image_options=ImageOptions(bands, nodata, unreferenced, aoi),
            work=Work(block, workers, dask),
            existing=existing,
            progress=progress,
        )
    if figure is not None:
        from hrt_cli.report.figures.maps import draw_classes

        backdrop = ortho[0] if len(ortho) == 1 and ortho[0].is_file() and not unreferenced else None
        draw_classes(output, figure, backdrop=backdrop, existing=existing)
    for note in done.notes:
        console.note(f"Note: {ortho[0]}: {note}")
    _print(output, done, console)


def _print(output: Path, done: Segmentation, console: Console) -> None:
    stats, found = done.found.stats, done.found
    speed = stats.pixels / 1e6 / done.seconds
    shares = ", ".join(f"{k}: {share:.0%}" for k, share in enumerate(stats.class_fractions))
    state = "up to date" if done.up_to_date else f"{len(stats.class_pixels)} classes in {done.seconds:.1f} s"
    for row in found.table:
        console.detail(f"class {row['id']}: mean colour {row['mean_rgb']}, roughness {row['roughness']}")
    for count, ratio in found.considered.items():
        console.detail(f"{count} classes: variance ratio {ratio:.0f}")
    console.result(
        f"{output}: {state} ({shares})",
        {
            "output": str(output),
            "up_to_date": done.up_to_date,
            "classes": len(stats.class_pixels),
            "class_fractions": list(stats.class_fractions),
            "class_table": found.table,
            "variance_ratios": found.considered,
            "novel_share": found.novel_share,
            "new_classes": found.grown,
            "pixels": stats.pixels,
            "valid_pixels": stats.valid_pixels,
            "seconds": done.seconds,
            "megapixels_per_second": speed,
            "notes": done.notes,
        },
    )


def _lengths(text: str | None) -> tuple[float, ...] | None:
    if not text:
        return None
    finite = opt.FiniteFloat(0, low_open=True)
    return tuple(finite.convert(part, None, None) for part in text.split(","))
