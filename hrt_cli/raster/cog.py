"""The one GeoTIFF writer: a Cloud Optimised GeoTIFF, published whole, with its provenance inside.

Pixels go window by window into a working GeoTIFF in the publishing folder; GDAL's COG driver copies it with
overviews; the copy is re-opened and its pixels are hashed again before it takes its name. Nothing grows with the
raster but the file.
"""

from __future__ import annotations

import hashlib
import json
import re
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
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError, RasterioIOError
from rasterio.io import DatasetReader, DatasetWriter
from rasterio.windows import Window as RioWindow

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import canonical, parse_strict
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window

TILE_PX = 512
_NAMESPACE = "HRT"
_STRIP_ROWS = 512
_SPACE_LEFT = 64 * 1024
_MOST_GATHERED = 2**24
"""Pixels gathered to be hashed; of a wider raster what was written is read again, so that memory does not grow."""

# GDAL's own errors reach us bare from some of rasterio's functions (`rasterio.shutil.copy` on a full disk).
_GDAL_ERRORS = (RasterioError, CPLE_BaseError)
_COMPRESSIONS = "NONE|DEFLATE|LZW|ZSTD|LZMA"
_CREATION = {
    "COMPRESS": _COMPRESSIONS,
    "LEVEL": "[0-9]{1,2}",
    "PREDICTOR": "YES|NO|STANDARD|FLOATING_POINT",
    "BLOCKSIZE": "128|256|512|1024|2048",
    "BIGTIFF": "YES|NO|IF_NEEDED|IF_SAFER",
    "OVERVIEWS": "AUTO|NONE",
    "OVERVIEW_COMPRESS": _COMPRESSIONS,
    "OVERVIEW_RESAMPLING": "NEAREST|AVERAGE|BILINEAR|CUBIC|MODE",
    "SPARSE_OK": "YES|NO",
}
"""Creation options of the COG driver that users may set, and the values of each (a regular expression)."""

_LEVELS = {"DEFLATE": "5", "ZSTD": "1"}
"""Higher ones take several times as long, for files a fifth smaller."""

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


class _RunningHash:
    """The content of a raster of one band and without a mask, hashed as it is written from top to bottom.

    Attributes
    ----------
    content : str or None
        As `_content_of`, once all is written; None where it was not written so.
    """

    def __init__(self, dataset: DatasetWriter) -> None:
        self._digest = _hash_header(dataset)
        self._shape = dataset.shape
        self._row, self._beside = 0, 0
        self._band: NDArray[Any] | None = None
        self._follows = dataset.count == 1 and dataset.nodata is not None

    def add(self, window: Window, pixels: NDArray[Any]) -> None:
        """Take the pixels [height, width] of the window beside the last one, or of the first of the rows below it."""
        if not self._follows or window.height * self._shape[1] > _MOST_GATHERED:
            self._follows = False
            return
        if self._band is None:
            self._band = np.empty((window.height, self._shape[1]), pixels.dtype)
        place = (window.row, window.col, window.height)
        self._follows = self._follows and place == (self._row, self._beside, len(self._band))
        if not self._follows:
            self._band = None
            return
        self._band[:, window.col : window.col + window.width] = pixels
        self._beside += window.width
        if self._beside == self._shape[1]:
            self._digest.update(self._band.data)
            self._row, self._beside, self._band = self._row + window.height, 0, None

    @property
    def content(self) -> str | None:
        return self._digest.hexdigest() if self._follows and self._row == self._shape[0] else None


