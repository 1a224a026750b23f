"""An orthomosaic as an 8-bit RGB image with a validity mask, whatever bands, types and masks the file has."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.gate import Raster, is_nodata, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window, blocks

_STRETCH_QUANTILES = (0.005, 0.995)
_PROBE_WINDOWS = 12
_PROBE_PX = 128
_FEW = 100_000


@dataclass(frozen=True)
class Stretch:
    """The global linear map of 16-bit and real values to 8 bits: `low` -> 0, `high` -> 255, clipped."""

    low: float
    high: float

    def apply(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Map values of any shape to uint8."""
        with np.errstate(invalid="ignore", over="ignore"):  # what nodata comes to does not matter
            scaled = (values.astype(np.float32) - self.low) * np.float32(255.0 / (self.high - self.low))
        return np.asarray(np.nan_to_num(np.clip(np.rint(scaled), 0, 255))).astype(np.uint8)


class Image:
    """An RGB image read window by window (an `ImageSource`).

    Attributes
    ----------
    raster : Raster
        The file behind it.
    bands : list of int
        The 1-based bands taken as red, green, blue, or one band taken as grey.
    alpha : int or None
        The 1-based band declared as alpha.
    stretch : Stretch or None
        How values become 8-bit; None for 8-bit files.
    valid_share : float
        Share of valid pixels in a probe of the raster, 0 to 1.
    """

    def __init__(self, raster: Raster, bands: list[int]) -> None:
        self.raster = raster
        self.bands = bands
        alphas = [i + 1 for i, colour in enumerate(raster.colours) if colour == ColorInterp.alpha]
        self.alpha: int | None = alphas[-1] if alphas and alphas[-1] not in bands else None
        self.stretch: Stretch | None = None
        self.valid_share = 0.0
        self._probed: NDArray[np.uint32] = np.zeros(0, np.uint32)

    @property
    def grid(self) -> Grid:
        """The raster's geometry."""
        return self.raster.grid

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.raster.grid.shape

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Ground metres per step along rows and columns."""
        return self.raster.grid.pixel_m

    @property
    def anchor(self) -> tuple[int, int]:
        """See `ImageSource`."""
        return self.raster.grid.anchor

    def read(self, window: Window) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return `(rgb [height, width, 3], valid [height, width])`; outside the raster nothing is valid."""
        inside = window.clipped(self.shape)
        rgb = np.zeros((window.height, window.width, 3), np.uint8)
        valid = np.zeros((window.height, window.width), np.bool_)
        if inside.height and inside.width:
            values, good = self._read_inside(inside)
            there = Window(inside.row - window.row, inside.col - window.col, inside.height, inside.width).slices
            self._paint(rgb[there], values)
            valid[there] = good
        return rgb, valid

    def _read_inside(self, window: Window) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        # The alpha band is read as data: GDAL's own mask calls every pixel of a 16-bit or real ODM file valid.
        wanted = [*self.bands, self.alpha] if self.alpha else self.bands
        values = self.raster.read_bands(wanted, window)
        colours = values[: len(self.bands)]
        empty = np.ones(colours.shape[1:], np.bool_)
        broken = np.zeros(colours.shape[1:], np.bool_)
        for band, plane in zip(self.bands, colours, strict=True):
            # A pixel is nodata where all its bands are; one band alone may be black. NaN in any band spoils it.
            nodata = self.raster.nodata[band - 1]
            empty &= is_nodata(plane, nodata)
            if plane.dtype.kind == "f":
                broken |= ~np.isfinite(plane)
        valid = ~(empty | broken)
        if self.alpha:
            valid &= values[-1] > 0
        elif self.raster.has_mask:
            valid &= self.raster.read_mask(window)
        return colours, valid

    def _paint(self, rgb: NDArray[np.uint8], values: NDArray[Any]) -> None:
        """Fill `rgb` [height, width, 3] from the bands read [band, height, width]."""
        if self.raster.palette is not None:
            rgb[:] = self.raster.palette[values[0]]
            return
        planes = values if self.stretch is None else self.stretch.apply(values)
        # Plane by plane: numpy is several times slower at turning the whole array round.
        for channel in range(3):
            rgb[..., channel] = planes[min(channel, len(planes) - 1)]

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
        values, total = [], 0
        for window in _probe_windows(self.shape, self.raster.block_shape):
            colours, valid = self._read_inside(window)
            values.append(colours[:, valid])
            total += valid.size
        found = np.concatenate(values, axis=1)
        if found.shape[1] == 0:
            found = self._search_valid()
        self.valid_share = min(1.0, found.shape[1] / total)
        if (found == found[:, :1]).all():
            found = self._search_variety(found[:, :1])
        if self.raster.dtypes[self.bands[0] - 1] != "uint8":
            low, high = np.quantile(found.astype(np.float64), _STRETCH_QUANTILES)
            if not high > low:
                low, high = float(found.min()), float(found.max())
            self.stretch = Stretch(float(low), float(high))
            self.raster.notes.append(
                f"its {self.raster.dtypes[0]} values are stretched to 8 bits: {low:g} to 0, {high:g} to 255"
            )
        thinned = found[:, None, :: max(1, found.shape[1] // _FEW)]
        rgb = np.zeros((*thinned.shape[1:], 3), np.uint8)
        self._paint(rgb, thinned)
        self._probed = _codes(rgb[0])

    def has_colours(self, count: int) -> bool:
        """Whether at least `count` different colours occur; looks at all pixels only where the probe saw fewer."""
        seen = np.unique(self._probed)
        for window in blocks(self.shape, 1024):
            if seen.size >= count:
                return True
            rgb, valid = self.read(window)
            seen = np.union1d(seen, _codes(rgb[valid]))
        return bool(seen.size >= count)

    def _search_valid(self) -> NDArray[Any]:
        for window in blocks(self.shape, 1024):
            colours, valid = self._read_inside(window)
            if valid.any():
                return np.asarray(colours[:, valid])
        sidecar = self.raster.path.with_name(self.raster.path.name + ".msk")
        blame = f"; the side-car {sidecar.name} masks all of it: delete it if it is stale" if sidecar.exists() else ""
        raise InputError(self.raster.path, "has no valid pixel: all is nodata" + blame)

    def _search_variety(self, colour: NDArray[Any]) -> NDArray[Any]:
        """Find a block in which some valid pixel is not of the one colour [band, 1] that the probe saw."""
        for window in blocks(self.shape, 1024):
            colours, valid = self._read_inside(window)
            found = colours[:, valid]
            if (found != colour).any():
                return np.concatenate([colour, found], axis=1)
        raise InputError(self.raster.path, "all its pixels have one value: there is nothing to tell apart")


@contextmanager
def open_image(
    path: str | os.PathLike[str],
    *,
    bands: tuple[int, ...] = (),
    nodata: float | None = None,
    unreferenced: bool = False,
) -> Iterator[Image]:
    """Open an orthomosaic as an RGB image through the gate.

    Parameters
    ----------
    path : path-like
        The file.
    bands : tuple of int, optional
        The 1-based bands to take as red, green and blue (or one as grey). By default those that the file declares,
        else the first three; a further band that is not declared as alpha is never taken for one.
    nodata, unreferenced
        As in `open_raster`.

    Raises
    ------
    InputError
        As `open_raster`, and where no pixel is valid or all have one value.
    ArgumentError
        A band asked for does not exist.
    """
    with open_raster(path, nodata=nodata, unreferenced=unreferenced) as raster:
        image = Image(raster, _choose_bands(raster, bands))
        image.probe()
        yield image


def _codes(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """One number a colour [n, 3]."""
    wide = rgb.astype(np.uint32)
    return np.asarray(wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2])


def _choose_bands(raster: Raster, asked: tuple[int, ...]) -> list[int]:
    if asked:
        if len(asked) not in (1, 3) or not all(1 <= band <= raster.count for band in asked):
            raise ArgumentError(f"{raster.path}: --bands takes one or three of the bands 1 to {raster.count}")
        return list(asked)
    declared = {colour: i + 1 for i, colour in reversed(list(enumerate(raster.colours)))}
    wanted = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(colour in declared for colour in wanted):
        chosen = [declared[colour] for colour in wanted]
    else:
        colours = [i + 1 for i, colour in enumerate(raster.colours) if colour != ColorInterp.alpha]
        if not colours:
            raise InputError(raster.path, "has an alpha band but no colour")
        chosen = colours[:3] if len(colours) >= 3 else colours[:1]
    extra = [i + 1 for i, colour in enumerate(raster.colours) if i + 1 not in chosen and colour != ColorInterp.alpha]
    if extra:
        raster.notes.append(
            f"bands {', '.join(map(str, chosen))} are taken as colour; "
            f"band {', '.join(map(str, extra))} is not declared as alpha and is not used"
        )
    return chosen


def _middles(length: int, step: int) -> NDArray[np.intp]:
    """Index the middle of each piece of `step` pixels, the last piece being what is left."""
    return np.minimum(np.arange(0, length, step) + step // 2, length - 1)


def _in_blocks(starts: NDArray[Any], block_px: int) -> NDArray[Any]:
    """Move windows that reach into the next block back into theirs, so that each costs the decoding of one only."""
    if block_px < _PROBE_PX:
        return starts
    return np.asarray(np.minimum(starts, starts // block_px * block_px + block_px - _PROBE_PX))


def _probe_windows(shape: tuple[int, int], block: tuple[int, int]) -> list[Window]:
    """Windows on a regular lattice over the raster, each inside one block of its file; all of it where it is small."""
    if max(shape) <= _PROBE_WINDOWS * _PROBE_PX // 2:
        return list(blocks(shape, _PROBE_PX * 4))
    middles = (np.arange(_PROBE_WINDOWS) + 0.5) / _PROBE_WINDOWS
    tops = np.clip(middles * shape[0] - _PROBE_PX / 2, 0, max(shape[0] - _PROBE_PX, 0)).astype(int)
    lefts = np.clip(middles * shape[1] - _PROBE_PX / 2, 0, max(shape[1] - _PROBE_PX, 0)).astype(int)
    tops, lefts = _in_blocks(tops, block[0]), _in_blocks(lefts, block[1])
    return [
        Window(int(top), int(left), min(_PROBE_PX, shape[0]), min(_PROBE_PX, shape[1]))
        for top in sorted(set(tops))
        for left in sorted(set(lefts))
    ]
