"""Materials: what the ground looks like from above, as functions of ground coordinates.

A texture gives two numbers for each point: `mix` in [0, 1], the place on the material's colour ramp, and `tone`, a
factor on its lightness. Colour and texture are thus independent: gravel and soil may share a texture and differ in
ramp, asphalt and rock may share a ramp and differ in texture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hrt_cli.world.noise import FloatArray, derive_seed, fbm, hashed, sticks, warp, worley


@dataclass(frozen=True)
class Points:
    """The points of one material to be painted, in one-dimensional arrays of one length.

    Attributes
    ----------
    y_m, x_m : float64 array
        Ground coordinates in metres.
    lateral_m : float64 array
        Signed distance to the road's centre line.
    key : float64 array
        One number in [0, 1) per individual (tree), 0 elsewhere.
    inset : float64 array
        0 at the rim of the class, 1 half a metre inside it.
    sunward : tuple of float
        Horizontal unit vector (southward, eastward) towards the sun.
    seed : int
    """

    y_m: FloatArray
    x_m: FloatArray
    lateral_m: FloatArray
    key: FloatArray
    inset: FloatArray
    sunward: tuple[float, float]
    seed: int

    def facing(self, dy: FloatArray, dx: FloatArray) -> FloatArray:
        """Component of an offset from a rounded thing's middle towards the sun: positive on its lit side."""
        return self.sunward[0] * dy + self.sunward[1] * dx

    def emboss(self, name: str, wavelength_m: float, octaves: int, gain: float, depth_m: float) -> FloatArray:
        """Light the named noise as a relief: positive on slopes that face the sun."""
        y, x = self.sunward[0] * depth_m, self.sunward[1] * depth_m
        seed = derive_seed(self.seed, name)
        return fbm(self.y_m - y, self.x_m - x, wavelength_m, seed, octaves=octaves, gain=gain) - fbm(
            self.y_m + y, self.x_m + x, wavelength_m, seed, octaves=octaves, gain=gain
        )

    def fbm(self, name: str, wavelength_m: float, octaves: int = 1, gain: float = 0.5) -> FloatArray:
        """Draw the named noise at the points."""
        return fbm(self.y_m, self.x_m, wavelength_m, derive_seed(self.seed, name), octaves=octaves, gain=gain)


LOG_SPACING_M = 1.3
"""Side of the lattice square that holds one fallen trunk."""

Shade = tuple[FloatArray, FloatArray]
Texture = Callable[[Points], Shade]
Ramp = tuple[tuple[int, int, int], ...]


def colour(ramp: Ramp, shade: Shade) -> FloatArray:
    """Look `shade` up on an sRGB ramp of evenly spaced stops.

    Returns
    -------
    float64 array, [points, 3]
        In sRGB units of 0 to 255, not clipped.
    """
    mix, tone = shade
    stops = np.linspace(0.0, 1.0, len(ramp))
    return np.stack([np.interp(mix, stops, [s[c] for s in ramp]) * tone for c in range(3)], axis=1)


def turf(p: Points) -> Shade:
    """Grass: patches a few metres wide, tufts of a few decimetres, blades at the edge of resolution."""
    patches = p.fbm("patches", 2.6, 3)
    tufts = p.fbm("tufts", 0.38, 2, 0.7)
    blades = p.emboss("blades", 0.16, 2, 0.8, 0.03)
    weed = worley(p.y_m, p.x_m, 1.3, derive_seed(p.seed, "weeds"))
    leaf = np.clip(1.0 - weed.nearest / (0.10 + 0.12 * hashed(weed.key, 1)), 0.0, 1.0) * (weed.key < 0.4)
    mix = 0.5 + 0.11 * patches + 0.11 * tufts - 0.30 * leaf
    return mix, 1.0 + 0.03 * patches + 0.055 * tufts + 0.075 * blades - 0.12 * leaf


