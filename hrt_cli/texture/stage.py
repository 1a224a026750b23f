"""The segment stage: an orthomosaic becomes a class raster (and a texture model), from file to file."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.carriers import npz_provenance, publish_npz, read_stamped_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.stage import REFUSE, Existing, Job, ReadProvenance, begin
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.image import Image, open_image
from hrt_cli.texture.model import TextureModel, describe
from hrt_cli.texture.segment import SegmentSpec, SegmentStats, fit, predict

STAGE = "segment"
STAGE_VERSION = 1


@dataclass(frozen=True)
class ImageOptions:
    """How the orthomosaic is to be read; see `open_image`."""

    bands: tuple[int, ...] = ()
    nodata: float | None = None
    unreferenced: bool = False


@dataclass(frozen=True)
class Segmentation:
    """What the segment stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    stats : SegmentStats
        Pixels of each class, of the raster, and with data.
    table : list of dict
        A row a class: id, share in the sample, mean_rgb, roughness.
    notes : list of str
        What the user ought to know about the orthomosaic.
    seconds : float
        Wall-clock time of the stage.
    """

    up_to_date: bool
    stats: SegmentStats
    table: list[dict[str, object]]
    notes: list[str]
    seconds: float


def segment_file(
    ortho: Path,
    output: Path,
    *,
    spec: SegmentSpec | None = None,
    model_path: Path | None = None,
    model_out: Path | None = None,
    image_options: ImageOptions = ImageOptions(),
    creation: dict[str, str] | None = None,
    block_px: int = 1024,
    workers: int = 1,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> Segmentation:
    """Segment `ortho` into `output`, by a model fitted on it (`spec`) or by one of before (`model_path`).

    Parameters
    ----------
    spec : SegmentSpec, optional
        What to fit; not together with `model_path`.
    model_path, model_out : Path, optional
        The model to apply; where to keep the model that was fitted.
    block_px, workers : int
        How the work is cut up; the result does not depend on it.

    Raises
    ------
    InputError
        The orthomosaic or the model cannot be used.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    began = time.monotonic()
    creation = creation or {}
    if model_out is not None and model_out.resolve() == output.resolve():
        raise OutputError(f"{output}: is named for two outputs; give the classes and the model different files")
    with open_image(ortho, **asdict(image_options)) as image:
        inputs = {**image.raster.sources(), **({"model": model_path} if model_path else {})}
        parameters = _parameters(spec, image_options, creation)
        outputs: dict[Path, ReadProvenance] = {
            output: cog_provenance,
            **({model_out: npz_provenance} if model_out else {}),
        }
        job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs=outputs, existing=existing)
        if job.up_to_date:
            stats, table = _recall(output)
        else:
            stats, table = _compute(
                image, output, spec, model_path, model_out, creation, block_px, workers, job, progress
            )
        return Segmentation(job.up_to_date, stats, table, image.raster.notes, time.monotonic() - began)


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


def _parameters(spec: SegmentSpec | None, image_options: ImageOptions, creation: dict[str, str]) -> dict[str, Any]:
    fitted = json.loads(json.dumps(asdict(spec))) if spec else None
    return {"fit": fitted, "image": json.loads(json.dumps(asdict(image_options))), "creation": creation}


def _compute(
    image: Image,
    output: Path,
    spec: SegmentSpec | None,
    model_path: Path | None,
    model_out: Path | None,
    creation: dict[str, str],
    block_px: int,
    workers: int,
    job: Job,
    progress: Progress,
) -> tuple[SegmentStats, list[dict[str, object]]]:
    try:
        if model_path is not None:
            model = read_model(model_path)
        elif spec is not None:
            if not image.has_colours(spec.classes):
                raise ArgumentError(f"holds fewer than {spec.classes} different colours, too few for as many classes")
            model = fit(image, spec, workers=workers, progress=progress)
        else:
            raise ValueError("either a spec or a model is needed")
        stats = _write(image, output, model, creation, block_px, workers, job.provenance, progress)
    except ArgumentError as error:
        raise InputError(image.raster.path, str(error)) from error
    if model_out is not None:
        publish_npz(model_out, model.to_arrays(), job.provenance)
    return stats, describe(model)


def _write(
    image: Image,
    output: Path,
    model: TextureModel,
    creation: dict[str, str],
    block_px: int,
    workers: int,
    provenance: Provenance,
    progress: Progress,
) -> SegmentStats:
    table = describe(model)
    names = [f"class {row['id']}" for row in table]
    with publishing_classes(output, image.grid, names, provenance, tags={"table": table}, creation=creation) as writer:
        stats = predict(image, model, writer.write, block_px=block_px, workers=workers, progress=progress)
        if not any(stats.class_pixels):
            raise InputError(image.raster.path, "has no patch that is at least half valid: nothing could be classified")
        writer.tags["stats"] = asdict(stats)
    return stats


def _recall(output: Path) -> tuple[SegmentStats, list[dict[str, object]]]:
    """Read back from an up-to-date output what its making found."""
    with open_raster(output, unreferenced=True) as raster:
        stats = json.loads(raster.hrt_tags["STATS"])
        table: list[dict[str, object]] = json.loads(raster.hrt_tags["TABLE"])
    stats["class_pixels"] = tuple(stats["class_pixels"])
    return SegmentStats(**stats), table
