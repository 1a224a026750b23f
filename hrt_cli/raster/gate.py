"""The one input gate for rasters: what cannot be answered rightly is refused here, before any pixel is worked on.

Most bad rasters load without any exception (no CRS, alpha as a colour, NaN without a nodata tag, a bomb of 30 GB in
40 kB), so each property is checked by itself, from the header, before the first read.
"""

from __future__ import annotations

import logging
import math
import os
import re
import threading
import warnings
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import unescape

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader
from rasterio.windows import Window as RioWindow

from hrt_cli.errors import InputError
from hrt_cli.raster.grid import Grid, require_measurable
from hrt_cli.raster.windows import Window

# GDAL's default cache is 5 % of the machine's memory; blocks are read once, so a small one serves as well.
os.environ.setdefault("GDAL_CACHEMAX", "64")
# GDAL's complaints reach the user as one `Error:` line from the exception, not as a second one from its logger.
logging.getLogger("rasterio").setLevel(logging.CRITICAL)

_DRIVERS = ("GTiff", "COG", "VRT", "JP2OpenJPEG", "HFA", "PNG", "JPEG")
_FORMATS = "GeoTIFF, VRT, JPEG 2000, Imagine, PNG or JPEG is"
_BOMB_BYTES = 2**30
_BOMB_RATIO = 500
_MAX_BLOCK_BYTES = 512 * 2**20
_VRT_ESCAPES = re.compile(rb"/vsi|https?://|<PixelFunction|&#|<!ENTITY|<!\[CDATA", re.IGNORECASE)
_VRT_SOURCE = re.compile(rb"<Source(?:Filename|Dataset)\b([^>]*)>([^<]*)<", re.IGNORECASE)
_VRT_RELATIVE = re.compile(rb"relativeToVRT\s*=\s*[\"']\s*1", re.IGNORECASE)
_MAX_VRT_BYTES = 64 * 2**20
_MAX_VRT_DEPTH = 4


class DatasetPool:
    """The files that are open, at most `limit` a thread: rasterio's datasets must not be shared between threads.

    A thread that asks for a file beyond the limit has the one closed that it has not read for longest. Close all by
    `with`, when no thread reads any more.
    """

    def __init__(self, limit: int = 1) -> None:
        self._limit = limit
        self._local = threading.local()
        self._all: list[OrderedDict[Path, DatasetReader]] = []
        self._lock = threading.Lock()

    def __enter__(self) -> DatasetPool:
        return self

    def __exit__(self, *_: object) -> None:
        for mine in self._all:
            while mine:
                mine.popitem()[1].close()

    def dataset(self, path: Path) -> DatasetReader:
        """Return this thread's own dataset of a file, to be used before the next is asked for.

        Raises
        ------
        InputError
            The file cannot be opened.
        """
        mine: OrderedDict[Path, DatasetReader] | None = getattr(self._local, "mine", None)
        if mine is None:
            mine = self._local.mine = OrderedDict()
            with self._lock:
                self._all.append(mine)
        if path in mine:
            mine.move_to_end(path)
            return mine[path]
        while len(mine) >= self._limit:
            mine.popitem(last=False)[1].close()
        mine[path] = _open(path)
        return mine[path]

    @property
    def open_count(self) -> int:
        """The number of datasets open in all threads."""
        return sum(map(len, self._all))


