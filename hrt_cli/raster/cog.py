"""The one GeoTIFF writer: a Cloud Optimised GeoTIFF, published whole, with its provenance inside.

Pixels go window by window into a working GeoTIFF in the publishing folder; GDAL's COG driver copies it with
overviews; the copy is re-opened and its pixels are hashed again before it takes its name. Nothing grows with the
raster but the file.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.windows import Window as RioWindow

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import canonical, parse_strict
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import OutputError
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window

TILE_PX = 512
_NAMESPACE = "HRT"
_STRIP_ROWS = 512
_SPACE_LEFT = 64 * 1024

Colour = tuple[int, int, int, int]


@dataclass(frozen=True)
class Layout:
    """What a GeoTIFF of ours looks like.

    Attributes
    ----------
    bands : tuple of str
        One description a band.
    dtype : str
    nodata : float or None
    resampling : {"nearest", "average"}
        How overviews are made.
    palette : mapping of int to (r, g, b, alpha), optional
        Colours of a one-band uint8 raster.
    rgb : bool
        Declare three bands as red, green and blue.
    tags : mapping of str to JSON values
        Written into the namespace HRT beside the provenance.
    style : str, optional
        The text of a `.qml` (QGIS style) published beside the raster.
    creation : mapping of str to str
        Further options of the COG driver, as the user gave them (`--co`).
    """

    bands: tuple[str, ...]
    dtype: str
    nodata: float | None = None
    resampling: Literal["nearest", "average"] = "nearest"
    palette: Mapping[int, Colour] | None = None
    rgb: bool = False
    tags: Mapping[str, Any] = field(default_factory=dict)
    style: str | None = None
    creation: Mapping[str, str] = field(default_factory=dict)


class CogWriter:
    """Takes the pixels of a raster being written, in any order of windows."""

    def __init__(self, dataset: DatasetWriter) -> None:
        self._dataset = dataset
        self.tags: dict[str, Any] = {}

    def write(self, window: Window, pixels: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> None:
        """Write `pixels` [band, height, width] (or [height, width] for one band), and the mask if there is one."""
        there = RioWindow(window.col, window.row, window.width, window.height)
        self._dataset.write(pixels if pixels.ndim == 3 else pixels[np.newaxis], window=there)
        if valid is not None:
            self._dataset.write_mask(valid, window=there)


@contextmanager
def publishing_cog(target: Path, grid: Grid, layout: Layout, provenance: Provenance) -> Iterator[CogWriter]:
    """Yield a writer; on a clean exit the GeoTIFF (and its style) is published as `target`.

    `writer.tags` may be filled while writing with what is only known then; they join `layout.tags`.

    Raises
    ------
    OutputError
        The file cannot be written or does not read back as it was written.
    """
    digest = ""

    def check(draft: Path) -> None:
        if _content_of(draft) != digest:
            raise OutputError(f"{target}: did not read back as it was written (is the disk full?)")

    with publishing(target, check) as draft:
        work = draft.with_name("work.tif")
        if layout.style is not None:
            draft.with_suffix(".qml").write_text(layout.style, encoding="utf-8")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
                    with rasterio.open(work, "w", **_work_profile(grid, layout)) as dataset:
                        _describe(dataset, layout)
                        writer = CogWriter(dataset)
                        yield writer
                    digest = _content_of(work)
                    _tag(work, {**layout.tags, **writer.tags}, provenance.with_content(digest))
                    _copy_to_cog(work, draft, layout)
        except RasterioError as error:
            raise _write_error(target, error) from error
        work.unlink()


def cog_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a GeoTIFF of ours and check its pixels against it."""
    with open_raster(path, unreferenced=True) as raster:
        found = tagged_provenance(raster)
    if found is None:
        return None
    return checked(path, found, _content_of(path))


def tagged_provenance(raster: Raster) -> Provenance | None:
    """Read the provenance of an open raster without looking at its pixels."""
    text = raster.hrt_tags.get("PROVENANCE")
    return None if text is None else parse_provenance(raster.path, parse_strict(raster.path, text))


def _work_profile(grid: Grid, layout: Layout) -> dict[str, Any]:
    return {
        "driver": "GTiff",
        "height": grid.rows,
        "width": grid.cols,
        "count": len(layout.bands),
        "dtype": layout.dtype,
        "nodata": layout.nodata,
        "crs": grid.crs,
        "transform": grid.transform if grid.crs is not None else None,
        "tiled": True,
        "blockxsize": TILE_PX,
        "blockysize": TILE_PX,
        "compress": "deflate",
        "zlevel": 1,
        "interleave": "pixel" if layout.rgb else "band",
        "photometric": "RGB" if layout.rgb else "MINISBLACK",
        "BIGTIFF": "IF_SAFER",
    }


def _describe(dataset: DatasetWriter, layout: Layout) -> None:
    if layout.rgb:
        dataset.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if layout.palette is not None:
        dataset.write_colormap(1, dict(layout.palette))
    for index, text in enumerate(layout.bands, start=1):
        dataset.set_band_description(index, text)


def _tag(work: Path, tags: Mapping[str, Any], provenance: Provenance) -> None:
    values = {key.upper(): canonical(value).decode() for key, value in tags.items()}
    values["PROVENANCE"] = canonical(provenance.model_dump(mode="json")).decode()
    with rasterio.open(work, "r+") as dataset:
        dataset.update_tags(ns=_NAMESPACE, **values)


def _copy_to_cog(work: Path, draft: Path, layout: Layout) -> None:
    options = {
        "COMPRESS": "DEFLATE",
        "PREDICTOR": "YES" if np.dtype(layout.dtype).kind == "f" or layout.rgb else "NO",
        "BLOCKSIZE": str(TILE_PX),
        "OVERVIEW_RESAMPLING": layout.resampling.upper(),
        "BIGTIFF": "IF_SAFER",
        **{key.upper(): value for key, value in layout.creation.items()},
    }
    rasterio.shutil.copy(work, draft, driver="COG", copy_src_mdd="YES", **options)


def _content_of(path: Path) -> str:
    """Hash shape, dtype, pixels and mask of a GeoTIFF, strip by strip."""
    digest = hashlib.sha256()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as dataset:
            digest.update(f"{dataset.height}|{dataset.width}|{dataset.count}|{dataset.dtypes}".encode())
            digest.update(json.dumps([repr(dataset.nodata), list(dataset.transform)[:6]]).encode())
            for top in range(0, dataset.height, _STRIP_ROWS):
                _hash_strip(dataset, digest, top)
    return digest.hexdigest()


def _hash_strip(dataset: DatasetReader, digest: hashlib._Hash, top: int) -> None:
    window = RioWindow(0, top, dataset.width, min(_STRIP_ROWS, dataset.height - top))
    for band in range(1, dataset.count + 1):
        digest.update(np.ascontiguousarray(dataset.read(band, window=window)).data)
    if dataset.nodata is None:
        digest.update(np.packbits(dataset.dataset_mask(window=window) > 0).data)


def _write_error(target: Path, error: Exception) -> OutputError:
    free = shutil.disk_usage(target.parent).free
    if free < _SPACE_LEFT or "No space left" in str(error.__cause__ or error):
        return OutputError(f"{target}: No space left on device; nothing was changed")
    return OutputError(f"{target}: cannot be written: {' '.join(str(error.__cause__ or error).split())}")
