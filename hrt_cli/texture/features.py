"""What is measured of a patch: the feature sets, computed per cell from a tile of the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.windows import Window
from hrt_cli.texture.bank import MIN_WAVELENGTH_PX, GaborBank, amplitudes, halve
from hrt_cli.texture.colour import HUE_BINS, LUMA, U8, cell_means, hue_histogram, hue_votes, lab, luma
from hrt_cli.texture.lattice import CellGrid, gaussian_taps, smooth

F32 = NDArray[np.float32]

FEATURE_SETS = ("site", "paper", "texture")
ROTATIONS = ("invariant", "aware", "sorted")
MAX_WAVELENGTH_PX = 512.0
"""Above this the halo of a block would dwarf the block."""
_MIN_SIGMA_CELLS = 0.8
"""Windows reach two cells at least, so that a patch beside the data's edge is defined."""
_STEPS_PX = (2, 4, 8, 16, 32)
_AMPLITUDE_FLOOR = 1e-3
"""Added to an amplitude (relative contrast) before the logarithm: below 8-bit quantisation."""
_LUMA_FLOOR = 8.0
"""Added to the local mean luma before dividing by it, so that deep shadow is not all noise."""


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
    texture_sigma_m, colour_sigma_m, contrast_sigma_m : float
        Windows over which energy and colour are averaged and luminance is levelled.
    step_m : float
        Distance between patches; rounded to a power of two of pixels.
    """

    features: str
    rotation: str
    wavelengths_m: tuple[float, ...]
    orientations: int
    texture_sigma_m: float
    colour_sigma_m: float
    contrast_sigma_m: float
    step_m: float

    @property
    def texture_mode(self) -> str:
        """How orientations really enter: see `texture_channels`."""
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
        return colour, per_scale * len(self.wavelengths_m)


@dataclass(frozen=True)
class Patches:
    """Features of a rectangle of cells.

    Attributes
    ----------
    values : ndarray [channels, rows, cols] float32
        Colour channels, then texture channels.
    rgb : ndarray [3, rows, cols] float32
        Mean colour of the cell itself.
    roughness : ndarray [rows, cols] float32
        Mean log amplitude over wavelengths and orientations.
    usable : ndarray [rows, cols] bool
        At least half of the cell's pixels are valid.
    defined : ndarray [rows, cols] bool
        The cell or one of its eight neighbours is usable.
    """

    values: F32
    rgb: F32
    roughness: F32
    usable: NDArray[np.bool_]
    defined: NDArray[np.bool_]


class Extractor:
    """Feature settings made ready for a raster with given pixels.

    Parameters
    ----------
    settings : FeatureSettings
    pixel_m : (float, float)
        Ground metres per pixel along rows and columns.

    Raises
    ------
    ArgumentError
        A wavelength is shorter than 2.5 pixels or longer than 512.
    """

    def __init__(self, settings: FeatureSettings, pixel_m: tuple[float, float]) -> None:
        coarse, fine = max(pixel_m), min(pixel_m)
        shortest, longest = min(settings.wavelengths_m), max(settings.wavelengths_m)
        if shortest / coarse < MIN_WAVELENGTH_PX * (1 - 1e-6):
            raise ArgumentError(
                f"the texture wavelength {shortest:g} m is {shortest / coarse:.2g} pixels at {coarse:g} m per pixel, "
                f"but {MIN_WAVELENGTH_PX:g} pixels are needed: use a finer image or fit longer wavelengths"
            )
        if longest / fine > MAX_WAVELENGTH_PX:
            raise ArgumentError(
                f"the texture wavelength {longest:g} m is {longest / fine:.0f} pixels at {fine:g} m per pixel, "
                f"more than {MAX_WAVELENGTH_PX:g}: resample the image or fit shorter wavelengths"
            )
        self.settings = settings
        self.pixel_m = pixel_m
        self.step_px = min(_STEPS_PX, key=lambda step: abs(math.log2(settings.step_m / coarse / step)))
        self.bank = GaborBank(settings.wavelengths_m, settings.orientations)
        self.filters = self.bank.filters(pixel_m, self.step_px)

    def _window_taps(self, sigma_m: float) -> tuple[F32, F32]:
        rows, cols = (max(sigma_m / (d * self.step_px), _MIN_SIGMA_CELLS) for d in self.pixel_m)
        return gaussian_taps(rows), gaussian_taps(cols)

    @cached_property
    def _contrast_taps(self) -> tuple[F32, F32]:
        return self._window_taps(self.settings.contrast_sigma_m)

    @cached_property
    def _texture_taps(self) -> tuple[F32, F32]:
        return self._window_taps(self.settings.texture_sigma_m)

    @cached_property
    def _colour_taps(self) -> tuple[F32, F32]:
        return self._window_taps(self.settings.colour_sigma_m)

    @cached_property
    def _filter_cells(self) -> tuple[int, int]:
        rows, cols = self.bank.reach_px(self.pixel_m, self.step_px)
        return -(-rows // self.step_px), -(-cols // self.step_px)

    @cached_property
    def halo_cells(self) -> tuple[int, int]:
        """Cells that must be read around the cells wanted, along rows and columns."""
        rows, cols = (
            max(
                len(self._texture_taps[axis]) - 1 + self._filter_cells[axis] + len(self._contrast_taps[axis]),
                len(self._colour_taps[axis]) - 1,
            )
            for axis in (0, 1)
        )
        return rows, cols

    @property
    def halo_px(self) -> tuple[int, int]:
        """Pixels that are read around a block for exact answers, along rows and columns."""
        rows, cols = self.halo_cells
        return (rows + 2) * self.step_px, (cols + 2) * self.step_px

    def read_window(self, grid: CellGrid, anchor: tuple[int, int]) -> Window:
        """Return the window to read for the patches of `grid`."""
        return grid.grown(*self.halo_cells).window(anchor)

    def patches(self, rgb: NDArray[np.uint8], valid: NDArray[np.bool_]) -> Patches:
        """Measure every cell of a tile but its halo.

        Parameters
        ----------
        rgb : ndarray [rows, cols, 3] uint8
        valid : ndarray [rows, cols] bool
            Both of the window `read_window` names.
        """
        rgb, valid = np.ascontiguousarray(rgb), np.ascontiguousarray(valid)
        mean, share = cell_means(rgb, valid, self.step_px)
        halo_r, halo_c = self.halo_cells
        log_amplitude = self._log_amplitudes(rgb, valid, mean, share)
        texture = self._texture(log_amplitude, share)
        colour = self._colour(mean, share)
        inner = (slice(halo_r, -halo_r), slice(halo_c, -halo_c))
        usable = share >= np.float32(0.5)
        return Patches(
            values=np.concatenate([colour, texture[1:]]),
            rgb=mean[:, *inner],
            roughness=texture[0],
            usable=usable[inner],
            defined=_dilate(usable)[inner],
        )

    def _log_amplitudes(self, rgb: U8, valid: NDArray[np.bool_], mean: F32, share: F32) -> F32:
        """Return [wavelengths, orientations, rows, cols] on the cells that the texture window needs."""
        local, _ = smooth(luma(mean)[None], share, *self._contrast_taps)
        crop_r, crop_c = (
            self.halo_cells[axis] - (len(self._texture_taps[axis]) - 1) - self._filter_cells[axis] for axis in (0, 1)
        )
        spare_r, spare_c = crop_r - len(self._contrast_taps[0]), crop_c - len(self._contrast_taps[1])
        local = np.ascontiguousarray(local[0, spare_r : local.shape[1] - spare_r, spare_c : local.shape[2] - spare_c])
        step = self.step_px
        levels = [_relative_luma(rgb.reshape(len(rgb), -1), valid, local, step, crop_r * step, crop_c * step)]
        for _ in range(max(one.level for one in self.filters)):
            levels.append(halve(levels[-1]))
        margin_r, margin_c = self._filter_cells
        cells = (local.shape[0] - 2 - 2 * margin_r, local.shape[1] - 2 - 2 * margin_c)
        out = np.empty((len(self.filters), self.settings.orientations, *cells), np.float32)
        for index, one in enumerate(self.filters):
            per_cell = step >> one.level
            origin = (margin_r * per_cell, margin_c * per_cell)
            amplitudes(levels[one.level], one, origin, per_cell, out[index])
        out += np.float32(_AMPLITUDE_FLOOR)
        return np.log(out, out=out)

    def _texture(self, log_amplitude: F32, share: F32) -> F32:
        """Return the roughness and the texture channels, averaged over the texture window."""
        row_taps, col_taps = self._texture_taps
        crop_r = (share.shape[0] - log_amplitude.shape[2]) // 2
        crop_c = (share.shape[1] - log_amplitude.shape[3]) // 2
        weights = np.ascontiguousarray(share[crop_r : share.shape[0] - crop_r, crop_c : share.shape[1] - crop_c])
        mode = self.settings.texture_mode
        if mode == "mean":
            channels, _ = smooth(_orientation_mean(log_amplitude), weights, row_taps, col_taps)
            return np.concatenate([_mean(channels)[None], channels])
        flat = log_amplitude.reshape(-1, *log_amplitude.shape[2:])
        smoothed, _ = smooth(flat, weights, row_taps, col_taps)
        per_scale = smoothed.reshape(*log_amplitude.shape[:2], *smoothed.shape[1:])
        roughness = _mean(_orientation_mean(per_scale))
        if mode == "invariant":
            per_scale = _fourier_magnitudes(per_scale)
        elif mode == "sorted":
            per_scale = np.sort(per_scale, axis=1)
        return np.concatenate([roughness[None], per_scale.reshape(-1, *per_scale.shape[2:])])

    def _colour(self, mean: F32, share: F32) -> F32:
        """Return the colour channels, averaged over the colour window."""
        row_taps, col_taps = self._colour_taps
        crop_r = self.halo_cells[0] - (len(row_taps) - 1)
        crop_c = self.halo_cells[1] - (len(col_taps) - 1)
        inner = (slice(crop_r, share.shape[0] - crop_r), slice(crop_c, share.shape[1] - crop_c))
        weights = np.ascontiguousarray(share[inner])
        if self.settings.features == "texture":
            rows, cols = weights.shape[0] - 2 * len(row_taps) + 2, weights.shape[1] - 2 * len(col_taps) + 2
            return np.empty((0, rows, cols), np.float32)
        cells = lab(np.ascontiguousarray(mean[:, *inner]))
        if self.settings.features == "site":
            return smooth(cells, weights, row_taps, col_taps)[0]
        return hue_histogram(smooth(hue_votes(cells), weights, row_taps, col_taps)[0])


@njit(cache=True, nogil=True)
def _relative_luma(samples: U8, valid: NDArray[np.bool_], local: F32, step_px: int, top: int, left: int) -> F32:
    """Return luma relative to its local mean, minus 1, and 0 where invalid: [2, rows, cols / 2], even and odd columns.

    `samples` [rows, 3 · cols] is the image with its channels side by side.
    `local` holds the mean of every cell wanted and of one more cell on each side; between cell centres it is
    interpolated bilinearly. `top` and `left` are the pixel at which the cells wanted start.
    """
    rows, cols = (local.shape[0] - 2) * step_px, (local.shape[1] - 2) * step_px
    out = np.empty((2, rows, cols // 2), np.float32)
    half = step_px // 2
    parts = ((np.arange(step_px) + 0.5) / step_px).astype(np.float32)
    upper, lower = np.empty(cols + 2 * step_px, np.float32), np.empty(cols + 2 * step_px, np.float32)
    line = np.empty(cols, np.float32)
    floor = np.float32(_LUMA_FLOOR)
    weights = LUMA
    for r in range(rows):
        low, phase = (r + half) // step_px, (r + half) % step_px
        if r == 0 or phase == 0:
            _stretch(local[low], step_px, upper)
            _stretch(local[low + 1], step_px, lower)
        above, below = upper[step_px : step_px + cols], lower[step_px : step_px + cols]
        pixels, inside = samples[top + r, 3 * left :], valid[top + r, left:]
        part = parts[phase]
        for c in range(cols):
            mean = above[c] + part * (below[c] - above[c])
            value = (
                weights[0] * np.float32(pixels[3 * c])
                + weights[1] * np.float32(pixels[3 * c + 1])
                + weights[2] * np.float32(pixels[3 * c + 2])
            )
            relative = (value - mean) / (mean + floor)
            line[c] = relative if inside[c] else np.float32(0)
        for c in range(cols // 2):
            out[0, r, c] = line[2 * c]
            out[1, r, c] = line[2 * c + 1]
    return out


@njit(cache=True, nogil=True)
def _stretch(cells: F32, step_px: int, out: F32) -> None:
    """Interpolate a line of cells linearly between their centres; half a cell at each end is left as it is."""
    half = step_px // 2
    for cell in range(cells.shape[0] - 1):
        start, base, rise = cell * step_px + half, cells[cell], cells[cell + 1] - cells[cell]
        for c in range(step_px):
            out[start + c] = base + np.float32((c + 0.5) / step_px) * rise


def _mean(channels: F32) -> F32:
    total: F32 = channels[0].copy()
    for one in channels[1:]:
        total += one
    total *= np.float32(1 / len(channels))
    return total


def _orientation_mean(per_scale: F32) -> F32:
    return np.stack([_mean(one) for one in per_scale])


def _fourier_magnitudes(per_scale: F32) -> F32:
    """Return the mean over orientations and the magnitudes of their further Fourier coefficients.

    Turning the image shifts the orientations cyclically, which changes phases only.
    """
    count = per_scale.shape[1]
    out = np.empty((per_scale.shape[0], count // 2 + 1, *per_scale.shape[2:]), np.float32)
    out[:, 0] = _orientation_mean(per_scale)
    for order in range(1, count // 2 + 1):
        real = np.zeros(out[:, 0].shape, np.float32)
        imag = np.zeros(out[:, 0].shape, np.float32)
        for orientation in range(count):
            angle = 2 * math.pi * order * orientation / count
            real += np.float32(math.cos(angle) / count) * per_scale[:, orientation]
            imag += np.float32(math.sin(angle) / count) * per_scale[:, orientation]
        out[:, order] = np.sqrt(real * real + imag * imag)
    return out


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    out = np.zeros_like(mask)
    for dr in range(3):
        for dc in range(3):
            out |= padded[dr : dr + rows, dc : dc + cols]
    return out
