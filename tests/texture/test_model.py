from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import ArraySource

from hrt_cli.texture.model import TextureModel
from hrt_cli.texture.segment import SegmentSpec


@pytest.fixture
def model(site: ArraySource) -> TextureModel:
    return site.model(SegmentSpec(3, features="paper", rotation="aware"))


def test_arrays_come_back_as_the_same_model(model: TextureModel) -> None:
    arrays = model.to_arrays()
    assert all(array.dtype.kind in "fiuU" for array in arrays.values())
    again = TextureModel.from_arrays(arrays)
    assert again.settings == model.settings
    assert again.pixel_m == model.pixel_m
    for name, array in again.to_arrays().items():
        assert np.array_equal(array, arrays[name]), name


def test_linear_scores_order_classes_as_distances_do(model: TextureModel) -> None:
    x = model.mean + np.random.default_rng(0).normal(size=(200, len(model.mean)))
    z = (x - model.mean) @ model.transform.T
    distances = ((z[:, None] - model.centroids) ** 2).sum(axis=2)
    mean, gain, offset = model.linear_scores()
    scores = (x - mean) @ gain.T + offset
    assert scores == pytest.approx(distances - (z**2).sum(axis=1)[:, None], rel=1e-3, abs=1e-3)


Change = Callable[[dict[str, Any]], Any]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("centroids"), "missing"),
        (lambda a: a.update(version=np.array(3)), "update hrt"),
        (lambda a: a.update(version=np.array(1)), "fit it again"),
        (lambda a: a.update(version=np.array(0)), "outside"),
        (lambda a: a.pop("radius"), "missing"),
        (lambda a: a.update(scale_invariant=np.array(2)), "outside"),
        (lambda a: a.update(version=np.array(1.0)), "integer"),
        (lambda a: a.update(features=np.array("nose")), "nose"),
        (lambda a: a.update(features=np.array(3)), "string"),
        (lambda a: a.update(rotation=np.array(["aware"])), "string"),
        (lambda a: a["centroids"].__setitem__((0, 0), np.nan), "finite"),
        (lambda a: a["transform"].__setitem__((0, 0), np.inf), "finite"),
        (lambda a: a.update(centroids=a["centroids"][:, :-1]), "shape"),
        (lambda a: a.update(centroids=a["centroids"][:1]), "classes"),
        (lambda a: a.update(mean=a["mean"][:-1]), "shape"),
        (lambda a: a.update(share=a["share"] * 0.5), "sums"),
        (lambda a: a.update(share=-a["share"]), "outside"),
        (lambda a: a.update(mean_rgb=a["mean_rgb"] + 255), "outside"),
        (lambda a: a.update(wavelengths_m=np.array([0.1, -0.2])), "outside"),
        (lambda a: a.update(wavelengths_m=np.array([])), "entries"),
        (lambda a: a.update(step_m=np.array(0.0)), "outside"),
        (lambda a: a.update(pixel_m=np.array(["a", "b"])), "numeric"),
        (lambda a: a.update(orientations=np.array(1000)), "outside"),
        (lambda a: a.update(mean=np.array([None, 1], dtype=object)), "numeric"),
    ],
)
def test_what_is_not_a_model_is_refused(model: TextureModel, change: Change, message: str) -> None:
    arrays = model.to_arrays()
    change(arrays)
    with pytest.raises(ValueError, match=message):
        TextureModel.from_arrays(arrays)
