"""Slope and ruggedness: analytic grounds, a reference point by point, and what must not matter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hrt_cli.drivability.relief import eased, gradient, greatest_in_cells, ruggedness, slope

Floats = NDArray[np.float64]
QUICK = settings(deadline=None, max_examples=40)
INSIDE = np.s_[1:-1, 1:-1]
WITHIN = np.s_[2:-2, 2:-2]


def plane(rows: int, cols: int, row_m: float, col_m: float, down: float, right: float) -> Floats:
    i, j = np.mgrid[:rows, :cols]
    return down * i * row_m + right * j * col_m + 123.0


def rough(seed: int, rows: int = 9, cols: int = 11) -> Floats:
    return np.random.default_rng(seed).normal(0, 0.3, (rows, cols))


def by_point(z: Floats, row_m: float, col_m: float) -> tuple[Floats, Floats]:
    """Slope and ruggedness as they are printed: Horn's eight weights, and unit vectors of slope and aspect."""
    steep, normals = np.full(z.shape, np.nan), np.full((*z.shape, 3), np.nan)
    for i in range(1, z.shape[0] - 1):
        for j in range(1, z.shape[1] - 1):
            (a, b, c), (d, _, f), (g, h, k) = z[i - 1 : i + 2, j - 1 : j + 2]
            east = ((c + 2 * f + k) - (a + 2 * d + g)) / (8 * col_m)
            south = ((g + 2 * h + k) - (a + 2 * b + c)) / (8 * row_m)
            angle = math.atan(math.hypot(east, south))
            aspect = math.atan2(-east, south)  # where it falls to, clockwise from north
            steep[i, j] = math.degrees(angle)
            flat = math.sin(angle)
            normals[i, j] = flat * math.sin(aspect), flat * math.cos(aspect), math.cos(angle)
    rugged = np.full(z.shape, np.nan)
    for i in range(2, z.shape[0] - 2):
        for j in range(2, z.shape[1] - 2):
            rugged[i, j] = 1 - np.linalg.norm(normals[i - 1 : i + 2, j - 1 : j + 2].sum(axis=(0, 1))) / 9
    return steep, rugged


def relief(z: Floats, row_m: float = 1.0, col_m: float = 1.0) -> tuple[Floats, Floats]:
    rises = gradient(z, row_m, col_m)
    return slope(*rises), ruggedness(*rises)


tilt = st.floats(-3, 3)


@QUICK
@given(tilt, tilt, st.floats(0.05, 5), st.floats(0.05, 5))
def test_a_tilted_plane_has_its_slope_and_no_ruggedness(down: float, right: float, row_m: float, col_m: float) -> None:
    steep, rugged = relief(plane(7, 8, row_m, col_m, down, right), row_m, col_m)
    np.testing.assert_allclose(steep[INSIDE], math.degrees(math.atan(math.hypot(down, right))), atol=1e-9)
    np.testing.assert_allclose(rugged[INSIDE], 0, atol=1e-12)


@QUICK
@given(tilt, tilt, st.integers(0, 2**32 - 1))
def test_beside_holes_a_plane_has_its_own_slope(down: float, right: float, seed: int) -> None:
    z = plane(9, 9, 0.5, 0.25, down, right)
    z[np.random.default_rng(seed).random(z.shape) < 0.4] = np.nan
    steep, _ = relief(z, 0.5, 0.25)
    known = np.isfinite(steep)
    np.testing.assert_allclose(steep[known], math.degrees(math.atan(math.hypot(down, right))), atol=1e-9)


@QUICK
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 3), st.floats(0.2, 3))
def test_both_are_as_they_are_printed(seed: int, row_m: float, col_m: float) -> None:
    z = rough(seed)
    found, expected = relief(z, row_m, col_m), by_point(z, row_m, col_m)
    np.testing.assert_allclose(found[0][INSIDE], expected[0][INSIDE], atol=1e-9)
    np.testing.assert_allclose(found[1][WITHIN], expected[1][WITHIN], atol=1e-12)


def test_a_cone_is_as_steep_everywhere() -> None:
    i, j = np.mgrid[-30:31, -30:31]
    steep, _ = relief(-0.7 * np.hypot(i, j))
    far = np.hypot(i, j) > 12
    np.testing.assert_allclose(steep[INSIDE][far[INSIDE]], math.degrees(math.atan(0.7)), atol=0.15)


