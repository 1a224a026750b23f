"""Classes of angles, against values worked out by hand and plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.steering.network.angles import class_angles, expected_angle, nearest_class, smoothed_labels

ANGLES = st.floats(-1, 1, width=32)
HALVES = st.integers(1, 127)


def test_the_angles_of_the_classes() -> None:
    assert class_angles(1).tolist() == [-1.0, 0.0, 1.0]
    assert class_angles(2).tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert class_angles(7).dtype == torch.float32


@pytest.mark.parametrize(
    ("angle", "chosen"),
    [(-1.0, 0), (-0.76, 0), (-0.74, 1), (0.0, 2), (0.24, 2), (0.26, 3), (1.0, 4), (0.25, 3), (-0.25, 1), (0.75, 4)],
)
def test_the_nearest_class_and_the_outer_of_two(angle: float, chosen: int) -> None:
    assert int(nearest_class(torch.tensor(angle), 2)) == chosen


@given(ANGLES, HALVES)
def test_no_class_is_nearer(angle: float, half: int) -> None:
    chosen = int(nearest_class(torch.tensor(angle), half))
    away = [abs(angle - (index - half) / half) for index in range(2 * half + 1)]
    assert away[chosen] <= min(away) + 1e-6


@given(ANGLES, HALVES)
def test_left_and_right_are_alike(angle: float, half: int) -> None:
    there = int(nearest_class(torch.tensor(angle), half))
    assert int(nearest_class(torch.tensor(-angle), half)) == 2 * half - there


@given(ANGLES, st.integers(1, 20), st.floats(0.02, 2))
def test_labels_are_a_normal_density_over_the_classes(angle: float, half: int, sigma: float) -> None:
    found = smoothed_labels(torch.tensor([angle]), half, sigma)[0].double().numpy()
    away = [(index - half) / half - angle for index in range(2 * half + 1)]
    least = min(each**2 for each in away)
    density = [math.exp(-(each**2 - least) / (2 * sigma**2)) for each in away]
    np.testing.assert_allclose(found, np.array(density) / sum(density), atol=2e-5)
    assert found.sum() == pytest.approx(1.0, abs=1e-5)


def test_labels_without_a_width_are_the_nearest_class() -> None:
    found = smoothed_labels(torch.tensor([-0.3, 0.9]), 2, 0.0)
    assert found.tolist() == [[0, 1, 0, 0, 0], [0, 0, 0, 0, 1]]
    assert found.dtype == torch.float32


def test_mean_and_spread_by_hand() -> None:
    mean, spread = expected_angle(torch.tensor([[0.5, 0.0, 0.5], [0.0, 0.25, 0.75], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(mean, [0.0, 0.75, 0.0], atol=1e-7)
    np.testing.assert_allclose(spread, [1.0, math.sqrt(0.75 - 0.75**2), 0.0], atol=1e-7)
