from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.metrics import calinski_harabasz_score
from threadpoolctl import threadpool_limits

from hrt_cli.errors import ArgumentError
from hrt_cli.texture import cluster as room
from hrt_cli.texture.cluster import (
    MOST_CONSIDERED,
    Sample,
    best,
    class_radius,
    cluster,
    consider,
    distances,
    kmeans,
    project,
)
from hrt_cli.texture.discriminate import Tile
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.settings import FeatureSettings

F64 = NDArray[np.float64]


def blobs(seed: int, kinds: int = 5, count: int = 1500, channels: int = 6, apart: float = 4.0) -> F64:
    rng = np.random.default_rng(seed)
    centres = apart * rng.normal(size=(kinds, channels))
    return np.asarray(centres[rng.integers(0, kinds, count)] + rng.normal(size=(count, channels)))


def skewed(seed: int) -> F64:
    """Points without clusters, with long tails and very different spreads."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.lognormal(0, 1, (1500, 5)) * [3.0, 1.0, 1.0, 0.3, 0.1])


def inertia(points: F64, centroids: F64) -> float:
    return float((distances(points, centroids).min(axis=0) ** 2).sum())


def sample_of(values: F64, seed: int = 0) -> Sample:
    rng = np.random.default_rng(seed)
    # One column of cells, whose wide window shows what the narrow one does.
    tile = Tile(values.T[:, :, None].astype(np.float32), np.ones((len(values), 1), bool))
    rgb, roughness = rng.uniform(0, 255, (len(values), 3)), rng.normal(size=len(values))
    return Sample(values, rgb, roughness, np.ones(len(values), bool), [tile])


def site_settings(wavelengths: int = 4) -> FeatureSettings:
    return SegmentSpec(2, wavelengths_m=tuple(4.0 * 2**k for k in range(wavelengths))).settings((1.0, 1.0))


@pytest.mark.parametrize("kind", ["blobs", "overlapping", "skewed"])
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("classes", [3, 8])
def test_the_partition_is_as_good_as_scikit_learns(kind: str, seed: int, classes: int) -> None:
    points = {"blobs": blobs(seed), "overlapping": blobs(seed, apart=0.7), "skewed": skewed(seed)}[kind]
    with threadpool_limits(1):
        peer = KMeans(classes, n_init=20, random_state=seed).fit(points)
    centroids, labels = kmeans(points, classes, seed)
    assert inertia(points, centroids) <= 1.001 * peer.inertia_
    assert labels.shape == (len(points),)


@pytest.mark.parametrize("points", [blobs(3), skewed(3)], ids=["blobs", "skewed"])
def test_the_partition_is_a_fixed_point(points: F64) -> None:
    centroids, labels = kmeans(points, 7, 0)
    nearest = np.linalg.norm(points[:, None] - centroids, axis=2).argmin(axis=1)
    assert np.array_equal(labels, nearest)
    assert np.bincount(labels, minlength=7).min() > 0
    means = np.stack([points[labels == k].mean(axis=0) for k in range(7)])
    assert centroids == pytest.approx(means, abs=1e-12)


def test_it_hangs_on_the_seed_alone() -> None:
    points = skewed(4)
    threads = cv2.getNumThreads()
    state = np.random.get_state()  # noqa: NPY002 - that it is not touched is the point
    expected = kmeans(points, 9, 5)
    try:
        for count in (1, 2, 4):
            cv2.setNumThreads(count)
            cv2.setRNGSeed(count)
            again = kmeans(points, 9, 5)
            assert cv2.getNumThreads() == count
            assert all(np.array_equal(one, other) for one, other in zip(expected, again, strict=True))
    finally:
        cv2.setNumThreads(threads)
    assert all(np.array_equal(one, other) for one, other in zip(state, np.random.get_state(), strict=True))  # noqa: NPY002


def test_seeds_change_what_chance_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "RESTARTS", 1)
    points = blobs(5, apart=0.5)
    found = {inertia(points, kmeans(points, 12, seed)[0]) for seed in range(6)}
    assert len(found) > 1
    # Seeds beyond OpenCV's range are seeds too.
    kmeans(points, 3, 2**40 + 1)


def test_the_threads_of_opencv_are_as_before_even_after_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = cv2.getNumThreads()
    seen: list[int] = []

    def fail(*args: object) -> None:
        seen.append(cv2.getNumThreads())
        raise RuntimeError

    monkeypatch.setattr(cv2, "kmeans", fail)
    try:
        cv2.setNumThreads(2)
        with pytest.raises(RuntimeError):
            kmeans(blobs(0), 3, 0)
        assert cv2.getNumThreads() == 2
        assert seen == [1]
    finally:
        cv2.setNumThreads(threads)


def test_distances_and_radii_by_hand() -> None:
    points = np.array([[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]])
    centroids = np.array([[0.0, 0.0], [6.0, 8.0]])
    assert distances(points, centroids) == pytest.approx(np.array([[0, 5, 10], [10, 5, 0]]))
    many = np.concatenate([np.linspace(0, 1, 1001)[:, None], np.full((1, 1), 50.0)])
    radius = class_radius(many, np.array([[0.0], [50.0], [99.0]]), np.array([0] * 1001 + [1]))
    assert radius == pytest.approx([0.999, 0, 0])


def test_the_criterion_is_that_of_partitions_as_good_as_scikit_learns() -> None:
    sample = sample_of(blobs(6, kinds=5, count=900, channels=7, apart=3.0))
    found = consider(sample, site_settings(), 0)
    assert list(found) == list(range(2, MOST_CONSIDERED + 1))
    points = room._points(sample, site_settings())
    with threadpool_limits(1):
        for classes, ratio in found.items():
            peer = KMeans(classes, n_init=20, random_state=1).fit_predict(points)
            assert ratio > 0.95 * calinski_harabasz_score(points, peer)
            centroids, labels = kmeans(points, classes, 0)
            within = inertia(points, centroids) / (len(points) - classes)
            between = ((centroids[labels] - points.mean(axis=0)) ** 2).sum() / (classes - 1)
            assert ratio == pytest.approx(between / within)
    assert consider(sample, site_settings(), 0) == found


def test_numbers_are_considered_on_a_part_of_a_large_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "_CONSIDERED_PATCHES", 500)
    sample = sample_of(blobs(6, kinds=4, count=3000, channels=7))
    found = {seed: consider(sample, site_settings(), seed) for seed in (0, 1)}
    assert found[0] != found[1]
    assert found[0] == consider(sample, site_settings(), 0)
    assert best(found[0]) == best(found[1]) == 4


@pytest.mark.parametrize("kinds", [3, 4, 5, 6, 7])
def test_textures_well_apart_are_counted(kinds: int) -> None:
    rng = np.random.default_rng(kinds)
    # As far from one another as from any, in all channels: corners of a simplex, turned.
    corners = np.linalg.qr(rng.normal(size=(7, 7)))[0][:kinds]
    values = 12 * corners[rng.integers(0, kinds, 1200)] + rng.normal(size=(1200, 7))
    assert best(consider(sample_of(values), site_settings(), 0)) == kinds


def test_of_equal_numbers_the_fewest_is_best() -> None:
    assert best({2: 1.0, 3: 7.0, 4: 7.0, 5: 6.0}) == 3


def test_few_textures_bound_what_is_considered() -> None:
    four = np.repeat(np.arange(4.0), 30)[:, None] * np.ones(7)
    assert list(consider(sample_of(four), site_settings(), 0)) == [2, 3]
    with pytest.raises(ArgumentError, match="too few textures"):
        consider(sample_of(four[:60]), site_settings(), 0)
    with pytest.raises(ArgumentError, match="one texture only"):
        consider(sample_of(four[:30]), site_settings(), 0)


def test_a_model_says_of_its_sample_what_is_true() -> None:
    sample = sample_of(blobs(7, kinds=4, channels=7))
    model = cluster(sample, site_settings(), (0.5, 0.5), 4, 0)
    points = project(model, sample.values)
    labels = distances(points, model.centroids).argmin(axis=0)
    assert model.share == pytest.approx(np.bincount(labels) / len(labels))
    for k in range(4):
        assert model.mean_rgb[k] == pytest.approx(sample.rgb[labels == k].mean(axis=0))
        assert model.roughness[k] == pytest.approx(sample.roughness[labels == k].mean())
        own = np.linalg.norm(points[labels == k] - model.centroids[k], axis=1)
        assert model.radius[k] == pytest.approx(np.quantile(own, 0.999))
    light = model.mean_rgb @ [0.299, 0.587, 0.114]
    assert (np.diff(light) > 0).all()
    mean, gain, offset = model.linear_scores()
    assert np.array_equal(((sample.values - mean) @ gain.T + offset).argmin(axis=1), labels)


def test_whitened_features_have_unit_variance_and_no_correlation() -> None:
    spec = SegmentSpec(2, features="paper", wavelengths_m=(4.0, 8.0)).settings((1.0, 1.0))
    rng = np.random.default_rng(8)
    channels = sum(spec.block_sizes)
    values = rng.normal(size=(2000, channels)) @ rng.normal(size=(channels, channels))
    values[:, -1] = 0.3
    points = project(cluster(sample_of(values), spec, (1.0, 1.0), 3, 0), values)
    assert np.cov(points.T, bias=True) == pytest.approx(np.eye(points.shape[1]), abs=1e-6)
    assert points.shape[1] < channels


def test_channels_of_a_site_count_whatever_their_spread_and_constant_ones_do_not() -> None:
    rng = np.random.default_rng(9)
    values = rng.normal(size=(2000, 7)) * [10, 5, 5, 0.1, 0.2, 0.3, 0.4]
    points = room._points(sample_of(values), site_settings())
    spread = points.std(axis=0)
    assert spread[0] < spread[1]
    assert spread[1] == pytest.approx(spread[2])
    assert (spread[3:] ** 2).sum() == pytest.approx(1)
    stretched = values * [1, 2, 3, 4, 5, 6, 7] + 5
    # Wide features are kept in single precision.
    assert room._points(sample_of(stretched), site_settings()) == pytest.approx(points, abs=1e-5)
    values[:, 6] = 1.0
    assert not room._points(sample_of(values), site_settings())[:, 6].any()
