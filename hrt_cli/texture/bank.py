"""A bank of Gabor filters in quadrature, as separable passes on a pyramid of octaves.

A Gabor filter with an isotropic envelope is the product of a complex filter along the rows axis and one along
the columns axis (Fogel and Sagi 1989; Jain and Farrokhnia 1991), so a filter costs two one-dimensional passes.
Filters at theta and pi − theta share all of them. Long wavelengths run on an image halved once or more, where
they are as short as the short ones; the gain of the halving is divided out of the taps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
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
GROUP = 4
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
    padded = -(-reach // GROUP) * GROUP
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
