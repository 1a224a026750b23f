"""Rare steering drawn more often."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.errors import ArgumentError
from hrt_cli.steering.training.balance import class_weights, draw_epoch, unexplained

YAWS = st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=200).map(lambda each: np.array(each, np.float32))


def test_by_hand() -> None:
    yaw = np.array([0, 0, 0, 0, 0, 0, 1, 1, -1], np.float32)
    np.testing.assert_allclose(class_weights(yaw, 1, 1.0), [0.5] * 6 + [1.5] * 2 + [3.0])
    np.testing.assert_allclose(class_weights(yaw, 1, 0.0), np.ones(9))
    half = np.array([6**-0.5] * 6 + [2**-0.5] * 2 + [1.0])
    np.testing.assert_allclose(class_weights(yaw, 1, 0.5), half * 9 / half.sum())


def test_a_frame_is_not_drawn_too_often() -> None:
    """999 straight on and one to the right: alike would be 500 times the one."""
    yaw = np.zeros(1000, np.float32)
    yaw[7] = 1.0
    weight = class_weights(yaw, 7, 1.0)
    assert weight[7] == 10.0
    np.testing.assert_allclose(np.delete(weight, 7), 990 / 999)


@given(YAWS, st.integers(1, 20), st.floats(0, 1))
def test_weights(yaw: np.ndarray, half_classes: int, strength: float) -> None:
    weight = class_weights(yaw, half_classes, strength)
    assert weight.sum() == pytest.approx(len(yaw))
    assert weight.min() > 0
    assert weight.max() <= 10.0 + 1e-9
    classes = np.sign(yaw) * np.floor(np.abs(yaw) * half_classes + np.float32(0.5))
    counts = {each: (classes == each).sum() for each in classes}
    by_count = sorted((counts[each], w) for each, w in zip(classes, weight, strict=True))
    assert all(a[1] >= b[1] - 1e-9 for a, b in itertools.pairwise(by_count))


def test_cascade_of_caps() -> None:
    """Once the rarest are capped, the next rise above the cap, too."""
    yaw = np.concatenate([np.zeros(2000), np.full(1, 1.0), np.full(55, -1.0), np.full(30, 0.5)]).astype(np.float32)
    weight = class_weights(yaw, 2, 1.0)
    assert weight.max() <= 10.0
    assert weight.sum() == pytest.approx(len(yaw))


@given(YAWS, st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_an_epoch_draws_each_frame_as_often_as_it_weighs(yaw: np.ndarray, strength: float, seed: int) -> None:
    weight = class_weights(yaw, 5, strength)
    drawn = draw_epoch(weight, np.random.default_rng(seed))
    assert drawn.shape == weight.shape
    assert drawn.dtype == np.int64
    count = np.bincount(drawn, minlength=len(weight))
    assert (np.abs(count - weight) < 1 + 1e-6).all()


def test_equal_weights_give_each_frame_once_in_random_order() -> None:
    drawn = draw_epoch(np.ones(500), np.random.default_rng(0))
    assert sorted(drawn.tolist()) == list(range(500))
    assert drawn.tolist() != list(range(500))
    assert draw_epoch(np.ones(500), np.random.default_rng(0)).tolist() == drawn.tolist()


def test_over_many_epochs() -> None:
    weight = class_weights(np.array([0] * 7 + [1], np.float32), 1, 1.0)
    rng = np.random.default_rng(3)
    count = sum(np.bincount(draw_epoch(weight, rng), minlength=8) for _ in range(2000))
    np.testing.assert_allclose(count / 2000, weight, rtol=0.07)


@pytest.mark.parametrize("strength", [-0.1, 1.1, float("nan")])
def test_refused(strength: float) -> None:
    with pytest.raises(ArgumentError, match="strength"):
        class_weights(np.zeros(3, np.float32), 1, strength)


def test_what_the_goal_explains_is_not_rare() -> None:
    yaw = np.array([0.0, 0.5, 1.0, -0.5, 0.4], np.float32)
    goal = np.radians(np.array([0.0, 22.5, 120.0, 22.5, 0.0], np.float32))
    assert unexplained(yaw, goal) == pytest.approx([0.0, 0.0, 0.0, -1.0, 0.4], abs=1e-6)
    assert unexplained(yaw, None) is yaw
