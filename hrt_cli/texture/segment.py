"""Fit texture classes on a sample of an image, and apply them block by block."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.windows import ImageSource, Window, blocks
from hrt_cli.texture.cluster import Sample, cluster
from hrt_cli.texture.features import FEATURE_SETS, ROTATIONS, Extractor, FeatureSettings
from hrt_cli.texture.label import NODATA, cell_scores, count_classes, label
from hrt_cli.texture.lattice import CellGrid
from hrt_cli.texture.model import MAX_CLASSES, TextureModel

SAMPLE_TILE_PX = 512
"""Side of the tiles that the sample is drawn from; fixed, so that the sample depends on the seed alone."""
MAX_SAMPLE_TILES = 64
MAX_SAMPLE = 40_000
"""Patches K-means sees."""
STRIP_PX = 2048
"""Blocks of a row are worked on together up to this width."""
_LOOK_AHEAD = 2
"""Blocks in work or waiting for their turn, per worker."""

Sink = Callable[[Window, NDArray[np.uint8]], None]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class SegmentSpec:
    """What to look for; lengths in pixels of the image that is fitted.

    Parameters
    ----------
    classes : int
        Number of texture classes, 2 to 255.
    features : {"site", "paper", "texture"}
        Colour and texture of a site; hue histogram and Gabor order statistics, whitened; Gabor alone, whitened.
    rotation : {"invariant", "aware", "sorted"}
        Whether one texture turned is the same texture.
    wavelengths_m : tuple of float, optional
        Wavelengths on the ground; by default 4, 8, 16 and 32 pixels.
    seed : int
        Of the sample and of K-means.
    orientations : int
    texture_sigma_px, colour_sigma_px, contrast_sigma_px : float
        Windows over which energy and colour are averaged, and luminance is levelled.
    step_px : int
        Distance between patches, a power of two.
    """

    classes: int
    features: str = "site"
    rotation: str = "invariant"
    wavelengths_m: tuple[float, ...] | None = None
    seed: int = 0
    orientations: int = 6
    texture_sigma_px: float = 16.0
    colour_sigma_px: float = 8.0
    contrast_sigma_px: float = 12.0
    step_px: int = 8

    def settings(self, pixel_m: tuple[float, float]) -> FeatureSettings:
        """Return the settings in metres for an image with these pixels.

        Raises
        ------
        ArgumentError
            The number of classes, a name or a wavelength is out of range.
        """
        if not 2 <= self.classes <= MAX_CLASSES:
            raise ArgumentError(f"{self.classes} classes asked: choose 2 to {MAX_CLASSES}")
        if self.features not in FEATURE_SETS:
            raise ArgumentError(f"unknown feature set {self.features!r}: choose {', '.join(FEATURE_SETS)}")
        if self.rotation not in ROTATIONS:
            raise ArgumentError(f"unknown rotation mode {self.rotation!r}: choose {', '.join(ROTATIONS)}")
        ground = max(pixel_m)
        wavelengths = self.wavelengths_m
        if wavelengths is None:
            wavelengths = tuple(px * ground for px in DEFAULT_WAVELENGTHS_PX)
        if not wavelengths or not all(np.isfinite(one) and one > 0 for one in wavelengths):
            raise ArgumentError(f"wavelengths must be lengths above 0 m, not {wavelengths}")
        return FeatureSettings(
            features=self.features,
            rotation=self.rotation,
            wavelengths_m=tuple(sorted(wavelengths)),
            orientations=self.orientations,
            texture_sigma_m=self.texture_sigma_px * ground,
            colour_sigma_m=self.colour_sigma_px * ground,
            contrast_sigma_m=self.contrast_sigma_px * ground,
            step_m=self.step_px * ground,
        )


DEFAULT_WAVELENGTHS_PX = (4.0, 8.0, 16.0, 32.0)


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


def fit(source: ImageSource, spec: SegmentSpec, *, workers: int = 1, progress: Progress = silent) -> TextureModel:
    """Find the texture classes of an image.

    The sample is drawn from tiles of a fixed size that the seed alone chooses (all of them where the image is small),
    so the model depends neither on blocks nor on workers.

    Parameters
    ----------
    source : ImageSource
    spec : SegmentSpec
    workers : int
        Threads that measure tiles.
    progress : Progress
        Counts tiles, then one step for the clustering.

    Raises
    ------
    ArgumentError
        The specification is out of range, no pixel is valid, or the image holds fewer textures than classes.
    """
    settings = spec.settings(source.pixel_m)
    extractor = Extractor(settings, source.pixel_m)
    sample = _draw_sample(source, extractor, spec.seed, workers, progress)
    return cluster(sample, settings, source.pixel_m, spec.classes, spec.seed)


def predict(
    source: ImageSource,
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
    source : ImageSource
    model : TextureModel
    sink : callable
        Called as `sink(window, classes)` for every block, row by row, from this thread; `classes` is
        uint8 [height, width], `NODATA` where the image has none.
    block_px : int
        Side of a block; the classes do not depend on it.
    workers : int
        Threads that measure blocks; the classes do not depend on it.
    progress : Progress
        Counts blocks.

    Raises
    ------
    ArgumentError
        The image is too coarse or too fine for the model's wavelengths.
    """
    extractor = Extractor(model.settings, source.pixel_m)
    mean, gain, offset = model.linear_scores()
    windows = list(blocks(source.shape, block_px, source.anchor))

    def classify(strip: list[Window]) -> tuple[NDArray[np.uint8], int]:
        return _classify(source, extractor, _union(strip), mean, gain, offset)

    counts = np.zeros(256, np.int64)
    valid_pixels = done = 0
    strips = list(_strips(windows))
    with closing(_in_order(classify, strips, workers)) as results:
        for strip, (classes, valid) in zip(strips, results, strict=True):
            counts += count_classes(classes)
            valid_pixels += valid
            for window in strip:
                left = window.col - strip[0].col
                sink(window, np.ascontiguousarray(classes[:, left : left + window.width]))
                done += 1
                progress(done, len(windows))
    return SegmentStats(
        class_pixels=tuple(int(n) for n in counts[: model.classes]),
        pixels=source.shape[0] * source.shape[1],
        valid_pixels=valid_pixels,
    )


