"""Cells vote with their neighbours: a border goes where the textures of both sides agree that it goes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_COUPLING = 4.0
"""Weight of what the neighbours say."""
_SIGMA_CELLS, _REACH_CELLS = 1.0, 2
_SMALLEST_SHARE = 1e-6
_LOWEST = -40.0
"""Logarithm of what is nothing among probabilities, and still no denormal number."""


def halo_cells(rounds: int) -> int:
    """Cells that are needed around the cells wanted."""
    return (rounds + 1) * _REACH_CELLS


def vote(scores: F32, weights: F32, rounds: int) -> F32:
    """Return what neighbours agree on: mean-field rounds of a Potts field with Gaussian coupling.

    Kraehenbuehl and Koltun 2011, the spatial term alone: q = softmax(−(score − coupling · blur(q))), a few times.

    Parameters
    ----------
    scores : ndarray [classes, rows, cols] float32
        Minus log likelihoods, up to a constant.
    weights : ndarray [rows, cols] float32 in [0, 1]
        Share of valid pixels; cells without do not vote.
    rounds : int
        How often neighbours are heard.

    Returns
    -------
    ndarray [classes, rows, cols] float32
        Minus the blurred probabilities: the class of least value wins, and interpolating them interpolates
        probabilities. Right where `halo_cells` lie around.
    """
    field = np.zeros_like(scores)
    _mean_field(scores, weights, _taps(), rounds, field)
    return np.negative(field, out=field)


def _taps() -> F32:
    side = np.exp(-0.5 * (np.arange(_REACH_CELLS + 1) / _SIGMA_CELLS) ** 2)
    return np.asarray(side / (side[0] + 2 * side[1:].sum()), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_field(scores: F32, weights: F32, taps: F32, rounds: int, field: F32) -> None:
    inverse = np.empty(weights.shape, np.float32)
    _blur_plane(weights, taps, inverse)
    for r in range(weights.shape[0]):
        for c in range(weights.shape[1]):
            inverse[r, c] = np.float32(1) / max(inverse[r, c], np.float32(_SMALLEST_SHARE))
    q = np.empty(scores.shape, np.float32)
    for _ in range(rounds + 1):
        _posterior(scores, field, np.float32(_COUPLING), weights, q)
        for k in range(scores.shape[0]):
            _blur_plane(q[k], taps, field[k])
            for r in range(weights.shape[0]):
                _multiply(inverse[r], field[k, r])


# Loops over plain lines, and comparisons instead of min and max, which mind NaN: else nothing is vectorised.
@njit(cache=True, nogil=True, error_model="numpy")
def _posterior(scores: F32, field: F32, coupling: np.float32, weights: F32, out: F32) -> None:
    kinds, rows, cols = scores.shape
    least, total = np.empty(cols, np.float32), np.empty(cols, np.float32)
    for r in range(rows):
        least[:] = np.float32(np.inf)
        total[:] = np.float32(0)
        for k in range(kinds):
            _energy(scores[k, r], field[k, r], coupling, out[k, r], least)
        for k in range(kinds):
            _exponential(least, out[k, r], total)
        inside = weights[r]
        for c in range(cols):
            total[c] = inside[c] / total[c]
        for k in range(kinds):
            _multiply(total, out[k, r])


@njit(cache=True, nogil=True)
def _energy(scores: F32, field: F32, coupling: np.float32, out: F32, least: F32) -> None:
    for c in range(out.shape[0]):
        energy, lowest = scores[c] - coupling * field[c], least[c]
        out[c] = energy
        least[c] = energy if energy < lowest else lowest


@njit(cache=True, nogil=True)
def _exponential(least: F32, line: F32, total: F32) -> None:
    """Replace energies by exp(least − energy), and add them to `total`."""
    lowest = np.float32(_LOWEST)
    for c in range(line.shape[0]):
        x = least[c] - line[c]
        x = x if x > lowest else lowest
        # (1 + x/1024)^1024: within 1 % of exp(x) where that is not negligible, and without a branch.
        power = np.float32(1) + x * np.float32(1 / 1024)
        for _ in range(10):
            power *= power
        line[c] = power
        total[c] += power


@njit(cache=True, nogil=True)
def _blur_plane(plane: F32, taps: F32, out: F32) -> None:
    """Blur a plane, zeros outside."""
    rows, cols = plane.shape
    reach = taps.shape[0] - 1
    padded = np.zeros(cols + 2 * reach, np.float32)
    nothing = np.zeros(cols, np.float32)
    for r in range(rows):
        _weighted(plane[r], taps[0], padded[reach:])
        for d in range(1, reach + 1):
            above = plane[r - d] if r >= d else nothing
            below = plane[r + d] if r + d < rows else nothing
            _add_weighted(above, below, taps[d], padded[reach:])
        _weighted(padded[reach : reach + cols], taps[0], out[r])
        for d in range(1, reach + 1):
            _add_weighted(padded[reach - d :], padded[reach + d :], taps[d], out[r])


@njit(cache=True, nogil=True)
def _multiply(factors: F32, line: F32) -> None:
    for c in range(line.shape[0]):
        line[c] *= factors[c]


@njit(cache=True, nogil=True)
def _weighted(values: F32, weight: np.float32, out: F32) -> None:
    for c in range(values.shape[0]):
        out[c] = weight * values[c]


@njit(cache=True, nogil=True)
def _add_weighted(left: F32, right: F32, weight: np.float32, out: F32) -> None:
    for c in range(min(left.shape[0], right.shape[0], out.shape[0])):
        out[c] += weight * (left[c] + right[c])
