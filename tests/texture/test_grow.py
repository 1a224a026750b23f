from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import ArraySource
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.texture.cells import measured
from hrt_cli.texture.cluster import Sample, class_radius, cluster, distances, project
from hrt_cli.texture.discriminate import Tile
from hrt_cli.texture.grow import MAX_NEW, MIN_SHARE, grow, novel
from hrt_cli.texture.model import MAX_CLASSES, TextureModel
from hrt_cli.texture.segment import SegmentSpec, draw_sample

U8 = NDArray[np.uint8]
TINTS = np.array([[60, 80, 50], [110, 120, 125], [150, 130, 110], [215, 205, 190], [70, 90, 150]])


def ground(kind: int, rows: int, cols: int, seed: int) -> U8:
    """One texture: fine noise, coarse noise, stripes, nearly smooth, or checks; each with its own tint."""
    rng = np.random.default_rng([seed, kind])
    y, x = np.mgrid[:rows, :cols]
    fine = rng.normal(size=(rows, cols))
    coarse = np.kron(rng.normal(size=(-(-rows // 8), -(-cols // 8))), np.ones((8, 8)))[:rows, :cols]
    texture = [
        15 * fine,
        25 * coarse + 3 * fine,
        40 * np.sin(2 * np.pi * x / 8) + 5 * fine,
        2 * fine,
        30 * ((x // 8 + y // 8) % 2) + 4 * fine,
    ][kind]
    return np.asarray(np.clip(TINTS[kind] + texture[..., None], 0, 255).astype(np.uint8))


SIDE = 640
"""Of a strip: so wide that the patches on its edges, which are like neither side, are too few for a class."""
RIM = 20
"""How far an edge is felt."""


def survey(kinds: tuple[int, ...], seed: int, gap: int = 0) -> ArraySource:
    """Strips of ground side by side; the last may lie beyond a gap in which nothing is valid."""
    rgb = np.concatenate([ground(kind, SIDE, SIDE, seed) for kind in kinds], axis=1)
    valid = np.ones(rgb.shape[:2], bool)
    valid[:, rgb.shape[1] - SIDE : rgb.shape[1] - SIDE + gap] = False
    return ArraySource(rgb, valid)


def votes(classes: U8, strips: int) -> list[int]:
    """The class that most pixels of each strip have, their rims left out."""
    return [int(np.bincount(one[:, RIM:-RIM].ravel()).argmax()) for one in np.split(classes, strips, axis=1)]


def sample_of(source: ArraySource, model: TextureModel) -> Sample:
    with measured(source, model.settings) as cells:
        return draw_sample(cells, 0)


@cache
def fitted() -> TextureModel:
    return survey((0, 1, 2), 0).model(SegmentSpec(3))


@cache
def later() -> tuple[ArraySource, Sample, TextureModel]:
    """A survey of the same ground and one kind more, its sample, and the model grown on it."""
    source = survey((0, 1, 2, 3), 1, gap=2 * RIM)
    sample = sample_of(source, fitted())
    return source, sample, grow(fitted(), sample, 0)


def test_old_ground_keeps_its_ids_and_new_ground_gets_the_next() -> None:
    source = survey((0, 1, 2, 3), 1)
    grown = grow(fitted(), sample_of(source, fitted()), 0)
    assert grown.classes == 4
    before, _ = source.classes(fitted())
    after, _ = source.classes(grown)
    assert (after[:, : 3 * SIDE] == before[:, : 3 * SIDE]).mean() >= 0.99
    assert (after[:, 3 * SIDE + RIM :] == 3).mean() >= 0.99
    # Each strip is one class, so the ids are worth keeping.
    assert votes(after, 4) == [0, 1, 2, 3]


def test_what_is_known_of_the_old_classes_stays_to_the_bit() -> None:
    _, sample, grown = later()
    for name in ("settings", "pixel_m", "version"):
        assert getattr(grown, name) == getattr(fitted(), name)
    for name in ("mean", "transform"):
        assert np.array_equal(getattr(grown, name), getattr(fitted(), name))
    for name in ("centroids", "radius", "mean_rgb", "roughness"):
        assert np.array_equal(getattr(grown, name)[:3], getattr(fitted(), name))
    assert grown.share.sum() == pytest.approx(1)
    nearest = distances(project(grown, sample.values), grown.centroids).argmin(axis=0)
    assert grown.share == pytest.approx(np.bincount(nearest, minlength=4) / len(nearest))
    assert grown.mean_rgb[3] == pytest.approx(TINTS[3], abs=3)
    assert np.array_equal(grown.to_arrays()["centroids"], grown.centroids)
    TextureModel.from_arrays(grown.to_arrays())


def test_once_grown_nothing_is_new_there() -> None:
    _, sample, grown = later()
    assert novel(fitted(), sample).mean() > 0.2
    assert novel(grown, sample).mean() < 0.01
    assert grow(grown, sample, 0) is grown
    # Nor where the same grounds lie otherwise.
    again = sample_of(survey((2, 0, 1, 3), 2, gap=2 * RIM), grown)
    assert novel(grown, again).mean() < 0.01
    assert grow(grown, again, 0) is grown


@pytest.mark.parametrize("seed", [0, 1])
def test_the_survey_that_was_fitted_is_not_new(seed: int) -> None:
    source = survey((0, 1, 2), 0)
    model = source.model(SegmentSpec(3, seed=seed))
    sample = sample_of(source, model)
    share = novel(model, sample).mean()
    # Radii hold all but a thousandth of their class.
    assert 0 < share <= 0.002
    assert grow(model, sample, 0) is model


def test_novel_is_what_lies_beyond_every_radius() -> None:
    _, sample, _ = later()
    model = fitted()
    points = project(model, sample.values)
    inside = np.zeros(len(points), bool)
    for centroid, radius in zip(model.centroids, model.radius, strict=True):
        inside |= np.linalg.norm(points - centroid, axis=1) <= radius
    assert not sample.plain.all()
    assert np.array_equal(novel(model, sample), ~inside & sample.plain)


def part_of(sample: Sample, chosen: NDArray[np.intp]) -> Sample:
    return Sample(sample.values[chosen], sample.rgb[chosen], sample.roughness[chosen], sample.plain[chosen])


@pytest.mark.parametrize(("share", "grows"), [(0.6, False), (1.4, True)])
def test_a_class_takes_its_least_share(share: float, grows: bool) -> None:
    _, sample, _ = later()
    model = fitted()
    outside = novel(model, sample)
    strange = np.flatnonzero(outside)
    # Of one place in the middle of what is new, so that it is one texture.
    points = project(model, sample.values)[strange]
    strange = strange[np.argsort(np.linalg.norm(points - np.median(points, axis=0), axis=1), kind="stable")]
    familiar = np.flatnonzero(~outside)
    count = round(share * MIN_SHARE * len(familiar))
    few = part_of(sample, np.concatenate([familiar, strange[:count]]))
    assert novel(model, few).sum() == count
    grown = grow(model, few, 0)
    assert (grown is not model) == grows
    assert grown.classes == (4 if grows else 3)


def test_two_new_kinds_are_two_classes_dark_to_bright() -> None:
    source = survey((0, 1, 2, 3, 4), 1)
    model = fitted()
    grown = grow(model, sample_of(source, model), 0)
    classes, _ = source.classes(grown)
    # The last is the darker of the two.
    assert votes(classes, 5) == [0, 1, 2, 4, 3]
    light = grown.mean_rgb[3:] @ [0.299, 0.587, 0.114]
    assert (np.diff(light) > 0).all()
    assert grown.classes <= 3 + MAX_NEW


def made_up(centres: NDArray[np.float64], seed: int = 0, count: int = 400) -> Sample:
    rng = np.random.default_rng(seed)
    values = np.repeat(centres, count, axis=0)
    values = values + 0.1 * rng.normal(size=values.shape)
    # One column of cells, whose wide window shows what the narrow one does.
    tile = Tile(values.T[:, :, None].astype(np.float32), np.ones((len(values), 1), bool))
    rgb, roughness = rng.uniform(0, 255, (len(values), 3)), rng.normal(size=len(values))
    return Sample(values, rgb, roughness, np.ones(len(values), bool), [tile])


def made_up_model() -> TextureModel:
    corners = np.zeros((3, 7))
    corners[1, 1], corners[2, 2], corners[1:, 0] = 3, 3, 1
    corners[:, 3:] = np.eye(3, 4)
    sample = made_up(corners, count=2000)
    return cluster(sample, SegmentSpec(3).settings((1.0, 1.0)), (1.0, 1.0), 3, 0)


@pytest.mark.parametrize("new", [1, 2, 5, 8, 11])
def test_new_classes_are_the_fewest_that_are_no_wider_than_the_old(new: int) -> None:
    model = made_up_model()
    centres = np.random.default_rng(0).normal(size=(new, 7)) * [5, 5, 5, 2, 2, 2, 2] + 20
    sample = made_up(centres)
    assert novel(model, sample).all()
    grown = grow(model, sample, 0)
    assert grown.classes == 3 + min(new, MAX_NEW)
    points = project(grown, sample.values)
    labels = distances(points, grown.centroids).argmin(axis=0)
    assert labels.min() == 3
    assert grown.radius[3:] == pytest.approx(class_radius(points, grown.centroids, labels)[3:])
    for k in range(3, grown.classes):
        assert grown.mean_rgb[k] == pytest.approx(sample.rgb[labels == k].mean(axis=0))
        assert grown.roughness[k] == pytest.approx(sample.roughness[labels == k].mean())
    assert (np.diff(grown.mean_rgb[3:] @ [0.299, 0.587, 0.114]) > 0).all()
    if new < MAX_NEW:
        assert grown.radius.max() <= 1.2 * model.radius.max()
    if new <= MAX_NEW:
        assert len(set(zip(labels, np.repeat(np.arange(new), 400), strict=True))) == new


@pytest.mark.parametrize("seed", range(5))
def test_strays_are_no_class(seed: int) -> None:
    model = made_up_model()
    centres = np.array([[20.0] * 7, [26.0] * 7, [600.0] * 7])
    every = made_up(centres)
    stray = part_of(every, np.arange(803))
    grown = grow(model, stray, seed)
    assert grown.classes == 5
    points = project(grown, stray.values)
    labels = distances(points, grown.centroids).argmin(axis=0)[:800]
    # The three that are far from all go to the nearest, of which they are no part.
    assert grown.radius[3:] == pytest.approx(class_radius(points[:800], grown.centroids, labels)[3:])
    assert novel(grown, stray)[800:].all()


def test_the_same_seed_grows_the_same_classes() -> None:
    _, sample, grown = later()
    again = grow(fitted(), sample, 0)
    for name, array in grown.to_arrays().items():
        assert np.array_equal(array, again.to_arrays()[name]), name


def test_more_classes_than_a_raster_can_hold_are_refused() -> None:
    model = made_up_model()
    copies = MAX_CLASSES // 3
    full = replace(
        model,
        share=np.full(MAX_CLASSES, 1 / MAX_CLASSES),
        **{
            name: np.concatenate([getattr(model, name)] * copies)
            for name in ("centroids", "mean_rgb", "roughness", "radius")
        },
    )
    assert full.classes == MAX_CLASSES
    sample = made_up(np.full((1, 7), 20.0))
    with pytest.raises(ArgumentError, match="256 classes, 255 are possible"):
        grow(full, sample, 0)
    last = replace(
        full, **{name: getattr(full, name)[:-1] for name in ("centroids", "mean_rgb", "roughness", "radius", "share")}
    )
    assert grow(last, sample, 0).classes == MAX_CLASSES
