"""Seeded families of score maps: what policies are trained and compared on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

BARE_SHARE = 0.6
"""Share of the Gaussian mixtures whose low ground is worth nothing at all: no gradient leads across it."""

Scores = NDArray[np.float64]


def _box_blur(values: Scores, radius: int) -> Scores:
    """Blur with three passes of a (2 radius + 1) box, mirrored at the edges: close to a Gaussian."""
    for _ in range(3):
        for axis in (0, 1):
            width = [(0, 0), (0, 0)]
            width[axis] = (radius + 1, radius)
            table = np.pad(values, width, mode="reflect").cumsum(axis=axis)
            size = 2 * radius + 1
            high = np.take(table, range(size, table.shape[axis]), axis=axis)
            low = np.take(table, range(table.shape[axis] - size), axis=axis)
            values = (high - low) / size
    return values


def _stretch(values: Scores) -> Scores:
    """Map values linearly onto 0..1."""
    low, high = float(values.min()), float(values.max())
    return (values - low) / (high - low) if high > low else np.zeros_like(values)


def gaussians(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a mixture of 3 to 12 Gaussian hot spots of different widths, often on ground worth nothing."""
    rows, cols = np.indices(shape)
    total = np.zeros(shape)
    for _ in range(int(rng.integers(3, 13))):
        row, col = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        spread = rng.uniform(0.03, 0.14) * min(shape)
        total += rng.uniform(0.3, 1.0) * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * spread**2))
    floor = rng.uniform(0.1, 0.4) if rng.random() < BARE_SHARE else 0.0
    return _stretch(np.maximum(_stretch(total) - floor, 0.0))


def noise(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a smoothed white-noise field with a random correlation length."""
    radius = int(rng.integers(1, max(2, min(shape) // 8)))
    return np.asarray(_stretch(_box_blur(rng.random(shape), radius)) ** rng.uniform(1.0, 6.0))


def classes(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a map of a few constant classes with roads across, as a segmented orthomosaic gives."""
    levels = np.sort(rng.random(int(rng.integers(3, 7))))
    radius = int(rng.integers(2, max(3, min(shape) // 10)))
    field = _stretch(_box_blur(rng.random(shape), radius))
    cuts = np.quantile(field, np.linspace(0, 1, levels.size + 1)[1:-1])
    score = rng.permutation(levels)[np.searchsorted(cuts, field)]
    rows, cols = np.indices(shape)
    for _ in range(int(rng.integers(1, 4))):
        angle = rng.uniform(0, np.pi)
        row, col = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        bend = rng.uniform(0, 0.1) * min(shape) * np.sin((rows + cols) / rng.uniform(4, 12))
        away = np.abs((rows - row) * np.cos(angle) - (cols - col) * np.sin(angle) + bend)
        score = np.where(away < rng.uniform(0.8, 2.0), rng.uniform(0.7, 1.0), score)
    return np.asarray(np.clip(score + 0.02 * rng.standard_normal(shape), 0.0, 1.0))


def obstacles(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a smoothed field or a mixture with blobs of no-go cells."""
    score = noise(shape, rng) if rng.random() < 0.5 else gaussians(shape, rng)
    mask = _stretch(_box_blur(rng.random(shape), int(rng.integers(1, 4))))
    return np.asarray(np.where(mask > np.quantile(mask, rng.uniform(0.75, 0.95)), np.nan, score))


def speckle(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a weak smooth field with single rich cells strewn over it."""
    score = 0.3 * noise(shape, rng)
    return np.asarray(np.where(rng.random(shape) < rng.uniform(0.02, 0.2), rng.random(shape), score))


def islands(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a few rich patches of uneven score, the rest worth nothing or next to it: most starts see none."""
    radius = int(rng.integers(2, max(3, min(shape) // 8)))
    field = _box_blur(rng.random(shape), radius)
    shore = np.quantile(field, rng.uniform(0.8, 0.97))
    height = _stretch(np.maximum(field - shore, 0.0)) ** rng.uniform(0.2, 1.5)
    ground = rng.uniform(0.0, 0.05) * noise(shape, rng) if rng.random() < 0.5 else 0.0
    return np.asarray(np.clip(height * (0.5 + 0.5 * noise(shape, rng)) + ground, 0.0, 1.0))


def trails(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return the smoothed trails of a few wanderers that turn a little at each step, on bare ground."""
    total = np.zeros(shape)
    side = min(shape)
    for _ in range(int(rng.integers(1, 5))):
        length = int(side * rng.uniform(0.5, 3.0))
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0.0, rng.uniform(0.05, 0.4), length))
        rows = rng.uniform(0, shape[0]) + np.cumsum(np.sin(heading))
        cols = rng.uniform(0, shape[1]) + np.cumsum(np.cos(heading))
        np.maximum.at(
            total,
            (rows.astype(np.int64) % shape[0], cols.astype(np.int64) % shape[1]),
            np.linspace(1.0, rng.uniform(0.1, 1.0), length),
        )
    return _stretch(_box_blur(total, int(rng.integers(0, 3))))


_MAKERS: dict[str, Callable[[tuple[int, int], np.random.Generator], Scores]] = {
    "gaussians": gaussians,
    "noise": noise,
    "classes": classes,
    "obstacles": obstacles,
    "speckle": speckle,
    "islands": islands,
    "trails": trails,
}

FAMILIES = tuple(_MAKERS)


def make_map(family: str, shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Return a score map, float64 `shape` in [0, 1] with NaN for no-go cells, of a family of `FAMILIES`."""
    return _MAKERS[family](shape, rng)
