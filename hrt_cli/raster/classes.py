"""The class raster (`classes.tif`): one uint8 band of texture classes 0 to K-1, 255 where there is no class."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.errors import InputError
from hrt_cli.raster.cog import CogWriter, Layout, publishing_cog
from hrt_cli.raster.gate import Raster, is_nodata, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.style import class_palette, class_qml
from hrt_cli.raster.windows import Window

NODATA = 255
MAX_CLASSES = 255


@dataclass(frozen=True)
class ClassRaster:
    """An open class raster that passed the gate."""

    raster: Raster
    names: list[str]

    @property
    def grid(self) -> Grid:
        """The raster's geometry."""
        return self.raster.grid

    def read(self, window: Window) -> NDArray[np.uint8]:
        """Read classes [height, width] in a window inside the raster; 255 is nodata.

        Raises
        ------
        InputError
            A value is neither nodata nor a class id from 0 to 254.
        """
        values = self.raster.read_bands([1], window)[0]
        empty = is_nodata(values, self.raster.nodata[0])
        if self.raster.has_mask:
            empty |= ~self.raster.read_mask(window)
        wrong = ~empty & ((values < 0) | (values >= NODATA) | (values != np.floor(values)))
        if values.dtype == np.uint8 and self.raster.nodata[0] is None:
            wrong &= values != NODATA  # 255 means nodata in a class raster even where it is not declared
            empty |= values == NODATA
        if wrong.any():
            value = values[wrong][0]
            raise InputError(self.raster.path, f"holds the value {value}, which is no class id (0 to {NODATA - 1})")
        return np.where(empty, NODATA, np.where(empty, 0, values)).astype(np.uint8)


@contextmanager
def open_classes(path: Path, *, unreferenced: bool = False) -> Iterator[ClassRaster]:
    """Open a class raster through the gate.

    Raises
    ------
    InputError
        As `open_raster`, and where the file is not a raster of one band of whole numbers.
    """
    with open_raster(path, unreferenced=unreferenced) as raster:
        if raster.count != 1:
            raise InputError(path, f"has {raster.count} bands; a class raster has one")
        if np.dtype(raster.dtypes[0]).kind == "f":
            raise InputError(path, f"has pixels of type {raster.dtypes[0]}; class ids are whole numbers")
        yield ClassRaster(raster, _names(raster))


@contextmanager
def publishing_classes(
    target: Path,
    grid: Grid,
    names: list[str],
    provenance: Provenance,
    *,
    tags: dict[str, Any],
    creation: dict[str, str],
) -> Iterator[CogWriter]:
    """Yield a writer for a class raster with its palette, names and QGIS style."""
    layout = Layout(
        bands=("class",),
        dtype="uint8",
        nodata=NODATA,
        palette=class_palette(len(names), NODATA),
        tags={"names": names, **tags},
        style=class_qml(names),
        creation=creation,
    )
    with publishing_cog(target, grid, layout, provenance) as writer:
        yield writer


def _names(raster: Raster) -> list[str]:
    try:
        names = json.loads(raster.hrt_tags.get("NAMES", "[]"))
    except (ValueError, RecursionError) as error:
        raise InputError(raster.path, "its class names are damaged") from error
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise InputError(raster.path, "its class names are damaged")
    return names
