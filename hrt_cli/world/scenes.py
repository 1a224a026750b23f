"""The three scenes as data (classes, materials, colours) and their layouts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hrt_cli.world import paint
from hrt_cli.world.layout import (
    Classes,
    Crowns,
    Frame,
    Mask,
    Roads,
    absorb_slivers,
    border_share,
    box_blur,
    grow_crowns,
    lay_roads,
    region_field,
    top_share,
)
from hrt_cli.world.noise import FloatArray, derive_seed, fbm, sticks, within
from hrt_cli.world.relief import facets, mounds, taper, terrain


@dataclass(frozen=True)
class Material:
    """One class of a scene.

    Attributes
    ----------
    name : str
    drivability : float
        True score in [0, 1] of a ground vehicle there.
    obstacle : bool
        Whether the vehicle collides with it.
    texture : callable
        One of `paint`'s textures.
    ramp : tuple of sRGB stops
    ambient_c : float
        Surface temperature, degrees Celsius; used by scenes that have a thermal layer.
    soft_m : float
        Standard deviation of the blur of the class's border in the picture.
    """

    name: str
    drivability: float
    obstacle: bool
    texture: paint.Texture
    ramp: paint.Ramp
    ambient_c: float = 20.0
    soft_m: float = 0.06


@dataclass(frozen=True)
class Ground:
    """A laid-out site before it is painted: everything on the pixel grid of its frame.

    Attributes
    ----------
    classes : uint8 array
        Index into the scene's materials.
    dsm_m : float64 array
        Surface height in metres.
    lateral_m : float64 array
        Signed distance to the nearest road's centre line; infinite without roads.
    key : float64 array
        One number in [0, 1) per tree.
    """

    classes: Classes
    dsm_m: FloatArray
    lateral_m: FloatArray
    key: FloatArray


@dataclass(frozen=True)
class Scene:
    """Recipe of one kind of site.

    Attributes
    ----------
    materials : tuple of Material
        In class order.
    lay : callable
        `(frame, seed) -> Ground`.
    start_class : str
        Where the robot is put down.
    target_class : str or None
        What the survey looks for.
    relief_gain : float
        Strength of the shading of slopes.
    under_water : bool
        Whether the picture is seen through water.
    thermal : bool
        Whether the site has a thermal layer.
    """

    materials: tuple[Material, ...]
    lay: Callable[[Frame, int], Ground]
    start_class: str
    target_class: str | None
    relief_gain: float = 0.6
    under_water: bool = False
    thermal: bool = False


SMALLEST_PIECE_M2 = 18.0
"""Connected pieces of a class below this area (at full scale) are given to their neighbours."""

_CANDIDATES = 12
_FREEBOARD_M = 0.05
"""No dry ground lies lower than this above the water."""

THINNEST_STRIP_M = 1.5
"""Strips and spikes thinner than about this (at full scale) are given to their neighbours."""


class _Map:
    """A class map under construction: later regions are laid only where nothing but the base class lies."""

    def __init__(self, frame: Frame, seed: int) -> None:
        self.frame = frame
        self.seed = seed
        self.classes: Classes = np.zeros((frame.rows, frame.cols), np.uint8)

    def set(self, value: int, mask: Mask) -> None:
        self.classes[mask] = value

    def field(self, name: str, value: int, share: float, wavelength_m: float, *, block_m: float = 0.0) -> FloatArray:
        """Draw the field whose top `share` would make the most compact region of class `value`.

        Of a few candidates, weighed on a coarse picture, the one with the shortest borders is taken: robots and
        surveys work on fields, not on confetti.
        """
        coarse = self.frame.coarse()
        rows = (np.arange(coarse.rows) + 0.5) * self.frame.rows / coarse.rows
        cols = (np.arange(coarse.cols) + 0.5) * self.frame.cols / coarse.cols
        below = self.classes[np.ix_(rows.astype(int), cols.astype(int))]
        candidates: list[tuple[float, int]] = []
        for number in range(_CANDIDATES):
            seed = derive_seed(self.seed, name, number)
            laid = below.copy()
            laid[top_share(region_field(coarse, wavelength_m, seed), share, below == 0)] = value
            candidates.append((border_share(laid), seed))
        return region_field(self.frame, wavelength_m, min(candidates)[1], block_m=block_m)

    def region(self, value: int, share: float, wavelength_m: float, *, block_m: float = 0.0) -> None:
        """Lay class `value` on about `share` of the picture, in whole blocks if `block_m` is positive."""
        field = self.field(f"region {value}", value, share, wavelength_m, block_m=block_m)
        self.set(value, top_share(field, share, self.classes == 0))

    def done(self) -> Classes:
        """Give the map with slivers absorbed."""
        scale = self.frame.scale
        return absorb_slivers(self.classes, SMALLEST_PIECE_M2 * scale**2, THINNEST_STRIP_M * scale, self.frame.pixel_m)


def _roadbed(broad: FloatArray, bumps: FloatArray, roads: Roads) -> FloatArray:
    """Give the terrain with the small bumps graded away on the road and faded out beside it."""
    fade = np.clip((np.abs(roads.lateral_m) - roads.half_width_m) / 1.0, 0.0, 1.0)
    return broad + bumps * fade


def _rock_heights(frame: Frame, mask: Mask, seed: int) -> FloatArray:
    """Raise rock outcrops of 0.3 to 1.5 m in broken blocks."""
    size = 1.6 * frame.scale + 0.2
    blocks = within(mask, lambda y, x: facets(y, x, size, seed), frame.y_m, frame.x_m)
    return np.where(mask, 0.10 + (0.30 + 0.70 * taper(mask, 0.8, frame.pixel_m)) * 1.1 * blocks, 0.0)


def _sward(frame: Frame, mask: Mask, height_m: float, wavelength_m: float, seed: int) -> FloatArray:
    """Roughen the surface of `mask` by noise of standard deviation `height_m`."""
    return height_m * within(mask, lambda y, x: fbm(y, x, wavelength_m, seed, octaves=2), frame.y_m, frame.x_m)


def _log_heights(y_m: FloatArray, x_m: FloatArray, seed: int) -> FloatArray:
    """Give the height of the round upper side of fallen trunks, the ones that `paint.deadfall` draws."""
    across, key = sticks(y_m, x_m, paint.LOG_SPACING_M, seed)
    return np.asarray((0.15 + 0.25 * key) * np.sqrt(1.0 - across**2) * (key > 0.0))


def _plant(site: _Map, value: int, share: float, roads: Roads) -> Crowns:
    """Grow groves that cover about `share` of the picture on the base class, clear of the roads.

    The small gaps between crowns count as tree, since no vehicle passes there.
    """
    frame, barred = site.frame, np.abs(roads.lateral_m) < roads.half_width_m + 0.3
    field = site.field("groves", value, share, 33.0)
    grove = top_share(field, share, (site.classes == 0) & ~barred)
    crowns = grow_crowns(frame, grove, barred, site.seed)
    gaps = (site.classes == 0) & (box_blur(crowns.mask, 0.9 * frame.scale, frame.pixel_m) > 0.55)
    site.set(value, (crowns.mask & ~roads.mask) | gaps)
    return crowns


def lay_meadow(frame: Frame, seed: int) -> Ground:
    """Lay grass, gravel, road, rock, water and trees."""
    grass, gravel, road, rock, water, tree = range(6)
    broad, bumps = terrain(frame, 1.1, seed)
    everywhere = np.ones((frame.rows, frame.cols), bool)
    pond = top_share(-broad, 0.13, everywhere)
    roads = lay_roads(frame, 4.2, pond, seed)
    site = _Map(frame, seed)
    site.set(road, roads.mask)
    site.set(water, pond & ~roads.mask)
    site.region(rock, 0.13, 33.0, block_m=0.9 * frame.scale)
    site.region(gravel, 0.16, 33.0)
    crowns = _plant(site, tree, 0.16, roads)
    classes = site.done()
    level = float(broad[pond].max())
    dsm = _roadbed(broad, bumps, roads)
    dsm += _rock_heights(frame, classes == rock, derive_seed(seed, "rock"))
    dsm += _sward(frame, classes == gravel, 0.015, 0.25, derive_seed(seed, "gravel"))
    dsm += _sward(frame, classes == grass, 0.03, 0.4, derive_seed(seed, "grass"))
    dsm = np.where(classes == water, level, np.maximum(dsm, level + _FREEBOARD_M))
    dsm += np.where(classes == tree, np.maximum(crowns.height_m, 0.7 * frame.scale), 0.0)
    return Ground(classes, dsm, roads.lateral_m, crowns.tone)


def lay_wildfire(frame: Frame, seed: int) -> Ground:
    """Lay dry grass, burnt ground, a dirt road, rock, trees and fallen trunks."""
    grass, burnt, road, rock, tree, fallen = range(6)
    broad, bumps = terrain(frame, 1.3, seed)
    roads = lay_roads(frame, 4.0, np.zeros((frame.rows, frame.cols), bool), seed)
    site = _Map(frame, seed)
    site.set(road, roads.mask)
    site.region(burnt, 0.44, 34.0)
    deadwood = region_field(frame, 33.0, derive_seed(seed, "fallen"))
    site.set(fallen, top_share(deadwood, 0.14, site.classes == burnt))
    site.region(rock, 0.13, 33.0, block_m=0.9 * frame.scale)
    crowns = _plant(site, tree, 0.16, roads)
    classes = site.done()
    dsm = _roadbed(broad, bumps, roads)
    dsm += _rock_heights(frame, classes == rock, derive_seed(seed, "rock"))
    logs_seed = derive_seed(derive_seed(seed, "paint", fallen), "logs")
    dsm += within(classes == fallen, lambda y, x: _log_heights(y, x, logs_seed), frame.y_m, frame.x_m)
    dsm += _sward(frame, classes == grass, 0.04, 0.4, derive_seed(seed, "grass"))
    dsm += np.where(classes == tree, np.maximum(crowns.height_m, 0.7 * frame.scale), 0.0)
    return Ground(classes, dsm, roads.lateral_m, crowns.tone)


def lay_reef(frame: Frame, seed: int) -> Ground:
    """Lay sand, coral, seagrass, rubble and a deep channel; heights are negative depths."""
    _, coral, seagrass, stones, channel = range(5)
    broad, bumps = terrain(frame, 0.8, seed)
    site = _Map(frame, seed)
    everywhere = np.ones((frame.rows, frame.cols), bool)
    deep = top_share(-broad, 0.15, everywhere)
    site.set(channel, deep)
    site.region(coral, 0.20, 33.0, block_m=0.8 * frame.scale)
    site.region(seagrass, 0.18, 33.0)
    site.region(stones, 0.15, 33.0, block_m=0.4 * frame.scale)
    classes = site.done()
    brink = float(broad[deep].max())
    dsm = broad + bumps - brink - 5.0
    drop = np.clip((brink - broad) / max(brink - float(broad.min()), 1e-6), 0.0, 1.0)
    dsm -= np.where(classes == channel, 4.0 * drop, 0.0)
    head_m, heads_seed = 1.9 * frame.scale + 0.3, derive_seed(seed, "heads")
    heads = within(classes == coral, lambda y, x: mounds(y, x, head_m, heads_seed), frame.y_m, frame.x_m)
    rim = taper(classes == coral, 0.8, frame.pixel_m)
    dsm += np.where(classes == coral, 0.3 + (0.3 + 0.7 * rim) * 1.6 * heads, 0.0)
    stones_seed = derive_seed(seed, "stones")
    dsm += 0.25 * within(classes == stones, lambda y, x: facets(y, x, 0.5, stones_seed), frame.y_m, frame.x_m)
    dsm += np.where(classes == seagrass, 0.20, 0.0)
    dsm += _sward(frame, classes == seagrass, 0.04, 0.3, derive_seed(seed, "blades"))
    return Ground(classes, dsm, np.full(classes.shape, np.inf), np.zeros(classes.shape))


SCENES: dict[str, Scene] = {
    "meadow": Scene(
        (
            Material("grass", 0.75, False, paint.turf, ((74, 92, 42), (106, 122, 60), (146, 152, 92))),
            Material("gravel", 0.60, False, paint.speckle, ((120, 117, 113), (144, 140, 135), (164, 159, 152))),
            Material("road", 0.95, False, paint.pavement, ((131, 128, 127), (142, 139, 137), (156, 152, 148))),
            Material("rock", 0.10, True, paint.boulders, ((130, 127, 121), (164, 159, 150), (196, 189, 174))),
            Material("water", 0.00, True, paint.still_water, ((40, 54, 52), (54, 70, 66), (78, 90, 78))),
            Material("tree", 0.00, True, paint.foliage, ((34, 48, 26), (84, 106, 54), (150, 164, 100))),
        ),
        lay_meadow,
        start_class="road",
        target_class=None,
    ),
    "wildfire": Scene(
        (
            Material("grass", 0.75, False, paint.tussocks, ((128, 109, 79), (176, 154, 113), (212, 193, 150)), 24.0),
            Material("burnt", 0.70, False, paint.ash, ((38, 36, 35), (74, 70, 67), (158, 153, 147)), 30.0),
            Material("road", 0.95, False, paint.tracks, ((146, 125, 95), (160, 138, 106), (180, 158, 126)), 27.0),
            Material("rock", 0.10, True, paint.boulders, ((124, 118, 113), (160, 154, 147), (194, 188, 178)), 26.0),
            Material("tree", 0.00, True, paint.foliage, ((38, 50, 26), (80, 98, 52), (136, 150, 88)), 19.0),
            Material("fallen", 0.10, True, paint.deadfall, ((34, 32, 31), (80, 73, 67), (140, 130, 118)), 29.0),
        ),
        lay_wildfire,
        start_class="road",
        target_class="burnt",
        thermal=True,
    ),
    "reef": Scene(
        (
            Material("sand", 0.95, False, paint.rippled_sand, ((160, 158, 141), (178, 176, 157), (198, 194, 175))),
            Material(
                "coral",
                0.20,
                True,
                paint.coral_heads,
                ((150, 112, 88), (168, 138, 84), (132, 120, 84), (176, 128, 112), (150, 110, 118), (160, 146, 100)),
            ),
            Material("seagrass", 0.70, False, paint.leaf_blades, ((26, 46, 40), (50, 78, 62), (98, 122, 88))),
            Material("rubble", 0.45, False, paint.rubble, ((156, 151, 132), (204, 199, 178), (234, 228, 208))),
            Material("channel", 0.30, False, paint.deep_water, ((30, 58, 58), (40, 72, 74), (56, 90, 90)), soft_m=0.35),
        ),
        lay_reef,
        start_class="sand",
        target_class="coral",
        relief_gain=0.5,
        under_water=True,
    ),
}
"""Every scene by name."""