def tussocks(p: Points) -> Shade:
    """Dry bunch grass: pale tussocks with darker litter between them, singed towards its rim."""
    y, x = warp(p.y_m, p.x_m, 0.4, 0.10, p.seed)
    bunch = worley(y, x, 0.46, derive_seed(p.seed, "bunch"))
    size = 0.45 + 0.5 * hashed(bunch.key, 2)
    crest = np.clip(1.0 - bunch.nearest / size, 0.0, 1.0)
    straw = p.emboss("straw", 0.17, 2, 0.8, 0.03)
    patches = p.fbm("patches", 2.4, 3)
    singed = np.clip(0.7 - p.inset, 0.0, 0.7)
    mix = 0.30 + 0.40 * crest + 0.20 * (bunch.key - 0.5) + 0.10 * patches - 0.25 * singed
    return mix, 0.93 + 0.13 * crest + 0.03 * patches + 0.085 * straw - 0.12 * singed


def speckle(p: Points) -> Shade:
    """Gravel: stones of a decimetre, each with its own grey, a few larger ones among them, in faint drifts."""
    fine = worley(p.y_m, p.x_m, 0.105, derive_seed(p.seed, "fine"))
    coarse = worley(p.y_m, p.x_m, 0.60, derive_seed(p.seed, "coarse"))
    stone = (coarse.key < 0.30) & (coarse.nearest < 0.09 + 0.14 * hashed(coarse.key, 3))
    key = np.where(stone, hashed(coarse.key, 1), fine.key)
    lit = np.where(stone, 0.6 * p.facing(coarse.dy, coarse.dx), 0.16 * p.facing(fine.dy, fine.dx))
    drift = p.fbm("drift", 1.4, 3)
    tone = 0.85 + 0.31 * hashed(key, 2) + lit + 0.012 * drift
    return 0.5 + 0.7 * (key - 0.5) + 0.05 * drift, tone


def pavement(p: Points) -> Shade:
    """Asphalt: nearly even, fine grain, two worn wheel paths, few thin cracks, pale dusty edges."""
    wear = np.exp(-(((np.abs(p.lateral_m) - 0.85) / 0.30) ** 2))
    y, x = warp(p.y_m, p.x_m, 2.0, 0.30, p.seed)
    plates = worley(y, x, 4.5, derive_seed(p.seed, "cracks"))
    crack = np.clip(1.0 - (plates.second - plates.nearest) * 4.5 / 0.05, 0.0, 1.0)
    crack *= np.clip(0.5 + 0.8 * p.fbm("healed", 4.0), 0.0, 1.0)
    grain = p.fbm("grain", 0.11)
    mix = 0.5 + 0.10 * p.fbm("stain", 1.8, 3) + 0.12 * wear
    return mix, 1.0 + 0.036 * grain + 0.035 * wear - 0.20 * crack


def tracks(p: Points) -> Shade:
    """Graded earth: even, with smeared wheel ruts along the road and a loose crown between them."""
    rut = np.exp(-(((np.abs(p.lateral_m) - 0.80) / 0.22) ** 2))
    smear = fbm(p.lateral_m, 0.06 * (p.y_m + p.x_m), 0.22, derive_seed(p.seed, "smear"), octaves=2)
    grain = p.fbm("grain", 0.12)
    mix = 0.5 + 0.10 * p.fbm("stain", 2.0, 2) + 0.22 * rut + 0.05 * smear
    return mix, 1.0 + 0.046 * grain + 0.018 * smear + 0.05 * rut


def boulders(p: Points) -> Shade:
    """Rock: its blocks and clefts are shaded by the relief; here lichen, stains and mineral grain."""
    lichen = np.clip(p.fbm("lichen", 0.45, 4, 0.65) - 0.6, 0.0, 1.0)
    stain = p.fbm("stain", 0.9, 3, 0.6)
    grain = p.emboss("grain", 0.50, 3, 0.6, 0.06)
    moss = np.clip(0.6 - p.inset, 0.0, 0.6)
    mix = 0.45 + 0.10 * stain + 0.45 * lichen
    return mix, 1.02 + 0.045 * stain + 0.085 * grain + 0.08 * lichen - 0.12 * moss


