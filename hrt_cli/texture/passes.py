"""The passes of a Gabor bank over the pixels, compiled: halving, and the amplitudes of cells.

Loops run over plain lines, which the compiler turns into wide instructions, and each takes as many taps as the
registers hold.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.texture.bank import GROUP, HALVING_TAPS, Filters
from hrt_cli.texture.lattice import F32


def columns_apart(image: F32, buffer: F32 | None = None) -> F32:
    """Return [2, rows, cols / 2]: the even and the odd columns of an image with an even number of columns.

    They are put into `buffer`, a flat array, if that is large enough.
    """
    out = shaped(buffer, (2, image.shape[0], image.shape[1] // 2))
    _split_columns(image, out)
    return out


@njit(cache=True, nogil=True)
def _split_columns(image: F32, out: F32) -> None:
    for r in range(out.shape[1]):
        line, even, odd = image[r], out[0, r], out[1, r]
        for c in range(out.shape[2]):
            even[c] = line[2 * c]
            odd[c] = line[2 * c + 1]


def halve(image: F32, buffer: F32 | None = None) -> F32:
    """Halve an image along both axes with `HALVING_TAPS`, centred between pixels.

    Pixel j of the result stands for pixels 2j and 2j + 1; the outermost results, whose kernel would reach outside,
    are computed on a repeated edge.

    Parameters
    ----------
    image : ndarray [2, rows, cols / 2] float32
        From `columns_apart`; even numbers of rows and columns.
    buffer : ndarray [n] float32, optional
        Where to put the result, if it is large enough.

    Returns
    -------
    ndarray [2, rows / 2, cols / 4] float32
        In the same form; a last odd column is kept with a zero beside it.
    """
    out = shaped(buffer, (2, image.shape[1] // 2, (image.shape[2] + 1) // 2))
    _halve(image, np.array(HALVING_TAPS, np.float32), out)
    return out


def shaped(buffer: F32 | None, shape: tuple[int, ...]) -> F32:
    """Return the beginning of a flat buffer as an array, or a new array where it is too small."""
    size = math.prod(shape)
    return np.empty(shape, np.float32) if buffer is None or buffer.size < size else buffer[:size].reshape(shape)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _fold_four(out: F32, a1: F32, a2: F32, a3: F32, a4: F32, b1: F32, b2: F32, b3: F32, b4: F32, taps: F32) -> None:
    w1, w2, w3, w4 = taps[0], taps[1], taps[2], taps[3]
    for x in range(out.shape[0]):
        out[x] = w1 * (a1[x] + b1[x]) + w2 * (a2[x] + b2[x]) + w3 * (a3[x] + b3[x]) + w4 * (a4[x] + b4[x])


@njit(cache=True, nogil=True)
def _halve(image: F32, taps: F32, out: F32) -> None:
    rows, cols = image.shape[1] // 2, image.shape[2]
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
        first, second = out[0, r], out[1, r]
        for c in range(cols // 2):
            first[c] = line[2 * c]
            second[c] = line[2 * c + 1]
        if cols % 2:
            first[cols // 2], second[cols // 2] = line[cols - 1], np.float32(0)


def amplitudes(image: F32, filters: Filters, origin: tuple[int, int], per_cell: int, out: F32) -> None:
    """Compute the mean quadrature amplitude |Gabor answer| of each cell.

    Parameters
    ----------
    image : ndarray [2, rows, cols / 2] float32
        The pyramid level the filters are for, from `columns_apart` or `halve`.
    origin : (int, int)
        Level pixel of the image at which cell (0, 0) starts; its column is a multiple of the stride.
    per_cell : int
        Level pixels per cell side.
    out : ndarray [orientations, rows, cols] float32
        Receives the result. A wave of amplitude a at the filter's centre answers a/2.
    """
    if origin[1] % filters.stride:
        raise ValueError(f"cells start at column {origin[1]}, no multiple of the stride {filters.stride}")
    if filters.stride == 1:
        image = np.ascontiguousarray(image.transpose(1, 2, 0)).reshape(1, image.shape[1], -1)
    _amplitude_cells(
        image, origin[0], origin[1], per_cell // filters.stride, filters.stride,
        filters.row_even, filters.row_odd, filters.col_even, filters.col_odd,
        filters.col_envelope, filters.dc, filters.first, filters.second, out,
    )  # fmt: skip


@njit(cache=True, nogil=True, forceinline=True, fastmath={"contract"})
def _first_taps(
    even: F32, odd: F32, line: F32, even_taps: F32, odd_taps: F32,
    a0: F32, a1: F32, a2: F32, a3: F32, b0: F32, b1: F32, b2: F32, b3: F32,
) -> None:  # fmt: skip
    """Set `even` to tap 0 · line + Σ even_taps · (a + b), and `odd` to Σ odd_taps · (a − b), in one sweep.

    Four taps of both kernels are as many as the registers hold.
    """
    middle, e0, e1, e2, e3 = even_taps[0], even_taps[1], even_taps[2], even_taps[3], even_taps[4]
    o0, o1, o2, o3 = odd_taps[1], odd_taps[2], odd_taps[3], odd_taps[4]
    for x in range(even.shape[0]):
        # All is read before anything is written: the compiler cannot know that the lines do not overlap.
        p0, p1, p2, p3, q0, q1, q2, q3 = a0[x], a1[x], a2[x], a3[x], b0[x], b1[x], b2[x], b3[x]
        alike = middle * line[x] + e0 * (p0 + q0) + e1 * (p1 + q1) + e2 * (p2 + q2) + e3 * (p3 + q3)
        opposite = o0 * (p0 - q0) + o1 * (p1 - q1) + o2 * (p2 - q2) + o3 * (p3 - q3)
        even[x], odd[x] = alike, opposite


@njit(cache=True, nogil=True, forceinline=True, fastmath={"contract"})
def _further_taps(
    even: F32, odd: F32, even_taps: F32, odd_taps: F32,
    a0: F32, a1: F32, a2: F32, a3: F32, b0: F32, b1: F32, b2: F32, b3: F32,
) -> None:  # fmt: skip
    """Add Σ even_taps · (a + b) to `even` and Σ odd_taps · (a − b) to `odd`, in one sweep."""
    e0, e1, e2, e3 = even_taps[0], even_taps[1], even_taps[2], even_taps[3]
    o0, o1, o2, o3 = odd_taps[0], odd_taps[1], odd_taps[2], odd_taps[3]
    for x in range(even.shape[0]):
        p0, p1, p2, p3, q0, q1, q2, q3 = a0[x], a1[x], a2[x], a3[x], b0[x], b1[x], b2[x], b3[x]
        alike = even[x] + e0 * (p0 + q0) + e1 * (p1 + q1) + e2 * (p2 + q2) + e3 * (p3 + q3)
        opposite = odd[x] + o0 * (p0 - q0) + o1 * (p1 - q1) + o2 * (p2 - q2) + o3 * (p3 - q3)
        even[x], odd[x] = alike, opposite


@njit(cache=True, nogil=True, fastmath={"contract"})
def _row_pass(p: F32, r: int, even_taps: F32, odd_taps: F32, even: F32, odd: F32) -> None:
    """Filter row `r` of a plane along the rows axis with an even and an odd kernel."""
    a, b = p[r + 1 : r + 5], p[r - 4 : r]
    _first_taps(even, odd, p[r], even_taps, odd_taps, a[0], a[1], a[2], a[3], b[3], b[2], b[1], b[0])
    for t in range(1 + GROUP, even_taps.shape[0], GROUP):
        a, b = p[r + t : r + t + GROUP], p[r - t - GROUP + 1 : r - t + 1]
        _further_taps(even, odd, even_taps[t:], odd_taps[t:], a[0], a[1], a[2], a[3], b[3], b[2], b[1], b[0])


@njit(cache=True, nogil=True, forceinline=True)
def _taps_of_columns(p: F32, c: int, stride: int, even_taps: F32, odd_taps: F32, even: F32, odd: F32) -> None:
    """See `_column_pass`: tap k of a sample at phase 0 stands at phase k mod stride, k // stride samples on."""
    n, whole = even.shape[0], GROUP // stride
    near, middle, far = 1 // stride, 2 // stride, 3 // stride
    i, j = c // stride, c // stride - whole
    zero, one, two, three = p[0], p[1 % stride], p[2 % stride], p[3 % stride]
    _first_taps(
        even, odd, zero[i : i + n], even_taps, odd_taps,
        one[i + near : i + near + n], two[i + middle : i + middle + n],
        three[i + far : i + far + n], zero[i + whole : i + whole + n],
        three[j + far : j + far + n], two[j + middle : j + middle + n],
        one[j + near : j + near + n], zero[j : j + n],
    )  # fmt: skip
    for _ in range(1 + GROUP, even_taps.shape[0], GROUP):
        i, j = i + whole, j - whole
        even_taps, odd_taps = even_taps[GROUP:], odd_taps[GROUP:]
        _further_taps(
            even, odd, even_taps[1:], odd_taps[1:],
            one[i + near : i + near + n], two[i + middle : i + middle + n],
            three[i + far : i + far + n], zero[i + whole : i + whole + n],
            three[j + far : j + far + n], two[j + middle : j + middle + n],
            one[j + near : j + near + n], zero[j : j + n],
        )  # fmt: skip


