"""Real sites: polygons drawn by hand, as (column, row) pixels, against the classes found without them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import DATA, ArraySource
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from hrt_cli.raster.windows import Window
from hrt_cli.texture.colour import cell_means, lab
from hrt_cli.texture.segment import NODATA, SegmentSpec, fit, predict

pytestmark = pytest.mark.real

POLYGONS = json.loads((Path(__file__).parent / "polygons.json").read_text())
U8 = NDArray[np.uint8]


def load(name: str) -> ArraySource:
    rasterio = pytest.importorskip("rasterio")
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no real data: {name} is absent")
    with rasterio.open(path) as raster:
        rgb = np.ascontiguousarray(np.moveaxis(raster.read([1, 2, 3]), 0, -1))
        return ArraySource(rgb, raster.dataset_mask() > 0, (raster.res[1], raster.res[0]))


def truth_of(name: str, source: ArraySource) -> NDArray[np.int8]:
    truth = np.full(source.shape, -1, np.int8)
    for index, polygons in enumerate(POLYGONS[name].values()):
        for polygon in polygons:
            inside = np.zeros(source.shape, np.uint8)
            cv2.fillPoly(inside, [np.array(polygon, np.int32)], 1)
            truth[(inside > 0) & source.valid] = index
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


def segment(source: ArraySource, classes: int) -> U8:
    out = np.full(source.shape, NODATA, np.uint8)

    def sink(window: Window, part: U8) -> None:
        out[window.slices] = part

    predict(source, fit(source, SegmentSpec(classes)), sink, block_px=1024)
    return out


def baseline(source: ArraySource, classes: int) -> U8:
    """Mean Lab and local contrast in a Gaussian window, standardised, K-means: what anyone would write first."""
    step = 4
    rows, cols = (n - n % step for n in source.shape)
    assert source.valid is not None
    mean, share = cell_means(source.rgb[:rows, :cols].copy(), source.valid[:rows, :cols].copy(), step)
    cells = lab(mean)
    weight = cv2.GaussianBlur(share, (0, 0), 3) + 1e-6
    smooth = [cv2.GaussianBlur(one * share, (0, 0), 3) / weight for one in (*cells, cells[0] ** 2)]
    smooth[3] = np.sqrt(np.maximum(smooth[3] - smooth[0] ** 2, 0))
    usable = share >= 0.5
    x = np.stack([one[usable] for one in smooth], axis=1)
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    kmeans = KMeans(classes, n_init=5, random_state=0).fit(x[:: max(len(x) // 30_000, 1)])
    out = np.full((rows // step, cols // step), NODATA, np.uint8)
    out[usable] = kmeans.predict(x)
    full = np.full(source.shape, NODATA, np.uint8)
    full[:rows, :cols] = np.kron(out, np.ones((step, step), np.uint8))
    return full


def test_roads_are_one_class_and_the_lawn_another() -> None:
    name = "brighton_beach/ortho_3cm.tif"
    source = load(name)
    truth = truth_of(name, source)
    recall, table = recalls(segment(source, 5), truth)
    labels = list(POLYGONS[name])
    road, lawn = labels.index("road"), labels.index("lawn")
    assert table[:, road].max() > 0.9
    assert table[:, lawn].max() > 0.95
    assert table[:, road].argmax() != table[:, lawn].argmax()
    assert recall.mean() > 0.88
    assert recall.mean() > recalls(baseline(source, 5), truth)[0].mean()


def test_an_off_road_site() -> None:
    name = "caliterra/ortho_5cm.tif"
    source = load(name)
    truth = truth_of(name, source)
    recall, _ = recalls(segment(source, 6), truth)
    assert recall.mean() > 0.94
    assert recall.mean() > recalls(baseline(source, 6), truth)[0].mean()
