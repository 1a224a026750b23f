"""How much each channel of a site counts where K-means looks for the classes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.texture.discriminate import Tile
from hrt_cli.texture.settings import FeatureSettings

F64 = NDArray[np.float64]

ONE_TEXTURE = "the image has one texture only: there is nothing to tell apart"
APART_SIGMAS = 5.0
"""Two windows so many standard deviations apart share nothing: what is alike in both is the ground."""
_SPREAD_FLOOR = 1e-3
"""A channel that varies less than this (Lab units, log units) carries no information and is left out."""
_COLOUR_WEIGHTS = np.array([0.57, 1.3, 1.3]) / np.sqrt(3)
"""Of L, a and b: at full weight of lightness a class is spent on the shadows of what is one ground."""
_SCALE_WEIGHTS = (0.8, 1.0, 1.4, 1.0)
"""Of four wavelengths, ascending: the shortest holds the noise of the camera, the third most of the ground."""
_LEAST_PERSISTENCE = 0.5
"""What persists half as much as chroma counts in full."""
_PERSISTENCE_FLOOR = 0.02
"""Added to shares: where nothing persists, nothing is known of any channel."""
_EVERY = 2
"""Every second cell along both axes says how much persists."""


def unit_spread(centred: F64) -> F64:
    """Return the factors that give channels unit spread.

    Raises
    ------
    ArgumentError
        No channel varies.
    """
    spread = centred.std(axis=0)
    scale = np.where(spread > _SPREAD_FLOOR, 1 / np.maximum(spread, _SPREAD_FLOOR), 0.0)
    if not scale.any():
        raise ArgumentError(ONE_TEXTURE)
    return np.asarray(scale)


def site_factors(tiles: list[Tile], centred: F64, settings: FeatureSettings, apart_cells: tuple[int, int]) -> F64:
    """Return the factors of colour and texture channels with which K-means' distance is fair.

    Parameters
    ----------
    tiles : list of Tile
    centred : ndarray [patches, channels] float64
        Their patches, less the mean.
    settings : FeatureSettings
    apart_cells : (int, int)
        Cells along rows and columns that lie between windows which share nothing.

    Returns
    -------
    ndarray [channels] float64

    Raises
    ------
    ArgumentError
        No channel varies.
    """
    _, texture = settings.block_sizes
    weights = np.concatenate([_COLOUR_WEIGHTS, _scale_weights(settings, texture)])
    return np.asarray(unit_spread(centred) * weights * trust(persistence(tiles, apart_cells)))


def persistence(tiles: list[Tile], apart_cells: tuple[int, int]) -> F64:
    """Return how much of each channel's variance lies in what two cells apart have in common: [channels], 0 to 1.

    It is the covariance of cells that lie `apart_cells` from each other, over the variance (an autocorrelation; in
    geostatistics one less the share of the nugget; Matheron 1963). A kind of ground goes on over that distance, light
    and shade between leaves do not.
    """
    points = np.concatenate([one.patches for one in tiles])
    mean, variance = points.mean(axis=0), points.var(axis=0)
    total, pairs = np.zeros(len(mean)), 0
    down, along = apart_cells
    for one in tiles:
        wide = one.wide[:, ::_EVERY, ::_EVERY].astype(np.float64) - mean[:, None, None]
        usable = one.usable[::_EVERY, ::_EVERY]
        for rows, cols in ((-(-down // _EVERY), 0), (0, -(-along // _EVERY))):
            height, width = usable.shape[0] - rows, usable.shape[1] - cols
            if height <= 0 or width <= 0:
                continue
            both = usable[:height, :width] & usable[rows:, cols:]
            total += (wide[:, :height, :width] * wide[:, rows:, cols:])[:, both].sum(axis=1)
            pairs += int(np.count_nonzero(both))
    if pairs == 0:
        return np.ones(len(mean))
    return np.asarray(np.clip(total / pairs / np.maximum(variance, _SPREAD_FLOOR**2), 0, 1))


def trust(persisting: F64) -> F64:
    """Return the factors of L, a, b and the texture channels: 1, or less for what persists much less than chroma.

    Light changes chroma least, so chroma is the measure; lightness and texture are judged as blocks. Where a canopy's
    texture is that of its shades, it says nothing of the ground, and K-means would spend classes on it.
    """
    chroma = persisting[1:3].mean() + _PERSISTENCE_FLOOR
    factors = np.ones(len(persisting))
    for block in (slice(0, 1), slice(3, None)):
        ratio = (persisting[block].mean() + _PERSISTENCE_FLOOR) / (_LEAST_PERSISTENCE * chroma)
        factors[block] = min(1.0, ratio) ** 2
    return factors


def _scale_weights(settings: FeatureSettings, channels: int) -> F64:
    """Return the weights of the texture channels, a unit in all."""
    scales = len(settings.wavelengths_m)
    per_scale = np.array(_SCALE_WEIGHTS) if scales == len(_SCALE_WEIGHTS) else np.ones(scales)
    weights = np.repeat(per_scale, channels // scales)
    return np.asarray(weights / np.sqrt((weights**2).sum()))
