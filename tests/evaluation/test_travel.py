"""The way that places tell, beside the plain loops that it was first written as."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.evaluation.travel import metres_gone, travel_heading
from hrt_cli.raster.grid import Grid

Floats = NDArray[np.float64]
GLOBE = CRS.from_epsg(4326)
UTM33 = CRS.from_epsg(32633)
DAY = 36_000


def plain_gone(place: Floats, crs: CRS | None, breaks: tuple[int, ...]) -> Floats:
    grid = Grid(1, 1, Affine.identity(), crs)
    gone = np.zeros(len(place))
    last = 0
    for k in range(1, len(gone)):
        gone[k] = gone[k - 1]
        if k in breaks:
            last = k
            continue
        a, b = place[last], place[k]
        leg = float(grid.ground_length_m([a[1], b[1]], [a[0], b[0]])[0])
        if leg >= 0.5:
            gone[k] += leg
            last = k
    return gone


def plain_heading(place: Floats) -> Floats:
    heading = np.zeros(len(place))
    last = 0.0
    for k in range(len(place)):
        away = np.hypot(*(place[k : k + 500] - place[k]).T)
        far = np.flatnonzero(away >= 1.0)
        if far.size:
            east, south = place[k + far[0]] - place[k]
            last = math.atan2(east, -south)
        heading[k] = last
    return heading


def walk(records: int, seed: int, step_m: float = 0.1) -> Floats:
    """A robot that wanders, and stands for a third of the time while its receiver does not."""
    rng = np.random.default_rng(seed)
    turn = np.cumsum(rng.normal(0, 0.1, records))
    moves = (np.arange(records) // 700) % 3 != 2
    way = np.stack([np.cos(turn), np.sin(turn)], axis=1) * (step_m * moves)[:, None]
    return np.cumsum(way, axis=0) + rng.normal(0, 0.03, (records, 2))


def on(crs: CRS | None, metres: Floats) -> Floats:
    if crs is None:
        return metres
    if crs == UTM33:
        return metres + np.array([500_000.0, 5_000_000.0])
    # Across the antimeridian.
    lon, lat = 180.0 + metres[:, 0] / 78_000, 45.0 + metres[:, 1] / 111_000
    return np.stack([(lon + 180.0) % 360.0 - 180.0, lat], axis=1)


@pytest.mark.parametrize("crs", [None, UTM33, GLOBE], ids=["plane", "utm", "globe"])
@pytest.mark.parametrize("breaks", [(), (1,), (700, 701, 1500)])
def test_metres_are_those_of_the_plain_loop(crs: CRS | None, breaks: tuple[int, ...]) -> None:
    place = on(crs, walk(2500, 1))
    found = metres_gone(place, crs, breaks)
    np.testing.assert_allclose(found, plain_gone(place, crs, breaks), rtol=1e-12, atol=1e-9)
    assert 100 < found[-1] < 250


@settings(max_examples=30)
@given(
    seed=st.integers(0, 99), records=st.integers(1, 60), step_m=st.sampled_from([0.0, 0.05, 0.3, 3.0]),
    breaks=st.sets(st.integers(1, 59), max_size=4),
)  # fmt: skip
def test_so_are_those_of_short_tracks(seed: int, records: int, step_m: float, breaks: set[int]) -> None:
    place, cuts = walk(records, seed, step_m), tuple(sorted(k for k in breaks if k < records))
    np.testing.assert_allclose(metres_gone(place, None, cuts), plain_gone(place, None, cuts), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(travel_heading(place), plain_heading(place), rtol=0, atol=1e-12)


def test_headings_are_those_of_the_plain_loop() -> None:
    place = walk(4000, 2)
    np.testing.assert_array_equal(travel_heading(place), plain_heading(place))
    # A robot that stands longer than is looked ahead keeps the heading that it came with.
    stands = np.concatenate([np.stack([np.arange(9.0), np.zeros(9)], axis=1), np.full((700, 2), [8.0, 0.0])])
    np.testing.assert_allclose(travel_heading(stands), math.pi / 2)
    np.testing.assert_array_equal(travel_heading(stands), plain_heading(stands))


def test_a_days_log_takes_no_time() -> None:
    place = walk(DAY, 3)
    globe = on(GLOBE, place)
    metres_gone(globe[:5], GLOBE, ())
    travel_heading(place[:5])
    begin = time.process_time()
    metres_gone(globe, GLOBE, ())
    travel_heading(place)
    travel_heading(np.zeros((DAY, 2)))  # the worst: it looks as far ahead as it may from every record
    assert time.process_time() - begin < 0.5
