from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hrt_cli.raster.windows import Planes, Window
from hrt_cli.texture.cells import measured
from hrt_cli.texture.cluster import cluster
from hrt_cli.texture.model import TextureModel
from hrt_cli.texture.segment import SegmentSpec, SegmentStats, draw_sample, predict

DATA = Path(__file__).parents[2].parent / "shared" / "data"


@dataclass
class ArraySource:
    """An image in memory; it fills what lies outside with a loud colour, for that must not matter."""

    rgb: NDArray[np.uint8]
    valid: NDArray[np.bool_] | None = None
    pixel_m: tuple[float, float] = (1.0, 1.0)
    anchor: tuple[int, int] = (0, 0)
    windows: list[Window] = field(default_factory=list)

    @property
    def shape(self) -> tuple[int, int]:
        return self.rgb.shape[:2]

    def read_planes(self, window: Window, out: Planes | None = None) -> Planes:
        self.windows.append(window)
        rgb = np.full((window.height, window.width, 3), (255, 0, 200), np.uint8)
        valid = np.zeros((window.height, window.width), bool)
        inside = window.clipped(self.shape)
        if inside.height and inside.width:
            top, left = inside.row - window.row, inside.col - window.col
            place = (slice(top, top + inside.height), slice(left, left + inside.width))
            rgb[place] = self.rgb[inside.slices]
            valid[place] = True if self.valid is None else self.valid[inside.slices]
        if out is None:
            return np.ascontiguousarray(np.moveaxis(rgb, -1, 0)), valid
        out[0][:], out[1][:] = np.moveaxis(rgb, -1, 0), valid
        return out

    def model(self, spec: SegmentSpec, **options: int) -> TextureModel:
        """Fit a model on it."""
        with measured(self, spec.settings(self.pixel_m), **options) as cells:
            assert spec.classes is not None
            sample = draw_sample(cells, spec.seed)
            return cluster(sample, cells.settings, cells.pixel_m, spec.classes, spec.seed)

    def classes(self, model: TextureModel, **options: int) -> tuple[NDArray[np.uint8], SegmentStats]:
        """Classify it; checks the order and the shapes of the blocks."""
        out = np.full(self.shape, 77, np.uint8)
        seen: list[tuple[int, int]] = []

        def sink(window: Window, classes: NDArray[np.uint8]) -> None:
            assert classes.shape == (window.height, window.width)
            seen.append((window.row, window.col))
            out[window.slices] = classes

        rows_px = options.pop("rows_px", 1024)
        with measured(self, model.settings, rows_px=rows_px, workers=options.get("workers", 1)) as cells:
            stats = predict(cells, model, sink, **options)
        assert seen == sorted(seen)
        return out, stats


def patchwork(rows: int, cols: int, seed: int = 0) -> NDArray[np.uint8]:
    """Four textures in four quarters: fine noise, coarse noise, stripes, smooth; each with its own tint."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols]
    coarse = np.kron(rng.normal(size=(-(-rows // 8), -(-cols // 8))), np.ones((8, 8)))[:rows, :cols]
    kinds = [
        30 * rng.normal(size=(rows, cols)),
        30 * coarse,
        40 * np.sin(2 * np.pi * x / 8),
        2 * rng.normal(size=(rows, cols)),
    ]
    tints = np.array([[90, 110, 70], [120, 120, 125], [150, 130, 110], [70, 90, 120]])
    quarter = 2 * (y >= rows // 2) + (x >= cols // 2)
    texture = np.choose(quarter, kinds)
    return np.clip(tints[quarter] + texture[..., None], 0, 255).astype(np.uint8)


@pytest.fixture
def site() -> ArraySource:
    """A small site of four textures with a hole, a ragged edge and an anchor off the lattice."""
    rgb = patchwork(300, 330)
    rows, cols = np.mgrid[: rgb.shape[0], : rgb.shape[1]]
    valid = np.hypot(rows - 140, cols - 200) > 25
    valid &= cols > 10 + 6 * np.sin(rows / 9)
    return ArraySource(rgb, valid, pixel_m=(0.05, 0.05), anchor=(7, 1021))
