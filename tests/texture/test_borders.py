"""Classes found in a wide window and told apart in a narrow one; cells that vote."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from conftest import DATA, ArraySource
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from hrt_cli.evaluation.segment import agreement
from hrt_cli.texture import discriminate
from hrt_cli.texture.discriminate import Tile, discriminant, noise_whitening, pure
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.vote import halo_cells, vote

ROUNDS = 3


def slow_vote(scores: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean-field rounds, written down as in the paper."""
    taps = np.exp(-0.5 * np.arange(-2, 3) ** 2)
    taps /= taps.sum()

    def blur(values: NDArray[np.float64]) -> NDArray[np.float64]:
        once = correlate1d(values, taps, axis=-1, mode="constant")
        return np.asarray(correlate1d(once, taps, axis=-2, mode="constant"))

    share = np.maximum(blur(weights), 1e-6)
    field = np.zeros_like(scores)
    for _ in range(ROUNDS + 1):
        energy = scores - 4 * field
        q = np.exp(energy.min(axis=0) - energy)
        field = blur(q / q.sum(axis=0) * weights) / share
    return -field


@given(
    arrays(np.float32, (3, 9, 11), elements=st.floats(-8, 8, width=32)),
    arrays(np.float32, (9, 11), elements=st.sampled_from([0.0, 0.25, 1.0])),
)
@settings(max_examples=40, deadline=None)
def test_votes_agree_with_the_definition(scores: NDArray[np.float32], weights: NDArray[np.float32]) -> None:
    expected = slow_vote(scores.astype(np.float64), weights.astype(np.float64))
    assert vote(scores, weights, ROUNDS) == pytest.approx(expected, abs=2e-3)


def test_votes_look_no_further_than_they_say() -> None:
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(4, 60, 64)).astype(np.float32)
    weights = (rng.random((60, 64)) < 0.8).astype(np.float32)
    whole, halo = vote(scores, weights, ROUNDS), halo_cells(ROUNDS)
    part = vote(np.ascontiguousarray(scores[:, 5:50, 7:60]), np.ascontiguousarray(weights[5:50, 7:60]), ROUNDS)
    inner = (slice(None), slice(halo, -halo), slice(halo, -halo))
    assert np.array_equal(part[inner], whole[:, 5 + halo : 50 - halo, 7 + halo : 60 - halo])


def test_a_lone_cell_is_outvoted_and_an_edge_is_kept() -> None:
    scores = np.zeros((2, 24, 24), np.float32)
    scores[1, :, :12], scores[0, :, 12:] = 1, 1
    scores[:, 5, 5] = (0.8, 0)
    found = vote(scores, np.ones((24, 24), np.float32), ROUNDS).argmin(axis=0)
    assert (found[:, :12] == 0).all()
    assert (found[:, 12:] == 1).all()


def blobs(seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 3, 3000)
    mixing = rng.normal(size=(4, 4))
    return rng.normal(size=(3, 4))[labels] * 3 + rng.normal(size=(3000, 4)) @ mixing, labels


@pytest.mark.parametrize("seed", range(4))
def test_the_discriminant_is_fishers(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discriminate, "_RIDGE", 0.0)
    values, labels = blobs(seed)
    transform, means = discriminant(values, labels, np.ones(len(labels), bool), 3)
    away = (((values[:, None] - means) @ transform.T) ** 2).sum(axis=2)
    peer = LinearDiscriminantAnalysis(solver="lsqr", priors=[1 / 3] * 3).fit(values, labels)
    assert (away.argmin(axis=1) == peer.predict(values)).mean() > 0.995
    residuals = (values - means[labels]) @ transform.T
    assert residuals.T @ residuals / len(values) == pytest.approx(np.eye(4), abs=1e-6)


def test_only_pure_patches_teach_where_there_are_enough() -> None:
    values, labels = blobs(0)
    inside = np.random.default_rng(1).random(len(labels)) < 0.5
    values[~inside] += 1000
    _, means = discriminant(values, labels, inside, 3)
    assert means == pytest.approx(np.stack([values[inside & (labels == k)].mean(axis=0) for k in range(3)]))
    few = inside & ((labels != 2) | (np.cumsum(labels == 2) < 20))
    _, means = discriminant(values, labels, few, 3)
    assert means[2] == pytest.approx(values[labels == 2].mean(axis=0))


def test_whitening_by_near_differences_leaves_what_tells_classes_apart() -> None:
    rng = np.random.default_rng(2)
    noise = np.einsum("kl,lij->kij", rng.normal(size=(3, 3)), rng.normal(size=(3, 80, 80)))
    step = np.array([4.0, -6.0, 2.0])
    ground = np.where(np.arange(80) < 40, 0.0, 1.0) * step[:, None, None]
    transform = noise_whitening([Tile((noise + ground).astype(np.float32), rng.random((80, 80)) < 0.9)])

    def separation(matrix: NDArray[np.float64]) -> float:
        within = np.cov(matrix @ noise.reshape(3, -1))
        return float(((matrix @ step) ** 2).sum() / within.trace())

    total = np.linalg.inv(np.linalg.cholesky(np.cov((noise + ground * np.ones((1, 80, 1))).reshape(3, -1))))
    assert separation(transform) > 2 * separation(total)
    assert separation(transform) > separation(np.eye(3))


def test_pure_cells_have_only_their_class_around() -> None:
    rng = np.random.default_rng(3)
    usable = rng.random((30, 40)) < 0.8
    classes = np.where(np.arange(40) < 17, 0, 2) * np.ones((30, 1), np.int64)
    classes[20:, :10] = 1
    tiles = [Tile(np.zeros((1, 30, 40), np.float32), usable)] * 2
    found = pure(tiles, np.concatenate([classes[usable]] * 2))
    expected = np.zeros((30, 40), bool)
    for r in range(30):
        for c in range(40):
            around = (slice(max(r - 2, 0), r + 3), slice(max(c - 2, 0), c + 3))
            expected[r, c] = len(np.unique(classes[around][usable[around]])) == 1
    assert np.array_equal(found, np.concatenate([expected[usable]] * 2))
    assert 0 < found.mean() < 1


@pytest.mark.real
@pytest.mark.parametrize(("rotation", "ari", "border"), [("aware", 0.92, 0.75), ("invariant", 0.9, 0.7)])
def test_mosaics_of_textures(rotation: str, ari: float, border: float) -> None:
    folder = DATA / "outex"
    if not folder.is_dir():
        pytest.skip("no real data: outex is absent")
    truth = np.unique(cv2.imread(str(folder / "gt.png"), 0), return_inverse=True)[1].reshape(512, 512)
    edges = cv2.morphologyEx(truth.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    near = cv2.distanceTransform((edges == 0).astype(np.uint8), cv2.DIST_L2, 5) <= 20
    for name in ("020.png", "070.png"):
        grey = cv2.imread(str(folder / name), 0)
        source = ArraySource(np.repeat(grey[..., None], 3, axis=2))
        classes, _ = source.classes(source.model(SegmentSpec(5, features="texture", rotation=rotation)))
        for where, least in ((np.ones_like(near), ari), (near, border)):
            table = np.zeros((255, 255), np.int64)
            np.add.at(table, (classes[where], truth[where]), 1)
            assert agreement(table).ari > least, (name, rotation)
