"""Heights of a synthetic site and what the sun makes of them: terrain, rock facets, shading, cast shadows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage

from hrt_cli.world.layout import Frame, Mask, box_blur
from hrt_cli.world.noise import FloatArray, derive_seed, fbm, hashed, warp, worley

AMBIENT = 0.42
"""Share of the light on level ground that comes from the sky, and so reaches the shadows too."""


@dataclass(frozen=True)
class Sun:
    """Where the sun stands.

    Attributes
    ----------
    elevation_rad : float
        Above the horizon.
    across : float
        Eastward component of the unit vector towards the sun's azimuth; its northward component is positive.
    """

    elevation_rad: float
    across: float

    @property
    def towards(self) -> tuple[float, float, float]:
        """Unit vector towards the sun as (southward, eastward, up)."""
        flat = float(np.cos(self.elevation_rad))
        north = float(np.sqrt(1.0 - self.across**2))
        return -flat * north, flat * self.across, float(np.sin(self.elevation_rad))


def terrain(frame: Frame, amplitude_m: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Draw bare ground as (broad relief, small bumps), metres, whose sum is the terrain.

    `amplitude_m` is the standard deviation of the broad relief on a site of reference size.
    """
    size = 34.0 * frame.spread
    y, x = warp(frame.y_m, frame.x_m, size, 0.1 * size, derive_seed(seed, "terrain warp"))
    broad = amplitude_m * frame.spread * fbm(y, x, size, derive_seed(seed, "terrain"), octaves=3, gain=0.25)
    bumps = 0.04 * fbm(frame.y_m, frame.x_m, 3.0, derive_seed(seed, "bumps"), octaves=3, gain=0.4)
    return broad, bumps


def facets(y_m: FloatArray, x_m: FloatArray, size_m: float, seed: int) -> FloatArray:
    """Draw broken rock: tilted blocks within tilted blocks, parted by clefts of varying width.

    Returns
    -------
    float64 array
        Height in units of the block size, about 0 to 1.
    """
    strike = np.pi * (derive_seed(seed, "strike") % 1000) / 1000.0
    along, across = np.cos(strike) * x_m + np.sin(strike) * y_m, np.cos(strike) * y_m - np.sin(strike) * x_m
    y, x = warp(across, 0.62 * along, 0.8 * size_m, 0.10 * size_m, derive_seed(seed, "facet warp"), octaves=3)
    height = np.zeros_like(y_m)
    for level, (size, weight) in enumerate(((size_m, 1.0), (0.42 * size_m, 0.40), (0.17 * size_m, 0.15))):
        blocks = worley(y, x, size, derive_seed(seed, "blocks", level))
        tilt_y, tilt_x = 1.1 * (hashed(blocks.key, 1) - 0.5), 1.1 * (hashed(blocks.key, 2) - 0.5)
        open_to = 0.03 + 0.22 * hashed(blocks.key, 3)
        cleft = np.clip((blocks.second - blocks.nearest) / open_to, 0.0, 1.0)
        height += weight * (0.55 * blocks.key + tilt_y * blocks.dy + tilt_x * blocks.dx + 0.18 * (cleft - 1.0))
    return np.asarray(np.clip(0.30 + height, 0.0, None))


def mounds(y_m: FloatArray, x_m: FloatArray, size_m: float, seed: int) -> FloatArray:
    """Draw rounded heads, one for each Worley cell, of unlike height.

    Returns
    -------
    float64 array
        Height in [0, 1].
    """
    y, x = warp(y_m, x_m, 0.6 * size_m, 0.10 * size_m, derive_seed(seed, "mound warp"))
    heads = worley(y, x, size_m, derive_seed(seed, "heads"))
    dome = np.sqrt(np.clip(1.0 - (heads.nearest / 0.85) ** 2, 0.0, None))
    return np.asarray((0.35 + 0.65 * heads.key) * dome)


def taper(mask: Mask, width_m: float, pixel_m: float) -> FloatArray:
    """Rise from 0 at the rim of `mask` to 1 inside it over about `width_m`."""
    return np.asarray(np.where(mask, np.clip(2.0 * box_blur(mask, width_m, pixel_m) - 1.0, 0.0, 1.0), 0.0))


def shading(dsm_m: FloatArray, pixel_m: float, sun: Sun, *, relief_gain: float = 1.0) -> FloatArray:
    """Light falling on the surface from sun and sky, relative to level ground (Lambert's law).

    `relief_gain` multiplies the slopes: below 1 it softens the picture as a bright hazy sky does.
    """
    slope_y, slope_x = (relief_gain / pixel_m * _limited_slope(dsm_m, axis) for axis in (0, 1))
    south, east, up = sun.towards
    facing = (up - south * slope_y - east * slope_x) / np.sqrt(1.0 + slope_y**2 + slope_x**2)
    return np.asarray(AMBIENT + (1.0 - AMBIENT) * np.clip(facing / up, 0.0, 1.9))


def openness(dsm_m: FloatArray, pixel_m: float, *, reach_m: float = 0.9) -> FloatArray:
    """Share of the sky's light that reaches a pixel: less in clefts and hollows narrower than `reach_m`.

    Returns
    -------
    float64 array, [rows, cols]
        In [0.7, 1]; falls with the depth below the mean height of the surroundings.
    """
    around = ndimage.uniform_filter(dsm_m, max(1, round(reach_m / pixel_m)), mode="nearest")
    return np.asarray(np.clip(1.0 - 0.6 * np.clip(around - dsm_m, 0.0, None) / reach_m, 0.7, 1.0))


def _limited_slope(height: FloatArray, axis: int) -> FloatArray:
    """Difference along `axis`, the smaller of the two one-sided ones (minmod), so that a step draws no outline."""
    step = np.diff(height, axis=axis)
    edge = [(1, 1) if a == axis else (0, 0) for a in range(2)]
    step = np.pad(step, edge, mode="edge")
    count = height.shape[axis]
    before, after = step.take(np.arange(count), axis), step.take(np.arange(1, count + 1), axis)
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    return np.asarray(np.where(before * after > 0.0, smaller, 0.0))


def cast_shadow(dsm_m: FloatArray, pixel_m: float, sun: Sun, *, penumbra_m: float = 0.25) -> FloatArray:
    """Find how deep each pixel lies in the shadow of what stands between it and the sun.

    The height of the shadow's upper edge is carried row by row away from the sun, falling by the tangent of the
    sun's elevation: one pass over the picture instead of a ray for each pixel. Interpolation between columns
    softens it, so that things a few pixels wide cast a somewhat short shadow.

    Returns
    -------
    float64 array, [rows, cols]
        0 in the sun, 1 where the surface lies `penumbra_m` or more below the shadow's edge.
    """
    south, east, up = sun.towards
    drift = -east / south
    fall = up / np.hypot(south, east) * np.hypot(1.0, drift) * pixel_m
    edge = _sweep(dsm_m, drift, fall)
    return np.asarray(np.clip((edge - dsm_m) / penumbra_m, 0.0, 1.0))


@njit(cache=True, nogil=True)
def _sweep(dsm: FloatArray, drift: float, fall: float) -> FloatArray:
    rows, cols = dsm.shape
    edge = dsm.copy()
    for row in range(1, rows):
        for col in range(cols):
            source = min(max(col + drift, 0.0), cols - 1.0)
            left = min(int(source), cols - 2)
            part = source - left
            before = (1.0 - part) * edge[row - 1, left] + part * edge[row - 1, left + 1]
            edge[row, col] = max(dsm[row, col], before - fall)
    return edge