@njit(cache=True, nogil=True, fastmath={"contract"})
def _column_pass(p: F32, c: int, even_taps: F32, odd_taps: F32, even: F32, odd: F32) -> None:
    """Filter a line along the columns axis with an even and an odd kernel, at every stride-th sample from `c` on.

    The line is kept as one row per phase [stride, ...], and `c` is a multiple of the stride, which is 1, 2 or 4. Said
    as constants, the taps stand at fixed places, and the processor has `stride` addresses to keep, not eight.
    """
    if p.shape[0] == 1:
        _taps_of_columns(p, c, 1, even_taps, odd_taps, even, odd)
    elif p.shape[0] == 2:
        _taps_of_columns(p, c, 2, even_taps, odd_taps, even, odd)
    else:
        _taps_of_columns(p, c, 4, even_taps, odd_taps, even, odd)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_magnitude(ee: F32, oo: F32, eo: F32, oe: F32, blur: F32, dc: np.float32, sign: np.float32, out: F32) -> None:
    """Add the amplitude of the filter at theta (sign 1) or pi − theta (sign −1), from the four products of passes."""
    for x in range(out.shape[0]):
        real = ee[x] - sign * oo[x] - dc * blur[x]
        imag = eo[x] + sign * oe[x]
        out[x] += np.sqrt(real * real + imag * imag)


