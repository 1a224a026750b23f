"""Changed pictures, and labels that follow them."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_files import picture

from hrt_cli.steering.training.augment import YAW_UNIT_RAD, Augment, augment

PICTURES = np.stack([picture(seed, 20, 32) for seed in range(40)])
LABELS = np.stack([np.linspace(-0.8, 0.8, 40), np.linspace(-1, 1, 40)], axis=1).astype(np.float32)
GOALS = np.stack([np.linspace(-3, 3, 40), np.linspace(2, -1, 40)], axis=1).astype(np.float32)
NONE = Augment.none()


def changed(seed: int = 0, **strengths: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    before = PICTURES.copy(), LABELS.copy(), GOALS.copy()
    made = augment(PICTURES, LABELS, GOALS, None, dataclasses.replace(NONE, **strengths), np.random.default_rng(seed))
    for kept, now in zip(before, (PICTURES, LABELS, GOALS), strict=True):
        np.testing.assert_array_equal(kept, now)
    assert made[0].dtype == np.uint8
    assert made[0].shape == PICTURES.shape
    assert made[1].dtype == np.float32
    assert made[2] is not None
    assert made[2].dtype == np.float32
    return made[0], made[1], made[2]


def test_nothing() -> None:
    pictures, labels, goals = changed()
    np.testing.assert_array_equal(pictures, PICTURES)
    np.testing.assert_array_equal(labels, LABELS)
    np.testing.assert_allclose(goals, GOALS, atol=1e-6)


def test_flip() -> None:
    pictures, labels, goals = changed(flip=1.0)
    np.testing.assert_array_equal(pictures, PICTURES[:, :, ::-1])
    np.testing.assert_array_equal(labels, LABELS * np.float32([-1, 1]))
    np.testing.assert_allclose(goals, -GOALS, atol=1e-6)


def test_half_of_them_flipped() -> None:
    pictures, labels, _ = changed(flip=0.5)
    flipped = labels[:, 0] == -LABELS[:, 0]
    assert 10 < flipped.sum() < 30
    np.testing.assert_array_equal(pictures[flipped], PICTURES[flipped][:, :, ::-1])
    np.testing.assert_array_equal(pictures[~flipped], PICTURES[~flipped])


def test_shift() -> None:
    gain = 0.75
    pictures, labels, goals = changed(shift=0.2, shift_gain=gain)
    seen = set()
    for index in range(40):
        turn = labels[index, 0] - LABELS[index, 0]
        dx = round(turn / gain * 32)
        assert turn == pytest.approx(gain * dx / 32, abs=1e-6)
        for column in range(32):  # what was at column c is at c + dx; the edge is repeated
            source = min(31, max(0, column - dx))
            np.testing.assert_array_equal(pictures[index, :, column], PICTURES[index, :, source])
        away = goals[index] - (GOALS[index] + turn * math.pi / 4)
        np.testing.assert_allclose(np.cos(away), 1, atol=1e-6)
        seen.add(dx)
    assert min(seen) < -3
    assert max(seen) > 3
    assert max(map(abs, seen)) <= 6
    np.testing.assert_array_equal(labels[:, 1], LABELS[:, 1])


def test_what_is_ahead_moves_right_and_so_does_the_steering() -> None:
    """A bright post in the middle: where it moves to the right, yaw grows."""
    post = np.zeros((30, 10, 41, 3), np.uint8)
    post[:, :, 20] = 255
    for flip in (0.0, 1.0):
        strengths = dataclasses.replace(NONE, shift=0.3, flip=flip)
        pictures, labels, _, _ = augment(
            post, np.zeros((30, 1), np.float32), None, None, strengths, np.random.default_rng(1)
        )
        column = pictures[:, 0, :, 0].argmax(axis=1)
        np.testing.assert_allclose(labels[:, 0], (column - 20) / 41, atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_labels_stay_in_range(seed: int) -> None:
    pictures = np.zeros((8, 4, 10, 3), np.uint8)
    labels = np.array([[1, 1], [-1, -1]] * 4, np.float32)
    goals = np.array([[math.pi], [-math.pi]] * 4, np.float32)
    strengths = dataclasses.replace(NONE, flip=0.5, shift=0.4, shift_gain=3.0)
    _, yaw, goal, _ = augment(pictures, labels, goals, None, strengths, np.random.default_rng(seed))
    assert np.abs(yaw).max() <= 1.0
    assert goal is not None
    assert np.abs(goal).max() <= np.float32(math.pi)
    np.testing.assert_array_equal(yaw[:, 1], labels[:, 1])


def test_the_unit_of_yaw() -> None:
    assert pytest.approx(math.radians(45)) == YAW_UNIT_RAD


@pytest.mark.parametrize("name", ["brightness", "contrast", "gamma", "colour"])
def test_light(name: str) -> None:
    pictures, labels, _ = changed(**{name: 0.3})
    np.testing.assert_array_equal(labels, LABELS)
    assert (pictures != PICTURES).any(axis=(1, 2, 3)).mean() > 0.9
    for before, after in zip(PICTURES, pictures, strict=True):
        for channel in range(3):  # one rising curve for each channel
            order = np.argsort(before[..., channel], axis=None, kind="stable")
            old, new = before[..., channel].flat[order], after[..., channel].flat[order].astype(int)
            assert (np.diff(new) >= 0).all()
            assert len({(a, b) for a, b in zip(old, new, strict=True)}) == len(set(old))
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    strengths = dataclasses.replace(NONE, **{name: 0.3})
    grey = np.repeat(ramp[None, ..., None], 3, axis=3).repeat(20, axis=0)
    made, *_ = augment(grey, np.zeros((20, 1), np.float32), None, None, strengths, np.random.default_rng(0))
    curves = made.reshape(20, 256, 3) / 255.0
    level = np.arange(256) / 255.0
    middle = slice(100, 140)  # where no curve is clipped
    for curve in curves:
        fits = {
            "brightness": [curve[middle, 0] - level[middle]],
            "contrast": [(curve[200:210, 0] - 0.5) / (level[200:210] - 0.5)],
            "gamma": [np.log(curve[middle, 0]) / np.log(level[middle])],
            "colour": [curve[middle, c] / level[middle] for c in range(3)],
        }[name]
        for fit in fits:
            assert np.ptp(fit) < 0.03
            low, high = {"brightness": (-0.3, 0.3), "gamma": (2**-0.3, 2**0.3)}.get(name, (0.7, 1.3))
            assert low - 0.02 < fit.mean() < high + 0.02
        assert (np.ptp(curve, axis=1).max() > 0) == (name == "colour")
    assert np.ptp(curves[:, 128].mean(axis=1)) > 0.01 or name == "contrast"


def test_blur() -> None:
    pictures, _, _ = changed(blur=1.0)
    np.testing.assert_array_equal(pictures[3], cv2.GaussianBlur(PICTURES[3], (3, 3), 0))


def test_noise() -> None:
    grey = np.full((200, 20, 32, 3), 128, np.uint8)
    made, *_ = augment(
        grey,
        np.zeros((200, 1), np.float32),
        None,
        None,
        dataclasses.replace(NONE, noise=0.04),
        np.random.default_rng(0),
    )
    spread = made.astype(float).std(axis=(1, 2, 3))
    assert spread.max() < 1.05 * 0.04 * 255
    assert spread.max() > 0.9 * 0.04 * 255
    assert 0.4 < spread.mean() / (0.04 * 255) < 0.6
    assert abs(made.mean() - 128) < 0.1
    apart = made.reshape(200, -1).astype(float) - 128
    noisy = apart[spread > 3]
    together = np.corrcoef(noisy[:30])
    assert np.abs(together[~np.eye(30, dtype=bool)]).mean() < 0.1


def test_white_and_black_do_not_wrap() -> None:
    ends = np.concatenate([np.zeros((20, 4, 4, 3), np.uint8), np.full((20, 4, 4, 3), 255, np.uint8)])
    strengths = Augment(noise=0.05)
    made, *_ = augment(ends, np.zeros((40, 1), np.float32), None, None, strengths, np.random.default_rng(0))
    assert made[:20].max() < 128 < made[20:].min()


def test_costs_follow_flips_and_shifts() -> None:
    pictures, steering = np.zeros((40, 8, 32, 3), np.uint8), np.zeros((40, 1), np.float32)
    yaw = np.linspace(-1, 1, 15)
    costs = np.tile((2.0 * np.abs(yaw - 0.2)).astype(np.float32), (40, 3, 1))
    strengths = dataclasses.replace(NONE, flip=0.5, shift=0.1)
    _, labels, _, found = augment(pictures, steering, None, costs, strengths, np.random.default_rng(2))
    assert found is not None
    assert (found.shape, found.dtype) == (costs.shape, np.float32)
    flipped = 0
    for turn, goals in zip(labels[:, 0], found, strict=True):
        each = goals[2]
        np.testing.assert_array_equal(goals, np.tile(each, (3, 1)))
        right = [np.interp(sign * (yaw - turn), yaw, costs[0, 0]) for sign in (1, -1)]
        fits = [np.allclose(each[2:-2], wanted[2:-2], atol=1e-5) for wanted in right]
        assert any(fits)
        flipped += fits[1] and not fits[0]
    assert 10 < flipped < 30
    best = [yaw[int(each[0].argmin())] for each in found]
    assert np.abs(np.abs(np.array(best) - labels[:, 0]) - 0.2).max() < 0.1, "the best turn moves as the label does"


@given(st.integers(0, 2**32 - 1))
def test_the_state_of_the_generator_is_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rng.random()
    again = np.random.default_rng()
    again.bit_generator.state = rng.bit_generator.state
    first, second = (augment(PICTURES[:4], LABELS[:4], GOALS[:4], None, Augment(), each) for each in (rng, again))
    for a, b in zip(first[:3], second[:3], strict=True):
        assert a is not None
        assert b is not None
        np.testing.assert_array_equal(a, b)
    assert rng.bit_generator.state == again.bit_generator.state
