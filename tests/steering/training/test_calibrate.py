"""The temperature is the one that a fine search finds, and never makes the likelihood worse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hrt_cli.steering.training.calibrate import HIGHEST, LOWEST, fit_temperature, negative_log_likelihood, softmax


def drawn(rng: np.random.Generator, scale: float, n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Logits, and classes drawn from what they would be if divided by `scale`."""
    logits = rng.normal(0.0, 1.5, (n, 7))
    chance = softmax(logits)
    classes = np.array([rng.choice(7, p=each) for each in chance])
    return logits * scale, classes


@pytest.mark.parametrize("scale", [0.4, 1.0, 2.5])
def test_the_scale_of_over_confident_logits_is_found(scale: float) -> None:
    logits, classes = drawn(np.random.default_rng(3), scale)
    assert fit_temperature(logits, classes) == pytest.approx(scale, rel=0.08)


def test_no_other_temperature_is_likelier() -> None:
    logits, classes = drawn(np.random.default_rng(4), 1.7, 300)
    found = negative_log_likelihood(logits / fit_temperature(logits, classes), classes)
    grid = [negative_log_likelihood(logits / t, classes) for t in np.geomspace(LOWEST, HIGHEST, 2000)]
    assert found <= min(grid)
    assert found == pytest.approx(min(grid), abs=1e-6)


def test_likelihood_and_softmax_by_hand() -> None:
    logits = np.log(np.array([[1.0, 3.0], [2.0, 2.0]]))
    np.testing.assert_allclose(softmax(logits), [[0.25, 0.75], [0.5, 0.5]])
    assert negative_log_likelihood(logits, np.array([1, 0])) == pytest.approx((math.log(4 / 3) + math.log(2)) / 2)
    assert negative_log_likelihood(np.array([[1000.0, -1000.0]]), np.array([1])) == pytest.approx(2000.0)


def test_the_bounds_hold_where_all_or_nothing_is_right() -> None:
    logits = np.tile([3.0, 0.0, -1.0], (6, 1))
    assert fit_temperature(logits, np.zeros(6, np.int64)) == pytest.approx(LOWEST)
    assert fit_temperature(logits, np.full(6, 2)) == pytest.approx(HIGHEST)
    assert fit_temperature(np.zeros((4, 3)), np.array([0, 1, 2, 0])) == 1.0


@given(
    arrays(np.float64, st.tuples(st.integers(1, 8), st.just(5)), elements=st.floats(-30, 30)),
    st.integers(0, 2**32 - 1),
)
def test_it_never_makes_the_likelihood_worse(logits: np.ndarray, seed: int) -> None:
    classes = np.random.default_rng(seed).integers(0, 5, logits.shape[0])
    temperature = fit_temperature(logits, classes)
    assert LOWEST * 0.999 <= temperature <= HIGHEST * 1.001
    assert negative_log_likelihood(logits / temperature, classes) <= negative_log_likelihood(logits, classes)
