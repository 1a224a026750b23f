"""A bank of Gabor filters in quadrature, as separable passes on a pyramid of octaves.

A Gabor filter with an isotropic envelope is the product of a complex filter along the rows axis and one along
the columns axis (Fogel and Sagi 1989; Jain and Farrokhnia 1991), so a filter costs two one-dimensional passes.
Filters at theta and pi − theta share all of them. Long wavelengths run on an image halved once or more, where
they are as short as the short ones; the gain of the halving is divided out of the taps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.texture.lattice import F32, add_folded

SIGMA_OVER_LAMBDA = 0.56
"""Envelope over wavelength for a bandwidth of one octave."""
KERNEL_REACH = 3.0
"""A kernel is cut at this many standard deviations."""
SHORTEST_ON_LEVEL_PX = 4.0
"""An octave is descended only while the wavelength stays at least this many pixels."""
MIN_WAVELENGTH_PX = 2.5
"""Below this a wavelength is not resolved."""
_GROUP = 4
"""Taps a pass takes at once; kernels are padded to whole groups."""
_LEVEL_TOLERANCE = 0.01
HALVING_TAPS = (0.44105, 0.14875, -0.0515, -0.0383)
"""One side of the even filter that precedes halving: least squares with pass band to 0.16 and stop band from
0.34 cycles per pixel. Flat enough for the band of a wavelength of 8 pixels, and what would fold into it is below 4 %."""


@dataclass(frozen=True)
class Filters:
    """All orientations of one wavelength, as taps for one pyramid level.

    Attributes
    ----------
    level : int
        Octaves of the pyramid: the image is halved this often first.
    stride : int
        Output samples are this many level pixels apart.
    row_even, row_odd : ndarray [frequencies, reach + 1] float32
        Even and odd parts of the pass along the rows axis, one per distinct |row frequency|; centre first.
    col_even, col_odd : ndarray [frequencies, reach + 1] float32
        The same along the columns axis.
    dc : ndarray [frequencies] float32
        What the filter answers to a constant image of 1, subtracted through the envelope alone.
    first, second : ndarray [frequencies] int64
        The orientations each frequency pair serves (+theta, pi − theta); `second` is −1 where there is none.
    """

    level: int
    stride: int
    row_even: F32
    row_odd: F32
    col_even: F32
    col_odd: F32
    row_envelope: F32
    col_envelope: F32
    dc: F32
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @property
    def reach(self) -> tuple[int, int]:
        """Level pixels a kernel reaches along rows and columns."""
        return self.row_even.shape[1] - 1, self.col_even.shape[1] - 1


@dataclass(frozen=True)
class GaborBank:
    """Wavelengths in metres and a number of orientations.

    Parameters
    ----------
    wavelengths_m : tuple of float
        Ascending or not; metres on the ground.
    orientations : int
        Evenly over half a turn; orientation 0 has its wave vector along the columns axis.
    sigma_over_lambda : float
        Envelope width over wavelength.
    """

    wavelengths_m: tuple[float, ...]
    orientations: int
    sigma_over_lambda: float = SIGMA_OVER_LAMBDA

    def filters(self, pixel_m: tuple[float, float], step_px: int) -> tuple[Filters, ...]:
        """Return the taps for a raster with these pixels, one entry per wavelength.

        Parameters
        ----------
        pixel_m : (float, float)
            Ground metres per pixel along rows and columns; kernels are round on the ground, so they are
            elliptic in pixels where the two differ.
        step_px : int
            Cell side, a power of two: no level is coarser than a cell.
        """
        return tuple(self._filters(wavelength, pixel_m, step_px) for wavelength in self.wavelengths_m)

    def _filters(self, wavelength_m: float, pixel_m: tuple[float, float], step_px: int) -> Filters:
        shortest_px = wavelength_m / max(pixel_m)
        octaves = np.floor(np.log2(shortest_px / SHORTEST_ON_LEVEL_PX) + _LEVEL_TOLERANCE)
        level = int(np.clip(octaves, 0, int(np.log2(step_px))))
        scale = 2.0**level
        theta = np.pi * np.arange(self.orientations // 2 + 1) / self.orientations
        row_freq = np.sin(theta) * pixel_m[0] / wavelength_m
        col_freq = np.cos(theta) * pixel_m[1] / wavelength_m
        sigma_m = self.sigma_over_lambda * wavelength_m
        row_even, row_odd, row_envelope = _taps(sigma_m / (pixel_m[0] * scale), row_freq * scale)
        col_even, col_odd, col_envelope = _taps(sigma_m / (pixel_m[1] * scale), col_freq * scale)
        gain = (_pyramid_gain(row_freq, level) * _pyramid_gain(col_freq, level))[:, None]
        row_even, row_odd = row_even / gain, row_odd / gain
        dc = _sum(row_even) * _sum(col_even)
        first = np.arange(len(theta))
        second = self.orientations - first
        second[(first == 0) | (second == first)] = -1
        return Filters(
            level=level,
            stride=2 if scale * 2 <= step_px else 1,
            row_even=row_even.astype(np.float32),
            row_odd=row_odd.astype(np.float32),
            col_even=col_even.astype(np.float32),
            col_odd=col_odd.astype(np.float32),
            row_envelope=row_envelope.astype(np.float32),
            col_envelope=col_envelope.astype(np.float32),
            dc=dc.astype(np.float32),
            first=first,
            second=second,
        )

    def reach_px(self, pixel_m: tuple[float, float], step_px: int) -> tuple[int, int]:
        """Return how far, in image pixels, an answer looks beyond its cell along rows and columns."""
        rows = cols = 0
        for one in self.filters(pixel_m, step_px):
            halving = len(HALVING_TAPS) * (2**one.level - 1)
            rows = max(rows, one.reach[0] * 2**one.level + halving)
            cols = max(cols, one.reach[1] * 2**one.level + halving)
        return rows, cols


def _taps(
    sigma: float, frequencies: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    reach = int(np.ceil(KERNEL_REACH * sigma))
    padded = -(-reach // _GROUP) * _GROUP
    offsets = np.arange(padded + 1)
    envelope = np.exp(-0.5 * (offsets / sigma) ** 2) * (offsets <= reach)
    envelope /= _sum(envelope[None])[0]
    phase = 2 * np.pi * frequencies[:, None] * offsets
    return envelope * np.cos(phase), envelope * np.sin(phase), envelope


def _sum(one_sided: NDArray[np.float64]) -> NDArray[np.float64]:
    total: NDArray[np.float64] = one_sided[:, 0] + 2 * one_sided[:, 1:].sum(axis=1)
    return total


def _pyramid_gain(frequency: NDArray[np.float64], level: int) -> NDArray[np.float64]:
    """Return the amplitude that `level` halvings leave of a wave (cycles per full-resolution pixel)."""
    gain = np.ones_like(frequency)
    for octave in range(level):
        turn = 2 * np.pi * frequency * 2**octave
        gain = gain * sum(2 * tap * np.cos((k + 0.5) * turn) for k, tap in enumerate(HALVING_TAPS))
    return gain


def halve(image: F32) -> F32:
    """Halve an image along both axes with `HALVING_TAPS`, centred between pixels.

    Pixel j of the result stands for pixels 2j and 2j + 1; the outermost results, whose kernel would reach outside,
    are computed on a repeated edge.

    Parameters
    ----------
    image : ndarray [rows, cols] float32
        Even numbers of rows and columns.
    """
    return _halve(image, np.array(HALVING_TAPS, np.float32))


@njit(cache=True, nogil=True)
def _halve(image: F32, taps: F32) -> F32:
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    out = np.zeros((rows, cols), np.float32)
    reach = taps.shape[0] - 1
    line = np.empty(2 * (cols + reach), np.float32)
    inner = line[reach : reach + 2 * cols]
    for r in range(rows):
        inner[:] = np.float32(0)
        for k in range(taps.shape[0]):
            add_folded(inner, image[max(2 * r - k, 0)], image[min(2 * r + 1 + k, 2 * rows - 1)], taps[k])
        line[:reach] = inner[0]
        line[reach + 2 * cols :] = inner[2 * cols - 1]
        for c in range(cols):
            centre = reach + 2 * c
            total = np.float32(0)
            for k in range(taps.shape[0]):
                total += taps[k] * (line[centre - k] + line[centre + 1 + k])
            out[r, c] = total
    return out


def amplitudes(
    image: F32, filters: Filters, orientations: int, origin: tuple[int, int], cells: tuple[int, int], per_cell: int
) -> F32:
    """Return the mean quadrature amplitude |Gabor answer| of each cell.

    Parameters
    ----------
    image : ndarray [rows, cols] float32
        The pyramid level the filters are for.
    origin : (int, int)
        Level pixel of `image` at which cell (0, 0) starts.
    cells : (int, int)
        Rows and columns of cells wanted.
    per_cell : int
        Level pixels per cell side.

    Returns
    -------
    ndarray [orientations, rows, cols] float32
        A wave of amplitude a at the filter's centre answers a/2.
    """
    stride = filters.stride
    phases = np.stack([_plane(image, phase, stride) for phase in range(stride)])
    out = np.zeros((orientations, *cells), np.float32)
    _amplitude_cells(
        phases, origin[0], origin[1], per_cell // stride,
        filters.row_even, filters.row_odd, filters.col_even, filters.col_odd,
        filters.row_envelope, filters.col_envelope, filters.dc, filters.first, filters.second, out,
    )  # fmt: skip
    return out


def _plane(image: F32, phase: int, stride: int) -> F32:
    plane = image[:, phase::stride]
    short = -(-image.shape[1] // stride) - plane.shape[1]
    return np.pad(plane, ((0, 0), (0, short))) if short else plane


@njit(cache=True, nogil=True)
def _even(acc: F32, a1: F32, a2: F32, a3: F32, a4: F32, b1: F32, b2: F32, b3: F32, b4: F32, taps: F32) -> None:
    w1, w2, w3, w4 = taps[0], taps[1], taps[2], taps[3]
    for x in range(acc.shape[0]):
        acc[x] += w1 * (a1[x] + b1[x]) + w2 * (a2[x] + b2[x]) + w3 * (a3[x] + b3[x]) + w4 * (a4[x] + b4[x])


@njit(cache=True, nogil=True)
def _odd(acc: F32, a1: F32, a2: F32, a3: F32, a4: F32, b1: F32, b2: F32, b3: F32, b4: F32, taps: F32) -> None:
    w1, w2, w3, w4 = taps[0], taps[1], taps[2], taps[3]
    for x in range(acc.shape[0]):
        acc[x] += w1 * (a1[x] - b1[x]) + w2 * (a2[x] - b2[x]) + w3 * (a3[x] - b3[x]) + w4 * (a4[x] - b4[x])


@njit(cache=True, nogil=True)
def _row_pass(plane: F32, r: int, taps: F32, odd: bool, acc: F32) -> None:
    """Filter row `r` of a plane along the rows axis."""
    if odd:
        acc[:] = np.float32(0)
    else:
        acc[:] = taps[0] * plane[r]
    for t in range(1, taps.shape[0], 4):
        upper = (plane[r + t], plane[r + t + 1], plane[r + t + 2], plane[r + t + 3])
        lower = (plane[r - t], plane[r - t - 1], plane[r - t - 2], plane[r - t - 3])
        if odd:
            _odd(acc, *upper, *lower, taps[t : t + 4])
        else:
            _even(acc, *upper, *lower, taps[t : t + 4])


@njit(cache=True, nogil=True)
def _shifted(lines: F32, column: int, count: int) -> F32:
    """Every stride-th sample from `column` on, out of a line kept as one plane per phase."""
    stride = lines.shape[0]
    start = column // stride
    return lines[column % stride, start : start + count]


@njit(cache=True, nogil=True)
def _col_pass(lines: F32, column: int, taps: F32, odd: bool, acc: F32) -> None:
    """Filter a line along the columns axis, at every stride-th sample from `column` on."""
    n = acc.shape[0]
    if odd:
        acc[:] = np.float32(0)
    else:
        acc[:] = taps[0] * _shifted(lines, column, n)
    for t in range(1, taps.shape[0], 4):
        right = (_shifted(lines, column + t, n), _shifted(lines, column + t + 1, n),
                 _shifted(lines, column + t + 2, n), _shifted(lines, column + t + 3, n))  # fmt: skip
        left = (_shifted(lines, column - t, n), _shifted(lines, column - t - 1, n),
                _shifted(lines, column - t - 2, n), _shifted(lines, column - t - 3, n))  # fmt: skip
        if odd:
            _odd(acc, *right, *left, taps[t : t + 4])
        else:
            _even(acc, *right, *left, taps[t : t + 4])


@njit(cache=True, nogil=True)
def _add_cells(real: F32, imag: F32, samples: int, share: np.float32, out: F32) -> None:
    for x in range(real.shape[0]):
        real[x] = np.sqrt(real[x] * real[x] + imag[x] * imag[x])
    for cell in range(out.shape[0]):
        total = np.float32(0)
        for s in range(samples):
            total += real[cell * samples + s]
        out[cell] += share * total


@njit(cache=True, nogil=True)
def _amplitude_cells(
    planes: F32, top: int, left: int, samples: int,
    row_even: F32, row_odd: F32, col_even: F32, col_odd: F32,
    row_envelope: F32, col_envelope: F32, dc: F32,
    first: NDArray[np.int64], second: NDArray[np.int64], out: F32,
) -> None:  # fmt: skip
    stride, width = planes.shape[0], planes.shape[2]
    n = out.shape[2] * samples
    share = np.float32(1.0 / (samples * samples))
    even, odd = np.empty((stride, width), np.float32), np.empty((stride, width), np.float32)
    blur, ee, eo = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    oe, oo = np.empty(n, np.float32), np.empty(n, np.float32)
    real, imag = np.empty(n, np.float32), np.empty(n, np.float32)
    for sample_row in range(out.shape[1] * samples):
        r, cell_row = top + sample_row * stride, sample_row // samples
        for phase in range(stride):
            _row_pass(planes[phase], r, row_envelope, False, even[phase])
        _col_pass(even, left, col_envelope, False, blur)
        for f in range(first.shape[0]):
            for phase in range(stride):
                _row_pass(planes[phase], r, row_even[f], False, even[phase])
                _row_pass(planes[phase], r, row_odd[f], True, odd[phase])
            _col_pass(even, left, col_even[f], False, ee)
            _col_pass(even, left, col_odd[f], True, eo)
            _col_pass(odd, left, col_even[f], False, oe)
            _col_pass(odd, left, col_odd[f], True, oo)
            for x in range(n):
                real[x] = ee[x] - oo[x] - dc[f] * blur[x]
                imag[x] = eo[x] + oe[x]
            _add_cells(real, imag, samples, share, out[first[f], cell_row])
            if second[f] >= 0:
                for x in range(n):
                    real[x] = ee[x] + oo[x] - dc[f] * blur[x]
                    imag[x] = eo[x] - oe[x]
                _add_cells(real, imag, samples, share, out[second[f], cell_row])
