"""Surface and terrain models: rasters of heights, in metres whatever their own unit is."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.errors import InputError
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.grid import Grid

VOID = (-9999.0, -10000.0, -32767.0, -32768.0, float(np.finfo(np.float32).min))
"""What programs write where they have no height or temperature, also where they do not declare it."""

_FOOT_M, _US_FOOT_M = 0.3048, 1200 / 3937
_UNITS_M = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter"), 0.001),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), _FOOT_M),
    **dict.fromkeys(("us-ft", "ftus", "us survey foot", "us survey feet", "foot_us", "survey foot"), _US_FOOT_M),
}
_VERTICAL = re.compile(r"\bVERTCRS\[")
_LENGTH_UNIT = re.compile(r'\bLENGTHUNIT\["[^"]*",([0-9.eE+-]+)')


@contextmanager
def open_heights(path: Path) -> Iterator[Raster]:
    """Open a surface or terrain model through the gate.

    Raises
    ------
    InputError
        As `open_raster`, and where it has several bands or its unit of height is not known.
    """
    with open_raster(path) as raster:
        alpha = raster.count == 2 and raster.colours[1] == ColorInterp.alpha
        if raster.count != 1 and not alpha:
            raise InputError(path, f"has {raster.count} bands; a surface model has one: heights")
        height_unit_m(raster)
        yield raster


def height_unit_m(raster: Raster) -> float:
    """Return how many metres one unit of height is: by the band's unit tag, else the vertical CRS, else 1.

    Raises
    ------
    InputError
        The tag names no known unit of length, or another one than the CRS.
    """
    tag = raster.units[0].strip().lower()
    by_tag = _UNITS_M.get(tag)
    if tag and by_tag is None:
        raise InputError(raster.path, f"has heights in {tag!r}, no unit of length known here", "convert it to metres")
    by_crs = _vertical_unit_m(raster.grid)
    if by_tag is not None and by_crs is not None and not math.isclose(by_tag, by_crs, rel_tol=1e-4):
        raise InputError(
            raster.path,
            f"says that its heights are in {tag!r}, while a unit of its vertical CRS is {by_crs:g} m",
            "correct one of them, as with gdal_edit -a_srs",
        )
    return by_tag or by_crs or 1.0


def _vertical_unit_m(grid: Grid) -> float | None:
    text = grid.crs.to_wkt(version="WKT2_2019") if grid.crs is not None else ""
    found = _VERTICAL.search(text)
    # A VERTCRS ends the text of a compound CRS, its unit stands at its end.
    units = _LENGTH_UNIT.findall(text, found.end()) if found else []
    return float(units[-1]) if units else None


def in_metres(raster: Raster, values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return heights as they were read, in metres: by the band's scale and offset, then by its unit.

    Raises
    ------
    InputError
        As `height_unit_m`.
    """
    meant = values.astype(np.float64) * raster.scales[0] + raster.offsets[0]
    return meant * height_unit_m(raster)
