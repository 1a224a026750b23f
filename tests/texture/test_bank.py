from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter
from scipy.signal import fftconvolve

from hrt_cli.texture.bank import HALVING_TAPS, Filters, GaborBank, amplitudes, columns_apart, halve

F64 = NDArray[np.float64]


def full_kernel(
    wavelength_m: float, theta: float, pixel_m: tuple[float, float], ratio: float
) -> NDArray[np.complex128]:
    """The two-dimensional Gabor filter in float64, cut at 3 sigma, its envelope summing to 1, without DC."""
    reach = [int(np.ceil(3 * ratio * wavelength_m / d)) for d in pixel_m]
    y, x = np.mgrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1].astype(np.float64)
    y, x = y * pixel_m[0], x * pixel_m[1]
    envelope = np.exp(-0.5 * (x**2 + y**2) / (ratio * wavelength_m) ** 2)
    envelope /= envelope.sum()
    wave = np.exp(2j * np.pi * (x * np.cos(theta) + y * np.sin(theta)) / wavelength_m)
    kernel: NDArray[np.complex128] = envelope * wave - envelope * (envelope * wave).sum().real
    return kernel


def reference(image: F64, wavelength_m: float, orientations: int, pixel_m: tuple[float, float]) -> F64:
    """Amplitude at every pixel, [orientations, rows, cols]."""
    return np.stack(
        [
            np.abs(fftconvolve(image, full_kernel(wavelength_m, np.pi * n / orientations, pixel_m, 0.56), mode="same"))
            for n in range(orientations)
        ]
    )


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
    # Amplitudes fall with frequency, as in photographs.
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(512), np.fft.fftfreq(512)))
    spectrum = np.fft.fft2(np.random.default_rng(3).normal(size=(512, 512))) / np.maximum(frequency, 1 / 512)
    image = np.fft.ifft2(spectrum).real
    image /= image.std()
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
