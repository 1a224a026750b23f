"""Gabor banks side by side: one image, the same wavelengths and orientations, amplitudes per cell of 8 pixels."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import rasterio
import scipy.fft
from numpy.typing import NDArray
from process_cost import process_cost
from skimage.filters import gabor, gabor_kernel
from tables import Effort, Table, cpu_seconds

from hrt_cli.texture.bank import KERNEL_REACH, SIGMA_OVER_LAMBDA, GaborBank
from hrt_cli.texture.passes import amplitudes, columns_apart, halve
from hrt_cli.texture.settings import PRESETS

WAVELENGTHS_PX = (4.0, 8.0, 16.0, 32.0)
SHORT_WAVELENGTHS_PX = (4.0, 8.0, 16.0)
ORIENTATIONS = 6
STEP_PX = 8
REPEATS = 25
"""The fused bank takes hundredths of a second, in which anything may come between."""
WINDOW_CELLS = 2.0
"""Energies are compared as features take them: averaged over a Gaussian window of 16 pixels."""
ORFEO = "otbcli_HaralickTextureExtraction"
ORFEO_RADII_PX = (2, 4, 16)
"""Its default, which looks at 25 of the 64 pixels of a cell; all pixels; the texture window of `hrt segment`."""

F32 = NDArray[np.float32]
Bank = Callable[[F32, Sequence[float]], F32]


def natural_image(side: int, seed: int = 0) -> F32:
    """Noise whose amplitude falls with frequency, as in photographs; mean 0, standard deviation 1."""
    rows, cols = scipy.fft.fftfreq(side), scipy.fft.rfftfreq(side)
    spectrum = scipy.fft.rfft2(np.random.default_rng(seed).normal(size=(side, side)))
    image = scipy.fft.irfft2(spectrum / np.maximum(np.hypot(rows[:, None], cols), 1 / side), s=(side, side))
    return ((image - image.mean()) / image.std()).astype(np.float32)


def margin_cells(wavelengths: Sequence[float]) -> int:
    """Cells at the border whose answers look outside the image."""
    reach = GaborBank(tuple(wavelengths), ORIENTATIONS, samples=4).reach_px((1.0, 1.0), STEP_PX)
    return -(-max(reach) // STEP_PX)


def pyramid_room(side: int) -> list[F32]:
    """Room for the levels of the pyramid: made once, as for the chunks of a sweep."""
    return [np.zeros((side >> k) * ((side >> k) + 2), np.float32) for k in range(4)]


def fused_bank(
    image: F32,
    wavelengths: Sequence[float],
    orientations: int = ORIENTATIONS,
    samples: int = 4,
    room: Sequence[F32 | None] = (None, None, None, None),
) -> F32:
    """The bank of `hrt segment`: amplitudes of all cells but the margin."""
    filters = GaborBank(tuple(wavelengths), orientations, samples=samples).filters((1.0, 1.0), STEP_PX)
    levels = [columns_apart(image, room[0])]
    for octave in range(max(one.level for one in filters)):
        levels.append(halve(levels[-1], room[octave + 1]))
    margin = margin_cells(wavelengths)
    rows, cols = (side // STEP_PX - 2 * margin for side in image.shape)
    out = np.empty((len(filters), orientations, rows, cols), np.float32)
    for one, answer in zip(filters, out, strict=True):
        per_cell = STEP_PX >> one.level
        amplitudes(levels[one.level], one, (margin * per_cell, margin * per_cell), per_cell, answer)
    return out


def _angles() -> list[float]:
    return [math.pi * k / ORIENTATIONS for k in range(ORIENTATIONS)]


def _per_cell(amplitude: NDArray[np.floating]) -> F32:
    rows, cols = (side // STEP_PX for side in amplitude.shape)
    return amplitude.reshape(rows, STEP_PX, cols, STEP_PX).mean(axis=(1, 3)).astype(np.float32)


def scikit_bank(image: F32, wavelengths: Sequence[float]) -> F32:
    """`skimage.filters.gabor`, as its documentation uses it."""
    return np.array(
        [[_per_cell(np.hypot(*gabor(image, 1 / one, theta=theta))) for theta in _angles()] for one in wavelengths]
    )


def filter2d_bank(image: F32, wavelengths: Sequence[float]) -> F32:
    """`cv2.filter2D` with the real and the imaginary part of scikit-image's kernels, at every pixel."""
    out = []
    for one in wavelengths:
        kernels = [gabor_kernel(1 / one, theta=theta) for theta in _angles()]
        parts = [(np.float32(kernel.real), np.float32(kernel.imag)) for kernel in kernels]
        answers = [[cv2.filter2D(image, cv2.CV_32F, part) for part in pair] for pair in parts]
        out.append([_per_cell(cv2.magnitude(*pair)) for pair in answers])
    return np.array(out)


