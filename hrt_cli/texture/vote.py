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
    taps = _taps()
    share = np.empty((1, *weights.shape), np.float32)
    _blur(weights[None], np.ones_like(weights), taps, share)
    q, field = np.empty_like(scores), np.zeros_like(scores)
    for _ in range(rounds + 1):
        _posterior(scores, field, np.float32(_COUPLING), weights, q)
        _blur(q, share[0], taps, field)
    return -field


def _taps() -> F32:
    side = np.exp(-0.5 * (np.arange(_REACH_CELLS + 1) / _SIGMA_CELLS) ** 2)
    return np.asarray(side / (side[0] + 2 * side[1:].sum()), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _posterior(scores: F32, field: F32, coupling: np.float32, weights: F32, out: F32) -> None:
    kinds, rows, cols = scores.shape
    least, total = np.empty(cols, np.float32), np.empty(cols, np.float32)
    lowest = np.float32(_LOWEST)
    for r in range(rows):
        least[:] = np.float32(np.inf)
        total[:] = np.float32(0)
        for k in range(kinds):
            for c in range(cols):
                energy = scores[k, r, c] - coupling * field[k, r, c]
                out[k, r, c] = energy
                least[c] = min(least[c], energy)
        for k in range(kinds):
            for c in range(cols):
                # (1 + x/1024)^1024: within 1 % of exp(x) where that is not negligible, and without a branch.
                power = np.float32(1) + max(least[c] - out[k, r, c], lowest) * np.float32(1 / 1024)
                for _ in range(10):
                    power *= power
                out[k, r, c] = power
                total[c] += power
        for c in range(cols):
            total[c] = weights[r, c] / total[c]
        for k in range(kinds):
            for c in range(cols):
                out[k, r, c] *= total[c]


@njit(cache=True, nogil=True, error_model="numpy")
def _blur(values: F32, share: F32, taps: F32, out: F32) -> None:
    """Blur each plane, zeros outside, and divide by `share`."""
    kinds, rows, cols = values.shape
    reach = taps.shape[0] - 1
    line = np.zeros(cols + 2 * reach, np.float32)
    middle = line[reach : reach + cols]
    for k in range(kinds):
        for r in range(rows):
            for c in range(cols):
                middle[c] = taps[0] * values[k, r, c]
            for d in range(1, reach + 1):
                for y in (r - d, r + d):
                    if 0 <= y < rows:
                        for c in range(cols):
                            middle[c] += taps[d] * values[k, y, c]
            for c in range(cols):
                total = taps[0] * line[reach + c]
                for d in range(1, reach + 1):
                    total += taps[d] * (line[reach + c - d] + line[reach + c + d])
                out[k, r, c] = total / max(share[r, c], np.float32(_SMALLEST_SHARE))