def _strips(windows: list[Window]) -> Iterator[list[Window]]:
    """Join neighbouring blocks of a row: the halo is shared, and long lines suit the kernels."""
    strip: list[Window] = []
    for window in windows:
        if strip and (window.row != strip[0].row or _union([*strip, window]).width > STRIP_PX):
            yield strip
            strip = []
        strip.append(window)
    if strip:
        yield strip


def _union(strip: list[Window]) -> Window:
    first, last = strip[0], strip[-1]
    return Window(first.row, first.col, first.height, last.col + last.width - first.col)


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


def _draw_sample(source: ImageSource, extractor: Extractor, seed: int, workers: int, progress: Progress) -> Sample:
    tiles = list(blocks(source.shape, SAMPLE_TILE_PX, source.anchor))
    order = np.random.default_rng(seed).permutation(len(tiles))
    quota = -(-MAX_SAMPLE // min(len(tiles), MAX_SAMPLE_TILES))

    def measure(index: int) -> Sample | None:
        return _measure(source, extractor, tiles[index], quota, np.random.default_rng([seed, index]))

    parts: list[Sample] = []
    wanted = min(len(tiles), MAX_SAMPLE_TILES)
    with closing(_in_order(measure, (int(index) for index in order), workers)) as results:
        for part in results:
            if part is not None:
                parts.append(part)
                progress(len(parts), wanted)
            if len(parts) == wanted:
                break
    if not parts:
        raise ArgumentError("no valid pixel in the image (no patch of it is half valid): there is nothing to segment")
    return Sample.joined(parts)


def _measure(
    source: ImageSource, extractor: Extractor, tile: Window, quota: int, rng: np.random.Generator
) -> Sample | None:
    """Draw up to `quota` patches of a tile; None where no patch is at least half valid."""
    grid = CellGrid.covering(tile, source.anchor, extractor.step_px)
    rgb, valid = source.read(extractor.read_window(grid, source.anchor))
    halo_r, halo_c = extractor.halo_cells
    step = extractor.step_px
    if not valid[halo_r * step : -halo_r * step, halo_c * step : -halo_c * step].any():
        return None
    patches = extractor.patches(rgb, valid)
    chosen = np.flatnonzero(patches.usable.ravel())
    if len(chosen) == 0:
        return None
    if len(chosen) > quota:
        chosen = np.sort(rng.choice(chosen, quota, replace=False))
    channels = len(patches.values)
    return Sample(
        values=patches.values.reshape(channels, -1)[:, chosen].T.astype(np.float64),
        rgb=patches.rgb.reshape(3, -1)[:, chosen].T.astype(np.float64),
        roughness=patches.roughness.ravel()[chosen].astype(np.float64),
    )


def _classify(
    source: ImageSource,
    extractor: Extractor,
    window: Window,
    mean: NDArray[np.float32],
    gain: NDArray[np.float32],
    offset: NDArray[np.float32],
) -> tuple[NDArray[np.uint8], int]:
    """Return the classes of one block and its number of valid pixels."""
    grid = CellGrid.covering(window, source.anchor, extractor.step_px).grown(1, 1)
    tile = extractor.read_window(grid, source.anchor)
    rgb, valid = source.read(tile)
    top, left = window.row - tile.row, window.col - tile.col
    inner = np.ascontiguousarray(valid[top : top + window.height, left : left + window.width])
    count = int(np.count_nonzero(inner))
    if count == 0:
        return np.full(inner.shape, NODATA, np.uint8), 0
    patches = extractor.patches(rgb, valid)
    scores = cell_scores(patches.values, mean, gain, offset)
    step = extractor.step_px
    first_row = window.row + source.anchor[0] - grid.row * step
    first_col = window.col + source.anchor[1] - grid.col * step
    return label(scores, patches.defined, inner, step, first_row, first_col), count
