"""The segment stage: an orthomosaic becomes a class raster (and a texture model), from file to file."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.carriers import npz_provenance, publish_npz, read_stamped_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import output_error
from hrt_cli.artifacts.stage import REFUSE, Existing, ReadProvenance, begin
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.image import Image, open_orthomosaic
from hrt_cli.raster.recognise import require_picture
from hrt_cli.raster.style import class_qml
from hrt_cli.texture.cells import Cells, Filler, measured, rows_at_once
from hrt_cli.texture.cluster import best, cluster, consider
from hrt_cli.texture.grow import MIN_SHARE, grow, novel
from hrt_cli.texture.model import TextureModel, describe
from hrt_cli.texture.segment import SegmentSpec, SegmentStats, draw_sample, predict
from hrt_cli.texture.start import spare_linear_algebra

STAGE = "segment"
STAGE_VERSION = 5


@dataclass(frozen=True)
class ImageOptions:
    """How the orthomosaic is to be read; see `open_orthomosaic`."""

    bands: tuple[int, ...] = ()
    nodata: float | None = None
    unreferenced: bool = False
    aoi: Path | None = None


@dataclass(frozen=True)
class Found:
    """What a segmentation tells beside the classes themselves.

    Attributes
    ----------
    stats : SegmentStats
        Pixels of each class, of the raster, and with data.
    table : list of dict
        A row a class: id, share in the sample, mean_rgb, roughness.
    considered : dict of str to float
        The criterion of every number of classes considered, where none was asked for.
    novel_share : float or None
        Share of the patches that lie far from every class of the model given.
    grown : int
        Classes that were added to the model given.
    """

    stats: SegmentStats
    table: list[dict[str, object]]
    considered: dict[str, float] = field(default_factory=dict)
    novel_share: float | None = None
    grown: int = 0


@dataclass(frozen=True)
class Segmentation:
    """What the segment stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    found : Found
    notes : list of str
        What the user ought to know about the orthomosaic.
    seconds : float
        Wall-clock time of the stage.
    """

    up_to_date: bool
    found: Found
    notes: list[str]
    seconds: float


@dataclass(frozen=True)
class Wanted:
    """What is asked for: either a specification to fit, or a model of before.

    Attributes
    ----------
    spec : SegmentSpec or None
        What to fit.
    model_path : Path or None
        The model to apply.
    grow : bool
        Give what the model has never seen new classes after its own.
    model_out : Path or None
        Where to keep the model that was fitted or grown.
    creation : dict of str to str
        Options of the COG driver.
    """

    spec: SegmentSpec | None = None
    model_path: Path | None = None
    grow: bool = False
    model_out: Path | None = None
    creation: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Work:
    """How the work is cut up and who does it; nothing of it changes the result.

    Attributes
    ----------
    block_px : int
        Rows of pixels read, and side of the blocks classified, at once.
    workers : int
        Threads.
    dask : str or None
        Address of a Dask scheduler whose workers measure instead.
    """

    block_px: int = 1024
    workers: int = 1
    dask: str | None = None


def segment_file(
    paths: Sequence[Path],
    output: Path,
    wanted: Wanted,
    *,
    image_options: ImageOptions = ImageOptions(),
    work: Work = Work(),
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> Segmentation:
    """Segment an orthomosaic into `output`, by a model fitted on it or by one of before.

    Parameters
    ----------
    paths : sequence of Path
        The orthomosaic: one raster, several, or a folder of tiles.
    wanted : Wanted
    image_options : ImageOptions
    work : Work

    Raises
    ------
    InputError
        The orthomosaic or the model cannot be used.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    began = time.monotonic()
    spare_linear_algebra()
    model_out = wanted.model_out
    if model_out is not None and model_out.resolve() == output.resolve():
        raise OutputError(f"{output}: is named for two outputs; give the classes and the model different files")
    for path in paths:
        if path.is_dir() and output.resolve().parent == path.resolve():
            raise OutputError(f"{output}: lies among the tiles of {path}, of which it would be one; write it elsewhere")
    with open_orthomosaic(paths, **vars(image_options)) as image:
        if not image_options.bands:
            image.notes.extend(require_picture(image))
        inputs = {**image.sources(), **({"model": wanted.model_path} if wanted.model_path else {})}
        outputs: dict[Path, ReadProvenance] = {
            output: cog_provenance,
            **({model_out: npz_provenance} if model_out else {}),
        }
        parameters = _parameters(wanted, image_options)
        job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs=outputs, existing=existing)
        if job.up_to_date:
            found = _recall(output)
        else:
            filler = _filler(image, paths, image_options, work)
            found = _make(image, output, wanted, job.provenance, work, filler, progress)
        notes = [*image.notes, *_novelty_notes(found)]
        if wanted.spec and wanted.spec.features == "site" and _is_grey(image):
            notes.append("it has one grey band: its classes are told apart by texture alone")
        return Segmentation(job.up_to_date, found, notes, time.monotonic() - began)


def read_model(path: Path) -> TextureModel:
    """Read a texture model.

    Raises
    ------
    InputError
        The file is no NPZ, is damaged, or does not hold a texture model of a version known here.
    """
    arrays, _ = read_stamped_npz(path)
    try:
        return TextureModel.from_arrays(arrays)
    except ValueError as error:
        raise InputError(path, f"is not a usable texture model: {error}") from error


