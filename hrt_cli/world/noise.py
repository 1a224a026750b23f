"""Seeded procedural noise over ground coordinates: the raw material of every synthetic site.

All functions are pure functions of (coordinate in metres, seed), so that a site is the same whichever block of it
is computed, on however many threads. Lattice values come from an integer hash, never from a shared generator.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

_GRADIENT_SD = 0.181
"""Standard deviation of one octave of `_gradient_noise`, measured; divides it out so that amplitudes are sds."""

_TURN_COS, _TURN_SIN = 0.7986, 0.6018
"""Each octave's lattice is turned by 37 degrees against the one before (the first by the seed): no axis shows."""


_KEY_STEPS = 4194304.0
"""A cell key is one of 2**22 values."""


@dataclass(frozen=True)
class Cells:
    """Worley cells at a set of points; lengths in units of the cell size.

    Attributes
    ----------
    nearest, second : float64 array
        Distance to the nearest and to the second nearest seed point (F1, F2).
    key : float64 array
        One uniform number in [0, 1) per cell.
    dy, dx : float64 array
        Offset of the point from its cell's seed point.
    """

    nearest: FloatArray
    second: FloatArray
    key: FloatArray
    dy: FloatArray
    dx: FloatArray


def derive_seed(seed: int, *names: str | int) -> int:
    """Give the seed of a named part of a site: stable under renumbering of the other parts.

    Returns
    -------
    int
        In [0, 2**32).
    """
    return zlib.crc32("/".join(str(part) for part in (seed, *names)).encode())


@njit(cache=True, nogil=True)
def _hash(iy: int, ix: int, seed: int) -> np.uint64:
    h = (
        np.uint64(iy) * np.uint64(0x9E3779B97F4A7C15)
        ^ np.uint64(ix) * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ np.uint64(seed) * np.uint64(0x165667B19E3779F9)
    )
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xD6E8FEB86659FD93)
    return h ^ (h >> np.uint64(32))


@njit(cache=True, nogil=True)
def _corner(iy: int, ix: int, fy: float, fx: float, seed: int) -> float:
    h = _hash(iy, ix, seed)
    gy = np.float64(h >> np.uint64(32)) / 2147483648.0 - 1.0
    gx = np.float64(h & np.uint64(0xFFFFFFFF)) / 2147483648.0 - 1.0
    return gy * fy + gx * fx


@njit(cache=True, nogil=True)
def _gradient_noise(y: float, x: float, seed: int) -> float:
    iy, ix = int(np.floor(y)), int(np.floor(x))
    fy, fx = y - iy, x - ix
    wy = fy * fy * fy * (fy * (6.0 * fy - 15.0) + 10.0)
    wx = fx * fx * fx * (fx * (6.0 * fx - 15.0) + 10.0)
    top = _corner(iy, ix, fy, fx, seed)
    top += wx * (_corner(iy, ix + 1, fy, fx - 1.0, seed) - top)
    low = _corner(iy + 1, ix, fy - 1.0, fx, seed)
    low += wx * (_corner(iy + 1, ix + 1, fy - 1.0, fx - 1.0, seed) - low)
    return top + wy * (low - top)


@njit(cache=True, nogil=True)
def _fbm(y: FloatArray, x: FloatArray, wavelength: float, octaves: int, gain: float, seed: int) -> FloatArray:
    out = np.empty(y.size)
    power = 0.0
    for octave in range(octaves):
        power += gain ** (2 * octave)
    norm = 1.0 / (_GRADIENT_SD * np.sqrt(power))
    turn = 2.0 * np.pi * np.float64(_hash(seed, octaves, 0) >> np.uint64(40)) / 16777216.0
    cos, sin = np.cos(turn) / wavelength, np.sin(turn) / wavelength
    for i in range(y.size):
        py, px = cos * y[i] - sin * x[i], sin * y[i] + cos * x[i]
        total, amplitude = 0.0, 1.0
        for octave in range(octaves):
            total += amplitude * _gradient_noise(py, px, seed + octave)
            py, px = 2.0 * (_TURN_COS * py - _TURN_SIN * px), 2.0 * (_TURN_SIN * py + _TURN_COS * px)
            amplitude *= gain
        out[i] = total * norm
    return out


@njit(cache=True, nogil=True)
def _cells(y: FloatArray, x: FloatArray, size: float, seed: int) -> FloatArray:
    out = np.empty((5, y.size))
    for i in range(y.size):
        py, px = y[i] / size, x[i] / size
        iy, ix = int(np.floor(py)), int(np.floor(px))
        first, second, key, near_y, near_x = 9.0, 9.0, 0.0, 0.0, 0.0
        for cy in range(iy - 1, iy + 2):
            for cx in range(ix - 1, ix + 2):
                h = _hash(cy, cx, seed)
                dy = py - cy - np.float64(h >> np.uint64(43)) / 2097152.0
                dx = px - cx - np.float64((h >> np.uint64(22)) & np.uint64(0x1FFFFF)) / 2097152.0
                d2 = dy * dy + dx * dx
                if d2 < first:
                    second, first = first, d2
                    key = np.float64(h & np.uint64(0x3FFFFF)) / 4194304.0
                    near_y, near_x = dy, dx
                elif d2 < second:
                    second = d2
        out[0, i], out[1, i], out[2, i] = np.sqrt(first), np.sqrt(second), key
        out[3, i], out[4, i] = near_y, near_x
    return out