def still_water(p: Points) -> Shade:
    """Water: dark and smooth, a faint wind ripple, a broad soft gleam of the sky, paler in the shallows."""
    y, x = warp(p.y_m, p.x_m, 1.6, 0.12, p.seed)
    ripple = fbm(2.2 * y, 0.6 * x, 0.30, derive_seed(p.seed, "ripple"), octaves=2)
    gleam = p.fbm("gleam", 7.0, 3)
    shallow = (1.0 - p.inset) ** 2
    return 0.35 + 0.10 * gleam + 0.03 * ripple + 0.45 * shallow, 1.0 + 0.02 * gleam + 0.030 * ripple


def foliage(p: Points) -> Shade:
    """Tree crowns: sprays of leaves lit on their sunny side, with deep gaps; each tree its own green."""
    y, x = warp(p.y_m, p.x_m, 0.35, 0.07, p.seed)
    spray = worley(y, x, 0.30, derive_seed(p.seed, "spray"))
    boughs = p.emboss("boughs", 0.75, 4, 0.75, 0.07)
    hollow = np.clip(-0.5 - p.fbm("boughs", 0.75, 4, 0.75), 0.0, 1.2)
    lit = 0.10 * boughs + 0.22 * p.facing(spray.dy, spray.dx)
    leaf = p.fbm("leaf", 0.11)
    own = hashed(p.key, 1) - 0.5
    mix = 0.46 + 0.75 * lit - 0.16 * hollow + 0.30 * (p.key - 0.5) + 0.14 * (spray.key - 0.5)
    return mix, 1.03 + 0.80 * lit - 0.24 * hollow + 0.14 * own + 0.09 * leaf


def ash(p: Points) -> Shade:
    """Burnt ground: char mottled with ash in soft drifts and specks, black stubble standing in it."""
    drift = p.fbm("drift", 1.1, 4, 0.6)
    dust = np.clip(p.fbm("dust", 0.5, 4, 0.8) - 0.2, 0.0, 2.0)
    stubble = p.fbm("stubble", 0.13, 2, 0.8)
    mix = 0.32 + 0.075 * drift + 0.13 * dust * (1.0 + 0.5 * drift)
    return mix, 1.0 + 0.05 * stubble


def deadfall(p: Points) -> Shade:
    """Fallen, scorched trunks lying across one another over branches, on char."""
    trunks, trunk_key = sticks(p.y_m, p.x_m, LOG_SPACING_M, derive_seed(p.seed, "logs"))
    twigs, twig_key = sticks(p.y_m, p.x_m, 0.42, derive_seed(p.seed, "branches"))
    is_trunk, is_twig = trunk_key > 0.0, (twig_key > 0.35) & (trunk_key == 0.0)
    key = np.where(is_trunk, hashed(trunk_key, 1), hashed(twig_key, 1))
    across = np.where(is_trunk, trunks, twigs)
    under = p.fbm("under", 0.30, 3, 0.7)
    charred = np.clip(0.5 + 0.6 * p.fbm("charred", 0.7, 2), 0.0, 1.0)
    mix = np.where(is_trunk, 0.82 - 0.45 * charred + 0.35 * (key - 0.5), 0.22 + 0.07 * under)
    mix = np.where(is_twig, 0.30 + 0.50 * key, mix)
    round_light = 0.92 - 0.38 * across * -np.sign(p.sunward[0]) + 0.08 * p.fbm("bark", 0.12)
    return mix, np.where(is_trunk | is_twig, round_light, 0.88 + 0.12 * under)


