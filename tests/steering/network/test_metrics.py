"""Figures of predictions, against values worked out by hand, scikit-learn, and what must hold of any prediction."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, confusion_matrix, log_loss, mean_absolute_error, root_mean_squared_error

from hrt_cli.steering.network import angles
from hrt_cli.steering.network.metrics import (
    confusion,
    expected_angles,
    measure,
    median_angles,
    nearest_classes,
    reliability,
    spreads,
)

ZERO = np.zeros(1, np.float32)


def column(*labels: float) -> np.ndarray:
    return np.array(labels, np.float32)[:, None]


def drawn(seed: int, frames: int, half: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    probability = rng.dirichlet(np.full(2 * half + 1, 0.4), frames)
    return probability, rng.uniform(-1, 1, (frames, 1)).astype(np.float32)


def test_by_hand() -> None:
    # Angles -1, 0, 1; expected 0.5, -0.25, 0.
    probability = np.array([[0.1, 0.3, 0.6], [0.5, 0.25, 0.25], [0.05, 0.9, 0.05]])
    found = measure({"yaw": probability}, column(0.75, -0.25, 0.125), 1, np.array([0.25], np.float32))
    assert found.mae == pytest.approx((0.25 + 0 + 0.125) / 3)
    assert found.rmse == pytest.approx(math.sqrt((0.25**2 + 0.125**2) / 3))
    assert found.accuracy == pytest.approx(2 / 3)  # the second is nearest to 0 and taken for -1
    assert found.nll == pytest.approx(-(math.log(0.6) + math.log(0.25) + math.log(0.9)) / 3)
    # Confidences 0.6, 0.5, 0.9 are alone in their bins (0.6 closes the ninth).
    assert found.ece == pytest.approx((0.4 + 0.5 + 0.1) / 3)
    assert found.constant_baseline_mae == pytest.approx((0.5 + 0.5 + 0.125) / 3)
    assert found.frames == 3
    assert {name: vars(found)[name] for name in vars(found.outputs["yaw"])} == vars(found.outputs["yaw"])


def test_against_scikit_learn() -> None:
    probability, steering = drawn(1, 400, 4)
    found = measure({"yaw": probability}, steering, 4, ZERO)
    truth = np.abs(steering - np.arange(-4, 5) / 4).argmin(axis=1)
    label = steering[:, 0].astype(float)
    expected = (probability * np.arange(-4, 5) / 4).sum(axis=1)
    assert found.mae == pytest.approx(mean_absolute_error(label, expected))
    assert found.rmse == pytest.approx(root_mean_squared_error(label, expected))
    assert found.accuracy == pytest.approx(accuracy_score(truth, probability.argmax(1)))
    assert found.nll == pytest.approx(log_loss(truth, probability, labels=range(9)))
    np.testing.assert_array_equal(
        confusion(probability, steering[:, 0], 4), confusion_matrix(truth, probability.argmax(1), labels=range(9))
    )


def test_the_calibration_error_by_brute_force() -> None:
    probability, steering = drawn(2, 300, 3)
    truth = nearest_classes(steering[:, 0], 3)
    error = 0.0
    for k in range(1, 16):
        inside = [i for i in range(300) if (k - 1) / 15 < probability[i].max() <= k / 15]
        if inside:
            right = np.mean([probability[i].argmax() == truth[i] for i in inside])
            error += len(inside) / 300 * abs(right - np.mean([probability[i].max() for i in inside]))
    assert measure({"yaw": probability}, steering, 3, ZERO).ece == pytest.approx(error)


def test_a_bin_holds_its_upper_edge() -> None:
    # 0.4 = 6 / 15 and 1 = 15 / 15.
    probability = np.array([[0.4, 0.3, 0.3], [0.0, 1.0, 0.0]])
    bins = reliability(probability, np.zeros(2, np.float32), 1)
    assert np.flatnonzero(bins.count).tolist() == [5, 14]
    assert np.isnan(bins.confidence[[0, 4, 6]]).all()
    assert bins.accuracy[[5, 14]].tolist() == [0, 1]
    shown = bins.bins()
    assert shown[0] == {"count": 0, "confidence": None, "accuracy": None}
    assert shown[5] == {"count": 1, "confidence": pytest.approx(0.4), "accuracy": 0.0}


@given(st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_a_perfect_prediction_has_no_error(half: int, seed: int) -> None:
    classes = np.random.default_rng(seed).integers(0, 2 * half + 1, 30)
    found = measure({"yaw": np.eye(2 * half + 1)[classes]}, column(*((classes - half) / half)), half, ZERO)
    assert (found.nll, found.ece, found.accuracy) == (0, 0, 1)
    assert found.mae == pytest.approx(0, abs=1e-7)
    assert found.rmse == pytest.approx(0, abs=1e-7)


@given(st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_a_uniform_prediction_is_as_likely_as_chance(half: int, seed: int) -> None:
    classes = 2 * half + 1
    _, steering = drawn(seed, 20, half)
    found = measure({"yaw": np.full((20, classes), 1 / classes)}, steering, half, ZERO)
    assert found.nll == pytest.approx(math.log(classes))
    assert found.mae == pytest.approx(found.constant_baseline_mae)


@given(st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_what_holds_of_any_prediction(half: int, seed: int) -> None:
    probability, steering = drawn(seed, 40, half)
    found = measure({"yaw": probability}, steering, half, median_angles(steering))
    assert 0 <= found.mae <= found.rmse <= 2
    assert 0 <= found.ece <= 1
    table = confusion(probability, steering[:, 0], half)
    assert table.sum() == 40
    assert np.trace(table) / 40 == pytest.approx(found.accuracy)
    # Mirrored, left for right, it is as good.
    mirrored = measure({"yaw": probability[:, ::-1]}, -steering, half, -median_angles(steering))
    assert vars(mirrored)["mae"] == pytest.approx(found.mae)
    assert mirrored.nll == pytest.approx(found.nll)
    # No other constant is nearer to the labels than their median.
    for constant in (-1.0, -0.3, 0.0, 0.4, float(steering.mean())):
        other = measure({"yaw": probability}, steering, half, np.array([constant], np.float32))
        assert other.constant_baseline_mae >= found.constant_baseline_mae - 1e-7


@given(st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=30), st.integers(1, 127))
def test_classes_are_those_of_training(labels: list[float], half: int) -> None:
    label = np.array(labels, np.float32)
    np.testing.assert_array_equal(
        nearest_classes(label, half), angles.nearest_class(torch.from_numpy(label), half).numpy()
    )


def test_mean_and_spread_are_those_of_the_network() -> None:
    probability, _ = drawn(3, 50, 7)
    mean, spread = angles.expected_angle(torch.from_numpy(probability))
    np.testing.assert_allclose(expected_angles(probability), mean.numpy(), atol=1e-7)
    np.testing.assert_allclose(spreads(probability), spread.numpy(), atol=1e-7)


def test_figures_of_several_outputs_are_their_means() -> None:
    yaw, yaw_label = drawn(4, 60, 2)
    pitch, pitch_label = drawn(5, 60, 2)
    baseline = np.array([0.1, -0.4], np.float32)
    both = measure({"yaw": yaw, "pitch": pitch}, np.hstack([yaw_label, pitch_label]), 2, baseline)
    alone = [measure({"yaw": yaw}, yaw_label, 2, baseline[:1]), measure({"pitch": pitch}, pitch_label, 2, baseline[1:])]
    for name in ("mae", "rmse", "accuracy", "nll", "ece", "constant_baseline_mae"):
        assert vars(both)[name] == pytest.approx((vars(alone[0])[name] + vars(alone[1])[name]) / 2)
    assert both.outputs == {"yaw": alone[0].outputs["yaw"], "pitch": alone[1].outputs["pitch"]}


def test_what_was_held_impossible_costs_much_and_not_infinitely() -> None:
    found = measure({"yaw": np.array([[1.0, 0.0, 0.0]])}, column(1.0), 1, ZERO)
    assert found.nll == pytest.approx(12 * math.log(10))


@pytest.mark.parametrize(
    ("probability", "labels", "problem"),
    [
        (np.zeros((0, 3)), np.zeros((0, 1), np.float32), "no frame"),
        (np.full((2, 3), np.nan), np.zeros((2, 1), np.float32), "not finite"),
        (np.full((2, 5), 0.2), np.zeros((2, 1), np.float32), "3 classes"),
        (np.full((3, 3), 1 / 3), np.zeros((2, 1), np.float32), "3 classes"),
        (np.full((2, 3), 1 / 3), np.zeros((2, 2), np.float32), "different outputs"),
    ],
)
def test_what_does_not_fit_is_refused(probability: np.ndarray, labels: np.ndarray, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        measure({"yaw": probability}, labels, 1, ZERO)
