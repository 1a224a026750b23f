"""Score maps that the planner was never trained on: what it is measured on.

None of these families is among those of `hrt_cli.planning.families`. Each is what a survey finds: hot spots, a
density, the trail of a plume, the veins of a reef, a network of tracks, colonies on bare ground, a
shore. All are float64 in [0, 1]
with NaN for no-go cells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

Scores = np.ndarray


def _unit(values: Scores) -> Scores:
    low, high = np.nanmin(values), np.nanmax(values)
    return (values - low) / (high - low) if high > low else np.zeros_like(values)


def _smooth(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> Scores:
    return _unit(ndimage.gaussian_filter(rng.standard_normal(shape), sigma, mode="reflect"))


def mixtures(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Two to nine Gaussian hot spots, each stretched and turned its own way, on ground worth nothing."""
    rows, cols = np.indices(shape)
    total = np.zeros(shape)
    for _ in range(int(rng.integers(2, 10))):
        row, col = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        turn = rng.uniform(0, np.pi)
        long = rng.uniform(0.04, 0.16) * min(shape)
        short = long * rng.uniform(0.25, 1.0)
        along = (rows - row) * np.sin(turn) + (cols - col) * np.cos(turn)
        across = (rows - row) * np.cos(turn) - (cols - col) * np.sin(turn)
        total += rng.uniform(0.3, 1.0) * np.exp(-0.5 * ((along / long) ** 2 + (across / short) ** 2))
    return _unit(total)


def lognormal(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """The exponential of a Gaussian random field, as densities of plants and animals are modelled (Cox processes)."""
    field = ndimage.gaussian_filter(rng.standard_normal(shape), rng.uniform(2, 6), mode="reflect")
    field = (field - field.mean()) / field.std()
    return _unit(np.exp(rng.uniform(1.0, 2.0) * field))


def plumes(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """One to four sources that a wind spreads: narrow and rich at the source, wide and thin far from it."""
    rows, cols = np.indices(shape)
    wind = rng.uniform(0, 2 * np.pi)
    total = np.zeros(shape)
    for _ in range(int(rng.integers(1, 5))):
        row, col = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        turn = wind + rng.normal(0, 0.1)
        along = (rows - row) * np.sin(turn) + (cols - col) * np.cos(turn)
        across = (rows - row) * np.cos(turn) - (cols - col) * np.sin(turn)
        spread = 0.8 + rng.uniform(0.08, 0.2) * np.maximum(along, 0) ** 0.9
        upwind = np.where(along < 0, np.exp(-(along**2) / 2), 1.0)
        total += rng.uniform(0.5, 1.0) * upwind * np.exp(-(across**2) / (2 * spread**2)) / np.sqrt(spread)
    return _unit(total)


def veins(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Winding bands: the ridges of a smooth field, as reefs, gullies and hedges lie."""
    field = _smooth(shape, rng.uniform(4, 9), rng)
    ridge = 1.0 - np.abs(2.0 * field - 1.0) * rng.uniform(4, 9)
    return _unit(np.maximum(ridge, 0.0) * (0.4 + 0.6 * _smooth(shape, 8, rng)))


def tracks(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """A network of tracks, good to drive, on ground that is hardly so, with buildings in between."""
    score = 0.05 + 0.1 * _smooth(shape, 3, rng)
    for _ in range(int(rng.integers(3, 7))):
        ends = rng.uniform(0, 1, (2, 2)) * np.array(shape)
        bend = rng.normal(0, 0.15, 2) * np.array(shape)
        for t in np.linspace(0, 1, 4 * max(shape)):
            row, col = ends[0] + (ends[1] - ends[0]) * t + bend * np.sin(np.pi * t)
            r, c = int(row), int(col)
            if 0 <= r < shape[0] and 0 <= c < shape[1]:
                score[r, c] = rng.uniform(0.8, 1.0)
                if c + 1 < shape[1]:
                    score[r, c + 1] = rng.uniform(0.6, 0.9)
    for _ in range(int(rng.integers(3, 9))):
        h, w = rng.integers(2, 9, 2)
        r, c = int(rng.integers(0, shape[0] - h)), int(rng.integers(0, shape[1] - w))
        block = score[r : r + h, c : c + w]
        block[block < 0.5] = np.nan
    return score


def colonies(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Voronoi cells of which a few are rich, each with its own level, on bare ground."""
    count = int(rng.integers(25, 70))
    seeds = rng.uniform(0, 1, (count, 2)) * np.array(shape)
    rows, cols = np.indices(shape)
    nearest = np.argmin((rows[..., None] - seeds[:, 0]) ** 2 + (cols[..., None] - seeds[:, 1]) ** 2, axis=2)
    level = np.where(rng.random(count) < 0.15, rng.uniform(0.4, 1.0, count), rng.uniform(0.0, 0.05, count))
    if level.max() < 0.4:
        level[0] = 1.0
    return np.clip(level[nearest] + 0.01 * rng.standard_normal(shape), 0.0, 1.0)


def shores(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Water that must not be entered, and a score that falls with the distance from its edge."""
    field = _smooth(shape, rng.uniform(5, 10), rng)
    water = field < np.quantile(field, rng.uniform(0.15, 0.4))
    away = ndimage.distance_transform_edt(~water)
    score = np.exp(-away / rng.uniform(1.5, 4.0)) * (0.3 + 0.7 * _smooth(shape, 4, rng))
    return np.where(water, np.nan, _unit(score))


def mosaic(shape: tuple[int, int], rng: np.random.Generator) -> Scores:
    """Large regions of like scores, none of them bare: every path collects much, the hardest to win on."""
    count = int(rng.integers(15, 40))
    seeds = rng.uniform(0, 1, (count, 2)) * np.array(shape)
    rows, cols = np.indices(shape)
    nearest = np.argmin((rows[..., None] - seeds[:, 0]) ** 2 + (cols[..., None] - seeds[:, 1]) ** 2, axis=2)
    return np.clip(rng.random(count)[nearest] + 0.05 * rng.standard_normal(shape), 0.0, 1.0)


HELD_OUT: dict[str, Callable[[tuple[int, int], np.random.Generator], Scores]] = {
    "mixtures": mixtures,
    "lognormal": lognormal,
    "plumes": plumes,
    "veins": veins,
    "tracks": tracks,
    "colonies": colonies,
    "shores": shores,
    "mosaic": mosaic,
}


def held_out(family: str, index: int, side: int = 64) -> tuple[Scores, tuple[int, int]]:
    """Return map `index` of a family, float64 [side, side], and a start drawn evenly from its largest region."""
    rng = np.random.default_rng([index, *family.encode()])
    score = HELD_OUT[family]((side, side), rng)
    regions, count = ndimage.label(~np.isnan(score))
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:])) if count else 0
    cells = np.argwhere(regions == largest)
    row, col = cells[int(rng.integers(len(cells)))]
    return score, (int(row), int(col))
