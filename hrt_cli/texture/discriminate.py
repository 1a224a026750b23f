"""Classes found in a wide window, told apart in a narrow one: how borders get sharp.

A wide window tells textures apart well and blurs where they meet; a narrow one is noisy and sharp. So K-means finds
the classes in the wide window, and cells well inside a class teach a linear discriminant of the narrow one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_LAG_CELLS = 2
"""Distance of the cells whose differences measure local noise."""
_KEPT_DIFFERENCES = 0.7
"""Share of the differences that count: the largest straddle borders."""
_RIDGE = 0.02
"""Added to a covariance, times its mean eigenvalue, in channels of unit spread."""
_SMALLEST_SPREAD = 1e-3
_PURE_CELLS = 2
"""A cell is pure when all cells up to so far away are of its class."""
_MIN_PURE = 30
TEMPERATURE = 0.05
"""Neighbouring cells and channels are not independent: what the discriminant says of a cell is worth a twentieth."""


@dataclass(frozen=True)
class Tile:
    """Whole tiles of a sample, for what needs neighbours.

    Attributes
    ----------
    wide : ndarray [channels, rows, cols] float32
        Features in the wide window.
    usable : ndarray [rows, cols] bool
    """

    wide: NDArray[np.float32]
    usable: NDArray[np.bool_]

    @property
    def patches(self) -> F64:
        """The usable cells in the wide window [patches, channels]."""
        return self.wide[:, self.usable].T.astype(np.float64)


def noise_whitening(tiles: list[Tile]) -> F64:
    """Return the matrix in which differences of near cells have unit covariance.

    Green et al. 1988 (minimum noise fraction). Whitening by the covariance of all shrinks what separates classes;
    differences between near cells hold no classes once those that straddle borders are trimmed.
    """
    spread = _spread(np.concatenate([one.patches for one in tiles]))
    lag, parts = _LAG_CELLS, []
    for one in tiles:
        wide, usable = one.wide.astype(np.float64), one.usable
        parts.append((wide[:, lag:] - wide[:, :-lag])[:, usable[lag:] & usable[:-lag]].T)
        parts.append((wide[:, :, lag:] - wide[:, :, :-lag])[:, usable[:, lag:] & usable[:, :-lag]].T)
    differences = np.concatenate(parts) / spread
    if len(differences) == 0:
        return np.diag(1 / spread)
    size = (differences**2).sum(axis=1)
    return _inverse_root(differences[size <= np.quantile(size, _KEPT_DIFFERENCES)], spread)


def pure(tiles: list[Tile], labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which patches lie well inside their class: bool [patches], in the order of `labels`."""
    found, begin = [], 0
    window = np.ones((2 * _PURE_CELLS + 1, 2 * _PURE_CELLS + 1), np.uint8)
    for one in tiles:
        end = begin + int(one.usable.sum())
        low, high = np.full(one.usable.shape, 255, np.uint8), np.zeros(one.usable.shape, np.uint8)
        low[one.usable] = high[one.usable] = labels[begin:end]
        found.append((cv2.erode(low, window) == cv2.dilate(high, window))[one.usable])
        begin = end
    return np.concatenate(found)


def discriminant(values: F64, labels: NDArray[np.int64], inside: NDArray[np.bool_], classes: int) -> tuple[F64, F64]:
    """Return Fisher's linear discriminant of classes by their pure patches (all of them where there are few).

    Parameters
    ----------
    values : ndarray [patches, channels] float64
        Features in the narrow window.
    labels : ndarray [patches] int64
    inside : ndarray [patches] bool
        Which are pure.

    Returns
    -------
    transform : ndarray [channels, channels] float64
        In these coordinates the classes' pooled covariance is the identity.
    means : ndarray [classes, channels] float64
        Of the classes, in features.
    """
    groups = []
    for k in range(classes):
        members = labels == k
        some = members & inside
        groups.append(some if np.count_nonzero(some) >= _MIN_PURE else members)
    means = np.stack([values[group].mean(axis=0) for group in groups])
    spread = _spread(values)
    within = np.concatenate([values[group] - mean for group, mean in zip(groups, means, strict=True)]) / spread
    return _inverse_root(within, spread), means


def _spread(values: F64) -> F64:
    return np.asarray(np.maximum(values.std(axis=0), _SMALLEST_SPREAD))


def _inverse_root(residuals: F64, spread: F64) -> F64:
    """Return W with W·(spread·r) of unit covariance, for residuals r in channels of unit spread."""
    covariance = np.einsum("ni,nj->ij", residuals, residuals) / len(residuals)
    values, vectors = np.linalg.eigh(covariance)
    # An eigenvector's sign is arbitrary; the largest component is made positive.
    vectors = vectors * np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(values))])
    return np.asarray((vectors / np.sqrt(values + _RIDGE * values.mean())).T / spread)