def kernel_spectra(shape: tuple[int, int], wavelengths: Sequence[float]) -> list[list[NDArray[np.complex64]]]:
    """Spectra of scikit-image's kernels, centred on pixel (0, 0) of an image of `shape`."""
    spectra = []
    for one in wavelengths:
        placed = []
        for theta in _angles():
            kernel = gabor_kernel(1 / one, theta=theta)
            plane = np.zeros(shape, np.complex64)
            plane[: kernel.shape[0], : kernel.shape[1]] = kernel
            plane = np.roll(plane, (-(kernel.shape[0] // 2), -(kernel.shape[1] // 2)), axis=(0, 1))
            placed.append(scipy.fft.fft2(plane))
        spectra.append(placed)
    return spectra


def fft_bank(image: F32, spectra: list[list[NDArray[np.complex64]]]) -> F32:
    """Products of spectra in single precision; those of the kernels are given, as they serve any number of blocks."""
    spectrum = scipy.fft.fft2(image)
    return np.array(
        [[_per_cell(np.abs(scipy.fft.ifft2(spectrum * one, overwrite_x=True))) for one in scale] for scale in spectra]
    )


def lowest_correlation(ours: F32, theirs: F32, wavelengths: Sequence[float]) -> float:
    """The lowest correlation, over wavelengths, of patch energies where the kernel lies inside the image."""
    correlations = []
    for wavelength, *pair in zip(wavelengths, ours, theirs, strict=True):
        edge = math.ceil(KERNEL_REACH * SIGMA_OVER_LAMBDA * wavelength / STEP_PX)
        inner = (planes[:, edge:-edge, edge:-edge] for planes in pair)
        energies = [np.ravel([cv2.GaussianBlur(plane, (0, 0), WINDOW_CELLS) for plane in planes]) for planes in inner]
        correlations.append(float(np.corrcoef(*energies)[0, 1]))
    return min(correlations)


def haralick_cpu_s(side: int, radius_px: int, folder: Path) -> float:
    """CPU seconds of Orfeo's Haralick textures (8 figures, one direction) at our output step."""
    path = folder / f"grey_{side}.tif"
    if not path.exists():
        grey = np.clip(128 + 40 * natural_image(side), 0, 255).astype(np.uint8)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path, "w", driver="GTiff", width=side, height=side, count=1, dtype="uint8") as raster:
                raster.write(grey, 1)
    radius = str(radius_px)
    options = ["-channel", "1", "-step", str(STEP_PX), "-parameters.xrad", radius, "-parameters.yrad", radius]
    command = [ORFEO, "-in", str(path), *options, "-out", str(folder / "haralick.tif"), "float"]
    return process_cost(command, ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS="1", OMP_NUM_THREADS="1").cpu_s


def orfeo_rows(side: int, ours_mpx_s: float) -> list[dict[str, object]]:
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for radius in ORFEO_RADII_PX:
            # What it takes to start is not the filter's: a small image tells how much that is.
            start_s = min(haralick_cpu_s(64, radius, folder) for _ in range(3))
            cpu_s = haralick_cpu_s(side, radius, folder) - start_s
            rows.append(_row(f"Orfeo Haralick, radius {radius}", "-", side, cpu_s, ours_mpx_s, None))
    return rows


def _row(
    bank: str, wavelengths: str, side: int, cpu_s: float, ours_mpx_s: float, correlation: float | None
) -> dict[str, object]:
    speed = side * side / 1e6 / cpu_s
    return {
        "bank": bank,
        "wavelengths px": wavelengths,
        "side px": side,
        "cpu s": cpu_s,
        "Mpx/cpu-s": speed,
        "hrt is faster by": ours_mpx_s / speed,
        "correlation": correlation,
    }


def speed_kernel(effort: Effort) -> list[Table]:
    """The fused bank beside other ways to the same energies, each on one thread."""
    fused_bank(natural_image(256), WAVELENGTHS_PX)
    rows, ours = [], {}
    for wavelengths in (WAVELENGTHS_PX, SHORT_WAVELENGTHS_PX):
        image = natural_image(effort.bank_px + 2 * STEP_PX * margin_cells(wavelengths))
        room = pyramid_room(len(image))
        cpu_s, _ = cpu_seconds(lambda image=image, w=wavelengths, r=room: fused_bank(image, w, room=r), repeats=REPEATS)
        ours[wavelengths] = effort.bank_px**2 / 1e6 / cpu_s
        rows.append(_row("hrt", _span(wavelengths), effort.bank_px, cpu_s, ours[wavelengths], None))
    image = natural_image(effort.bank_px + 2 * STEP_PX * margin_cells(WAVELENGTHS_PX))
    site = PRESETS["site"]
    room = pyramid_room(len(image))
    cpu_s, _ = cpu_seconds(
        lambda: fused_bank(image, WAVELENGTHS_PX, site.orientations, site.samples, room), repeats=REPEATS
    )
    rows.append(_row("hrt, as for sites", _span(WAVELENGTHS_PX), effort.bank_px, cpu_s, ours[WAVELENGTHS_PX], None))

    spectra = kernel_spectra((effort.slow_px, effort.slow_px), WAVELENGTHS_PX)
    others: list[tuple[str, int, Sequence[float], Bank]] = [
        ("cv2.filter2D", effort.slow_px, WAVELENGTHS_PX, filter2d_bank),
        ("scipy.fft, float32", effort.slow_px, WAVELENGTHS_PX, lambda image, _: fft_bank(image, spectra)),
        ("scikit-image gabor", effort.crop_px, SHORT_WAVELENGTHS_PX, scikit_bank),
        ("scikit-image gabor", effort.crop_px, WAVELENGTHS_PX, scikit_bank),
    ]
    for name, side, wavelengths, bank in others:
        margin = STEP_PX * margin_cells(wavelengths)
        image = natural_image(side + 2 * margin)
        inner = np.ascontiguousarray(image[margin:-margin, margin:-margin])
        cpu_s, theirs = cpu_seconds(lambda bank=bank, inner=inner, w=wavelengths: bank(inner, w))
        correlation = lowest_correlation(fused_bank(image, wavelengths), theirs, wavelengths)
        rows.append(_row(name, _span(wavelengths), side, cpu_s, ours[wavelengths], correlation))
    notes = [
        f"{ORIENTATIONS} orientations, energies every {STEP_PX} px, one thread; correlation: of patch energies with "
        "hrt's, the lowest of the wavelengths.",
        f"As for sites: {site.orientations} orientations, {site.samples} amplitudes along a cell.",
    ]
    if shutil.which(ORFEO):
        rows += orfeo_rows(effort.bank_px, ours[WAVELENGTHS_PX])
        notes.append(
            f"Orfeo {_orfeo_version()}: 8 Haralick figures of one direction, every {STEP_PX} px, start-up off."
        )
    else:
        notes.append(f"Orfeo left out: no {ORFEO} here (Debian: otb-bin).")
    return [Table("Gabor banks", rows, notes)]


def _span(wavelengths: Sequence[float]) -> str:
    return f"{wavelengths[0]:g}..{wavelengths[-1]:g}"


def _orfeo_version() -> str:
    told = subprocess.run([ORFEO, "-help"], capture_output=True, text=True, check=False)
    found = re.search(r"version ([\d.]+)", told.stdout + told.stderr)
    return found[1] if found else ""
