"""The empty margin of an orthomosaic that nothing declares as such: it would become a class of its own."""

from __future__ import annotations

import numpy as np

from hrt_cli.raster.mosaic import Layer
from hrt_cli.raster.windows import Window

_CORNER_PX = 16
_BLURRED = 12
"""How far compression with loss moves a plain margin from its value, in 8 bits."""


def margin_notes(layer: Layer) -> list[str]:
    """Tell whether a corner of a raster is all black or all white and yet valid.

    A survey never fills the rectangle of its raster: what it did not see is left over in the corners.
    """
    if layer.palette is not None or np.dtype(layer.dtype).kind == "f":
        return []
    white = int(np.iinfo(layer.dtype).max)
    found = {value: _corners(layer, value) for value in (0, white)}
    return [_note(value, white, exact) for value, exact in found.items() if exact is not None]


def _corners(layer: Layer, value: int) -> bool | None:
    """Whether the corners that are of one value are so exactly; None where there are none that are valid."""
    reach = _BLURRED if layer.file.lossy and layer.dtype == "uint8" else 0
    rows, cols = layer.grid.shape
    height, width = min(_CORNER_PX, rows), min(_CORNER_PX, cols)
    exact = None
    for window in {Window(r, c, height, width) for r in (0, rows - height) for c in (0, cols - width)}:
        colours, valid = layer.read(window)
        seen = np.ones((height, width), np.bool_) if valid is None else valid
        off = np.abs(colours.astype(np.int64) - value)
        if seen.any() and off.max() <= reach:
            exact = exact is not False and not off[:, seen].any()
    return exact


def _note(value: int, white: int, exact: bool) -> str:
    what = "black" if value == 0 else "white"
    if not exact:
        return (
            f"its corners are nearly {what}, blurred by compression with loss, and count as data: --nodata {value} "
            "would miss much of that; mask it with GDAL's nearblack -setmask, or export it with an alpha band"
        )
    return (
        f"its corners are {what} ({value} of {white}) and nothing declares them as empty, so they count as data: "
        f"--nodata {value} leaves them out"
    )