@njit(cache=True, nogil=True)
def _cell_means(line: F32, samples: int, share: np.float32, out: F32) -> None:
    for cell in range(out.shape[0]):
        total = np.float32(0)
        for s in range(samples):
            total += line[cell * samples + s]
        out[cell] = share * total


@njit(cache=True, nogil=True)
def _deal(line: F32, phase: int, phases: int, out: F32) -> None:
    """Deal the samples of a line out in turn to the rows phase, phase + phases, ... of `out`: one or two of them."""
    count = line.shape[0]
    if out.shape[0] == phases:
        only = out[phase]
        for c in range(count):
            only[c] = line[c]
        return
    first, second = out[phase], out[phase + phases]
    for c in range(count // 2):
        first[c] = line[2 * c]
        second[c] = line[2 * c + 1]
    if count % 2:
        first[count // 2] = line[count - 1]


@njit(cache=True, nogil=True)
def _amplitude_cells(
    planes: F32, top: int, left: int, samples: int, stride: int,
    row_even: F32, row_odd: F32, col_even: F32, col_odd: F32, col_envelope: F32, dc: F32,
    first: NDArray[np.int64], second: NDArray[np.int64], out: F32,
) -> None:  # fmt: skip
    phases, width = planes.shape[0], planes.shape[2]
    frequencies, n = first.shape[0], out.shape[2] * samples
    share = np.float32(1.0 / (samples * samples))
    plus, minus = np.float32(1), np.float32(-1)
    shorter = -(-width // (stride // phases))
    passed_even, passed_odd = np.zeros(width, np.float32), np.zeros(width, np.float32)
    even = np.zeros((frequencies, stride, shorter), np.float32)
    odd = np.zeros((frequencies, stride, shorter), np.float32)
    nothing = np.zeros(col_envelope.shape[0], np.float32)
    blur, ee, eo = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    oe, oo, spare = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    lines = np.zeros((out.shape[0], n), np.float32)
    for cell_row in range(out.shape[1]):
        lines[:] = np.float32(0)
        for sample_row in range(cell_row * samples, (cell_row + 1) * samples):
            r = top + sample_row * stride
            for phase in range(phases):
                for f in range(frequencies):
                    _row_pass(planes[phase], r, row_even[f], row_odd[f], passed_even, passed_odd)
                    _deal(passed_even, phase, phases, even[f])
                    _deal(passed_odd, phase, phases, odd[f])
            _column_pass(even[0], left, col_envelope, nothing, blur, spare)
            for f in range(frequencies):
                _column_pass(even[f], left, col_even[f], col_odd[f], ee, eo)
                # The first frequency along the rows axis is 0: there is no odd part.
                if f > 0:
                    _column_pass(odd[f], left, col_even[f], col_odd[f], oe, oo)
                else:
                    oe[:], oo[:] = np.float32(0), np.float32(0)
                _add_magnitude(ee, oo, eo, oe, blur, dc[f], plus, lines[first[f]])
                if second[f] >= 0:
                    _add_magnitude(ee, oo, eo, oe, blur, dc[f], minus, lines[second[f]])
        for orientation in range(out.shape[0]):
            _cell_means(lines[orientation], samples, share, out[orientation, cell_row])