def test_a_step_is_as_steep_as_its_height_over_two_points() -> None:
    z = np.zeros((7, 8))
    z[:, 4:] = 0.35
    steep, rugged = relief(z, 0.25, 0.25)
    np.testing.assert_allclose(steep[INSIDE][:, [2, 3]], math.degrees(math.atan(0.7)))
    assert not steep[INSIDE][:, [0, 1, 4, 5]].any()
    angle = math.atan(0.7)
    np.testing.assert_allclose(rugged[WITHIN][:, 1], 1 - math.sqrt(5 + 4 * math.cos(angle)) / 3)


def test_facets_tilted_every_way_are_as_rugged_as_their_tilt() -> None:
    rng = np.random.default_rng(3)
    turn, tilt = rng.uniform(0, 2 * math.pi, (300, 300)), math.tan(math.radians(26))
    rugged = ruggedness(tilt * np.sin(turn), tilt * np.cos(turn))
    # Nine vectors do not cancel altogether: E|sum|^2 = 81 cos^2 + 9 sin^2.
    expected = 1 - math.sqrt(math.cos(math.radians(26)) ** 2 + math.sin(math.radians(26)) ** 2 / 9)
    assert rugged[INSIDE].mean() == pytest.approx(expected, abs=0.003)


@QUICK
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans(), st.floats(-1e4, 1e4))
def test_turning_mirroring_and_lifting_the_ground_change_nothing(seed: int, turns: int, flip: bool, up: float) -> None:
    z = rough(seed)
    turned = np.rot90(z, turns)[:, ::-1] if flip else np.rot90(z, turns)
    for found, plain in zip(relief(turned + up), relief(z), strict=True):
        expected = np.rot90(plain, turns)[:, ::-1] if flip else np.rot90(plain, turns)
        np.testing.assert_allclose(found[INSIDE], expected[INSIDE], atol=1e-8)


@QUICK
@given(st.integers(0, 2**32 - 1))
def test_they_stay_in_their_ranges(seed: int) -> None:
    steep, rugged = relief(1e3 * rough(seed))
    assert (steep[INSIDE] >= 0).all()
    assert (steep[INSIDE] <= 90).all()
    assert (rugged[INSIDE] >= 0).all()
    assert (rugged[INSIDE] <= 1).all()


def test_what_is_not_known_is_not_invented() -> None:
    steep, rugged = relief(np.full((5, 5), np.nan))
    assert np.isnan(steep).all()
    assert np.isnan(rugged).all()
    z = plane(7, 7, 1, 1, 0.2, 0.1)
    z[:, 3:] = np.nan
    steep, rugged = relief(z)
    assert np.isfinite(steep[1:-1, 1]).all()
    assert np.isnan(steep[:, 2:]).all()
    np.testing.assert_array_equal(np.isnan(steep), np.isnan(rugged))


def test_what_counts_falls_from_all_on_a_floor_to_nothing_at_a_limit() -> None:
    assert eased(0, 0, 35, 0.1) == 1
    assert eased(17.5, 0, 35, 0.1) == 0.75
    assert eased(0, 0.05, 35, 0.1) == 0.75
    assert eased(17.5, 0.05, 35, 0.1) == 0.5625
    np.testing.assert_array_equal(eased([35, 80, 0, 80], [0, 0, 0.1, 9], 35, 0.1), 0)
    along = eased(np.linspace(0, 35, 50), 0.02, 35, 0.1)
    assert (np.diff(along) < 0).all()


@QUICK
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_a_cell_has_the_greatest_of_its_points(rows: int, cols: int, per_cell: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(rows * per_cell, cols * per_cell))
    values[np.random.default_rng(seed + 1).random(values.shape) < 0.6] = np.nan
    found = greatest_in_cells(values, per_cell)
    for i in range(rows):
        for j in range(cols):
            part = values[i * per_cell : (i + 1) * per_cell, j * per_cell : (j + 1) * per_cell]
            real = part[~np.isnan(part)]
            if real.size:
                assert found[i, j] == np.float32(real.max())
            else:
                assert np.isnan(found[i, j])
