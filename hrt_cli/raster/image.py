"""An orthomosaic as an 8-bit RGB image with a validity mask, whatever bands, types and masks the file has."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.margins import margin_notes
from hrt_cli.raster.mosaic import Layer, Valid, open_layer
from hrt_cli.raster.windows import Planes, Window, blocks, probe_windows

if TYPE_CHECKING:
    from hrt_cli.raster.pixel_area import PixelArea

_STRETCH_QUANTILES = (0.005, 0.995)
_PROBE_WINDOWS = 4
_STRETCH_WINDOWS = 12
"""Windows along each axis: what is only counted needs fewer than the quantiles of a stretch."""
_SEARCH_PX = 1024
_FEW = 100_000


@dataclass(frozen=True)
class Stretch:
    """The global linear map of 16-bit and real values to 8 bits: `low` -> 0, `high` -> 255, clipped."""

    low: float
    high: float

    def apply(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Map values of any shape to uint8."""
        if values.dtype in (np.int16, np.uint16):
            # Sixteen bits are looked up by their pattern: several times faster than the arithmetic.
            return np.take(self._signed if values.dtype == np.int16 else self._unsigned, values.view(np.uint16))
        return self._computed(values)

    @cached_property
    def _unsigned(self) -> NDArray[np.uint8]:
        return self._computed(np.arange(2**16, dtype=np.uint16))

    @cached_property
    def _signed(self) -> NDArray[np.uint8]:
        return self._computed(np.arange(2**16, dtype=np.uint16).view(np.int16))

    def _computed(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        with np.errstate(invalid="ignore", over="ignore"):  # what nodata comes to does not matter
            scaled = (values.astype(np.float32) - self.low) * np.float32(255.0 / (self.high - self.low))
        return np.asarray(np.nan_to_num(np.clip(np.rint(scaled), 0, 255))).astype(np.uint8)


class Image:
    """An RGB image read window by window (an `ImageSource`).

    An area of interest clips it: its grid is the window of the raster that bounds the area, and outside the area
    nothing is valid. What is found out about the image as a whole (`stretch`, `valid_share`, `pixel_m`) comes from
    the whole raster all the same, so that no value inside depends on how the area is drawn.

    Attributes
    ----------
    raster : Layer
        The raster or the tiles behind it.
    grid : Grid
        Its geometry.
    stretch : Stretch or None
        How values become 8-bit; None for 8-bit files.
    valid_share : float
        Share of valid pixels in a probe of the raster, 0 to 1.
    notes : list of str
        What the user ought to know though it was no reason to refuse.
    """

    def __init__(self, raster: Layer) -> None:
        self.raster = raster
        self.grid: Grid = raster.grid
        self.stretch: Stretch | None = None
        self.valid_share = 0.0
        self.notes = raster.notes
        self._area: PixelArea | None = None
        self._aoi: Path | None = None
        self._origin = (0, 0)
        self._probed: NDArray[np.uint32] = np.zeros(0, np.uint32)

    @property
    def bands(self) -> list[int]:
        """The 1-based bands taken as red, green, blue, or one band taken as grey."""
        return self.raster.bands

    @property
    def alpha(self) -> int | None:
        """The 1-based band declared as alpha."""
        return self.raster.alpha

    @property
    def block_shape(self) -> tuple[int, int]:
        """Rows and columns of the blocks in which the file (of tiles, the first) is stored."""
        return self.raster.block_shape

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Ground metres per step along rows and columns, of the whole raster."""
        return self.raster.grid.pixel_m

    @property
    def anchor(self) -> tuple[int, int]:
        """See `ImageSource`."""
        return self.grid.anchor

    def sources(self) -> dict[str, Path]:
        """Return the files that the image comes from, by role, for provenance."""
        return self.raster.sources() | ({"aoi": self._aoi} if self._aoi else {})

    def read(self, window: Window) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return `(rgb [height, width, 3], valid [height, width])`; outside the image nothing is valid."""
        planes, valid = self.read_planes(window)
        rgb = np.empty((window.height, window.width, 3), np.uint8)
        # Plane by plane: numpy is several times slower at turning the whole array round.
        for channel, plane in enumerate(planes):
            rgb[..., channel] = plane
        return rgb, valid

    def read_planes(self, window: Window, out: Planes | None = None) -> Planes:
        """Return `(planes [3, height, width], valid [height, width])`: `read` without turning the pixels round.

        See `ImageSource`.
        """
        planes, valid = out or _nothing(window)
        inside = window.clipped(self.shape)
        if inside != window:
            valid[...] = False
        if not (inside.height and inside.width):
            return planes, valid
        there = Window(inside.row - window.row, inside.col - window.col, inside.height, inside.width).slices
        into = planes[:, *there]
        colours, good = self._colours(inside, into if self._is_plain_rgb else None)
        if colours is not into:
            into[...] = self._planes(colours)
        valid[there] = True if good is None else good
        return planes, valid

    def thumbnail(self, max_px: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return the whole image and its mask, every n-th pixel, with at most `max_px` rows and columns.

        Each pixel stands for a square of n x n, at the right and bottom edge for what is left of one.
        """
        step = max(1, -(-max(self.shape) // max_px))
        parts = []
        for window in blocks(self.shape, step * max(1, 512 // step)):
            rgb, valid = self.read(window)
            middle = np.ix_(_middles(window.height, step), _middles(window.width, step))
            parts.append((window.row, rgb[middle], valid[middle]))
        tops = sorted({top for top, _, _ in parts})
        rgb = np.concatenate([np.concatenate([r for t, r, _ in parts if t == top], axis=1) for top in tops])
        valid = np.concatenate([np.concatenate([v for t, _, v in parts if t == top], axis=1) for top in tops])
        return rgb, valid

    def probe(self) -> None:
        """Look at a regular sample of windows: the share of valid pixels, and the stretch where one is needed.

        Raises
        ------
        InputError
            No pixel is valid, or all that are have one value.
        """
        stretched = self.raster.dtype != "uint8" and self.raster.palette is None
        values, total = [], 0
        for window in probe_windows(self.shape, _STRETCH_WINDOWS if stretched else _PROBE_WINDOWS):
            values.append(self._valid_colours(window))
            total += window.height * window.width
        found = np.concatenate(values, axis=1)
        if found.shape[1] == 0:
            found = self._search_valid()
        self.valid_share = min(1.0, found.shape[1] / total)
        if (found == found[:, :1]).all():
            found = self._search_variety(found[:, :1])
        if stretched:
            low, high = np.quantile(found.astype(np.float64), _STRETCH_QUANTILES)
            if not high > low:
                low, high = float(found.min()), float(found.max())
            self.stretch = Stretch(float(low), float(high))
            self.notes.append(f"its {self.raster.dtype} values are stretched to 8 bits: {low:g} to 0, {high:g} to 255")
            self._note_largest(found)
        thinned = found[:, None, :: max(1, found.shape[1] // _FEW)]
        self._probed = _codes(self._planes(thinned)[:, 0])

    def clip(self, aoi: Path) -> None:
        """Clip the image, after `probe`, to an area of interest.

        Raises
        ------
        InputError
            The file is no area (see `read_aoi`), misses the raster, or holds none of its valid pixels.
        """
        from hrt_cli.raster.aoi import read_aoi

        drawn = read_aoi(aoi)
        area = drawn.require_on(self.raster.grid, self.raster.path)
        self.notes += [f"of the area {aoi}: {note}" for note in drawn.notes]
        bounds = area.bounds
        self.grid = _window_grid(self.raster.grid, bounds)
        self._area, self._aoi, self._origin = area, aoi, (bounds.row, bounds.col)
        # What the probe saw may lie outside.
        self._probed = np.zeros(0, np.uint32)
        if not any(self._valid_colours(window).size for window in blocks(self.shape, _SEARCH_PX)):
            raise InputError(aoi, f"holds no valid pixel of {self.raster.path}")

    def has_colours(self, count: int) -> bool:
        """Whether at least `count` different colours occur; looks at all pixels only where the probe saw fewer."""
        seen = np.unique(self._probed)
        for window in blocks(self.shape, _SEARCH_PX):
            if seen.size >= count:
                return True
            planes, valid = self.read_planes(window)
            seen = np.union1d(seen, _codes(planes[:, valid]))
        return bool(seen.size >= count)

    @property
    def _is_plain_rgb(self) -> bool:
        """Whether the file's own values are red, green and blue."""
        return len(self.bands) == 3 and self.stretch is None and self.raster.palette is None

    def _colours(self, window: Window, out: NDArray[Any] | None = None) -> tuple[NDArray[Any], Valid]:
        """Read the file's own values [band, height, width], and where they are valid, in a window inside the image.

        The values may be put into `out`, and are then `out` itself.
        """
        there = Window(window.row + self._origin[0], window.col + self._origin[1], window.height, window.width)
        if self._area is None:
            return self.raster.read(there, out)
        inside = self._area.mask(there)
        if not inside.any():
            return np.zeros((len(self.bands), window.height, window.width), self.raster.dtype), inside
        colours, valid = self.raster.read(there, out)
        return colours, inside if valid is None else inside & valid

    def _valid_colours(self, window: Window) -> NDArray[Any]:
        """Read the file's own values [band, n] of the valid pixels of a window inside the image."""
        colours, valid = self._colours(window)
        return np.asarray(colours.reshape(len(colours), -1) if valid is None else colours[:, valid])

    def _planes(self, colours: NDArray[Any]) -> NDArray[np.uint8]:
        """Turn the bands read [band, height, width] into red, green and blue [3, height, width]."""
        if self.raster.palette is not None:
            return np.stack([table[colours[0]] for table in self.raster.palette.T])
        planes = colours if self.stretch is None else self.stretch.apply(colours)
        return planes if len(planes) == 3 else np.broadcast_to(planes, (3, *planes.shape[1:]))

    def _note_largest(self, found: NDArray[Any]) -> None:
        """Tell of pixels [band, n] at the type's largest value, as OpenDroneMap writes them where it saw nothing."""
        if found.dtype.kind == "f":
            return
        largest = np.iinfo(found.dtype).max
        share = float((found == largest).all(axis=0).mean())
        if share > 1 - _STRETCH_QUANTILES[1]:
            self.notes.append(
                f"{share:.0%} of its valid pixels are {largest} in all bands, untextured or saturated, and widen the "
                f"stretch; --nodata {largest} leaves them out"
            )

    def _search_valid(self) -> NDArray[Any]:
        for window in blocks(self.shape, _SEARCH_PX):
            found = self._valid_colours(window)
            if found.size:
                return found
        masks = [path.name for path in self.raster.sources().values() if path.suffix == ".msk"]
        blame = f"; the side-car {masks[0]} masks all of it: delete it if it is stale" if masks else ""
        raise InputError(self.raster.path, "has no valid pixel: all is nodata" + blame)

    def _search_variety(self, colour: NDArray[Any]) -> NDArray[Any]:
        """Find a block in which some valid pixel is not of the one colour [band, 1] that the probe saw."""
        for window in blocks(self.shape, _SEARCH_PX):
            found = self._valid_colours(window)
            if (found != colour).any():
                return np.concatenate([colour, found], axis=1)
        raise InputError(self.raster.path, "all its pixels have one value: there is nothing to tell apart")


@contextmanager
def open_orthomosaic(
    paths: Sequence[Path],
    *,
    bands: tuple[int, ...] = (),
    nodata: float | None = None,
    unreferenced: bool = False,
    aoi: Path | None = None,
) -> Iterator[Image]:
    """Open an orthomosaic as an RGB image through the gate.

    Parameters
    ----------
    paths : sequence of Path
        One raster, several that lie on one lattice, or folders of such. Their order has no meaning: tiles are taken
        by name, and where they overlap the first whose pixel is valid wins.
    bands : tuple of int, optional
        The 1-based bands to take as red, green and blue (or one as grey). By default those that the file declares,
        else the first three; a further band that is not declared as alpha is never taken for one.
    nodata : float, optional
        The value to take as nodata instead of the file's own.
    unreferenced : bool
        Accept one plain image: lengths are pixels, and the result has no CRS.
    aoi : Path, optional
        GeoJSON or KML polygons to clip the image to.

    Raises
    ------
    InputError
        As `open_raster`; where rasters do not go together; where no pixel is valid or all have one value; where
        `aoi` is no area on the orthomosaic.
    ArgumentError
        A band asked for does not exist.
    """
    with open_layer(paths, bands=bands, nodata=nodata, unreferenced=unreferenced) as raster:
        image = Image(raster)
        image.probe()
        image.notes.extend(margin_notes(raster))
        if aoi is not None:
            image.clip(aoi)
        yield image


@contextmanager
def open_image(
    path: str | os.PathLike[str],
    *,
    bands: tuple[int, ...] = (),
    nodata: float | None = None,
    unreferenced: bool = False,
) -> Iterator[Image]:
    """Open one raster, or one folder of tiles, as `open_orthomosaic`."""
    with open_orthomosaic([Path(path)], bands=bands, nodata=nodata, unreferenced=unreferenced) as image:
        yield image


def _codes(planes: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """One number a colour [3, n]."""
    red, green, blue = planes.astype(np.uint32)
    return np.asarray(red << 16 | green << 8 | blue)


def _nothing(window: Window) -> Planes:
    shape = (window.height, window.width)
    return np.zeros((3, *shape), np.uint8), np.zeros(shape, np.bool_)


def _window_grid(grid: Grid, window: Window) -> Grid:
    moved = grid.transform @ Affine.translation(window.col, window.row)
    return Grid(window.height, window.width, moved, grid.crs)


def _middles(length: int, step: int) -> NDArray[np.intp]:
    """Index the middle of each piece of `step` pixels, the last piece being what is left."""
    return np.minimum(np.arange(0, length, step) + step // 2, length - 1)
