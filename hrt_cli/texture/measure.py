"""From pixels to cells: mean colour, share of valid pixels and log Gabor amplitudes of every cell, in one pass.

This is where the pixels are touched, each read once. All that follows works on cells, of which there are far fewer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.windows import ImageSource, Window
from hrt_cli.texture.bank import MIN_WAVELENGTH_PX, GaborBank
from hrt_cli.texture.colour import LUMA, cell_means, luma
from hrt_cli.texture.lattice import CellGrid, gaussian_taps, smooth
from hrt_cli.texture.passes import amplitudes, halve, shaped
from hrt_cli.texture.settings import FeatureSettings

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

MAX_WAVELENGTH_PX = 512.0
"""Above this the halo of a block would dwarf the block."""
_STEPS_PX = (2, 4, 8, 16, 32)
_AMPLITUDE_FLOOR = 1e-3
"""Added to an amplitude (relative contrast) before the logarithm: below 8-bit quantisation."""
_FACTORS = 8
"""So many amplitudes, which are above the floor, multiply to a number that single precision holds."""
_LUMA_FLOOR = 8.0
"""Added to the local mean luma before dividing by it, so that deep shadow is not all noise."""
_STRIPE_PX = 16_384
"""Columns swept at once at most: the rows kept for the strip below are as wide."""
_COLUMNS_PX = 2048
"""Columns measured at once, so that what is in work stays small."""
COLOUR = slice(0, 3)
SHARE = 3
TEXTURE = slice(4, None)
"""Where the channels of a cell stand: mean red, green and blue, share of valid pixels, log amplitudes."""


@dataclass(frozen=True)
class Part:
    """What a step of the sweep found.

    Attributes
    ----------
    grid : CellGrid
        The cells measured.
    cells : ndarray [rows, cols, channels] float32
        Their measures; see `COLOUR`, `SHARE` and `TEXTURE`.
    window : Window
        The pixels read that belong to the rows swept, inside the raster.
    valid_pixels : int
        How many of them hold data.
    invalid : ndarray [height, width / 8] uint8 or None
        Which of them do not, eight to a byte; None where all do.
    columns : (int, int) or None
        First and last (exclusive) column of the cells that are swept at once, of which these are some; None for all.
    """

    grid: CellGrid
    cells: F32
    window: Window
    valid_pixels: int
    invalid: U8 | None
    columns: tuple[int, int] | None = None

    @classmethod
    def of(
        cls,
        grid: CellGrid,
        cells: F32,
        window: Window,
        valid: NDArray[np.bool_],
        columns: tuple[int, int] | None = None,
    ) -> Part:
        """Return a part with the mask `valid` [height, width] packed."""
        count = int(np.count_nonzero(valid))
        invalid = None if count == valid.size else np.packbits(~valid, axis=1)
        return cls(grid, cells, window, count, invalid, columns)


class Gauge:
    """Feature settings made ready to measure rasters with given pixels.

    Parameters
    ----------
    settings : FeatureSettings
    pixel_m : (float, float)
        Ground metres per pixel along rows and columns.

    Raises
    ------
    ArgumentError
        A wavelength is shorter than 2.5 pixels or longer than 512.
    """

    def __init__(self, settings: FeatureSettings, pixel_m: tuple[float, float]) -> None:
        coarse, fine = max(pixel_m), min(pixel_m)
        shortest, longest = min(settings.wavelengths_m), max(settings.wavelengths_m)
        if shortest / coarse < MIN_WAVELENGTH_PX * (1 - 1e-6):
            raise ArgumentError(
                f"the texture wavelength {shortest:g} m is {shortest / coarse:.2g} pixels at {coarse:g} m per pixel, "
                f"but {MIN_WAVELENGTH_PX:g} pixels are needed: use a finer image or fit longer wavelengths"
            )
        if longest / fine > MAX_WAVELENGTH_PX:
            raise ArgumentError(
                f"the texture wavelength {longest:g} m is {longest / fine:.0f} pixels at {fine:g} m per pixel, "
                f"more than {MAX_WAVELENGTH_PX:g}: resample the image or fit shorter wavelengths"
            )
        self.settings = settings
        self.pixel_m = pixel_m
        self.step_px = min(_STEPS_PX, key=lambda step: abs(math.log2(settings.step_m / coarse / step)))
        self.bank = GaborBank(settings.wavelengths_m, settings.orientations, samples=settings.samples)
        self.filters = self.bank.filters(pixel_m, self.step_px)

    @property
    def channels(self) -> int:
        """Numbers kept of a cell."""
        per_scale = 1 if self.settings.texture_mode == "mean" else self.settings.orientations
        return TEXTURE.start + per_scale * len(self.filters)

    def grid(self, source: ImageSource) -> CellGrid:
        """Return the cells that cover a raster."""
        return CellGrid.covering(Window(0, 0, *source.shape), source.anchor, self.step_px)

    @cached_property
    def _contrast_taps(self) -> tuple[F32, F32]:
        rows, cols = (self.settings.contrast_sigma_m / (d * self.step_px) for d in self.pixel_m)
        return gaussian_taps(rows), gaussian_taps(cols)

    @cached_property
    def _filter_cells(self) -> tuple[int, int]:
        rows, cols = self.bank.reach_px(self.pixel_m, self.step_px)
        return -(-rows // self.step_px), -(-cols // self.step_px)

    @cached_property
    def reach_cells(self) -> tuple[int, int]:
        """Cells whose pixels count around a cell, along rows and columns."""
        rows, cols = (self._filter_cells[axis] + len(self._contrast_taps[axis]) for axis in (0, 1))
        return rows, cols

    @property
    def _octaves(self) -> int:
        return max(one.level for one in self.filters)

    def buffers(self, shape: tuple[int, int]) -> list[F32]:
        """Return room for the pyramid of planes of up to `shape` pixels."""
        rows, cols = shape
        return [np.empty((rows >> k) * ((cols >> k) + 2), np.float32) for k in range(self._octaves + 1)]

    def measure(
        self,
        planes: U8,
        valid: NDArray[np.bool_],
        origin: tuple[int, int],
        cells: tuple[int, int],
        buffers: Sequence[F32] = (),
    ) -> F32:
        """Measure a rectangle of cells.

        Parameters
        ----------
        planes : ndarray [3, rows, cols] uint8
            Red, green, blue.
        valid : ndarray [rows, cols] bool
        origin : (int, int)
            Pixel at which the first cell starts; pixels for `reach_cells` around the cells must be there.
        cells : (int, int)
            Rows and columns of cells.
        buffers : sequence of ndarray [n] float32
            Where to put the levels of the pyramid, from `buffers`; new arrays would cost page faults.

        Returns
        -------
        ndarray [rows, cols, channels] float32
            Where no pixel is valid, zero.
        """
        out = np.zeros((*cells, self.channels), np.float32)
        if 0 in cells:
            return out
        step, (reach_r, reach_c), (margin_r, margin_c) = self.step_px, self.reach_cells, self._filter_cells
        top, left = origin[0] - reach_r * step, origin[1] - reach_c * step
        mean, share = cell_means(planes, valid, (top, left), (cells[0] + 2 * reach_r, cells[1] + 2 * reach_c), step)
        inner = share[reach_r : reach_r + cells[0], reach_c : reach_c + cells[1]]
        if not inner.any():
            return out
        local, _ = smooth(luma(mean)[None], share, *self._contrast_taps)
        top, left = origin[0] - margin_r * step, origin[1] - margin_c * step
        spare = iter(buffers)
        rows, cols = ((n - 2) * step for n in local.shape[1:])
        levels = [shaped(next(spare, None), (2, rows, cols // 2))]
        _relative_luma(planes, valid, local[0], step, top, left, levels[0])
        for _ in range(self._octaves):
            levels.append(halve(levels[-1], next(spare, None)))
        found = np.empty((self.settings.orientations, *cells), np.float32)
        out[..., COLOUR] = mean[:, reach_r : reach_r + cells[0], reach_c : reach_c + cells[1]].transpose(1, 2, 0)
        out[..., SHARE] = inner
        texture = out[..., TEXTURE]
        for index, one in enumerate(self.filters):
            per_cell = step >> one.level
            amplitudes(levels[one.level], one, (margin_r * per_cell, margin_c * per_cell), per_cell, found)
            found += np.float32(_AMPLITUDE_FLOOR)
            if self.settings.texture_mode == "mean":
                texture[..., index] = _mean_log(found)
            else:
                np.log(found, out=found)
                first = index * len(found)
                texture[..., first : first + len(found)] = found.transpose(1, 2, 0)
        texture[inner == 0] = np.float32(0)
        return out

    def sweep(self, source: ImageSource, rows: tuple[int, int], rows_px: int) -> Iterator[Part]:
        """Measure whole rows of cells, top to bottom, reading each pixel once.

        A wide raster is swept in stripes, so that what is held does not grow with its width; pixels within reach of
        where stripes meet are read twice.

        Parameters
        ----------
        source : ImageSource
        rows : (int, int)
            First and last (exclusive) row of cells, within `grid(source)`.
        rows_px : int
            Rows of pixels to read at once; a multiple of the file's own blocks keeps these from being decoded twice.

        Yields
        ------
        Part
            The measures do not depend on how the sweep is cut.
        """
        grid = self.grid(source)
        count = -(-grid.cols * self.step_px // _STRIPE_PX)
        edges = [grid.col + grid.cols * k // count for k in range(count + 1)]
        for columns in itertools.pairwise(edges):
            yield from self._sweep_stripe(source, rows, columns, rows_px)

    def _sweep_stripe(
        self, source: ImageSource, rows: tuple[int, int], columns: tuple[int, int], rows_px: int
    ) -> Iterator[Part]:
        step, grid, (anchor_r, anchor_c) = self.step_px, self.grid(source), source.anchor
        reach_r, reach_c = (cells * step for cells in self.reach_cells)
        left, right = columns[0] * step - anchor_c - reach_c, columns[1] * step - anchor_c + reach_c
        top, bottom = rows[0] * step - anchor_r - reach_r, rows[1] * step - anchor_r + reach_r
        # Masks are kept eight pixels to a byte, and stripes share none.
        begin = 0 if columns[0] == grid.col else (columns[0] * step - anchor_c) // 8 * 8
        end = source.shape[1] if columns[1] == grid.col + grid.cols else (columns[1] * step - anchor_c) // 8 * 8
        own = Window(rows[0] * step - anchor_r, begin, (rows[1] - rows[0]) * step, end - begin)
        # What must stay for the next strip below, or chunk beside: both reaches and the rest of a cell.
        keep_r, keep_c = 2 * reach_r + step, 2 * reach_c + step
        row_cuts, col_cuts = _cuts(top, bottom, rows_px), _cuts(left, right, _COLUMNS_PX)
        tallest = max(b - a for a, b in itertools.pairwise(row_cuts))
        widest = max(b - a for a, b in itertools.pairwise(col_cuts))
        planes = np.zeros((3, keep_r + tallest, keep_c + widest), np.uint8)
        valid = np.zeros(planes.shape[1:], np.bool_)
        buffers = self.buffers(valid.shape)
        kept_planes = np.zeros((3, keep_r, right - left), np.uint8)
        kept_valid = np.zeros((keep_r, right - left), np.bool_)
        above, ready = 0, rows[0]
        for y0, y1 in itertools.pairwise(row_cuts):
            height = above + y1 - y0
            below = min(keep_r, height)
            first, ready = ready, rows[1] if y1 == bottom else max(ready, (y1 - reach_r + anchor_r) // step)
            beside, begun = 0, columns[0]
            for x0, x1 in itertools.pairwise(col_cuts):
                width = beside + x1 - x0
                window = Window(y0, x0, y1 - y0, x1 - x0)
                there = slice(beside, width)
                planes[:, :above, there] = kept_planes[:, :above, x0 - left : x1 - left]
                valid[:above, there] = kept_valid[:above, x0 - left : x1 - left]
                source.read_planes(window, (planes[:, above:height, there], valid[above:height, there]))
                kept_planes[:, :below, x0 - left : x1 - left] = planes[:, height - below : height, there]
                kept_valid[:below, x0 - left : x1 - left] = valid[height - below : height, there]
                start = begun
                begun = columns[1] if x1 == right else max(begun, (x1 - reach_c + anchor_c) // step)
                done = CellGrid(step, first, start, ready - first, begun - start)
                origin = (
                    first * step - anchor_r - (y0 - above),
                    start * step - anchor_c - (x0 - beside),
                )
                cells = self.measure(planes, valid, origin, (done.rows, done.cols), buffers)
                inside = _shared(window, own).clipped(source.shape)
                fresh = valid[above + inside.row - y0 :, beside + inside.col - x0 :]
                yield Part.of(done, cells, inside, fresh[: inside.height, : inside.width], columns)
                stay = min(keep_c, width)
                planes[:, :height, :stay] = planes[:, :height, width - stay : width].copy()
                valid[:height, :stay] = valid[:height, width - stay : width].copy()
                beside = stay
            above = below


def _shared(one: Window, other: Window) -> Window:
    top, left = max(one.row, other.row), max(one.col, other.col)
    bottom = min(one.row + one.height, other.row + other.height)
    right = min(one.col + one.width, other.col + other.width)
    return Window(top, left, max(bottom - top, 0), max(right - left, 0))


def _cuts(begin: int, end: int, size: int) -> list[int]:
    """Cut a range at multiples of `size`, but leave no piece at its ends that is much smaller."""
    inner = range(-(-(begin + size // 4) // size) * size, end - size // 4, size)
    return [begin, *inner, end]


def _mean_log(channels: F32) -> F32:
    """Return the mean logarithm over channels, by way of products: a logarithm costs more than all else here."""
    total = np.zeros(channels.shape[1:], np.float32)
    for first in range(0, len(channels), _FACTORS):
        product = channels[first].copy()
        for one in channels[first + 1 : first + _FACTORS]:
            product *= one
        total += np.log(product)
    total *= np.float32(1 / len(channels))
    return total


@njit(cache=True, nogil=True)
def _relative_luma(
    planes: U8, valid: NDArray[np.bool_], local: F32, step_px: int, top: int, left: int, out: F32
) -> None:
    """Set `out` to (luma + floor) / (local mean + floor) − 1, and 0 where invalid: [2, rows, cols / 2], even and odd.

    `local` holds the mean of every cell wanted and of one more cell on each side; between cell centres the factor
    1 / (mean + floor) is interpolated bilinearly. `top` and `left` are the pixel at which the cells wanted start.
    """
    rows, cols = (local.shape[0] - 2) * step_px, (local.shape[1] - 2) * step_px
    half = step_px // 2
    factor = np.float32(1) / (local + np.float32(_LUMA_FLOOR))
    parts = ((np.arange(step_px) + 0.5) / step_px).astype(np.float32)
    upper, lower = np.empty(cols + 2 * step_px, np.float32), np.empty(cols + 2 * step_px, np.float32)
    line = np.empty(cols, np.float32)
    for r in range(rows):
        low, phase = (r + half) // step_px, (r + half) % step_px
        if r == 0 or phase == 0:
            _stretch(factor[low], step_px, upper)
            _stretch(factor[low + 1], step_px, lower)
        y = top + r
        _relative_line(
            planes[0, y, left : left + cols], planes[1, y, left : left + cols], planes[2, y, left : left + cols],
            valid[y, left : left + cols], upper[step_px:], lower[step_px:], parts[phase], line,
        )  # fmt: skip
        even, odd = out[0, r], out[1, r]
        for c in range(cols // 2):
            even[c] = line[2 * c]
            odd[c] = line[2 * c + 1]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _relative_line(
    red: U8, green: U8, blue: U8, inside: NDArray[np.bool_], above: F32, below: F32, part: np.float32, out: F32
) -> None:
    weights, floor, one = LUMA, np.float32(_LUMA_FLOOR), np.float32(1)
    for c in range(out.shape[0]):
        factor = above[c] + part * (below[c] - above[c])
        value = (
            weights[0] * np.float32(red[c]) + weights[1] * np.float32(green[c]) + weights[2] * np.float32(blue[c])
        ) + floor
        out[c] = value * factor - one if inside[c] else np.float32(0)


@njit(cache=True, nogil=True)
def _stretch(cells: F32, step_px: int, out: F32) -> None:
    """Interpolate a line of cells linearly between their centres; half a cell at each end is left as it is."""
    half = step_px // 2
    for cell in range(cells.shape[0] - 1):
        start, base, rise = cell * step_px + half, cells[cell], cells[cell + 1] - cells[cell]
        for c in range(step_px):
            out[start + c] = base + np.float32((c + 0.5) / step_px) * rise
