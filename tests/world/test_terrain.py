"""Bare ground, slopes, clearances and filled gaps, against known surfaces and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.world.terrain import bare_ground, clearance, fill, rise, slope

PIXEL_M = 0.1


def plane(rows: int, cols: int, base_m: float = 100.0, east: float = 0.0, south: float = 0.0) -> NDArray[np.float32]:
    """A plane that rises by `east` and `south` metres a metre."""
    row, col = np.mgrid[:rows, :cols] * PIXEL_M
    return (base_m + east * col + south * row).astype(np.float32)


def edges_off(values: NDArray, pixels: int = 12) -> NDArray:
    return values[pixels:-pixels, pixels:-pixels]


@settings(max_examples=60)
@given(
    known=hnp.arrays(np.bool_, st.tuples(st.integers(1, 40), st.integers(1, 40))),
    seed=st.integers(0, 999),
    base=st.sampled_from([0.0, 142.0, -3000.0]),
)
def test_filling_keeps_what_is_known_and_stays_among_it(known: NDArray[np.bool_], seed: int, base: float) -> None:
    values = (base + np.random.default_rng(seed).normal(size=known.shape)).astype(np.float32)
    holed = np.where(known, values, np.float32(np.nan))
    found = fill(holed, known)
    assert found.dtype == np.float32
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[known], values[known])
    if known.any():
        assert found.min() >= values[known].min() - 1e-3
        assert found.max() <= values[known].max() + 1e-3
    else:
        assert not found.any()


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
@pytest.mark.parametrize("bands", [(), (3,)])
@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (33, 1), (700, 500)])
def test_a_constant_stays_constant_however_few_pixels_are_known(dtype: type, bands: tuple[int, ...], shape) -> None:
    values = np.full((*shape, *bands), 77, dtype)
    known = np.zeros(shape, np.bool_)
    known[shape[0] // 3, shape[1] // 2] = True
    found = fill(np.where(known.reshape(*shape, *(1 for _ in bands)), values, 0).astype(dtype), known)
    assert found.dtype == dtype
    np.testing.assert_allclose(found, values, rtol=1e-6)


def test_values_fade_in_no_large_gap() -> None:
    """A lone known pixel weighs next to nothing on the coarse levels that fill a large gap."""
    known = np.zeros((3000, 2000), np.bool_)
    known[1, 1] = known[2999, 1999] = True
    values = np.zeros(known.shape, np.float32)
    values[1, 1], values[2999, 1999] = 142.0, 160.0
    found = fill(values, known)
    assert found.min() >= 142.0 - 1e-3
    assert found.max() <= 160.0 + 1e-3


def test_a_gap_is_filled_smoothly_from_around_it() -> None:
    surface = plane(80, 80, 10.0, east=0.1, south=-0.2)
    known = np.ones(surface.shape, np.bool_)
    known[30:50, 30:50] = False
    found = fill(np.where(known, surface, np.float32(0)), known)
    assert np.abs(found - surface).max() < 0.12
    assert np.abs(np.diff(found, axis=0)).max() < 0.12
    whole = np.ones(surface.shape, np.bool_)
    assert fill(surface, whole) is surface


@pytest.mark.parametrize(("east", "south"), [(0.0, 0.0), (0.2, 0.0), (0.1, -0.17), (0.0, 0.1)])
def test_a_plane_is_bare_ground(east: float, south: float) -> None:
    surface = plane(200, 240, east=east, south=south)
    ground = bare_ground(surface, PIXEL_M)
    assert ground.dtype == np.float32
    assert ground.shape == surface.shape
    assert (ground <= surface).all()
    assert np.abs(edges_off(surface - ground)).max() < 0.02
    assert np.abs(surface - ground).max() < 0.3, "an obstacle at the rim"


@pytest.mark.parametrize("slope_", [0.0, 0.1, 0.2])
@pytest.mark.parametrize(("width_m", "height_m"), [(0.4, 0.7), (1.0, 0.5), (2.0, 2.0), (4.0, 1.5), (8.0, 4.0)])
def test_boxes_stand_on_the_ground(slope_: float, width_m: float, height_m: float) -> None:
    bare = plane(300, 300, east=slope_)
    half = round(width_m / PIXEL_M / 2)
    box = np.s_[150 - half : 150 + half, 150 - half : 150 + half]
    surface = bare.copy()
    surface[box] += np.float32(height_m)
    ground = bare_ground(surface, PIXEL_M)
    stands = surface - ground > 0.3
    assert stands[box].mean() > 0.9
    around = np.ones(stands.shape, np.bool_)
    around[150 - half - 4 : 150 + half + 4, 150 - half - 4 : 150 + half + 4] = False
    assert not stands[around].any()
    assert np.abs(ground - bare)[box].max() < 0.25 * height_m + 0.1


def test_trees_of_all_widths_are_found_on_rolling_ground() -> None:
    rng = np.random.default_rng(5)
    rolling = ndimage.gaussian_filter(rng.normal(size=(400, 400)), 60)
    bare = (50.0 + 0.8 * rolling / rolling.std()).astype(np.float32)
    surface = bare.copy()
    rows, cols = np.mgrid[:400, :400]
    crowns = np.zeros(bare.shape, np.bool_)
    for row, col, radius_m in [(60, 60, 0.3), (80, 300, 1.0), (300, 100, 2.0), (280, 290, 3.0)]:
        far = np.hypot(rows - row, cols - col) * PIXEL_M
        inside = far < radius_m
        dome = np.sqrt(np.maximum(0.0, 1.0 - (far / radius_m) ** 2))
        surface[inside] = (bare + 0.8 + 2.0 * dome)[inside]
        crowns |= inside
    stands = surface - bare_ground(surface, PIXEL_M) > 0.3
    assert stands[crowns].mean() > 0.97
    assert stands[~crowns].mean() < 0.002


@settings(max_examples=25)
@given(
    rows=st.integers(1, 60), cols=st.integers(1, 60), pixel=st.sampled_from([0.05, 0.1, 0.3, 1.0]),
    seed=st.integers(0, 99), rough=st.sampled_from([0.01, 0.3, 5.0]),
)  # fmt: skip
def test_the_ground_is_never_above_the_surface_nor_below_all_of_it(
    rows: int, cols: int, pixel: float, seed: int, rough: float
) -> None:
    surface = (142.0 + rough * np.random.default_rng(seed).normal(size=(rows, cols))).astype(np.float32)
    ground = bare_ground(surface, pixel)
    assert (ground <= surface).all()
    assert ground.min() >= surface.min() - 1e-3


def test_the_ground_under_a_wide_roof_is_not_below_its_surroundings() -> None:
    """So much stands here that whole coarse levels of the filling know next to nothing."""
    surface = plane(1500, 1500, 142.0)
    surface[200:1300, 200:1300] += ndimage.zoom(np.random.default_rng(0).random((110, 110)), 10, order=0).astype(
        np.float32
    ) * np.float32(9.0)
    ground = bare_ground(surface, PIXEL_M)
    assert ground.min() > 142.0 - 1e-3


@pytest.mark.parametrize(("east", "south"), [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.4)])
def test_the_slope_of_a_plane(east: float, south: float) -> None:
    found = slope(plane(60, 80, east=east, south=south), PIXEL_M)
    assert found.dtype == np.float32
    np.testing.assert_allclose(edges_off(found, 16), np.hypot(east, south), atol=2e-3)


@pytest.mark.parametrize("reach_m", [0.2, 0.3, 0.6])
@pytest.mark.parametrize(("east", "south"), [(0.0, 0.0), (0.3, 0.0), (0.0, -0.5)])
def test_the_rise_of_a_plane_is_its_slope_times_the_reach(reach_m: float, east: float, south: float) -> None:
    found = rise(plane(60, 80, east=east, south=south), PIXEL_M, reach_m)
    assert found.dtype == np.float32
    across = 2 * max(1, round(reach_m / 2 / PIXEL_M)) * PIXEL_M
    np.testing.assert_allclose(edges_off(found, 8), (abs(east) + abs(south)) * across, atol=2e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_rise_of_a_kerb_is_its_height_within_reach_of_it(axis: int) -> None:
    surface = np.full((40, 40), 3.0, np.float32)
    surface[:, 20:] += np.float32(0.4)
    expected = np.zeros((40, 40))
    expected[:, 18:22] = 0.4  # two pixels of a decimetre on either side
    turned = surface if axis else surface.T
    np.testing.assert_allclose(rise(turned, 0.1, 0.4), expected if axis else expected.T, atol=1e-6)
    np.testing.assert_allclose(rise(-turned, 0.1, 0.4), expected if axis else expected.T, atol=1e-6)


@settings(max_examples=30)
@given(rows=st.integers(1, 20), cols=st.integers(1, 20), reach=st.integers(1, 4), seed=st.integers(0, 99))
def test_the_rise_is_what_the_pixels_within_reach_span(rows: int, cols: int, reach: int, seed: int) -> None:
    surface = np.random.default_rng(seed).normal(size=(rows, cols)).astype(np.float32)
    found = rise(surface, 1.0, 2.0 * reach)
    most = ndimage.maximum_filter(surface, 2 * reach + 1, mode="reflect")
    least = ndimage.minimum_filter(surface, 2 * reach + 1, mode="reflect")
    line = np.maximum(
        ndimage.maximum_filter1d(surface, 2 * reach + 1, axis=0, mode="reflect")
        - ndimage.minimum_filter1d(surface, 2 * reach + 1, axis=0, mode="reflect"),
        ndimage.maximum_filter1d(surface, 2 * reach + 1, axis=1, mode="reflect")
        - ndimage.minimum_filter1d(surface, 2 * reach + 1, axis=1, mode="reflect"),
    )
    assert (found <= most - least + 1e-6).all(), "a disc lies in its square"
    assert (found >= line - 1e-6).all(), "and holds its diameters"


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_the_slope_of_a_line_of_pixels(shape: tuple[int, int]) -> None:
    assert np.isfinite(slope(np.ones(shape, np.float32), PIXEL_M)).all()


@settings(max_examples=30)
@given(obstacle=hnp.arrays(np.bool_, st.tuples(st.integers(1, 14), st.integers(1, 14))))
def test_clearance_is_the_distance_to_the_nearest_obstacle(obstacle: NDArray[np.bool_]) -> None:
    found = clearance(obstacle, 0.5)
    assert np.isfinite(found).all()
    blocks = np.argwhere(obstacle)
    if not len(blocks):
        assert (found > 1000).all()
        return
    for at in np.ndindex(obstacle.shape):
        assert found[at] == pytest.approx(0.5 * np.hypot(*(blocks - at).T).min(), abs=1e-4)
