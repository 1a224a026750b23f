from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gabor_reference import photograph, reference
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from hrt_cli.texture.bank import HALVING_TAPS, Filters, GaborBank
from hrt_cli.texture.passes import amplitudes, columns_apart, halve

F64 = NDArray[np.float64]


def answers(
    image: F64, one: Filters, orientations: int, origin: tuple[int, int], cells: tuple[int, int]
) -> NDArray[np.float32]:
    """Cell amplitudes of an image, cells 4 pixels a side and starting at pixel `origin`."""
    level = columns_apart(image.astype(np.float32))
    for _ in range(one.level):
        level = halve(level)
    out = np.full((orientations, *cells), np.nan, np.float32)
    scale = 1 << one.level
    amplitudes(level, one, (origin[0] // scale, origin[1] // scale), 4 // scale, out)
    return out


def test_the_finest_level_agrees_with_the_full_kernel() -> None:
    image = np.random.default_rng(1).normal(size=(96, 104))
    for orientations in (2, 5, 6):
        (one,) = GaborBank((4.0,), orientations).filters((1.0, 1.0), 4)
        assert (one.level, one.stride) == (0, 2)
        got = answers(image, one, orientations, (16, 20), (16, 15))
        samples = reference(image, 4.0, orientations, (1.0, 1.0))[:, 16:80:2, 20:80:2]
        expected = samples.reshape(orientations, 16, 2, 15, 2).mean(axis=(2, 4))
        assert np.abs(got - expected).max() < 2e-5 * expected.mean()


def test_cells_that_start_between_samples_are_a_fault() -> None:
    (one,) = GaborBank((4.0,), 6).filters((1.0, 1.0), 8)
    assert one.stride == 4
    with pytest.raises(ValueError, match="no multiple of the stride 4"):
        amplitudes(columns_apart(np.zeros((64, 64), np.float32)), one, (16, 18), 8, np.empty((6, 2, 2), np.float32))


def test_pixels_that_are_not_square() -> None:
    image = np.random.default_rng(2).normal(size=(120, 120))
    pixel_m = (0.05, 0.03)
    (one,) = GaborBank((0.2,), 6).filters(pixel_m, 4)
    got = answers(image, one, 6, (20, 20), (20, 20))
    samples = reference(image, 0.2, 6, pixel_m)[:, 20:100:2, 20:100:2]
    expected = samples.reshape(6, 20, 2, 20, 2).mean(axis=(2, 4))
    assert np.abs(got - expected).max() < 2e-5 * expected.mean()


@pytest.mark.parametrize(
    ("wavelength_px", "level", "correlation"), [(8.0, 1, 0.985), (16.0, 2, 0.997), (32.0, 2, 0.997)]
)
def test_the_pyramid_agrees_with_the_full_kernel(wavelength_px: float, level: int, correlation: float) -> None:
    image = photograph(512, 3)
    bank = GaborBank((wavelength_px,), 6)
    (one,) = bank.filters((1.0, 1.0), 4)
    assert one.level == level
    margin = -(-bank.reach_px((1.0, 1.0), 4)[0] // 4)
    cells = (128 - 2 * margin,) * 2
    got = answers(image, one, 6, (4 * margin,) * 2, cells)
    inner = slice(4 * margin, -4 * margin)
    full = reference(image, wavelength_px, 6, (1.0, 1.0))[:, inner, inner]
    expected = full.reshape(6, cells[0], 4, cells[1], 4).mean(axis=(2, 4))
    for one_got, one_expected in zip(got, expected, strict=True):
        patches = [uniform_filter(cells_of, 6)[::6, ::6].ravel() for cells_of in (one_got, one_expected)]
        assert np.corrcoef(*patches)[0, 1] > correlation
        assert one_got.mean() == pytest.approx(one_expected.mean(), rel=0.03)


@pytest.mark.parametrize(
    ("wavelength_px", "samples", "of_all", "of_one"),
    [
        (4.0, 2, 0.008, 0.015),
        (8.0, 2, 0.018, 0.036),
        (16.0, 2, 0.015, 0.03),
        (2.83, 4, 0.002, 0.004),
        (5.66, 4, 0.005, 0.01),
        (11.3, 4, 0.014, 0.028),
    ],
)
def test_sparse_sampling_of_cells_is_enough(wavelength_px: float, samples: int, of_all: float, of_one: float) -> None:
    """Root mean squares of the change, in the window of a site's texture, against the mean over all pixels."""
    side, margin = 8, 16
    (one,) = GaborBank((wavelength_px,), 6, samples=samples).filters((1.0, 1.0), side)
    per_cell = side >> one.level
    level = columns_apart((0.2 * photograph(1024, 5)).astype(np.float32))
    for _ in range(one.level):
        level = halve(level)
    few, every = (np.empty((6, 96, 96), np.float32) for _ in range(2))
    for filters, out in [(one, few), (replace(one, stride=1), every)]:
        amplitudes(level, filters, (margin * per_cell,) * 2, per_cell, out)
    # What the edge of the lattice mirrors would count twice.
    few, every = (np.stack([gaussian_filter(cells, 2)[8:-8, 8:-8] for cells in found]) for found in (few, every))
    assert few.mean() == pytest.approx(every.mean(), rel=2e-3)
    assert np.sqrt(np.mean((few.mean(axis=0) / every.mean(axis=0) - 1) ** 2)) < of_all
    assert np.sqrt(np.mean((few / every - 1) ** 2)) < of_one


@pytest.mark.parametrize("wavelength_px", [4.0, 5.7, 8.0, 16.0, 32.0, 64.0])
@pytest.mark.parametrize("orientation", [0, 1, 3])
def test_a_wave_answers_half_its_amplitude_and_a_constant_nothing(wavelength_px: float, orientation: int) -> None:
    bank = GaborBank((wavelength_px,), 6)
    (one,) = bank.filters((1.0, 1.0), 4)
    margin = -(-bank.reach_px((1.0, 1.0), 4)[0] // 4)
    size = 4 * (2 * margin + 6)
    y, x = np.mgrid[:size, :size]
    theta = np.pi * orientation / 6
    wave = 0.3 * np.cos(2 * np.pi * (x * np.cos(theta) + y * np.sin(theta)) / wavelength_px)
    for image, answer, tolerance in [(wave, 0.15, 2e-3), (np.full((size, size), 5.0), 0.0, 5e-3)]:
        got = answers(image, one, 6, (4 * margin,) * 2, (6, 6))
        assert np.abs(got[orientation] - answer).max() < tolerance


def test_halving_filters_and_takes_every_second_pixel() -> None:
    image = np.random.default_rng(4).normal(size=(40, 48)).astype(np.float32)
    taps = np.concatenate([HALVING_TAPS[::-1], HALVING_TAPS])
    assert taps.sum() == pytest.approx(1, abs=1e-4)
    smooth = np.apply_along_axis(np.convolve, 1, np.apply_along_axis(np.convolve, 0, image, taps), taps)
    halved = halve(columns_apart(image))
    whole = np.empty((20, 24))
    whole[:, 0::2], whole[:, 1::2] = halved
    assert whole[2:-2, 2:-2] == pytest.approx(smooth[8:-8:2, 8:-8:2], abs=1e-6)
