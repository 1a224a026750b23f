"""Real sites with polygons drawn by hand: what the tests and the benchmarks of the texture classes share."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from hrt_cli.raster.classes import NODATA
from hrt_cli.raster.image import open_image
from hrt_cli.raster.windows import Window

POLYGONS: dict[str, Any] = json.loads((Path(__file__).parent / "polygons.json").read_text(encoding="utf-8"))
"""A file, or a folder of tiles (tile -> ...) -> label -> polygons as (column, row) pixels.

The tiles of a folder are pictures of different places, each with light of its own: each is a site, and `read_site`
also lays them side by side for who wants them as one.

Labels name what can be told from above at the scale of a patch: at SJER the road and bare slabs are one pale ground,
and what is narrower than about 25 pixels (stones, the tyre track of the savanna) has none.
"""
FOLDERS = [name for name in POLYGONS if "/" not in name]
SITES = [name for name in POLYGONS if name not in FOLDERS] + [
    f"{name}/{tile}" for name in FOLDERS for tile in POLYGONS[name]
]
"""Every file with polygons, as a path in the folder of the real data."""
GAP_PX = 64
"""Tiles are laid beside one another with so much nodata between them."""

Mask = NDArray[np.bool_]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Site:
    """A picture with its polygons.

    Attributes
    ----------
    rgb : ndarray [rows, cols, 3] uint8
    valid : ndarray [rows, cols] bool
    truth : ndarray [rows, cols] int8
        Index of the label, −1 outside all polygons.
    labels : list of str
    pixel_m : (float, float)
    anchor : (int, int)
        Of the lattice; see `ImageSource`.
    """

    rgb: U8
    valid: Mask
    truth: NDArray[np.int8]
    labels: list[str]
    pixel_m: tuple[float, float]
    anchor: tuple[int, int]


def read_site(data: Path, name: str) -> Site:
    """Read one of `SITES` from the folder of the real data, or a folder of `POLYGONS` with its tiles side by side."""
    if not (data / name).is_dir():
        folder, _, tile = name.partition("/")
        drawn = POLYGONS[name] if name in POLYGONS else POLYGONS[folder][tile]
        return _read(data / name, drawn, list(drawn))
    labels = list(dict.fromkeys(label for drawn in POLYGONS[name].values() for label in drawn))
    tiles = [_read(path, POLYGONS[name].get(path.name, {}), labels) for path in sorted((data / name).glob("*.tif"))]
    around = ((GAP_PX, GAP_PX), (GAP_PX, GAP_PX))
    return Site(
        rgb=np.concatenate([np.pad(one.rgb, (*around, (0, 0))) for one in tiles], axis=1),
        valid=np.concatenate([np.pad(one.valid, around) for one in tiles], axis=1),
        truth=np.concatenate([np.pad(one.truth, around, constant_values=-1) for one in tiles], axis=1),
        labels=labels,
        pixel_m=tiles[0].pixel_m,
        anchor=(0, 0),
    )


def _read(path: Path, drawn: dict[str, list[list[list[int]]]], labels: list[str]) -> Site:
    with open_image(path) as image:
        rgb, valid = image.read(Window(0, 0, *image.shape))
        truth = np.full(image.shape, -1, np.int8)
        for label, polygons in drawn.items():
            for polygon in polygons:
                inside = np.zeros(image.shape, np.uint8)
                cv2.fillPoly(inside, [np.array(polygon, np.int32)], 1)
                truth[(inside > 0) & valid] = labels.index(label)
        return Site(rgb, valid, truth, labels, image.pixel_m, image.anchor)


def recalls(classes: U8, truth: NDArray[np.int8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Recall of each label when every class votes for one label, and the shares [256 classes, labels]."""
    drawn = truth >= 0
    table = np.zeros((256, truth.max() + 1))
    np.add.at(table, (classes[drawn], truth[drawn]), 1)
    table /= table.sum(axis=0)
    table[NODATA] = 0
    vote = table.argmax(axis=1)
    return np.array([table[vote == label, label].sum() for label in range(table.shape[1])]), table


def cell_colours(rgb: U8, valid: Mask, step: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean CIE Lab [3, rows, cols] of cells of `step` pixels, and the share of each that is valid."""
    rows, cols = (side // step for side in valid.shape)
    inside = valid[: rows * step, : cols * step, None].astype(np.float32)
    values = np.concatenate([rgb[: rows * step, : cols * step] * inside, inside], axis=2)
    sums = values.reshape(rows, step, cols, step, 4).sum(axis=(1, 3))
    mean = sums[..., :3] / np.maximum(sums[..., 3:], 1)
    return np.moveaxis(cv2.cvtColor(mean / np.float32(255), cv2.COLOR_RGB2LAB), -1, 0), sums[..., 3] / step**2


def smoothed(channels: list[NDArray[np.float32]], share: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Average channels over a Gaussian window, counting each cell with its share."""
    weight = cv2.GaussianBlur(share, (0, 0), sigma) + 1e-6
    return np.stack([cv2.GaussianBlur(one * share, (0, 0), sigma) / weight for one in channels])


def spread(cells: U8, shape: tuple[int, int], step: int) -> U8:
    """Return the classes of pixels from those of cells, `NODATA` beyond the last whole cell."""
    full = np.full(shape, NODATA, np.uint8)
    full[: cells.shape[0] * step, : cells.shape[1] * step] = cells.repeat(step, axis=0).repeat(step, axis=1)
    return full


def baseline(rgb: U8, valid: Mask, classes: int) -> U8:
    """Mean Lab and local contrast in a Gaussian window, standardised, K-means: what anyone would write first."""
    step = 4
    cells, share = cell_colours(rgb, valid, step)
    smooth = smoothed([*cells, cells[0] ** 2], share, 3)
    smooth[3] = np.sqrt(np.maximum(smooth[3] - smooth[0] ** 2, 0))
    usable = share >= 0.5
    x = smooth[:, usable].T
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    kmeans = KMeans(classes, n_init=5, random_state=0).fit(x[:: max(len(x) // 30_000, 1)])
    out = np.full(usable.shape, NODATA, np.uint8)
    out[usable] = kmeans.predict(x)
    return spread(out, valid.shape, step)
