"""Where things lie: regions, roads and tree crowns of a synthetic site, as class masks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hrt_cli.world.noise import FloatArray, derive_seed, fbm, warp, worley

Mask = npt.NDArray[np.bool_]
Classes = npt.NDArray[np.uint8]

REFERENCE_EXTENT_M = 51.2
"""Shorter side of the site at which regions, roads and crowns have their full, natural size."""


_THIN_SHARE = 0.36
"""A pixel whose class fills less of its surroundings than this lies on a thin strip or a spike."""


@dataclass(frozen=True)
class Frame:
    """The pixel frame of a site: its shape and the ground coordinates of its pixel centres."""

    rows: int
    cols: int
    pixel_m: float

    @property
    def extent_m(self) -> float:
        """Length of the shorter side in metres."""
        return min(self.rows, self.cols) * self.pixel_m

    @property
    def scale(self) -> float:
        """Shrink factor in [0.3, 1] of large features, so that a small site still holds every class."""
        return float(np.clip(self.extent_m / REFERENCE_EXTENT_M, 0.3, 1.0))

    @property
    def spread(self) -> float:
        """Factor in [0.3, 2] on the size of regions: a larger site has larger fields."""
        return float(np.clip(self.extent_m / REFERENCE_EXTENT_M, 0.3, 2.0))

    def coarse(self) -> Frame:
        """Give the same ground in about 100 pixels a side, for weighing layouts against one another."""
        step = max(1, min(self.rows, self.cols) // 96)
        return Frame(self.rows // step, self.cols // step, self.pixel_m * step)

    @cached_property
    def y_m(self) -> FloatArray:
        """Southward coordinate of every pixel centre, metres, [rows, cols]."""
        return self.band(0, self.rows)[0]

    @cached_property
    def x_m(self) -> FloatArray:
        """Eastward coordinate of every pixel centre, metres, [rows, cols]."""
        return self.band(0, self.rows)[1]

    def band(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """Give the ground coordinates (y, x) of rows `first` to `last`, metres, float64."""
        y, x = np.meshgrid(np.arange(first, last) + 0.5, np.arange(self.cols) + 0.5, indexing="ij")
        return y * self.pixel_m, x * self.pixel_m


@dataclass(frozen=True)
class Roads:
    """The road network of a site.

    Attributes
    ----------
    lateral_m : float64 array, [rows, cols]
        Signed distance to the nearest centre line.
    half_width_m : float
    """

    lateral_m: FloatArray
    half_width_m: float

    @property
    def mask(self) -> Mask:
        """Pixels on the carriageway."""
        return np.abs(self.lateral_m) <= self.half_width_m


@dataclass(frozen=True)
class Crowns:
    """Tree crowns composed by their upper envelope.

    Attributes
    ----------
    height_m : float64 array, [rows, cols]
        Crown surface above ground; 0 outside.
    tone : float64 array, [rows, cols]
        One number in [0, 1) per tree, 0 outside.
    """

    height_m: FloatArray
    tone: FloatArray

    @property
    def mask(self) -> Mask:
        """Pixels under a crown."""
        return self.height_m > 0.0


def region_field(frame: Frame, wavelength_m: float, seed: int, *, block_m: float = 0.0) -> FloatArray:
    """Draw a smooth domain-warped field whose level sets make natural region outlines.

    Parameters
    ----------
    frame : Frame
    wavelength_m : float
        Distance between like regions at full scale.
    seed : int
    block_m : float
        If positive, the field is constant over cells of this size, so that its outlines run around whole blocks.

    Returns
    -------
    float64 array, [rows, cols]
        Standard deviation about 1.
    """
    size = wavelength_m * frame.spread
    y, x = frame.y_m, frame.x_m
    if block_m > 0.0:
        rough_y, rough_x = warp(y, x, 0.8 * block_m, 0.15 * block_m, derive_seed(seed, "rough"), octaves=3)
        blocks = worley(rough_y, rough_x, block_m, derive_seed(seed, "blocks"))
        y, x = y - 0.85 * block_m * blocks.dy, x - 0.85 * block_m * blocks.dx
    y, x = warp(y, x, 0.55 * size, 0.10 * size, derive_seed(seed, "warp"))
    broad = fbm(y, x, size, derive_seed(seed, "broad"), octaves=2, gain=0.3)
    return broad + 0.07 * fbm(y, x, 0.14 * size, derive_seed(seed, "rim"), octaves=3, gain=0.55)


def top_share(field: FloatArray, share: float, allowed: Mask) -> Mask:
    """Take the allowed pixels with the highest values until they make `share` of the whole picture."""
    wanted = min(round(share * field.size), int(allowed.sum()))
    if wanted == 0:
        return np.zeros_like(allowed)
    values = field[allowed]
    threshold = np.partition(values, values.size - wanted)[values.size - wanted]
    return np.asarray(allowed & (field >= threshold))


def border_share(classes: Classes) -> float:
    """Give the share of neighbouring pixel pairs that differ: short, smooth borders score low."""
    return float((np.diff(classes, axis=0) != 0).mean() + (np.diff(classes, axis=1) != 0).mean())


def lay_roads(frame: Frame, width_m: float, avoid: Mask, seed: int) -> Roads:
    """Lay winding roads across the site, one for each 60 m of its shorter side.

    Each road is the graph of a smooth random function over a turned axis; of several candidates the one that meets
    the least of `avoid` (water) is taken.
    """
    rng = np.random.default_rng(derive_seed(seed, "roads"))
    half_width = 0.5 * width_m * frame.scale
    step = max(1, frame.rows // 128)
    y, x = frame.y_m[::step, ::step], frame.x_m[::step, ::step]
    count = max(1, round(frame.extent_m / 60.0))
    heading = rng.uniform(0.0, np.pi)
    lateral = np.full(frame.y_m.shape, np.inf)
    for number in range(count):
        offset = (number + 0.5) / count - 0.5
        candidates: list[tuple[float, tuple[float, float, int]]] = []
        for _ in range(24):
            shape = (
                heading + rng.normal(0.0, 0.35),
                (offset + rng.uniform(-0.22, 0.22) / count) * frame.extent_m,
                int(rng.integers(2**31)),
            )
            met = np.abs(_lateral(frame, y, x, *shape)) < 1.6 * half_width
            cost = float(avoid[::step, ::step][met].mean()) if met.any() else 1.0
            candidates.append((cost, shape))
        road = _lateral(frame, frame.y_m, frame.x_m, *min(candidates)[1])
        lateral = np.where(np.abs(road) < np.abs(lateral), road, lateral)
    verge = 0.07 * frame.scale * fbm(frame.y_m, frame.x_m, 1.2, derive_seed(seed, "verge"), octaves=4, gain=0.6)
    return Roads(lateral + np.sign(lateral) * verge, half_width)


def _lateral(
    frame: Frame, y_m: FloatArray, x_m: FloatArray, heading_rad: float, offset_m: float, seed: int
) -> FloatArray:
    """Give the signed distance to the winding line v = f(u) in axes turned by `heading_rad`."""
    y, x = y_m - 0.5 * frame.rows * frame.pixel_m, x_m - 0.5 * frame.cols * frame.pixel_m
    u, v = y * np.cos(heading_rad) + x * np.sin(heading_rad), x * np.cos(heading_rad) - y * np.sin(heading_rad)
    bend = 30.0 * frame.scale
    reach = float(np.hypot(frame.rows, frame.cols)) * frame.pixel_m
    along = np.linspace(-0.5 * reach, 0.5 * reach, 1024)
    line = offset_m + 0.09 * bend * fbm(along, np.zeros_like(along), bend, seed, octaves=2, gain=0.25)
    slope = np.gradient(line, along)
    return np.asarray((v - np.interp(u, along, line)) / np.sqrt(1.0 + np.interp(u, along, slope) ** 2))


def grow_crowns(frame: Frame, grove: Mask, forbidden: Mask, seed: int) -> Crowns:
    """Fill groves with tree crowns: dart throwing with touching, slightly overlapping crowns of unlike size.

    Parameters
    ----------
    grove : bool array, [rows, cols]
        Where trees stand densely.
    forbidden : bool array, [rows, cols]
        Where no trunk stands (road, water).
    """
    rng = np.random.default_rng(derive_seed(seed, "crowns"))
    depth_m = ndimage.distance_transform_edt(grove) * frame.pixel_m
    trunks = np.argwhere((depth_m > 0.25 * frame.scale) & ~forbidden)
    height = np.zeros(grove.shape)
    tone = np.zeros(grove.shape)
    placed = np.empty((0, 3))
    if not len(trunks):
        return Crowns(height, tone)
    for row, col in trunks[rng.integers(len(trunks), size=min(6000, 40 * len(trunks)))]:
        radius = frame.scale * rng.uniform(1.1, 3.1)
        radius = min(radius, depth_m[row, col] + 0.45 * frame.scale)
        y, x = (row + 0.5) * frame.pixel_m, (col + 0.5) * frame.pixel_m
        gaps = np.hypot(placed[:, 0] - y, placed[:, 1] - x) - 0.74 * (placed[:, 2] + radius)
        if (gaps < 0.0).any():
            continue
        placed = np.vstack([placed, (y, x, radius)])
        _raise_crown(frame, (y, x, radius), derive_seed(seed, "crown", len(placed)), height, tone)
    return Crowns(height, tone)


def _raise_crown(
    frame: Frame, crown: tuple[float, float, float], seed: int, height: FloatArray, tone: FloatArray
) -> None:
    """Merge one lumpy crown into the envelope, in place."""
    y0, x0, radius = crown
    reach = 1.5 * radius
    r0, r1 = (int(np.clip((y0 + s * reach) / frame.pixel_m, 0, frame.rows)) for s in (-1, 1))
    c0, c1 = (int(np.clip((x0 + s * reach) / frame.pixel_m, 0, frame.cols)) for s in (-1, 1))
    y, x = np.meshgrid(
        (np.arange(r0, r1) + 0.5) * frame.pixel_m, (np.arange(c0, c1) + 0.5) * frame.pixel_m, indexing="ij"
    )
    outline = fbm(y, x, 0.8 * radius, derive_seed(seed, "outline"), octaves=4, gain=0.62)
    d = np.hypot(y - y0, x - x0) / (radius * (1.0 + 0.12 * outline))
    top = frame.scale * (1.0 + 0.9 * radius / frame.scale)
    lumps = fbm(y, x, 0.9 * frame.scale, derive_seed(seed, "lumps"), octaves=2)
    dome = top * (0.35 + 0.65 * np.clip(1.0 - d * d, 0.0, None) ** 0.75) + 0.16 * frame.scale * lumps
    inside = (d < 1.0) & (dome > height[r0:r1, c0:c1])
    height[r0:r1, c0:c1][inside] = dome[inside]
    tone[r0:r1, c0:c1][inside] = (derive_seed(seed, "tone") % 4096) / 4096.0


def box_blur(mask: Mask, width_m: float, pixel_m: float) -> FloatArray:
    """Give the share of `mask` in the surroundings: two passes of a box of `width_m` (a tent), in [0, 1]."""
    width_px = max(1, round(width_m / pixel_m))
    blurred = mask.astype(np.float64)
    for _ in range(2):
        blurred = ndimage.uniform_filter(blurred, width_px, mode="nearest")
    return np.asarray(np.clip(blurred, 0.0, 1.0))


def absorb_slivers(classes: Classes, smallest_m2: float, thinnest_m: float, pixel_m: float) -> Classes:
    """Give thin strips, and connected pieces (4-connected) that are too small, to the nearest other class.

    Parameters
    ----------
    classes : uint8 array, [rows, cols]
    smallest_m2 : float
        Smallest area of a piece that stays.
    thinnest_m : float
        Strips narrower than about this go.
    pixel_m : float

    Returns
    -------
    uint8 array, [rows, cols]
    """
    values = np.unique(classes)
    sliver = np.zeros(classes.shape, bool)
    for value in values:
        mask = classes == value
        sliver |= mask & (box_blur(mask, 2.2 * thinnest_m, pixel_m) < _THIN_SHARE)
    classes = _nearest_outside(classes, sliver)
    sliver[:] = False
    for value in values:
        pieces, count = ndimage.label(classes == value)
        small = np.bincount(pieces.ravel(), minlength=count + 1) * pixel_m**2 < smallest_m2
        small[0] = False
        sliver |= small[pieces]
    return _nearest_outside(classes, sliver)


def _nearest_outside(classes: Classes, hole: Mask) -> Classes:
    """Fill `hole` with the class of the nearest pixel outside it."""
    if not hole.any() or hole.all():
        return classes
    nearest = ndimage.distance_transform_edt(hole, return_distances=False, return_indices=True)
    return np.asarray(classes[tuple(nearest)])
