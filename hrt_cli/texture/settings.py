"""What is measured of a patch, in metres on the ground: all that two flights must share to share their classes."""

from __future__ import annotations

from dataclasses import dataclass

from hrt_cli.texture.colour import HUE_BINS

FEATURE_SETS = ("site", "paper", "texture")
ROTATIONS = ("invariant", "aware", "sorted")


@dataclass(frozen=True)
class Preset:
    """What a feature set measures unless told otherwise, in pixels of the image that is fitted.

    Attributes
    ----------
    wavelengths_px : tuple of float
    orientations : int
    texture_sigma_px, fit_sigma_px, colour_sigma_px, contrast_sigma_px : float
        See `FeatureSettings`.
    samples : int
        Amplitudes taken along the side of a cell at the finest wavelength.
    votes : int
        Rounds in which cells vote with their neighbours.
    """

    wavelengths_px: tuple[float, ...]
    orientations: int
    texture_sigma_px: float
    fit_sigma_px: float
    colour_sigma_px: float = 8.0
    contrast_sigma_px: float = 12.0
    samples: int = 2
    votes: int = 3


PRESETS = {
    "site": Preset((4.0, 8.0, 16.0, 32.0), 4, 12.0, 20.0),
    "paper": Preset((4.0, 8.0, 16.0, 32.0), 6, 16.0, 16.0),
    "texture": Preset((2.83, 5.66, 11.3, 22.6), 6, 5.6, 20.0, samples=4),
}
"""Measured on sites and mosaics; see docs/method.md."""
STEP_PX = 8
"""Side of a cell, the distance between patches."""


@dataclass(frozen=True)
class FeatureSettings:
    """What to measure, in metres on the ground.

    Parameters
    ----------
    features : {"site", "paper", "texture"}
        The feature set.
    rotation : {"invariant", "aware", "sorted"}
        How orientations enter: magnitudes of their Fourier transform, as they are, or ordered by size.
    wavelengths_m : tuple of float
    orientations : int
    texture_sigma_m : float
        Window over which energy is averaged.
    fit_sigma_m : float
        With "site" and "texture", the wider window over which it is averaged to find the classes; colour over half.
    colour_sigma_m, contrast_sigma_m : float
        Windows over which colour is averaged and luminance is levelled.
    step_m : float
        Distance between patches; rounded to a power of two of pixels.
    scale_invariant : bool
        Order energies by size over the wavelengths too, so that a texture seen larger is the same texture.
    """

    features: str
    rotation: str
    wavelengths_m: tuple[float, ...]
    orientations: int
    texture_sigma_m: float
    fit_sigma_m: float
    colour_sigma_m: float
    contrast_sigma_m: float
    step_m: float
    scale_invariant: bool = False

    @property
    def texture_mode(self) -> str:
        """How orientations really enter: "mean", "invariant", "aware" or "sorted"."""
        if self.features == "site" and self.rotation == "invariant":
            return "mean"
        if self.features == "paper" and self.rotation == "invariant":
            return "sorted"
        return self.rotation

    @property
    def block_sizes(self) -> tuple[int, int]:
        """Number of colour and of texture channels."""
        per_scale = {
            "mean": 1,
            "invariant": self.orientations // 2 + 1,
            "aware": self.orientations,
            "sorted": self.orientations,
        }[self.texture_mode]
        colour = {"site": 3, "paper": HUE_BINS, "texture": 0}[self.features]
        texture = per_scale * len(self.wavelengths_m)
        if self.compares_scales:
            texture += 2 * (len(self.wavelengths_m) - 1)
        return colour, texture

    @property
    def compares_scales(self) -> bool:
        """Whether the directions of neighbouring wavelengths are compared: only where directions are forgotten."""
        return self.features == "texture" and self.texture_mode == "invariant" and not self.scale_invariant

    @property
    def discriminates(self) -> bool:
        """Whether classes are found in a wide window and told apart in a narrow one, cells voting."""
        return self.features in ("site", "texture")

    @property
    def votes(self) -> int:
        """Rounds in which cells vote with their neighbours, where they do."""
        return PRESETS[self.features].votes

    @property
    def samples(self) -> int:
        """Amplitudes taken along the side of a cell at the finest wavelength."""
        return PRESETS[self.features].samples
