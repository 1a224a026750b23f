"""What a user of scikit-image and scikit-learn would write: Gabor amplitudes, a Gaussian window, K-means."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve
from skimage.filters import gabor, gabor_kernel
from sklearn.cluster import KMeans

WAVELENGTHS_PX = (4.0, 8.0, 16.0, 32.0)
ORIENTATIONS = 6
WINDOW_PX = 16.0
STARTS = 10

F32 = NDArray[np.float32]


def _filters() -> list[tuple[float, float]]:
    return [(1 / one, math.pi * k / ORIENTATIONS) for one in WAVELENGTHS_PX for k in range(ORIENTATIONS)]


def amplitudes(grey: F32) -> F32:
    """Amplitudes [filters, rows, cols] by `skimage.filters.gabor`."""
    return np.array([np.hypot(*gabor(grey, frequency, theta=theta)) for frequency, theta in _filters()], np.float32)


def fast_amplitudes(grey: F32) -> F32:
    """The same by FFT: `skimage.filters.gabor` would take minutes for one mosaic."""
    kernels = [gabor_kernel(frequency, theta=theta) for frequency, theta in _filters()]
    reach = max(max(kernel.shape) for kernel in kernels) // 2
    padded = np.pad(grey, reach, mode="symmetric")
    inner = (slice(reach, -reach), slice(reach, -reach))
    return np.array([np.abs(fftconvolve(padded, kernel, mode="same")[inner]) for kernel in kernels], np.float32)


def plain_classes(amplitude: F32, classes: int, every: int = 1) -> NDArray[np.uint8]:
    """Classes of every pixel, found on every `every`-th."""
    smooth = np.array([gaussian_filter(one, WINDOW_PX) for one in amplitude])
    scaled = (smooth - smooth.mean(axis=(1, 2), keepdims=True)) / smooth.std(axis=(1, 2), keepdims=True)
    kmeans = KMeans(classes, n_init=STARTS, random_state=0)
    kmeans.fit(scaled[:, ::every, ::every].reshape(len(scaled), -1).T)
    found = kmeans.predict(scaled.reshape(len(scaled), -1).T)
    return found.reshape(scaled.shape[1:]).astype(np.uint8)