def _parameters(wanted: Wanted, image_options: ImageOptions) -> dict[str, Any]:
    spec = json.loads(json.dumps(asdict(wanted.spec))) if wanted.spec else None
    # The area of interest counts by its content, as an input.
    image = json.loads(json.dumps(asdict(replace(image_options, aoi=None))))
    return {"fit": spec, "image": image, "creation": wanted.creation, **({"grow": True} if wanted.grow else {})}


def _filler(image: Image, paths: Sequence[Path], options: ImageOptions, work: Work) -> Filler | None:
    if work.dask is None:
        return None
    from hrt_cli.texture.distributed import Recipe, sweep_on

    return sweep_on(work.dask, Recipe.of(image, list(paths), **vars(options)))


def _make(
    image: Image,
    output: Path,
    wanted: Wanted,
    provenance: Provenance,
    work: Work,
    filler: Filler | None,
    progress: Progress,
) -> Found:
    asked = _asked(image, wanted)
    rows_px = rows_at_once(work.block_px, image.block_shape[0])
    try:
        if isinstance(asked, SegmentSpec):
            if not image.has_colours(asked.classes or 2):
                raise ArgumentError(f"holds fewer than {asked.classes} different colours, too few for as many classes")
            settings, pixel_m = asked.settings(image.pixel_m), image.pixel_m
        else:
            settings, pixel_m = asked.settings, asked.pixels_of(image.pixel_m)
        with measured(
            image,
            settings,
            pixel_m=pixel_m,
            rows_px=rows_px,
            workers=work.workers,
            filler=filler,
            folder=output.parent,
            progress=progress,
        ) as cells:
            if isinstance(asked, SegmentSpec):
                model, extras = _fitted(cells, asked)
            else:
                model, extras = _applied(cells, asked, wanted.grow)
            found = _write(image, cells, output, model, extras, wanted.creation, work, provenance, progress)
    except ArgumentError as error:
        raise InputError(image.raster.path, str(error)) from error
    except OSError as error:
        raise output_error(output, error) from error
    if wanted.model_out is not None:
        publish_npz(wanted.model_out, model.to_arrays(), provenance)
    return found


def _asked(image: Image, wanted: Wanted) -> SegmentSpec | TextureModel:
    if wanted.model_path is not None:
        return read_model(wanted.model_path)
    if wanted.spec is None:
        raise ValueError("either a specification or a model is needed")
    if _is_grey(image) and wanted.spec.features == "site":
        return replace(wanted.spec, features="texture")
    return wanted.spec


def _is_grey(image: Image) -> bool:
    return len(image.bands) == 1 and image.raster.palette is None


def _fitted(cells: Cells, spec: SegmentSpec) -> tuple[TextureModel, dict[str, Any]]:
    sample = draw_sample(cells, spec.seed)
    considered = {} if spec.classes else consider(sample, cells.settings, spec.seed)
    classes = spec.classes or best(considered)
    model = cluster(sample, cells.settings, cells.pixel_m, classes, spec.seed)
    return model, {"considered": {str(k): value for k, value in considered.items()}}


def _applied(cells: Cells, model: TextureModel, growing: bool) -> tuple[TextureModel, dict[str, Any]]:
    sample = draw_sample(cells, 0)
    share = float(novel(model, sample).mean())
    used = grow(model, sample, 0) if growing else model
    return used, {"novel_share": share, "grown": used.classes - model.classes}


def _write(
    image: Image,
    cells: Cells,
    output: Path,
    model: TextureModel,
    extras: dict[str, Any],
    creation: dict[str, str],
    work: Work,
    provenance: Provenance,
    progress: Progress,
) -> Found:
    table = describe(model)
    names = [f"class {row['id']}" for row in table]
    with publishing_classes(output, image.grid, names, provenance, tags={"table": table}, creation=creation) as writer:
        stats = predict(cells, model, writer.write, block_px=work.block_px, workers=work.workers, progress=progress)
        if not any(stats.class_pixels):
            raise InputError(image.raster.path, "has no patch that is at least half valid: nothing could be classified")
        writer.style = class_qml(names, stats.class_fractions)
        writer.tags["stats"] = asdict(stats)
        writer.tags["extras"] = extras
    return Found(stats, table, **extras)


def _recall(output: Path) -> Found:
    """Read back from an up-to-date output what its making found."""
    with open_raster(output, unreferenced=True) as raster:
        stats, table, extras = (json.loads(raster.hrt_tags[name]) for name in ("STATS", "TABLE", "EXTRAS"))
    stats["class_pixels"] = tuple(stats["class_pixels"])
    return Found(SegmentStats(**stats), table, **extras)


def _novelty_notes(found: Found) -> list[str]:
    if found.grown:
        return [f"{found.novel_share:.1%} of its patches are unlike the model's classes: {found.grown} classes are new"]
    if found.novel_share is not None and found.novel_share >= MIN_SHARE:
        return [
            f"{found.novel_share:.1%} of its patches are unlike every class of the model and take the nearest; "
            "--grow makes classes of them"
        ]
    return []
