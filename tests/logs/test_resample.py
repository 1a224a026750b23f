"""Measurements at the times of records, against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.logs.resample import COMMAND_S, MEASURED_S, held, interpolated

TIMES = st.lists(st.integers(0, 60), max_size=12, unique=True).map(lambda each: np.array(each, float) / 4)


@given(when=TIMES, time=TIMES, seed=st.integers(0, 99))
def test_values_are_those_of_plain_loops(when: np.ndarray, time: np.ndarray, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=time.size)
    values[values > 1] = np.nan
    known = sorted((t, v) for t, v in zip(time, values, strict=True) if math.isfinite(v))
    straight, last = [], []
    for t in when:
        before = [each for each in known if each[0] <= t]
        after = [each for each in known if each[0] >= t]
        if not before or not after or after[0][0] - before[-1][0] > MEASURED_S:
            straight.append(math.nan)
        else:
            (t0, v0), (t1, v1) = before[-1], after[0]
            straight.append(v0 if t1 == t0 else v0 + (v1 - v0) * (t - t0) / (t1 - t0))
        given_before = sorted((s, v) for s, v in zip(time, values, strict=True) if s <= t)
        fresh = given_before and t - given_before[-1][0] <= COMMAND_S
        last.append(given_before[-1][1] if fresh else math.nan)
    np.testing.assert_allclose(interpolated(when, time, values), straight, atol=1e-12)
    np.testing.assert_array_equal(held(when, time, values), last)


def test_angles_go_the_shorter_way_round() -> None:
    found = interpolated(np.array([0.5, 1.5]), np.array([0.0, 1.0, 2.0]), np.array([179.0, -179.0, 150.0]), angle=True)
    assert abs(found[0]) == pytest.approx(180)
    assert found[1] == pytest.approx(165.5)
