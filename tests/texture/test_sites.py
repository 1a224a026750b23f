"""Real sites: polygons drawn by hand against the classes found without them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import DATA, ArraySource
from numpy.typing import NDArray
from sites import SITES, Site, baseline, read_site, recalls

from hrt_cli.texture.segment import SegmentSpec

pytestmark = pytest.mark.real


REACHED = {5: 0.90, 6: 0.92, 8: 0.95}


def load(name: str) -> Site:
    if not (DATA / name).exists():
        pytest.skip(f"no real data: {name} is absent")
    return read_site(DATA, name)


def found(site: Site, classes: int) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Recalls and shares of `recalls`, and the baseline's mean recall."""
    plain, _ = recalls(baseline(site.rgb, site.valid, classes), site.truth)
    source = ArraySource(site.rgb, site.valid, site.pixel_m, site.anchor)
    mine, _ = source.classes(source.model(SegmentSpec(classes)))
    return *recalls(mine, site.truth), float(plain.mean())


def test_roads_are_one_class_and_the_lawn_another() -> None:
    site = load("brighton_beach/ortho_3cm.tif")
    recall, table, plain = found(site, 5)
    road, lawn = site.labels.index("road"), site.labels.index("lawn")
    assert table[:, road].max() > 0.9
    assert table[:, lawn].max() > 0.95
    assert table[:, road].argmax() != table[:, lawn].argmax()
    assert recall.mean() > 0.9
    assert recall.mean() > plain


def test_an_off_road_site() -> None:
    recall, _, plain = found(load("caliterra/ortho_5cm.tif"), 6)
    assert recall.mean() > 0.94
    assert recall.mean() > plain


@pytest.mark.slow
@pytest.mark.parametrize("name", SITES)
def test_one_setting_serves_all_sites(name: str) -> None:
    site = load(name)
    for classes, least in REACHED.items():
        recall, _, plain = found(site, classes)
        assert recall.mean() > least
        assert recall.mean() > plain - 0.01