class CogWriter:
    """Takes the pixels of a raster being written, in any order of windows.

    Attributes
    ----------
    tags : dict
        What joins the layout's tags.
    style : str or None
        The text of the `.qml`: the layout's, or another that is known only when all is written.
    """

    def __init__(self, dataset: DatasetWriter, style: str | None) -> None:
        self._dataset = dataset
        self._running = _RunningHash(dataset)
        self.tags: dict[str, Any] = {}
        self.style = style

    @property
    def content(self) -> str | None:
        """The hash of what was written, where it is known without reading it back."""
        return self._running.content

    def write(self, window: Window, pixels: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> None:
        """Write `pixels` [band, height, width] (or [height, width] for one band), and the mask if there is one."""
        there = RioWindow(window.col, window.row, window.width, window.height)
        self._dataset.write(pixels if pixels.ndim == 3 else pixels[np.newaxis], window=there)
        self._running.add(window, pixels if pixels.ndim == 2 else pixels[0])
        if valid is not None:
            self._dataset.write_mask(valid, window=there)


@contextmanager
def publishing_cog(target: Path, grid: Grid, layout: Layout, provenance: Provenance) -> Iterator[CogWriter]:
    """Yield a writer; on a clean exit the GeoTIFF (and its style) is published as `target`.

    `writer.tags` and `writer.style` may be set while writing to what is only known then.

    Raises
    ------
    OutputError
        The file cannot be written or does not read back as it was written.
    ArgumentError
        A creation option is none that a lossless GeoTIFF on the same grid can have.
    """
    digest, work_bytes = "", 0
    creation = _checked_creation(layout.creation)

    def check(draft: Path) -> None:
        try:
            whole = _content_of(draft) == digest
        except _GDAL_ERRORS:
            whole = False
        if not whole:
            raise _write_error(target, "does not read back as it was written", work_bytes)

    with publishing(target, check) as draft:
        work = draft.with_name("work.tif")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
                    with rasterio.open(work, "w", **_work_profile(grid, layout)) as dataset:
                        _describe(dataset, layout)
                        writer = CogWriter(dataset, layout.style)
                        yield writer
                    digest = writer.content or _content_of(work)
                    _tag(work, {**layout.tags, **writer.tags}, provenance.with_content(digest))
                    _add_overviews(work, layout, creation)
                    work_bytes = work.stat().st_size
                    _copy_to_cog(work, draft, layout, creation)
        except _GDAL_ERRORS as error:
            raise _write_error(target, str(error.__cause__ or error), work_bytes) from error
        work.unlink()
        if writer.style is not None:
            draft.with_suffix(".qml").write_text(writer.style, encoding="utf-8")


def cog_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a GeoTIFF of ours and check its pixels against it."""
    with open_raster(path, unreferenced=True) as raster:
        found = tagged_provenance(raster)
    if found is None:
        return None
    try:
        content = _content_of(path)
    except _GDAL_ERRORS as error:
        raise InputError(path, "is damaged: its pixels cannot be read") from error
    return checked(path, found, content)


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
    try:
        dataset = rasterio.open(work, "r+")
    except TypeError as error:  # what rasterio makes of a file whose header the disk had no room for
        raise RasterioIOError(str(error)) from error
    with dataset:
        dataset.update_tags(ns=_NAMESPACE, **values)


def _checked_creation(creation: Mapping[str, str]) -> dict[str, str]:
    """Let through the options that change how pixels are stored, none that changes what they are.

    GDAL ignores an option that it does not know, and loops for ever on a block size below zero.
    """
    checked = {name.upper(): value.upper() for name, value in creation.items()}
    for name, value in checked.items():
        if name not in _CREATION:
            raise ArgumentError(f"--co {name}: is none of {', '.join(_CREATION)}")
        if not re.fullmatch(_CREATION[name], value):
            raise ArgumentError(f"--co {name}={value}: must be {_CREATION[name].replace('|', ', ')}")
    return checked


def _add_overviews(work: Path, layout: Layout, creation: Mapping[str, str]) -> None:
    """Build nearest-neighbour overviews beside the uncompressed pixels; the COG driver's own pass is much slower."""
    if layout.resampling != "nearest" or any(name.startswith("OVERVIEW") for name in creation):
        return
    with rasterio.Env(GDAL_TIFF_OVR_BLOCKSIZE=TILE_PX), rasterio.open(work, "r+") as dataset:
        factors: list[int] = []
        side = max(dataset.shape)
        while side > int(creation.get("BLOCKSIZE", TILE_PX)):
            factors.append(2 ** (len(factors) + 1))
            side //= 2
        if factors:
            dataset.build_overviews(factors, Resampling.nearest)


def _copy_to_cog(work: Path, draft: Path, layout: Layout, creation: Mapping[str, str]) -> None:
    # Zstandard makes smaller files of classes in a third of the time, but OpenCV, for one, does not read it.
    compression = creation.get("COMPRESS", "DEFLATE")
    options = {
        "COMPRESS": compression,
        "LEVEL": _LEVELS.get(compression, ""),
        "PREDICTOR": "YES" if np.dtype(layout.dtype).kind == "f" or layout.rgb else "NO",
        "BLOCKSIZE": str(TILE_PX),
        "OVERVIEW_RESAMPLING": layout.resampling.upper(),
        "BIGTIFF": "IF_SAFER",
        **creation,
    }
    options = {name: value for name, value in options.items() if value}
    rasterio.shutil.copy(work, draft, driver="COG", copy_src_mdd="YES", **options)


def _content_of(path: Path) -> str:
    """Hash shape, dtype, place, pixels and mask of a GeoTIFF, strip by strip."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as dataset:
            digest = _hash_header(dataset)
            for top in range(0, dataset.height, _STRIP_ROWS):
                _hash_strip(dataset, digest, top)
    return digest.hexdigest()


def _hash_header(dataset: DatasetReader | DatasetWriter) -> hashlib._Hash:
    digest = hashlib.sha256(f"{dataset.height}|{dataset.width}|{dataset.count}|{dataset.dtypes}".encode())
    # The CRS by its code: its text differs between versions of PROJ.
    code = dataset.crs.to_epsg() if dataset.crs else None
    digest.update(json.dumps([repr(dataset.nodata), list(dataset.transform)[:6], code]).encode())
    return digest


def _hash_strip(dataset: DatasetReader, digest: hashlib._Hash, top: int) -> None:
    window = RioWindow(0, top, dataset.width, min(_STRIP_ROWS, dataset.height - top))
    for band in range(1, dataset.count + 1):
        digest.update(np.ascontiguousarray(dataset.read(band, window=window)).data)
    if dataset.nodata is None:
        digest.update(np.packbits(dataset.dataset_mask(window=window) > 0).data)


def _write_error(target: Path, problem: str, work_bytes: int) -> OutputError:
    """Say why a raster could not be written, GDAL's own words for a full disk being many and obscure.

    GDAL has deleted what it wrote of the copy by now: the disk was full if a copy as large as the uncompressed
    original has no room in what is free again.
    """
    free = shutil.disk_usage(target.parent).free
    if free < max(_SPACE_LEFT, 2 * work_bytes) or "No space left" in problem:
        return OutputError(f"{target}: No space left on device; nothing was changed")
    return OutputError(f"{target}: cannot be written: {' '.join(problem.split())}")
