"""What is in a raster, who made it, its traps, whether `segment` will take it, and roughly what that will cost."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.errors import HrtError, InputError
from hrt_cli.inspection.traps import traps
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.grid import Grid, wrapped_deg
from hrt_cli.raster.image import Image, open_orthomosaic
from hrt_cli.raster.recognise import Sample, data_bands, hrt_stage, made_with, require_picture, take_sample, what_it_is

# Measured with benchmarks/texture.py on one core of the slow machine it was written on: a rough guide only.
_MEGAPIXELS_PER_SECOND = 20.0
_START_UP_S = 2.5
_BASE_MB = 290.0
_MB_PER_WORKER = 90.0

USES: dict[str, list[str]] = {
    "orthomosaic": ["hrt segment FILE -o classes.tif --classes 5"],
    "surface model": ["hrt scoremap --dsm FILE", "hrt feedback --dsm FILE", "hrt drive --world DIR, as dsm.tif"],
    "terrain model": ["hrt scoremap --dsm FILE", "hrt feedback --dsm FILE"],
    "thermal orthomosaic": ["hrt scoremap --interest FILE --thermal-units auto"],
    "index map": ["hrt scoremap --interest FILE"],
    "measured values": ["heights: hrt scoremap --dsm FILE", "temperatures: hrt scoremap --interest FILE"],
    "class raster": ["hrt scoremap FILE -o scoremap.tif"],
    "scoremap": ["hrt plan FILE -o plan.json --start auto --budget 400m"],
    "unknown": [],
}
"""What takes a raster, by its kind."""


@dataclass(frozen=True)
class Inspection:
    """What `inspect` found.

    Attributes
    ----------
    facts : dict
        JSON values by name, as `hrt inspect --json` prints them.
    notes : list of str
        Traps and warnings.
    refusal : str or None
        Why `segment` would refuse the raster; None if it would take it.
    grid : Grid or None
        Where it lies, if it has a trustworthy georeference.
    """

    facts: dict[str, Any]
    notes: list[str]
    refusal: str | None
    grid: Grid | None = None


def inspect_raster(
    path: Path, *, bands: tuple[int, ...] = (), nodata: float | None = None, unreferenced: bool = False
) -> Inspection:
    """Look at a raster as `segment` would, and tell everything that is known of it.

    Raises
    ------
    InputError
        The file is no raster at all.
    """
    return inspect_rasters([path], first=path, bands=bands, nodata=nodata, unreferenced=unreferenced)


def inspect_rasters(
    paths: Sequence[Path],
    *,
    first: Path,
    bands: tuple[int, ...] = (),
    nodata: float | None = None,
    unreferenced: bool = False,
) -> Inspection:
    """Look at the tiles of one orthomosaic as at a raster: what only one of them can tell, `first` tells.

    Parameters
    ----------
    paths : sequence of Path
        As `open_orthomosaic` takes them.
    first : Path
        One of the files meant.

    Raises
    ------
    InputError
        It is no raster at all.
    """
    grid, warnings = (None, []) if unreferenced else _placed(first)
    with open_raster(first, nodata=nodata, unreferenced=True) as raster:
        sample = take_sample(raster)
        maker, kind = made_with(raster), what_it_is(raster, sample)
        facts = _header(raster) | {"values": _values(raster, sample)}
        trapped = traps(raster, grid, sample, kind, maker)
    facts |= {
        "made_with": maker.program,
        "made_with_by": maker.by,
        "kind": kind.name,
        "kind_certainty": kind.certainty,
        "kind_because": kind.because,
        "used_by": [use.replace("FILE", shlex.quote(str(first))) for use in USES[kind.name]],
    }
    refusal = None
    try:
        with open_orthomosaic(paths, bands=bands, nodata=nodata, unreferenced=unreferenced) as image:
            facts |= _image(image)
            grid = image.grid if image.grid.crs is not None else None
            doubts = [] if bands else require_picture(image)
            warnings = image.notes + doubts
    except HrtError as error:
        refusal = str(error)
        if grid is not None and "crs" not in facts:
            facts |= _place(grid)
    notes = list(dict.fromkeys([*warnings, *trapped]))
    megapixels = facts["rows"] * facts["cols"] / 1e6
    facts["megapixels"] = megapixels
    facts["segment_seconds"] = round(_START_UP_S + megapixels / _MEGAPIXELS_PER_SECOND, 1)
    facts["segment_memory_mb"] = round(_BASE_MB + _MB_PER_WORKER)
    return Inspection(facts, notes, refusal, grid)


def _placed(path: Path) -> tuple[Grid | None, list[str]]:
    """Return where a raster lies, if that can be trusted, and what there is to know of it."""
    try:
        with open_raster(path) as raster:
            return raster.grid, raster.notes
    except InputError:
        return None, []


def _values(raster: Raster, sample: Sample) -> list[float] | None:
    """Return 1 %, median and 99 % of the values of a raster with one band of more than 8 bits."""
    bands = data_bands(raster)
    if len(bands) != 1 or raster.dtypes[bands[0] - 1] == "uint8":
        return None
    values = sample.valid(raster, bands[0])
    return (
        [float(value) for value in np.quantile(values.astype(np.float64), (0.01, 0.5, 0.99))] if values.size else None
    )


def _header(raster: Raster) -> dict[str, Any]:
    stage = hrt_stage(raster)
    return {
        "file": raster.path.name,
        "bytes": raster.path.stat().st_size,
        "driver": raster.driver,
        "rows": raster.grid.rows,
        "cols": raster.grid.cols,
        "bands": raster.count,
        "dtypes": list(raster.dtypes),
        "band_colours": [colour.name for colour in raster.colours],
        "nodata": [None if value is None else _json_number(value) for value in raster.nodata],
        "compression": raster.compression,
        "block": list(raster.block_shape),
        "overviews": raster.overviews,
        "mask": raster.has_mask,
        "software": raster.tags.get("TIFFTAG_SOFTWARE"),
        "made_by": f"hrt {stage}" if stage else None,
    }


def _place(grid: Grid) -> dict[str, Any]:
    row_m, col_m = grid.pixel_m
    return {
        "crs": grid.crs_text(),
        "pixel_m": [row_m, col_m],
        "extent_m": [row_m * grid.rows, col_m * grid.cols],
        "bounds_lonlat": _bounds(grid),
        "scale_variation": grid.ground.variation,
        "placeholder_georeference": grid.placeholder_georeference,
    }


def _bounds(grid: Grid) -> list[float] | None:
    """Return west, south, east and north in degrees; None where it has no place on the Earth."""
    if grid.crs is None or grid.placeholder_georeference:
        return None
    lon, lat = grid.lonlat(*grid.xy([0, 0, grid.rows, grid.rows], [0, grid.cols, 0, grid.cols]))
    middle = lon[0]
    lon = middle + wrapped_deg(lon - middle)
    return [round(float(each), 7) for each in (lon.min(), lat.min(), lon.max(), lat.max())]


def _image(image: Image) -> dict[str, Any]:
    return {
        **_place(image.grid),
        "rows": image.grid.rows,
        "cols": image.grid.cols,
        "colour_bands": image.bands,
        "alpha_band": image.alpha,
        "valid_share": image.valid_share,
    }


def _json_number(value: float) -> float | str:
    return value if value == value and abs(value) != float("inf") else str(value)
