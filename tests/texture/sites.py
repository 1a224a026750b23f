"""Real sites with polygons drawn by hand: what the tests and the benchmarks of the texture classes share."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from hrt_cli.raster.classes import NODATA

POLYGONS: dict[str, dict[str, list[list[list[int]]]]] = json.loads(
    (Path(__file__).parent / "polygons.json").read_text(encoding="utf-8")
)
"""File of a site -> label -> polygons as (column, row) pixels."""

Mask = NDArray[np.bool_]
U8 = NDArray[np.uint8]


def read_site(path: Path) -> tuple[U8, Mask, tuple[float, float]]:
    """Return the picture, its valid pixels and the pixel's height and width in metres."""
    import rasterio

    with rasterio.open(path) as raster:
        rgb = np.ascontiguousarray(np.moveaxis(raster.read([1, 2, 3]), 0, -1))
        return rgb, raster.dataset_mask() > 0, (raster.res[1], raster.res[0])


def truth_of(name: str, valid: Mask) -> NDArray[np.int8]:
    """Return the label of every pixel inside a polygon, −1 elsewhere."""
    truth = np.full(valid.shape, -1, np.int8)
    for index, polygons in enumerate(POLYGONS[name].values()):
        for polygon in polygons:
            inside = np.zeros(valid.shape, np.uint8)
            cv2.fillPoly(inside, [np.array(polygon, np.int32)], 1)
            truth[(inside > 0) & valid] = index
    return truth


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
