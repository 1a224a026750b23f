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

from hrt_cli.texture.lattice import F32

SIGMA_OVER_LAMBDA = 0.56
"""Envelope over wavelength for a bandwidth of one octave."""
KERNEL_REACH = 3.0
"""A kernel is cut at this many standard deviations."""
SHORTEST_ON_LEVEL_PX = 2.8
"""An octave is descended only while the wavelength stays at least this many pixels."""
MIN_WAVELENGTH_PX = 2.5
"""Below this a wavelength is not resolved."""
_MAX_STRIDE = 4
_GROUP = 8
"""Taps a pass takes at once; kernels are padded to whole groups."""
_LEVEL_TOLERANCE = 0.01
_NO_FREQUENCY = 1e-12
"""cos(pi/2) is not quite 0 in floating point; passes of frequency 0 are skipped."""
HALVING_TAPS = (0.44105, 0.14875, -0.0515, -0.0383)
"""One side of the even filter that precedes halving: least squares with pass band to 0.16 and stop band from
0.34 cycles per pixel: what folds into the band of a wavelength of 8 pixels stays below 4 %."""


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
        Even and odd parts of the pass along the rows axis, one per distinct |row frequency|; centre first. The first
        frequency is 0: its even part is the envelope.
    col_even, col_odd : ndarray [frequencies, reach + 1] float32
        The same along the columns axis, with the gain of the pyramid divided out.
    col_envelope : ndarray [reach + 1] float32
        The envelope along the columns axis.
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
    col_envelope: F32
    dc: F32
    first: NDArray[np.int64]
    second: NDArray[np.int64]


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
    samples : int
        Amplitudes taken along the side of a cell at the finest wavelength: 2 or 4 of a cell of 8 pixels.
    """

    wavelengths_m: tuple[float, ...]
    orientations: int
    sigma_over_lambda: float = SIGMA_OVER_LAMBDA
    samples: int = 2

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
        row_even, row_odd, _ = _taps(sigma_m / (pixel_m[0] * scale), row_freq * scale)
        col_even, col_odd, col_envelope = _taps(sigma_m / (pixel_m[1] * scale), col_freq * scale)
        gain = (_pyramid_gain(row_freq, level) * _pyramid_gain(col_freq, level))[:, None]
        col_even, col_odd = col_even / gain, col_odd / gain
        dc = _sum(row_even) * _sum(col_even)
        first = np.arange(len(theta))
        second = self.orientations - first
        second[(first == 0) | (second == first)] = -1
        return Filters(
            level=level,
            stride=_stride(step_px, step_px >> level, self.samples),
            row_even=row_even.astype(np.float32),
            row_odd=row_odd.astype(np.float32),
            col_even=col_even.astype(np.float32),
            col_odd=col_odd.astype(np.float32),
            col_envelope=col_envelope.astype(np.float32),
            dc=dc.astype(np.float32),
            first=first,
            second=second,
        )

    def reach_px(self, pixel_m: tuple[float, float], step_px: int) -> tuple[int, int]:
        """Return how far, in image pixels, an answer looks beyond its cell along rows and columns."""
        rows, cols = (
            max(_reach_px(one, taps) for one in self.filters(pixel_m, step_px) for taps in (one.row_even, one.row_odd)),
            max(_reach_px(one, taps) for one in self.filters(pixel_m, step_px) for taps in (one.col_even, one.col_odd)),
        )
        return rows, cols


def _stride(step_px: int, per_cell: int, samples: int) -> int:
    """Distance of samples in level pixels: the same on every level, where wavelengths are alike, within a cell."""
    return min(max(step_px // samples, 2), per_cell, _MAX_STRIDE)


def _reach_px(one: Filters, taps: F32) -> int:
    """Reach of a kernel and of the halvings before it, but at least what padded taps touch (and multiply by zero)."""
    scale: int = 1 << one.level
    reach = int(np.flatnonzero(taps.any(axis=0)).max(initial=0))
    padded: int = taps.shape[1] - 1
    return max(reach * scale + (len(HALVING_TAPS) - 1) * (scale - 1), padded * scale)


def _taps(
    sigma: float, frequencies: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    reach = int(np.ceil(KERNEL_REACH * sigma))
    padded = -(-reach // _GROUP) * _GROUP
    offsets = np.arange(padded + 1)
    envelope = np.exp(-0.5 * (offsets / sigma) ** 2) * (offsets <= reach)
    envelope /= _sum(envelope[None])[0]
    phase = 2 * np.pi * np.where(np.abs(frequencies) < _NO_FREQUENCY, 0.0, frequencies)[:, None] * offsets
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


def columns_apart(image: F32) -> F32:
    """Return [2, rows, cols / 2]: the even and the odd columns of an image with an even number of columns."""
    return np.stack([image[:, 0::2], image[:, 1::2]])


def halve(image: F32) -> F32:
    """Halve an image along both axes with `HALVING_TAPS`, centred between pixels.

    Pixel j of the result stands for pixels 2j and 2j + 1; the outermost results, whose kernel would reach outside,
    are computed on a repeated edge.

    Parameters
    ----------
    image : ndarray [2, rows, cols / 2] float32
        From `columns_apart`; even numbers of rows and columns.

    Returns
    -------
    ndarray [2, rows / 2, cols / 4] float32
        In the same form; a last odd column is kept with a zero beside it.
    """
    return _halve(image, np.array(HALVING_TAPS, np.float32))


@njit(cache=True, nogil=True, fastmath={"contract"})
def _fold_four(out: F32, a1: F32, a2: F32, a3: F32, a4: F32, b1: F32, b2: F32, b3: F32, b4: F32, taps: F32) -> None:
    w1, w2, w3, w4 = taps[0], taps[1], taps[2], taps[3]
    for x in range(out.shape[0]):
        out[x] = w1 * (a1[x] + b1[x]) + w2 * (a2[x] + b2[x]) + w3 * (a3[x] + b3[x]) + w4 * (a4[x] + b4[x])


@njit(cache=True, nogil=True)
def _halve(image: F32, taps: F32) -> F32:
    rows, cols = image.shape[1] // 2, image.shape[2]
    out = np.zeros((2, rows, (cols + 1) // 2), np.float32)
    even, odd = np.empty(cols + 4, np.float32), np.empty(cols + 4, np.float32)
    line = np.empty(cols, np.float32)
    last = 2 * rows - 1
    for r in range(rows):
        up = (2 * r, max(2 * r - 1, 0), max(2 * r - 2, 0), max(2 * r - 3, 0))
        down = (2 * r + 1, min(2 * r + 2, last), min(2 * r + 3, last), min(2 * r + 4, last))
        for phase in range(2):
            p = image[phase]
            target = (even if phase == 0 else odd)[2 : cols + 2]
            _fold_four(target, p[up[0]], p[up[1]], p[up[2]], p[up[3]],
                       p[down[0]], p[down[1]], p[down[2]], p[down[3]], taps)  # fmt: skip
        for edge in range(2):
            even[edge], odd[edge] = even[2], even[2]
            even[cols + 2 + edge], odd[cols + 2 + edge] = odd[cols + 1], odd[cols + 1]
        _fold_four(line, even[2:], odd[1:], even[1:], odd[0:], odd[2:], even[3:], odd[3:], even[4:], taps)
        for c in range(cols // 2):
            out[0, r, c] = line[2 * c]
            out[1, r, c] = line[2 * c + 1]
        if cols % 2:
            out[0, r, cols // 2] = line[cols - 1]
    return out


def amplitudes(image: F32, filters: Filters, origin: tuple[int, int], per_cell: int, out: F32) -> None:
    """Compute the mean quadrature amplitude |Gabor answer| of each cell.

    Parameters
    ----------
    image : ndarray [2, rows, cols / 2] float32
        The pyramid level the filters are for, from `columns_apart` or `halve`.
    origin : (int, int)
        Level pixel of the image at which cell (0, 0) starts.
    per_cell : int
        Level pixels per cell side.
    out : ndarray [orientations, rows, cols] float32
        Receives the result. A wave of amplitude a at the filter's centre answers a/2.
    """
    if filters.stride == 1:
        image = np.ascontiguousarray(image.transpose(1, 2, 0)).reshape(1, image.shape[1], -1)
    _amplitude_cells(
        image, origin[0], origin[1], per_cell // filters.stride, filters.stride,
        filters.row_even, filters.row_odd, filters.col_even, filters.col_odd,
        filters.col_envelope, filters.dc, filters.first, filters.second, out,
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath={"contract"})
def _combine(
    acc: F32, base: F32, weight: np.float32, sign: np.float32, taps: F32,
    a1: F32, a2: F32, a3: F32, a4: F32, a5: F32, a6: F32, a7: F32, a8: F32,
    b1: F32, b2: F32, b3: F32, b4: F32, b5: F32, b6: F32, b7: F32, b8: F32,
) -> None:  # fmt: skip
    """Set `acc` to weight · base + Σ taps · (a + sign · b): eight folded taps in one sweep."""
    w1, w2, w3, w4, w5, w6, w7, w8 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6], taps[7]
    for x in range(acc.shape[0]):
        acc[x] = (
            weight * base[x]
            + w1 * (a1[x] + sign * b1[x]) + w2 * (a2[x] + sign * b2[x])
            + w3 * (a3[x] + sign * b3[x]) + w4 * (a4[x] + sign * b4[x])
            + w5 * (a5[x] + sign * b5[x]) + w6 * (a6[x] + sign * b6[x])
            + w7 * (a7[x] + sign * b7[x]) + w8 * (a8[x] + sign * b8[x])
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _row_pass(p: F32, r: int, taps: F32, sign: np.float32, acc: F32) -> None:
    """Filter row `r` of a plane along the rows axis; `sign` is 1 for an even kernel, −1 for an odd one."""
    base, weight = p[r], taps[0]
    for t in range(1, taps.shape[0], 8):
        _combine(
            acc, base, weight, sign, taps[t : t + 8],
            p[r + t], p[r + t + 1], p[r + t + 2], p[r + t + 3],
            p[r + t + 4], p[r + t + 5], p[r + t + 6], p[r + t + 7],
            p[r - t], p[r - t - 1], p[r - t - 2], p[r - t - 3],
            p[r - t - 4], p[r - t - 5], p[r - t - 6], p[r - t - 7],
        )  # fmt: skip
        base, weight = acc, np.float32(1)


@njit(cache=True, nogil=True)
def _shifted(lines: F32, column: int, count: int) -> F32:
    """Every stride-th sample from `column` on, out of a line kept as one plane per phase."""
    stride = lines.shape[0]
    start = column // stride
    return lines[column % stride, start : start + count]


@njit(cache=True, nogil=True)
def _col_pass(p: F32, c: int, taps: F32, sign: np.float32, acc: F32) -> None:
    """Filter a line along the columns axis, at every stride-th sample from `c` on."""
    n = acc.shape[0]
    base, weight = _shifted(p, c, n), taps[0]
    for t in range(1, taps.shape[0], 8):
        _combine(
            acc, base, weight, sign, taps[t : t + 8],
            _shifted(p, c + t, n), _shifted(p, c + t + 1, n), _shifted(p, c + t + 2, n), _shifted(p, c + t + 3, n),
            _shifted(p, c + t + 4, n), _shifted(p, c + t + 5, n), _shifted(p, c + t + 6, n), _shifted(p, c + t + 7, n),
            _shifted(p, c - t, n), _shifted(p, c - t - 1, n), _shifted(p, c - t - 2, n), _shifted(p, c - t - 3, n),
            _shifted(p, c - t - 4, n), _shifted(p, c - t - 5, n), _shifted(p, c - t - 6, n), _shifted(p, c - t - 7, n),
        )  # fmt: skip
        base, weight = acc, np.float32(1)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _magnitude(ee: F32, oo: F32, eo: F32, oe: F32, blur: F32, dc: np.float32, sign: np.float32, out: F32) -> None:
    """Amplitude of the filter at theta (sign 1) or pi − theta (sign −1) from the four products of passes."""
    for x in range(out.shape[0]):
        real = ee[x] - sign * oo[x] - dc * blur[x]
        imag = eo[x] + sign * oe[x]
        out[x] = np.sqrt(real * real + imag * imag)


@njit(cache=True, nogil=True)
def _add_cells(line: F32, samples: int, share: np.float32, out: F32) -> None:
    if samples == 1:
        for cell in range(out.shape[0]):
            out[cell] += share * line[cell]
    elif samples == 2:
        for cell in range(out.shape[0]):
            out[cell] += share * (line[2 * cell] + line[2 * cell + 1])
    else:
        for cell in range(out.shape[0]):
            total = np.float32(0)
            for s in range(samples):
                total += line[cell * samples + s]
            out[cell] += share * total


@njit(cache=True, nogil=True)
def _deal(line: F32, out: F32) -> None:
    """Deal the samples of a line out to the rows of `out` [turns, ...] in turn."""
    turns = out.shape[0]
    for turn in range(turns):
        row = out[turn]
        for c in range((line.shape[0] - turn + turns - 1) // turns):
            row[c] = line[c * turns + turn]


@njit(cache=True, nogil=True)
def _amplitude_cells(
    planes: F32, top: int, left: int, samples: int, stride: int,
    row_even: F32, row_odd: F32, col_even: F32, col_odd: F32, col_envelope: F32, dc: F32,
    first: NDArray[np.int64], second: NDArray[np.int64], out: F32,
) -> None:  # fmt: skip
    phases, width = planes.shape[0], planes.shape[2]
    turns = stride // phases
    n = out.shape[2] * samples
    share = np.float32(1.0 / (samples * samples))
    plus, minus = np.float32(1), np.float32(-1)
    passed = np.empty(width, np.float32)
    shorter = -(-width // turns)
    even, odd = np.zeros((stride, shorter), np.float32), np.zeros((stride, shorter), np.float32)
    blur, ee, eo = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    oe, oo, line = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    out[:] = np.float32(0)
    for sample_row in range(out.shape[1] * samples):
        r, cell_row = top + sample_row * stride, sample_row // samples
        for f in range(first.shape[0]):
            row_wave, col_wave = f > 0, col_odd[f].any()
            for phase in range(phases):
                _row_pass(planes[phase], r, row_even[f], plus, passed)
                _deal(passed, even[phase::phases])
                if row_wave:
                    _row_pass(planes[phase], r, row_odd[f], minus, passed)
                    _deal(passed, odd[phase::phases])
            if f == 0:
                _col_pass(even, left, col_envelope, plus, blur)
            _col_pass(even, left, col_even[f], plus, ee)
            if row_wave:
                _col_pass(odd, left, col_even[f], plus, oe)
            else:
                oe[:], oo[:] = np.float32(0), np.float32(0)
            if col_wave:
                _col_pass(even, left, col_odd[f], minus, eo)
                if row_wave:
                    _col_pass(odd, left, col_odd[f], minus, oo)
            else:
                eo[:], oo[:] = np.float32(0), np.float32(0)
            _magnitude(ee, oo, eo, oe, blur, dc[f], plus, line)
            _add_cells(line, samples, share, out[first[f], cell_row])
            if second[f] >= 0:
                _magnitude(ee, oo, eo, oe, blur, dc[f], minus, line)
                _add_cells(line, samples, share, out[second[f], cell_row])
