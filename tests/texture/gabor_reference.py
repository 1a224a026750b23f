"""Gabor filters as the books write them, in two dimensions and double precision: what the kernels are held against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

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


def photograph(side: int, seed: int) -> F64:
    """Noise whose amplitudes fall with frequency, as in photographs; standard deviation 1."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side)))
    spectrum = np.fft.fft2(np.random.default_rng(seed).normal(size=(side, side))) / np.maximum(frequency, 1 / side)
    image = np.fft.ifft2(spectrum).real
    return np.asarray(image / image.std())