class Raster:
    """A raster that passed the gate. Reads are safe from several threads, as long as its pool is not closed.

    Attributes
    ----------
    path : Path
    grid : Grid
        Its geometry, found measurable (or pixel coordinates, where it was opened unreferenced).
    count, dtypes, nodata : int, tuple of str, tuple of float or None
        As the file declares them (`nodata` per band; the user's `--nodata` in its place if given).
    units, descriptions : tuple of str
        What the file says of its bands, "" where it says nothing.
    scales, offsets : tuple of float
        A band's values are meant to be those read times its scale plus its offset; `read_bands` does not apply them.
    lossy : bool
        Whether the pixels (of a VRT, those of its first part) are compressed with loss, an alpha band among them.
    notes : list of str
        What the user ought to know though it was no reason to refuse.
    """

    def __init__(self, path: Path, pool: DatasetPool, grid: Grid, nodata: float | None, parts: list[Path]) -> None:
        dataset = pool.dataset(path)
        self.path = path
        self.grid = grid
        self.count: int = dataset.count
        self.dtypes: tuple[str, ...] = dataset.dtypes
        self.nodata: tuple[float | None, ...] = dataset.nodatavals if nodata is None else (nodata,) * dataset.count
        self.units: tuple[str, ...] = tuple(unit or "" for unit in dataset.units)
        self.descriptions: tuple[str, ...] = tuple(text or "" for text in dataset.descriptions)
        self.scales: tuple[float, ...] = dataset.scales
        self.offsets: tuple[float, ...] = dataset.offsets
        self.driver: str = dataset.driver
        self.colours: tuple[ColorInterp, ...] = dataset.colorinterp
        self.block_shape: tuple[int, int] = dataset.block_shapes[0]
        self.compression: str = str(dataset.profile.get("compress", "none"))
        self.lossy = _is_lossy(dataset) or any(map(_is_lossy_part, [p for p in parts if p.suffix != ".vrt"][:1]))
        self.overviews: list[int] = dataset.overviews(1)
        self.tags: dict[str, str] = dataset.tags()
        self.hrt_tags: dict[str, str] = dataset.tags(ns="HRT")
        self.palette: NDArray[np.uint8] | None = _palette(dataset)
        self.has_mask = (
            MaskFlags.per_dataset in dataset.mask_flag_enums[0] and MaskFlags.alpha not in dataset.mask_flag_enums[0]
        )
        self.notes: list[str] = []
        self._parts = list(dict.fromkeys([*map(Path, dataset.files), *parts]))
        self._pool = pool

    def sources(self) -> dict[str, Path]:
        """Return the files that its pixels and mask come from, by role, for provenance.

        That is the file itself, a mask side-car, and the files a VRT is made of; overviews and statistics beside
        it change nothing.
        """
        parts = [
            part for part in self._parts if part != self.path and part.suffix not in (".ovr", ".xml") and part.is_file()
        ]
        return {"raster": self.path} | {f"raster/{index}": part for index, part in enumerate(parts)}

    def read_bands(self, bands: list[int], window: Window, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Read bands (1-based) in a window inside the raster: [band, height, width] in the file's dtype.

        They are put into `out`, of that shape and dtype, where it is given.
        """
        try:
            return np.asarray(self._pool.dataset(self.path).read(bands, window=_rio(window), out=out))
        except RasterioError as error:
            raise _damaged(self.path, error) from error

    def read_mask(self, window: Window) -> NDArray[np.bool_]:
        """Read the file's own mask (internal or side-car) in a window inside the raster."""
        try:
            return np.asarray(self._pool.dataset(self.path).read_masks(1, window=_rio(window)) > 0)
        except RasterioError as error:
            raise _damaged(self.path, error) from error


@contextmanager
def open_raster(
    path: str | os.PathLike[str], *, nodata: float | None = None, unreferenced: bool = False
) -> Iterator[Raster]:
    """Open a raster through the gate.

    Parameters
    ----------
    path : path-like
        A file on this machine (no GDAL virtual file system).
    nodata : float, optional
        The value to take as nodata instead of the file's own.
    unreferenced : bool
        Accept a plain image: lengths are pixels, and the result has no CRS.

    Raises
    ------
    InputError
        The file is no readable raster, is a decompression bomb, has no trustworthy georeference, or has pixels that
        cannot be measured in metres.
    """
    with DatasetPool() as pool:
        yield load_raster(path, pool, nodata=nodata, unreferenced=unreferenced)


def is_plain(path: Path) -> bool:
    """Whether a raster names no coordinate reference system at all: then its lengths are pixels.

    Raises
    ------
    InputError
        The file is no readable raster.
    """
    if not path.is_file():
        raise InputError(path, "is a folder, not a raster" if path.is_dir() else "no such file")
    with DatasetPool() as pool:
        _vrt_parts(path)
        crs = pool.dataset(path).crs
        return crs is None or not crs.to_wkt()


def load_raster(
    path: str | os.PathLike[str], pool: DatasetPool, *, nodata: float | None = None, unreferenced: bool = False
) -> Raster:
    """Let a raster through the gate that is read by way of a pool; else as `open_raster`."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "is a folder, not a raster" if path.is_dir() else "no such file")
    parts = _vrt_parts(path)
    dataset = pool.dataset(path)
    _check_header(path, dataset)
    raster = Raster(path, pool, _grid(path, dataset, unreferenced), nodata, parts)
    if raster.grid.placeholder_georeference:
        raster.notes.append(
            "its coordinates are a placeholder (UTM at 0, 0): the photographs carried no GPS; "
            "missions cannot be exported from it"
        )
    return raster


def _open(path: Path) -> DatasetReader:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset: DatasetReader = rasterio.open(path)
    except RasterioError as error:
        raise InputError(path, "is not a raster that can be read", _FORMATS) from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if dataset.driver not in _DRIVERS:
        dataset.close()
        raise InputError(path, f"is a {dataset.driver} file, which is not read", _FORMATS)
    return dataset


def _vrt_parts(path: Path, depth: int = 0) -> list[Path]:
    """List the files that a VRT is made of, also by way of other VRTs; none for any other file.

    GDAL would open whatever a VRT names: an address on the network, a database. Only plain files are let through.
    """
    try:
        with open(path, "rb") as file:
            if b"<VRTDataset" not in file.read(4096):
                return []
            file.seek(0)
            text = file.read(_MAX_VRT_BYTES + 1)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if len(text) > _MAX_VRT_BYTES:
        raise InputError(path, f"is a VRT of more than {_MAX_VRT_BYTES} bytes")
    if _VRT_ESCAPES.search(text):
        raise InputError(path, "is a VRT that reads over a network or virtual file system, or runs code")
    if depth >= _MAX_VRT_DEPTH:
        raise InputError(path, f"is a VRT inside {depth} other VRTs, or inside itself")
    parts: dict[Path, None] = {}
    for attributes, raw in set(_VRT_SOURCE.findall(text)):
        name = unescape(raw.decode("utf-8", "surrogateescape")).strip()
        part = path.parent / name if _VRT_RELATIVE.search(attributes) else Path(name)
        if not part.is_file():
            raise InputError(path, f"is a VRT of {name!r}, which is no file on this machine")
        parts |= dict.fromkeys([part, *_vrt_parts(part, depth + 1)])
    return sorted(parts)


def _check_header(path: Path, dataset: DatasetReader) -> None:
    if dataset.count < 1 or dataset.width < 1 or dataset.height < 1:
        raise InputError(path, "holds no pixels")
    kinds = {np.dtype(d).kind for d in dataset.dtypes if not d.startswith("complex_int")}
    if not kinds <= set("uif") or any(d.startswith("complex") for d in dataset.dtypes):
        raise InputError(path, f"has pixels of type {dataset.dtypes[0]}; integer or real ones are needed")
    itemsize = max(np.dtype(d).itemsize for d in dataset.dtypes)
    declared = dataset.width * dataset.height * dataset.count * itemsize
    stored = path.stat().st_size
    if dataset.driver != "VRT" and declared > _BOMB_BYTES and declared > _BOMB_RATIO * stored:
        raise InputError(
            path,
            f"declares {declared / 1e9:.0f} GB of pixels in a file of {stored / 1e6:.3g} MB: empty, or a bomb",
            "rewrite it with gdal_translate if it is genuine",
        )
    block_rows, block_cols = dataset.block_shapes[0]
    block = block_rows * block_cols * itemsize * dataset.count
    if block > _MAX_BLOCK_BYTES:
        raise InputError(
            path,
            f"is stored in blocks of {block_cols} x {block_rows} pixels: {block / 1e9:.1f} GB to read one",
            "rewrite it with gdal_translate -co TILED=YES",
        )


def _grid(path: Path, dataset: DatasetReader, unreferenced: bool) -> Grid:
    rows, cols = dataset.height, dataset.width
    if unreferenced:
        return Grid(rows, cols, Affine.identity(), None)
    if dataset.crs is None or not dataset.crs.to_wkt():
        remedy = "assign one with gdal_edit -a_srs, or use --unreferenced for a plain image"
        if dataset.gcps[0]:
            raise InputError(path, "has ground control points but no CRS of its own", "warp it with gdalwarp first")
        if dataset.rpcs is not None:
            raise InputError(path, "has RPCs but no CRS of its own", "orthorectify it with gdalwarp -rpc first")
        raise InputError(path, "has no coordinate reference system", remedy)
    if dataset.transform == Affine.identity():
        raise InputError(path, "has a CRS but no geotransform: it is not placed anywhere")
    grid = Grid(rows, cols, Affine(*dataset.transform[:6]), dataset.crs)
    require_measurable(path, grid)
    return grid


def _palette(dataset: DatasetReader) -> NDArray[np.uint8] | None:
    """Return the colour table [256 or 65536, 3] of a paletted band, else None."""
    length = {"uint8": 2**8, "uint16": 2**16}.get(dataset.dtypes[0], 0)
    if dataset.colorinterp[0] != ColorInterp.palette or not length:
        return None
    table = np.zeros((length, 3), np.uint8)
    for index, colour in dataset.colormap(1).items():
        if index < len(table):
            table[index] = colour[:3]
    return table


def _is_lossy(dataset: DatasetReader) -> bool:
    stored = dataset.tags(ns="IMAGE_STRUCTURE")
    compression = stored.get("COMPRESSION", "")
    # WebP keeps an alpha band as it is, whatever it does to the colours.
    lossy = stored.get("COMPRESSION_REVERSIBILITY") == "LOSSY" and compression != "WEBP"
    return lossy or "JPEG" in compression


def _is_lossy_part(path: Path) -> bool:
    try:
        with _open(path) as dataset:
            return _is_lossy(dataset)
    except InputError:  # VRTs show files of more kinds than are read by themselves
        return False


def _rio(window: Window) -> RioWindow:
    return RioWindow(window.col, window.row, window.width, window.height)


def _damaged(path: Path, error: Exception) -> InputError:
    cause = error.__cause__ or error
    return InputError(path, f"is damaged or cut short: {' '.join(str(cause).split())}")


def is_nodata(values: NDArray[Any], nodata: float | None) -> NDArray[np.bool_]:
    """Where values equal the nodata value (NaN equals NaN), or are no finite number at all."""
    empty = ~np.isfinite(values) if values.dtype.kind == "f" else np.zeros(values.shape, np.bool_)
    if nodata is None or not math.isfinite(nodata):
        return empty
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):  # a double's lowest number, declared on a float32 band, is met by no pixel
            return np.asarray(empty | (values == values.dtype.type(nodata)))
    limits = np.iinfo(values.dtype)
    # A nodata value outside the type's range (-9999 in uint8) is met by no pixel; a cast would wrap it round.
    if limits.min <= nodata <= limits.max and nodata == int(nodata):
        empty |= values == int(nodata)
    return empty
