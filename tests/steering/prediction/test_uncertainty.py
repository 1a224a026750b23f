"""How sure a prediction is: by hand, by the laws that take it apart, and how many ways a distribution sees."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hrt_cli.steering.prediction.uncertainty import count_modes, moments, uncertainty

SHARES = st.lists(st.floats(0, 1, allow_subnormal=False), min_size=3, max_size=15).filter(lambda s: sum(s) > 1e-3)


def drawn(seed: int, passes: int, n: int, classes: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).dirichlet(np.full(classes, 0.3), (passes, n))


def test_passes_that_disagree_by_hand() -> None:
    # Each pass is sure, one of the left and one of the right.
    found = uncertainty(np.array([[[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]]))
    assert (found.spread[0], found.aleatoric[0], found.epistemic[0]) == (1.0, 0.0, 1.0)
    assert found.entropy_nats[0] == pytest.approx(math.log(2))
    assert found.mutual_information_nats[0] == pytest.approx(math.log(2))


def test_passes_that_agree_on_not_knowing_by_hand() -> None:
    found = uncertainty(np.array([[[0.5, 0.0, 0.5]], [[0.5, 0.0, 0.5]]]))
    assert (found.spread[0], found.aleatoric[0], found.epistemic[0]) == (1.0, 1.0, 0.0)
    assert found.entropy_nats[0] == pytest.approx(math.log(2))
    assert found.mutual_information_nats[0] == pytest.approx(0.0, abs=1e-12)


@given(st.integers(0, 10_000), st.integers(1, 8), st.integers(1, 5))
def test_the_laws_of_total_variance_and_information(seed: int, passes: int, half: int) -> None:
    sampled = drawn(seed, passes, 3, 2 * half + 1)
    found = uncertainty(sampled)
    np.testing.assert_allclose(found.spread**2, found.aleatoric**2 + found.epistemic**2, atol=1e-12)
    assert (found.mutual_information_nats <= math.log(passes) + 1e-9).all()
    assert (found.mutual_information_nats <= found.entropy_nats + 1e-12).all()
    assert (found.entropy_nats <= math.log(2 * half + 1) + 1e-12).all()
    for row in range(3):
        p = sampled[:, row]
        together = p.mean(0)
        information = sum(
            p[t, j] * math.log(p[t, j] / together[j]) for t in range(passes) for j in range(2 * half + 1) if p[t, j] > 0
        )
        assert found.mutual_information_nats[row] == pytest.approx(information / passes, abs=1e-9)


def test_moments_by_hand() -> None:
    mean, variance = moments(np.array([[0.25, 0.0, 0.0, 0.0, 0.75], [0.0, 0.5, 0.0, 0.5, 0.0]]))
    np.testing.assert_allclose(mean, [0.5, 0.0])
    np.testing.assert_allclose(variance, [0.75, 0.25])


@pytest.mark.parametrize(
    ("shares", "ways"),
    [
        ([1, 0, 0, 0, 0], 1),
        ([1, 1, 1, 1, 1], 1),
        ([0, 0.5, 0, 0.5, 0], 2),
        ([0.5, 0, 0, 0, 0.5], 2),
        ([0.3, 0.3, 0, 0.4, 0], 2),
        ([0.35, 0.3, 0.35, 0, 0], 1),  # the saddle is too high
        ([0.4, 0.19, 0.41, 0, 0], 2),
        ([0.4, 0.21, 0.41, 0, 0], 1),
        ([0.8, 0, 0.19, 0, 0], 1),  # too low beside the highest
        ([0.8, 0, 0.21, 0, 0], 2),
        ([0.4, 0, 0.3, 0, 0.3], 3),
        ([0.1, 0.2, 0.4, 0.2, 0.1], 1),
        ([0.5, 0.1, 0.3, 0.28, 0.3], 2),
    ],
)
def test_ways_by_hand(shares: list[float], ways: int) -> None:
    assert count_modes(np.array(shares) / sum(shares)) == ways


def ways_by_levels(p: NDArray[np.float64]) -> int:
    """Lower a water level from the top: a peak that comes out at h is a way if it is still an island at h / 2."""
    counted = 0
    for at in range(len(p)):
        higher = [j for j in range(len(p)) if p[j] > p[at] or (p[j] == p[at] and j < at)]
        apart = all(p[min(at, j) : max(at, j) + 1].min() <= p[at] / 2 for j in higher)
        counted += apart and p[at] >= p.max() / 4
    return counted


@given(SHARES)
def test_ways_are_islands(shares: list[float]) -> None:
    p = np.array(shares) / sum(shares)
    assert count_modes(p) == ways_by_levels(p)
    assert count_modes(p) >= 1
    assert count_modes(p[::-1]) == count_modes(p)
