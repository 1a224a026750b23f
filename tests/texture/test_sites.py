"""Real sites: polygons drawn by hand against the classes found without them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import DATA, ArraySource
from numpy.typing import NDArray
from sites import POLYGONS, baseline, read_site, recalls, truth_of

from hrt_cli.texture.segment import SegmentSpec

pytestmark = pytest.mark.real


def load(name: str) -> ArraySource:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no real data: {name} is absent")
    return ArraySource(*read_site(path))


def against_baseline(name: str, classes: int) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Recalls and shares of `recalls`, and the baseline's mean recall."""
    source = load(name)
    assert source.valid is not None
    truth = truth_of(name, source.valid)
    plain, _ = recalls(baseline(source.rgb, source.valid, classes), truth)
    found, _ = source.classes(source.model(SegmentSpec(classes)))
    return *recalls(found, truth), float(plain.mean())


def test_roads_are_one_class_and_the_lawn_another() -> None:
    name = "brighton_beach/ortho_3cm.tif"
    recall, table, plain = against_baseline(name, 5)
    labels = list(POLYGONS[name])
    road, lawn = labels.index("road"), labels.index("lawn")
    assert table[:, road].max() > 0.9
    assert table[:, lawn].max() > 0.95
    assert table[:, road].argmax() != table[:, lawn].argmax()
    assert recall.mean() > 0.88
    assert recall.mean() > plain


def test_an_off_road_site() -> None:
    recall, _, plain = against_baseline("caliterra/ortho_5cm.tif", 6)
    assert recall.mean() > 0.94
    assert recall.mean() > plain
