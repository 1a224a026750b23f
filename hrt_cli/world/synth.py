"""Make a synthetic site: the picture a UAV would take of it, and the truth under the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Progress, silent
from hrt_cli.world import paint
from hrt_cli.world.layout import Frame, Mask
from hrt_cli.world.noise import FloatArray, derive_seed, fbm, worley
from hrt_cli.world.relief import AMBIENT, Sun, cast_shadow, openness, shading, taper
from hrt_cli.world.scenes import SCENES, Ground, Scene
from hrt_cli.world.survey import outline, start_cell, valid_area
from hrt_cli.world.thermal import Hotspot, thermal_layer

NODATA_CLASS = 255
"""Class id of pixels outside the valid area."""

_PIXEL_RANGE_M = (0.01, 0.5)
_SIDE_RANGE_PX = (128, 8192)
_BAND_ROWS = 256
"""Rows painted at a time; bounds the memory and cannot change the picture."""


@dataclass(frozen=True)
class SiteSpec:
    """What site to make.

    Attributes
    ----------
    scene : str
        'meadow', 'wildfire' or 'reef'.
    size_m : tuple of float
        Height and width in metres.
    pixel_m : float
        Ground resolution in metres.
    seed : int
        Not negative; the same specification gives the same bytes.
    """

    scene: str
    size_m: tuple[float, float] = (51.2, 51.2)
    pixel_m: float = 0.05
    seed: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the picture."""
        return round(self.size_m[0] / self.pixel_m), round(self.size_m[1] / self.pixel_m)


@dataclass(frozen=True)
class Site:
    """A synthetic site; every array has the shape of `spec`.

    Attributes
    ----------
    spec : SiteSpec
    rgb : uint8 array, [rows, cols, 3]
        The orthomosaic; 0 outside `valid`.
    truth : uint8 array, [rows, cols]
        Class ids 0 to n-1, 255 outside `valid`.
    class_names : tuple of str
    drivability : tuple of float
        True score in [0, 1] of each class.
    obstacle : tuple of bool
        Whether a vehicle collides with the class.
    dsm : float32 array, [rows, cols]
        Surface height in metres, finite everywhere; on the reef the bottom's height, negative.
    thermal_c : float32 array or None
        Surface temperature in degrees Celsius.
    hotspots : tuple of Hotspot
        The thermal layer's hot spots; empty without one.
    valid : bool array, [rows, cols]
        Pixels the survey covers.
    aoi : tuple of (row, col)
        Convex polygon inside the valid area, pixel coordinates with the origin at the upper left corner of the
        upper left pixel, not closed.
    start : tuple of int
        Row and column of a pixel where a robot can be put down.
    target_class : str or None
        The class the survey looks for.
    """

    spec: SiteSpec
    rgb: npt.NDArray[np.uint8]
    truth: npt.NDArray[np.uint8]
    class_names: tuple[str, ...]
    drivability: tuple[float, ...]
    obstacle: tuple[bool, ...]
    dsm: npt.NDArray[np.float32]
    thermal_c: npt.NDArray[np.float32] | None
    hotspots: tuple[Hotspot, ...]
    valid: Mask
    aoi: tuple[tuple[float, float], ...]
    start: tuple[int, int]
    target_class: str | None


def make_site(spec: SiteSpec, progress: Progress = silent) -> Site:
    """Make the site of a specification.

    Parameters
    ----------
    spec : SiteSpec
    progress : Progress, optional
        Called with rows painted and rows in all.

    Returns
    -------
    Site

    Raises
    ------
    ArgumentError
        If the scene is unknown, or the size, resolution or seed is out of range.
    """
    scene = _checked_scene(spec)
    frame = Frame(*spec.shape, spec.pixel_m)
    seed = derive_seed(spec.seed, spec.scene)
    ground = scene.lay(frame, seed)
    valid = valid_area(frame, seed)
    rgb = _photograph(frame, scene, ground, seed, progress)
    rgb[~valid] = 0
    aoi = outline(frame, valid)
    names = [material.name for material in scene.materials]
    passable = np.array([m.drivability > 0.25 and not m.obstacle for m in scene.materials])[ground.classes]
    thermal_c: npt.NDArray[np.float32] | None = None
    hotspots: tuple[Hotspot, ...] = ()
    if scene.thermal:
        ambient = np.array([m.ambient_c for m in scene.materials])[ground.classes]
        allowed = valid & (ground.classes == names.index(str(scene.target_class)))
        thermal_c, hotspots = thermal_layer(frame, ambient, allowed, seed)
    return Site(
        spec=spec,
        rgb=rgb,
        truth=np.where(valid, ground.classes, np.uint8(NODATA_CLASS)),
        class_names=tuple(names),
        drivability=tuple(m.drivability for m in scene.materials),
        obstacle=tuple(m.obstacle for m in scene.materials),
        dsm=ground.dsm_m.astype(np.float32),
        thermal_c=thermal_c,
        hotspots=hotspots,
        valid=valid,
        aoi=aoi,
        start=start_cell(frame, ground.classes == names.index(scene.start_class), passable & valid, aoi),
        target_class=scene.target_class,
    )


