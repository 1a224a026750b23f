"""What is in a raster, whether `segment` will take it, and roughly what that will cost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrt_cli.errors import HrtError
from hrt_cli.raster.cog import tagged_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.image import open_image

# Measured with benchmarks/texture.py on one core of the slow machine it was written on: a rough guide only.
_MEGAPIXELS_PER_SECOND = 20.0
_START_UP_S = 2.5
_BASE_MB = 290.0
_MB_PER_WORKER = 90.0


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
    """

    facts: dict[str, Any]
    notes: list[str]
    refusal: str | None


def inspect_raster(
    path: Path, *, bands: tuple[int, ...] = (), nodata: float | None = None, unreferenced: bool = False
) -> Inspection:
    """Look at a raster as `segment` would, and tell everything that is known of it.

    Raises
    ------
    InputError
        The file is no raster at all.
    """
    facts: dict[str, Any] = {"file": path.name, "bytes": path.stat().st_size if path.is_file() else 0}
    refusal = None
    notes: list[str] = []
    with open_raster(path, nodata=nodata, unreferenced=True) as raster:
        facts |= {
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
        }
        provenance = tagged_provenance(raster)
        facts["made_by"] = f"hrt {provenance.stage}" if provenance else None
    try:
        with open_image(path, bands=bands, nodata=nodata, unreferenced=unreferenced) as image:
            notes += image.raster.notes
            row_m, col_m = image.pixel_m
            ground = image.grid.ground
            facts |= {
                "crs": image.grid.crs_text(),
                "pixel_m": [row_m, col_m],
                "extent_m": [row_m * image.grid.rows, col_m * image.grid.cols],
                "scale_variation": ground.variation,
                "placeholder_georeference": image.grid.placeholder_georeference,
                "colour_bands": image.bands,
                "alpha_band": image.alpha,
                "valid_share": image.valid_share,
            }
    except HrtError as error:
        refusal = str(error)
    megapixels = facts["rows"] * facts["cols"] / 1e6
    facts["megapixels"] = megapixels
    facts["segment_seconds"] = round(_START_UP_S + megapixels / _MEGAPIXELS_PER_SECOND, 1)
    facts["segment_memory_mb"] = round(_BASE_MB + _MB_PER_WORKER)
    return Inspection(facts, notes, refusal)


def _json_number(value: float) -> float | str:
    return value if value == value and abs(value) != float("inf") else str(value)