@njit(cache=True, nogil=True)
def _sticks(y: FloatArray, x: FloatArray, size: float, seed: int) -> FloatArray:
    out = np.zeros((2, y.size))
    for i in range(y.size):
        py, px = y[i] / size, x[i] / size
        iy, ix = int(np.floor(py)), int(np.floor(px))
        for cy in range(iy - 2, iy + 3):
            for cx in range(ix - 2, ix + 3):
                h = _hash(cy, cx, seed)
                key = (np.float64(h & np.uint64(0xFFFF)) + 1.0) / 65537.0
                if key <= out[1, i]:
                    continue
                dy = py - cy - np.float64((h >> np.uint64(16)) & np.uint64(0xFFF)) / 4096.0
                dx = px - cx - np.float64((h >> np.uint64(28)) & np.uint64(0xFFF)) / 4096.0
                angle = np.pi * np.float64((h >> np.uint64(40)) & np.uint64(0xFFF)) / 4096.0
                thickness = np.float64(h >> np.uint64(52)) / 4096.0
                along = np.cos(angle) * dx + np.sin(angle) * dy
                offset = np.cos(angle) * dy - np.sin(angle) * dx
                half_length, half_width = 0.8 + 0.6 * key, (0.07 + 0.07 * thickness) * (1.0 - 0.2 * along)
                if np.abs(along) < half_length and np.abs(offset) < half_width:
                    out[0, i], out[1, i] = offset / half_width, key
    return out


def fbm(
    y_m: FloatArray, x_m: FloatArray, wavelength_m: float, seed: int, *, octaves: int = 1, gain: float = 0.5
) -> FloatArray:
    """Sum octaves of gradient noise (fractional Brownian motion).

    Parameters
    ----------
    y_m, x_m : float64 array
        Ground coordinates in metres, one shape.
    wavelength_m : float
        Lattice spacing of the first octave; each further octave halves it.
    seed : int
        Non-negative.
    octaves : int
    gain : float
        Amplitude of an octave relative to the one before.

    Returns
    -------
    float64 array
        The shape of `y_m`; mean 0, standard deviation about 1, within about +-3.

    References
    ----------
    K. Perlin, "Improving noise", SIGGRAPH 2002 (quintic fade).
    """
    flat = _fbm(np.ravel(y_m), np.ravel(x_m), wavelength_m, octaves, gain, seed)
    return flat.reshape(y_m.shape)


def worley(y_m: FloatArray, x_m: FloatArray, size_m: float, seed: int) -> Cells:
    """Find each point's cell among jittered seed points, one per lattice square of `size_m`.

    The search looks at the 3 x 3 squares around the point, as in S. Worley, "A cellular texture basis function",
    SIGGRAPH 1996; it is exact for F1 but for rare points whose error does not show.

    Returns
    -------
    Cells
        Arrays of the shape of `y_m`.
    """
    stack = _cells(np.ravel(y_m), np.ravel(x_m), size_m, seed).reshape(5, *y_m.shape)
    return Cells(stack[0], stack[1], stack[2], stack[3], stack[4])


def within(
    mask: npt.NDArray[np.bool_], make: Callable[[FloatArray, FloatArray], FloatArray], y_m: FloatArray, x_m: FloatArray
) -> FloatArray:
    """Compute `make(y, x)` where `mask` is true only; 0 elsewhere."""
    out = np.zeros(mask.shape)
    out[mask] = make(y_m[mask], x_m[mask])
    return out


def warp(
    y_m: FloatArray, x_m: FloatArray, wavelength_m: float, amplitude_m: float, seed: int, *, octaves: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Displace coordinates by noise of standard deviation `amplitude_m` (domain warping)."""
    return (
        y_m + amplitude_m * fbm(y_m, x_m, wavelength_m, derive_seed(seed, "y"), octaves=octaves),
        x_m + amplitude_m * fbm(y_m, x_m, wavelength_m, derive_seed(seed, "x"), octaves=octaves),
    )


def hashed(key: FloatArray, salt: int) -> FloatArray:
    """Turn a cell key in [0, 1) into another, independent one (integer arithmetic: the same on every machine)."""
    mixed = (key * _KEY_STEPS).astype(np.uint32) + np.uint32(0x9E3779B9 * (salt + 1) & 0xFFFFFFFF)
    for multiplier in (0x85EBCA6B, 0xC2B2AE35):
        mixed = (mixed ^ (mixed >> np.uint32(15))) * np.uint32(multiplier)
    return np.asarray((mixed ^ (mixed >> np.uint32(16))) / 4294967296.0)


def sticks(y_m: FloatArray, x_m: FloatArray, size_m: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Scatter one straight stick of random direction in each lattice square and find the topmost at each point.

    A stick is 1.6 to 2.8 squares long and 0.14 to 0.28 wide.

    Returns
    -------
    tuple of float64 array
        Position across the stick in [-1, 1] (positive to the south) and its key in (0, 1]; both 0 off the sticks.
    """
    across, key = _sticks(np.ravel(y_m), np.ravel(x_m), size_m, seed).reshape(2, *y_m.shape)
    return across, key
