"""Fit texture classes on a sample of an image, and apply them block by block."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.windows import Window, blocks
from hrt_cli.texture.cells import Cells
from hrt_cli.texture.cluster import Sample
from hrt_cli.texture.discriminate import TEMPERATURE, Tile
from hrt_cli.texture.features import Windows
from hrt_cli.texture.label import NODATA, cell_scores, label
from hrt_cli.texture.lattice import CellGrid
from hrt_cli.texture.measure import Gauge
from hrt_cli.texture.model import MAX_CLASSES, TextureModel
from hrt_cli.texture.settings import FEATURE_SETS, PRESETS, ROTATIONS, STEP_PX, FeatureSettings
from hrt_cli.texture.vote import halo_cells, vote

SAMPLE_TILE_PX = 512
"""Side of the tiles that the sample is drawn from; fixed, so that the sample depends on the seed alone."""
MAX_SAMPLE_TILES = 48
MAX_SAMPLE = 40_000
"""Patches in all, unless neighbours count: then tiles are taken whole."""
STRIP_PX = 4096
"""Blocks of a row are worked on together up to this width."""
_LOOK_AHEAD = 2
"""Blocks in work or waiting for their turn, per worker."""

F32 = NDArray[np.float32]
Sink = Callable[[Window, NDArray[np.uint8]], None]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class SegmentSpec:
    """What to look for.

    Parameters
    ----------
    classes : int or None
        Number of texture classes, 2 to 255; None to choose it from the image.
    features : {"site", "paper", "texture"}
        Colour and texture of a site; hue histogram and Gabor order statistics, whitened; Gabor alone, whitened.
    rotation : {"invariant", "aware", "sorted"}
        Whether one texture turned is the same texture.
    wavelengths_m : tuple of float, optional
        Wavelengths on the ground; by default those of the feature set's preset.
    seed : int
        Of the sample and of K-means.
    scale_invariant : bool
        Whether one texture seen larger is the same texture.
    """

    classes: int | None
    features: str = "site"
    rotation: str = "invariant"
    wavelengths_m: tuple[float, ...] | None = None
    seed: int = 0
    scale_invariant: bool = False

    def settings(self, pixel_m: tuple[float, float]) -> FeatureSettings:
        """Return the settings in metres for an image with these pixels.

        Raises
        ------
        ArgumentError
            The number of classes, a name or a wavelength is out of range.
        """
        if self.classes is not None and not 2 <= self.classes <= MAX_CLASSES:
            raise ArgumentError(f"{self.classes} classes asked: choose 2 to {MAX_CLASSES}")
        if self.features not in FEATURE_SETS:
            raise ArgumentError(f"unknown feature set {self.features!r}: choose {', '.join(FEATURE_SETS)}")
        if self.rotation not in ROTATIONS:
            raise ArgumentError(f"unknown rotation mode {self.rotation!r}: choose {', '.join(ROTATIONS)}")
        ground, preset = max(pixel_m), PRESETS[self.features]
        wavelengths = self.wavelengths_m
        if wavelengths is None:
            wavelengths = tuple(px * ground for px in preset.wavelengths_px)
        if not wavelengths or not all(np.isfinite(one) and one > 0 for one in wavelengths):
            raise ArgumentError(f"wavelengths must be lengths above 0 m, not {wavelengths}")
        return FeatureSettings(
            features=self.features,
            rotation=self.rotation,
            wavelengths_m=tuple(sorted(wavelengths)),
            orientations=preset.orientations,
            texture_sigma_m=preset.texture_sigma_px * ground,
            fit_sigma_m=preset.fit_sigma_px * ground,
            colour_sigma_m=preset.colour_sigma_px * ground,
            contrast_sigma_m=preset.contrast_sigma_px * ground,
            step_m=STEP_PX * ground,
            scale_invariant=self.scale_invariant,
        )


@dataclass(frozen=True)
class SegmentStats:
    """What `predict` wrote.

    Attributes
    ----------
    class_pixels : tuple of int
        Pixels of each class.
    pixels : int
        Pixels of the raster.
    valid_pixels : int
        Pixels that hold data in the source.
    """

    class_pixels: tuple[int, ...]
    pixels: int
    valid_pixels: int

    @property
    def class_fractions(self) -> tuple[float, ...]:
        """Share of each class among the classified pixels; zeros where there are none."""
        total = max(sum(self.class_pixels), 1)
        return tuple(count / total for count in self.class_pixels)


def draw_sample(cells: Cells, seed: int) -> Sample:
    """Draw patches from all over an image.

    They come from tiles of a fixed size that the seed alone chooses (all of them where the image is small), so the
    sample depends neither on blocks nor on workers.

    Raises
    ------
    ArgumentError
        No patch is at least half valid.
    """
    windows = Windows(cells.settings, cells.pixel_m, cells.grid.step_px)
    tiles = list(blocks(cells.shape, SAMPLE_TILE_PX, cells.anchor))
    order = np.random.default_rng(seed).permutation(len(tiles))
    wanted = min(len(tiles), MAX_SAMPLE_TILES)
    quota = -(-MAX_SAMPLE // wanted)
    parts: list[Sample] = []
    for index in order:
        part = _draw(cells, windows, tiles[index], quota, np.random.default_rng([seed, index]))
        if part is not None:
            parts.append(part)
        if len(parts) == wanted:
            break
    if not parts:
        raise ArgumentError("no valid pixel in the image (no patch of it is half valid): there is nothing to segment")
    return Sample.joined(parts)


def predict(
    cells: Cells,
    model: TextureModel,
    sink: Sink,
    *,
    block_px: int = 1024,
    workers: int = 1,
    progress: Progress = silent,
) -> SegmentStats:
    """Classify every pixel of an image.

    Parameters
    ----------
    cells : Cells
        Measured with `model.settings`.
    model : TextureModel
    sink : callable
        Called as `sink(window, classes)` for every strip of blocks, row by row, from this thread; `classes` is
        uint8 [height, width], `NODATA` where the image has none.
    block_px : int
        Side of a block; the classes do not depend on it.
    workers : int
        Threads that work on blocks; the classes do not depend on it.
    progress : Progress
        Counts strips of blocks.
    """
    windows = Windows(cells.settings, cells.pixel_m, cells.grid.step_px)
    linear = model.linear_scores()
    strips = list(_strips(blocks(cells.shape, block_px, cells.anchor)))
    counts = np.zeros(256, np.int64)

    def classify(strip: Window) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        return _classify(cells, windows, strip, linear)

    with closing(_in_order(classify, strips, workers)) as results:
        for done, (strip, (classes, found)) in enumerate(zip(strips, results, strict=True), start=1):
            counts += found
            sink(strip, classes)
            progress(done, len(strips))
    return SegmentStats(
        class_pixels=tuple(int(n) for n in counts[: model.classes]),
        pixels=cells.shape[0] * cells.shape[1],
        valid_pixels=cells.valid_pixels,
    )


def _strips(parts: Iterable[Window]) -> Iterator[Window]:
    """Join neighbouring blocks of a row, so that they share a halo."""
    strip: Window | None = None
    for part in parts:
        if strip is None:
            strip = part
        elif part.row == strip.row and part.col + part.width - strip.col <= STRIP_PX:
            strip = replace(strip, width=part.col + part.width - strip.col)
        else:
            yield strip
            strip = part
    if strip is not None:
        yield strip


def halo_px(settings: FeatureSettings, pixel_m: tuple[float, float]) -> tuple[int, int]:
    """Return how far from a pixel others can change its class, along rows and columns."""
    gauge = Gauge(settings, pixel_m)
    halo = Windows(settings, pixel_m, gauge.step_px).halo_cells
    votes = halo_cells(settings.votes) if settings.discriminates else 0
    rows, cols = ((gauge.reach_cells[axis] + halo[axis] + votes + 2) * gauge.step_px for axis in (0, 1))
    return rows, cols


def _in_order(work: Callable[[_Item], _Result], items: Iterable[_Item], workers: int) -> Generator[_Result]:
    """Map in threads, in order, with a bounded number of results alive; an interruption cancels the rest."""
    if workers <= 1:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(workers)
    waiting: deque[Future[_Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > _LOOK_AHEAD * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _draw(cells: Cells, windows: Windows, tile: Window, quota: int, rng: np.random.Generator) -> Sample | None:
    """Draw up to `quota` patches of a tile; None where no patch is at least half valid."""
    grid = CellGrid.covering(tile, cells.anchor, cells.grid.step_px)
    patches = windows.patches(cells.read(grid.grown(*windows.halo_cells)))
    chosen = np.flatnonzero(patches.usable.ravel())
    if len(chosen) == 0:
        return None
    tiles = []
    if cells.settings.discriminates:
        tiles = [Tile(windows.wide(cells.read(grid.grown(*windows.fit_halo_cells))), patches.usable)]
    elif len(chosen) > quota:
        chosen = np.sort(rng.choice(chosen, quota, replace=False))
    channels = len(patches.values)
    return Sample(
        values=patches.values.reshape(channels, -1)[:, chosen].T.astype(np.float64),
        rgb=patches.rgb.reshape(3, -1)[:, chosen].T.astype(np.float64),
        roughness=patches.roughness.ravel()[chosen].astype(np.float64),
        plain=patches.plain.ravel()[chosen],
        tiles=tiles,
        apart_cells=windows.apart_cells,
    )


def _classify(
    cells: Cells, windows: Windows, window: Window, linear: tuple[F32, F32, F32]
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return the classes of one block, and how often each of 256 values stands there."""
    valid = cells.read_valid(window)
    if not valid.any():
        return np.full(valid.shape, NODATA, np.uint8), np.bincount([NODATA], [valid.size]).astype(np.int64)
    # Labels are interpolated between cells, and where cells vote, more of them are asked.
    beside = 1 + (halo_cells(cells.settings.votes) if cells.settings.discriminates else 0)
    grid = CellGrid.covering(window, cells.anchor, cells.grid.step_px).grown(beside, beside)
    patches = windows.patches(cells.read(grid.grown(*windows.halo_cells)))
    scores = cell_scores(patches.values, *linear)
    if cells.settings.discriminates:
        scores = vote(np.float32(TEMPERATURE / 2) * scores, patches.share, cells.settings.votes)
    step = grid.step_px
    first_row = window.row + cells.anchor[0] - grid.row * step
    first_col = window.col + cells.anchor[1] - grid.col * step
    return label(scores, patches.defined, valid, step, first_row, first_col)