def rippled_sand(p: Points) -> Shade:
    """Sand under water: forked wave ripples that come and go, and mottles of finer and coarser sand."""
    y, x = warp(p.y_m, p.x_m, 1.4, 0.14, p.seed)
    y = y + 0.05 * p.fbm("forks", 0.4)
    phase = 2.0 * np.pi * (0.92 * y - 0.39 * x) / 0.33
    ripple = np.sin(phase + 0.5 * np.sin(phase)) * np.clip(0.80 + 0.40 * p.fbm("swell", 2.5), 0.25, 1.4)
    grain = p.fbm("grain", 0.11)
    stain = p.fbm("stain", 1.2, 4, 0.7)
    return 0.5 + 0.16 * stain + 0.10 * ripple, 1.0 + 0.012 * stain + 0.042 * ripple + 0.036 * grain


def leaf_blades(p: Points) -> Shade:
    """Seagrass: short blades combed by the current, in tufts, with dark gaps and pale old leaves."""
    y, x = warp(p.y_m, p.x_m, 3.0, 0.16, p.seed)
    along, across = 0.45 * y + 0.89 * x, 0.89 * y - 0.45 * x
    blade = fbm(across, 0.30 * along, 0.13, derive_seed(p.seed, "blade"), octaves=2, gain=0.8)
    tuft = fbm(across, 0.6 * along, 0.50, derive_seed(p.seed, "tuft"), octaves=3, gain=0.6)
    mix = 0.42 + 0.12 * tuft + 0.17 * blade
    return mix, 1.0 + 0.08 * tuft + 0.15 * blade


def coral_heads(p: Points) -> Shade:
    """Living coral: rounded colonies of unlike size and colour, lit on their sunny side, with dark crannies."""
    y, x = warp(p.y_m, p.x_m, 0.45, 0.09, p.seed, octaves=3)
    large = worley(y, x, 1.05, derive_seed(p.seed, "large"))
    small = worley(y, x, 0.42, derive_seed(p.seed, "small"))
    is_large = (hashed(large.key, 2) < 0.55) & (large.nearest < 0.40 + 0.12 * large.key)
    key = np.where(is_large, large.key, small.key)
    crest = np.where(is_large, 1.0 - 1.7 * large.nearest, 0.75 - 0.9 * small.nearest)
    lit = np.where(is_large, 0.45 * p.facing(large.dy, large.dx), 0.32 * p.facing(small.dy, small.dx))
    folds = p.emboss("folds", 0.22, 3, 0.7, 0.04)
    shelf = p.fbm("shelf", 1.3, 3, 0.6)
    mix = 0.5 + 0.75 * (key - 0.5) + 0.05 * shelf
    return mix, 0.80 + 0.26 * crest + lit + 0.075 * folds + 0.05 * shelf


def rubble(p: Points) -> Shade:
    """Broken coral and stones of 10 to 40 cm, dead and pale, sand and turf algae among them."""
    y, x = warp(p.y_m, p.x_m, 0.3, 0.05, p.seed, octaves=3)
    big = worley(y, x, 0.55, derive_seed(p.seed, "big"))
    small = worley(y, x, 0.21, derive_seed(p.seed, "small"))
    is_big = (big.key < 0.35) & (big.nearest < 0.20 + 0.22 * hashed(big.key, 3))
    key = np.where(is_big, hashed(big.key, 1), small.key)
    lit = np.where(is_big, 0.50 * p.facing(big.dy, big.dx), 0.34 * p.facing(small.dy, small.dx))
    gap = np.clip(1.0 - (small.second - small.nearest) / 0.30, 0.0, 1.0) * ~is_big
    algae = p.fbm("algae", 0.6, 4, 0.65)
    return 0.45 + 0.5 * (key - 0.5) - 0.10 * algae, 0.90 + 0.24 * hashed(key, 2) + 0.9 * lit - 0.18 * gap - 0.03 * algae


def deep_water(p: Points) -> Shade:
    """Deep channel: the bottom drowns in blue, only broad shades of it remain."""
    return 0.5 + 0.12 * p.fbm("shade", 4.0, 2), 1.0 + 0.03 * p.fbm("bottom", 1.2, 2) + 0.025 * p.fbm("grain", 0.14)
