from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hrt_cli.raster.windows import Window

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

    def read(self, window: Window) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        self.windows.append(window)
        rgb = np.full((window.height, window.width, 3), (255, 0, 200), np.uint8)
        valid = np.zeros((window.height, window.width), bool)
        inside = window.clipped(self.shape)
        if inside.height and inside.width:
            top, left = inside.row - window.row, inside.col - window.col
            place = (slice(top, top + inside.height), slice(left, left + inside.width))
            rgb[place] = self.rgb[inside.slices]
            valid[place] = True if self.valid is None else self.valid[inside.slices]
        return rgb, valid


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