def _checked_scene(spec: SiteSpec) -> Scene:
    if spec.scene not in SCENES:
        raise ArgumentError(f"unknown scene {spec.scene!r}; choose one of {', '.join(SCENES)}")
    if not _PIXEL_RANGE_M[0] <= spec.pixel_m <= _PIXEL_RANGE_M[1]:
        raise ArgumentError(f"pixel size {spec.pixel_m} m is outside {_PIXEL_RANGE_M[0]} to {_PIXEL_RANGE_M[1]} m")
    if not all(np.isfinite(side) and side > 0.0 for side in spec.size_m):
        raise ArgumentError(f"site size {spec.size_m} m must be finite and positive")
    if not all(_SIDE_RANGE_PX[0] <= side <= _SIDE_RANGE_PX[1] for side in spec.shape):
        raise ArgumentError(
            f"the site would have {spec.shape[0]} x {spec.shape[1]} pixels; each side must have"
            f" {_SIDE_RANGE_PX[0]} to {_SIDE_RANGE_PX[1]}"
        )
    if spec.seed < 0:
        raise ArgumentError(f"seed {spec.seed} must not be negative")
    return SCENES[spec.scene]


def _sun(seed: int) -> Sun:
    """Give the site a high sun from the north-west to north-east."""
    rng = np.random.default_rng(derive_seed(seed, "sun"))
    return Sun(
        elevation_rad=np.deg2rad(rng.uniform(58.0, 66.0)), across=float(rng.choice([-1, 1]) * rng.uniform(0.3, 0.65))
    )


def _photograph(frame: Frame, scene: Scene, ground: Ground, seed: int, progress: Progress) -> npt.NDArray[np.uint8]:
    """Paint, light and expose the site."""
    sun = _sun(seed)
    albedo = _paint(frame, scene, ground, sun, seed, progress)
    light = shading(ground.dsm_m, frame.pixel_m, sun, relief_gain=scene.relief_gain)
    light *= openness(ground.dsm_m, frame.pixel_m)
    if scene.under_water:
        shade = 0.55 * cast_shadow(ground.dsm_m, frame.pixel_m, sun, penumbra_m=0.6)
        exposed = albedo * (light * (1.0 - (1.0 - AMBIENT) * shade))[..., None]
        exposed = _through_water(frame, exposed, ground.dsm_m, seed)
    else:
        shade = cast_shadow(ground.dsm_m, frame.pixel_m, sun)[..., None]
        sky = np.array([0.40, 0.44, 0.52]) / 0.44 * AMBIENT
        exposed = albedo * (light[..., None] * (1.0 - shade) + sky * shade)
    rng = np.random.default_rng(derive_seed(seed, "sensor"))
    for channel in range(3):
        sharp = ndimage.gaussian_filter(exposed[..., channel], 0.55, truncate=3.0)
        grain = rng.standard_normal(sharp.shape, dtype=np.float32)
        exposed[..., channel] = sharp + grain * (1.2 + 0.006 * sharp)
    return np.asarray(np.clip(exposed + 0.5, 0.0, 255.0).astype(np.uint8))


def _paint(frame: Frame, scene: Scene, ground: Ground, sun: Sun, seed: int, progress: Progress) -> FloatArray:
    """Paint every class with its material, band by band; borders are ragged and a few pixels soft."""
    seen = _ragged(frame, ground, seed)
    picture = np.zeros((frame.rows, frame.cols, 3))
    weight = np.zeros((frame.rows, frame.cols))
    south, east, _ = sun.towards
    flat = float(np.hypot(south, east))
    for value, material in enumerate(scene.materials):
        cover = ndimage.gaussian_filter(
            (seen == value).astype(np.float32), material.soft_m / frame.pixel_m, truncate=2.5
        )
        inset = taper(seen == value, 0.5, frame.pixel_m)
        part_seed = derive_seed(seed, "paint", value)
        for first in range(0, frame.rows, _BAND_ROWS):
            last = min(first + _BAND_ROWS, frame.rows)
            inside = cover[first:last] > 1e-3
            y, x = frame.band(first, last)
            points = paint.Points(
                y[inside],
                x[inside],
                ground.lateral_m[first:last][inside],
                ground.key[first:last][inside],
                inset[first:last][inside],
                (south / flat, east / flat),
                part_seed,
            )
            layer = paint.colour(material.ramp, material.texture(points))
            picture[first:last][inside] += cover[first:last][inside][:, None] * layer
        weight += cover
        progress((value + 1) * frame.rows, len(scene.materials) * frame.rows)
    return picture / weight[..., None]


def _ragged(frame: Frame, ground: Ground, seed: int) -> npt.NDArray[np.uint8]:
    """Give the class map as the eye sees it: tufts, stones and leaves straggle over the borders."""
    reach_px = 0.065 / frame.pixel_m
    rows, cols = np.meshgrid(np.arange(frame.rows), np.arange(frame.cols), indexing="ij")
    for axis, index in (("y", rows), ("x", cols)):
        stray = reach_px * fbm(frame.y_m, frame.x_m, 0.9, derive_seed(seed, "ragged", axis), octaves=5, gain=0.75)
        index += np.rint(stray).astype(index.dtype)
    return np.asarray(ground.classes[np.clip(rows, 0, frame.rows - 1), np.clip(cols, 0, frame.cols - 1)])


def _through_water(frame: Frame, seen: FloatArray, dsm_m: FloatArray, seed: int) -> FloatArray:
    """Take away red and add a blue veil with depth, and lay a faint net of sunlight on the bottom."""
    y, x = frame.y_m, frame.x_m
    net = worley(y + 0.15 * np.sin(1.7 * x), x + 0.15 * np.sin(2.1 * y), 1.1, derive_seed(seed, "caustics"))
    caustic = np.exp(-(((net.second - net.nearest) / 0.12) ** 2))
    depth = np.clip(-dsm_m, 0.0, 12.0)[..., None]
    kept = np.exp(-depth * np.array([0.050, 0.018, 0.015]))
    veil = np.array([44.0, 92.0, 108.0]) * (1.0 - np.exp(-depth * 0.035))
    return np.asarray(seen * (1.0 + 0.035 * caustic[..., None]) * kept + veil)
