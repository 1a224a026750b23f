"""From the measures of cells to features: colour and log energy averaged over windows, as K-means sees them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.texture.colour import hue_histogram, hue_votes, lab
from hrt_cli.texture.lattice import gaussian_taps, smooth
from hrt_cli.texture.measure import COLOUR, SHARE, TEXTURE
from hrt_cli.texture.settings import FeatureSettings
from hrt_cli.texture.weigh import APART_SIGMAS

F32 = NDArray[np.float32]
Taps = tuple[F32, F32]

_MIN_SIGMA_CELLS = 0.7
"""Windows reach two cells at least, so that a patch beside the data's edge is defined."""
_BORDER_CELLS = 2
"""A colour difference is taken over so many cells to either side."""
_BORDER_LAB = 6.0
"""Colour difference over that distance at which a cell counts a quarter."""
_PLAIN = 0.25
"""Purity from which on a cell counts as plain ground."""
_PURITY_FLOOR = 1e-3
"""Where all is border, all counts alike."""
_CHROMA_KNEE = 24.0
"""a and b are linear below this and logarithmic above: greys are told apart by little chroma."""
_FIT_LIT_LAB, _LIT_LAB = 14.0, 30.0
"""Lightness that multiplies a cell's weight in its window's colour by e, in the window of the fit and in the narrow
one: the colour of a ground is that of its lit parts, for shadow has little of it and noise."""
_WHITE_LAB = 100.0
_CROSS_FLOOR = 1e-3
_LARGEST_INVERSE = 1e-3


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
    share : ndarray [rows, cols] float32
        Share of valid pixels.
    plain : ndarray [rows, cols] bool
        No border of colours runs beside the cell; everywhere where colour does not count.
    usable : ndarray [rows, cols] bool
        At least half of the cell's pixels are valid.
    defined : ndarray [rows, cols] bool
        The cell or one of its eight neighbours is usable.
    """

    values: F32
    rgb: F32
    roughness: F32
    share: F32
    plain: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    defined: NDArray[np.bool_]


class Windows:
    """The windows over which measures become features, for cells of a given size.

    Parameters
    ----------
    settings : FeatureSettings
    pixel_m : (float, float)
        Ground metres per pixel along rows and columns.
    step_px : int
        Cell side.
    """

    def __init__(self, settings: FeatureSettings, pixel_m: tuple[float, float], step_px: int) -> None:
        self.settings = settings
        self._cell_m = (pixel_m[0] * step_px, pixel_m[1] * step_px)

    def _taps(self, sigma_m: float) -> Taps:
        rows, cols = (max(sigma_m / cell_m, _MIN_SIGMA_CELLS) for cell_m in self._cell_m)
        return gaussian_taps(rows), gaussian_taps(cols)

    @cached_property
    def _texture_taps(self) -> Taps:
        return self._taps(self.settings.texture_sigma_m)

    @cached_property
    def _fit_taps(self) -> Taps:
        return self._taps(self.settings.fit_sigma_m)

    @cached_property
    def _colour_taps(self) -> Taps:
        return self._taps(self.settings.colour_sigma_m)

    @cached_property
    def halo_cells(self) -> tuple[int, int]:
        """Cells that are needed around the cells wanted, along rows and columns, for `patches`."""
        rows, cols = (self._halo(axis) for axis in (0, 1))
        return rows, cols

    def _halo(self, axis: int) -> int:
        texture, colour = len(self._texture_taps[axis]) - 1, len(self._colour_taps[axis]) - 1
        if self.settings.features == "site":
            return texture + _BORDER_CELLS + colour
        return max(texture, colour, 1)

    @cached_property
    def _fit_colour_taps(self) -> Taps:
        return self._taps(self.settings.fit_sigma_m / 2)

    @cached_property
    def fit_halo_cells(self) -> tuple[int, int]:
        """Cells that are needed around the cells wanted, along rows and columns, for `wide`."""
        rows, cols = (len(taps) - 1 for taps in self._fit_taps)
        if self.settings.features != "site":
            return rows, cols
        by_rows, by_cols = (len(taps) - 1 + _BORDER_CELLS for taps in self._fit_colour_taps)
        return rows + by_rows, cols + by_cols

    @property
    def apart_cells(self) -> tuple[int, int]:
        """Cells along rows and columns that lie between windows of the fit which share nothing."""
        rows, cols = (max(1, int(APART_SIGMAS * self.settings.fit_sigma_m / cell_m)) for cell_m in self._cell_m)
        return rows, cols

    def patches(self, cells: F32) -> Patches:
        """Return the features of every cell but the halo.

        Parameters
        ----------
        cells : ndarray [channels, rows, cols] float32
            Measures; see `hrt_cli.texture.measure`.
        """
        share, log_amplitude = cells[SHARE], cells[TEXTURE]
        if self.settings.features == "site":
            colour, averaged, plain = _site(cells, self._colour_taps, self._texture_taps, _LIT_LAB)
        else:
            colour = self._hues(cells[COLOUR], share)
            average = self._harmonic if self.settings.features == "texture" else self._averaged
            averaged = average(log_amplitude, share, self._texture_taps)
            plain = np.ones(averaged.shape[1:], np.bool_)
        texture = self._channels(averaged)
        inner = _inner(share, self.halo_cells)
        usable = share >= np.float32(0.5)
        return Patches(
            values=np.concatenate([colour, texture[1:]]),
            rgb=cells[COLOUR][:, *inner],
            roughness=texture[0],
            share=np.ascontiguousarray(share[inner]),
            plain=plain,
            usable=usable[inner],
            defined=_dilate(usable)[inner],
        )

    def wide(self, cells: F32) -> F32:
        """Return the features in the window of the fit, of every cell but `fit_halo_cells`; without hues."""
        if self.settings.features == "site":
            colour, averaged, _ = _site(cells, self._fit_colour_taps, self._fit_taps, _FIT_LIT_LAB)
            return np.concatenate([colour, self._channels(averaged)[1:]])
        averaged, _ = smooth(np.ascontiguousarray(cells[TEXTURE]), cells[SHARE], *self._fit_taps)
        return self._channels(averaged)[1:]

    def _averaged(self, values: F32, weights: F32, taps: Taps) -> F32:
        """Average over a window; there may be more around than it needs."""
        rows, cols = (self.halo_cells[axis] - (len(taps[axis]) - 1) for axis in (0, 1))
        inner = _inner(weights, (rows, cols))
        inside = np.ascontiguousarray(values[(slice(None), *inner)])
        return smooth(inside, np.ascontiguousarray(weights[inner]), *taps)[0]

    def _harmonic(self, log_amplitude: F32, weights: F32, taps: Taps) -> F32:
        """Return the log of the harmonic mean amplitude.

        A strong texture spills over a border through the filters' envelope, and the logarithm makes the spill wide;
        the harmonic mean leans to the weak side and takes it back.
        """
        mean = self._averaged(np.exp(-log_amplitude), weights, taps)
        return -np.log(np.maximum(mean, np.float32(_LARGEST_INVERSE)))

    def _hues(self, mean: F32, share: F32) -> F32:
        """Return the hue histogram, or no channel where colour does not count."""
        if self.settings.features == "texture":
            rows, cols = (share.shape[axis] - 2 * self.halo_cells[axis] for axis in (0, 1))
            return np.empty((0, rows, cols), np.float32)
        return hue_histogram(self._averaged(hue_votes(lab(mean)), share, self._colour_taps))

    def _channels(self, averaged: F32) -> F32:
        """Return the roughness and the texture channels of averaged log amplitudes."""
        mode, scales = self.settings.texture_mode, len(self.settings.wavelengths_m)
        per_scale = averaged.reshape(scales, -1, *averaged.shape[1:])
        roughness = _mean(_orientation_mean(per_scale))
        further = np.empty((0, *averaged.shape[1:]), np.float32)
        if self.settings.compares_scales:
            further = _cross_scale(per_scale)
        if mode == "invariant":
            per_scale = _fourier_magnitudes(per_scale)
        elif mode == "sorted":
            per_scale = np.sort(per_scale, axis=1)
        if self.settings.scale_invariant:
            per_scale = np.sort(per_scale, axis=0)
        return np.concatenate([roughness[None], per_scale.reshape(-1, *per_scale.shape[2:]), further])


def _inner(values: NDArray[np.generic], halo: tuple[int, int]) -> tuple[slice, slice]:
    return slice(halo[0], values.shape[0] - halo[0]), slice(halo[1], values.shape[1] - halo[1])


def _site(cells: F32, colour_taps: Taps, texture_taps: Taps, lit_lab: float) -> tuple[F32, F32, NDArray[np.bool_]]:
    """Return the colour channels and the averaged log amplitudes of a site, and which cells are plain ground.

    They are smaller by what the windows need.

    Colour is that of a window's lit cells. In the window of the texture cells count by their shares of valid pixels
    times their purity: one beside a border of colours counts little, so that its neighbours take their texture from
    plain ground, mostly on their own side of it.
    """
    share, colours = cells[SHARE], lab(cells[COLOUR])
    lit = share * np.exp((colours[0] - np.float32(_WHITE_LAB)) / np.float32(lit_lab))
    smoothed, _ = smooth(colours, lit, *colour_taps)
    # Borders are those of all cells: beside a bright one the lit colour steps late.
    plain, _ = smooth(colours, share, *colour_taps)
    reach = len(colour_taps[0]) - 1, len(colour_taps[1]) - 1
    weights = _purity(plain, np.ascontiguousarray(share[_inner(share, reach)]))
    inner = _inner(share, (reach[0] + _BORDER_CELLS, reach[1] + _BORDER_CELLS))
    averaged, _ = smooth(np.ascontiguousarray(cells[TEXTURE][(slice(None), *inner)]), weights, *texture_taps)
    rows, cols = (len(taps) - 1 + _BORDER_CELLS for taps in texture_taps)
    colour = smoothed[(slice(None), *_inner(smoothed[0], (rows, cols)))].copy()
    colour[1:] = _compressed(colour[1:])
    middle = _inner(weights, (len(texture_taps[0]) - 1, len(texture_taps[1]) - 1))
    return colour, averaged, weights[middle] >= np.float32(_PLAIN) * share[inner][middle]


def _compressed(chroma: F32) -> F32:
    """Return 24 asinh(chroma / 24), written with the logarithm that NumPy has vectorised."""
    knee = np.float32(_CHROMA_KNEE)
    size = np.abs(chroma) * (np.float32(1) / knee)
    size = np.log(size + np.sqrt(size * size + np.float32(1)))
    return np.asarray(np.copysign(size * knee, chroma))


@njit(cache=True, nogil=True, error_model="numpy")
def _purity(colour: F32, share: F32) -> F32:
    """Return share / (1 + g / `_BORDER_LAB`²)², g the squared colour differences along both axes.

    `colour` [3, rows, cols] is smoothed Lab; the result is smaller by `_BORDER_CELLS` on each side. A difference
    counts only where both its cells are at least half valid.
    """
    span, half = _BORDER_CELLS, np.float32(0.5)
    scale, floor = np.float32(1 / _BORDER_LAB**2), np.float32(_PURITY_FLOOR)
    out = np.empty((share.shape[0] - 2 * span, share.shape[1] - 2 * span), np.float32)
    for r in range(out.shape[0]):
        y = r + span
        for c in range(out.shape[1]):
            x = c + span
            along, across = np.float32(0), np.float32(0)
            for k in range(3):
                d = colour[k, y, x + span] - colour[k, y, x - span]
                e = colour[k, y + span, x] - colour[k, y - span, x]
                along += d * d
                across += e * e
            along = along if min(share[y, x + span], share[y, x - span]) >= half else np.float32(0)
            across = across if min(share[y + span, x], share[y - span, x]) >= half else np.float32(0)
            q = np.float32(1) / (np.float32(1) + (along + across) * scale)
            out[r, c] = share[y, x] * max(q * q, floor)
    return out


def _mean(channels: F32) -> F32:
    total: F32 = channels[0].copy()
    for one in channels[1:]:
        total += one
    total *= np.float32(1 / len(channels))
    return total


def _orientation_mean(per_scale: F32) -> F32:
    return np.stack([_mean(one) for one in per_scale])


def _coefficient(one_scale: F32, order: int) -> tuple[F32, F32]:
    """Return the real and the imaginary part of a Fourier coefficient over orientations [orientations, rows, cols]."""
    count = len(one_scale)
    real, imag = np.zeros(one_scale.shape[1:], np.float32), np.zeros(one_scale.shape[1:], np.float32)
    for orientation in range(count):
        angle = 2 * math.pi * order * orientation / count
        real += np.float32(math.cos(angle) / count) * one_scale[orientation]
        imag += np.float32(math.sin(angle) / count) * one_scale[orientation]
    return real, imag


def _fourier_magnitudes(per_scale: F32) -> F32:
    """Return the mean over orientations and the magnitudes of their further Fourier coefficients.

    Turning the image shifts the orientations cyclically, which changes phases only.
    """
    count = per_scale.shape[1]
    out = np.empty((per_scale.shape[0], count // 2 + 1, *per_scale.shape[2:]), np.float32)
    out[:, 0] = _orientation_mean(per_scale)
    for scale, one in enumerate(per_scale):
        for order in range(1, count // 2 + 1):
            real, imag = _coefficient(one, order)
            out[scale, order] = np.sqrt(real * real + imag * imag)
    return out


def _cross_scale(per_scale: F32) -> F32:
    """Return how the main directions of neighbouring wavelengths lie to each other [2 · (scales − 1), rows, cols].

    The product of one's first Fourier coefficient and the other's conjugate: a turn moves both phases alike. Divided
    by the root of its size it is as large as the magnitudes are.
    """
    found = [_coefficient(one, 1) for one in per_scale]
    parts = []
    for (a, b), (c, d) in itertools.pairwise(found):
        real, imag = a * c + b * d, b * c - a * d
        size = np.sqrt(np.sqrt(real * real + imag * imag) + np.float32(_CROSS_FLOOR))
        parts += [real / size, imag / size]
    return np.stack(parts) if parts else np.empty((0, *per_scale.shape[2:]), np.float32)


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    out = np.zeros_like(mask)
    for dr in range(3):
        for dc in range(3):
            out |= padded[dr : dr + rows, dc : dc + cols]
    return out
