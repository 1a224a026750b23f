"""Regions, roads, crowns, relief, light and the survey's outline, each against what it promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from shapely.geometry import Point, Polygon

from hrt_cli.world import layout, relief, survey, thermal

FRAME = layout.Frame(120, 160, 0.2)
SUN = relief.Sun(elevation_rad=np.deg2rad(60.0), across=0.5)


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.0, 1.0), seed=st.integers(0, 1000))
def test_top_share_takes_the_highest_allowed_values(share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    field, allowed = rng.normal(size=(20, 30)), rng.random((20, 30)) < 0.7
    taken = layout.top_share(field, share, allowed)
    assert taken.sum() == min(round(share * field.size), allowed.sum())
    assert not (taken & ~allowed).any()
    if taken.any() and (allowed & ~taken).any():
        assert field[taken].min() > field[allowed & ~taken].max()


def test_absorb_slivers_leaves_large_thick_pieces_only() -> None:
    classes = np.zeros((100, 100), np.uint8)
    classes[:, 60:] = 1
    classes[10:13, 10:13] = 2
    classes[50:52, 5:60] = 3
    classes[70:90, 20:40] = 4
    kept = layout.absorb_slivers(classes, smallest_m2=50.0, thinnest_m=5.0, pixel_m=1.0)
    assert set(np.unique(kept)) == {0, 1, 4}
    assert kept[11, 11] == 0
    assert kept[51, 30] == 0
    assert (kept == 4).sum() == pytest.approx(400, abs=8)


def test_border_share_counts_unlike_neighbours() -> None:
    classes = np.zeros((4, 5), np.uint8)
    classes[:, 3:] = 1
    assert layout.border_share(classes) == pytest.approx(4 / 16)


def test_roads_cross_the_site_with_their_width_and_avoid_water() -> None:
    water = np.zeros((120, 160), bool)
    water[40:80, 50:110] = True
    roads = layout.lay_roads(FRAME, 4.0, water, seed=3)
    assert roads.half_width_m == pytest.approx(2.0 * FRAME.scale)
    pieces, count = ndimage.label(roads.mask)
    assert count == 1
    rim = np.concatenate([pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]])
    assert (rim > 0).any()
    depth_m = ndimage.distance_transform_edt(roads.mask) * FRAME.pixel_m
    assert depth_m.max() == pytest.approx(roads.half_width_m, rel=0.35)
    assert (roads.mask & water).sum() < 0.35 * roads.mask.sum()


def test_crowns_stand_in_groves_and_never_root_on_barred_ground() -> None:
    grove = np.zeros((120, 160), bool)
    grove[20:90, 30:120] = True
    barred = np.zeros_like(grove)
    barred[:, 100:] = True
    crowns = layout.grow_crowns(FRAME, grove, barred, seed=1)
    assert crowns.mask[grove & ~barred].mean() > 0.6
    reach_px = round(3.5 / FRAME.pixel_m)
    assert not (crowns.mask & ~ndimage.binary_dilation(grove, iterations=reach_px)).any()
    assert crowns.height_m.max() < 6.0
    assert np.unique(crowns.tone[crowns.mask]).size > 5


def test_crowns_on_no_ground_are_none() -> None:
    nowhere = np.zeros((120, 160), bool)
    assert not layout.grow_crowns(FRAME, nowhere, nowhere, seed=1).mask.any()


def test_taper_rises_from_the_rim() -> None:
    mask = np.zeros((60, 60), bool)
    mask[10:50, 10:50] = True
    rise = relief.taper(mask, 2.0, 0.5)
    assert rise[~mask].max() == 0.0
    assert rise[30, 30] == pytest.approx(1.0)
    profile = rise[30, 10:30]
    assert (np.diff(profile) >= -1e-12).all()
    assert profile[0] < 0.3


def test_level_ground_has_unit_light_and_no_shadow() -> None:
    level = np.full((20, 30), 4.0)
    np.testing.assert_allclose(relief.shading(level, 0.1, SUN), 1.0)
    assert relief.cast_shadow(level, 0.1, SUN).max() == 0.0
    np.testing.assert_allclose(relief.openness(level, 0.1), 1.0)


def test_slopes_towards_the_sun_are_lighter() -> None:
    south, east, _ = SUN.towards
    y, x = np.meshgrid(np.arange(30) * 0.1, np.arange(30) * 0.1, indexing="ij")
    rising_away = -0.8 * (south * y + east * x)
    assert relief.shading(rising_away, 0.1, SUN).mean() > 1.05
    assert relief.shading(-rising_away, 0.1, SUN).mean() < 0.95


def test_a_step_draws_no_outline() -> None:
    step = np.zeros((20, 30))
    step[10:] = 3.0
    np.testing.assert_allclose(relief.shading(step, 0.1, SUN), 1.0)


def test_a_wall_casts_a_shadow_of_the_right_length_and_direction() -> None:
    pixel_m, height_m = 0.1, 2.0
    dsm = np.zeros((80, 80))
    dsm[10:12, 30:60] = height_m
    shade = relief.cast_shadow(dsm, pixel_m, SUN, penumbra_m=0.05) > 0.5
    south, east, up = SUN.towards
    length_m = height_m * np.hypot(south, east) / up
    rows, cols = np.nonzero(shade)
    assert rows.min() >= 11
    assert (rows.max() - 11) * pixel_m == pytest.approx(length_m * -south / np.hypot(south, east), abs=0.2)
    tip = cols[rows == rows.max() - 1].mean()
    assert (tip - 44.5) * pixel_m == pytest.approx(-length_m * east / np.hypot(south, east), abs=0.3)


def test_outline_is_convex_and_covered() -> None:
    valid = survey.valid_area(FRAME, seed=5)
    assert 0.93 <= valid.mean() < 1.0
    polygon = survey.outline(FRAME, valid)
    shape = Polygon(polygon)
    assert shape.is_valid
    assert shape.convex_hull.area == pytest.approx(shape.area)
    assert shape.area > 0.75 * valid.size
    mask = survey.inside(FRAME, polygon)
    assert valid[mask].all()
    assert mask.sum() == pytest.approx(shape.area, rel=0.01)
    rng = np.random.default_rng(0)
    for row, col in rng.integers((0, 0), (120, 160), (200, 2)):
        assert mask[row, col] == shape.covers(Point(row + 0.5, col + 0.5))


def test_start_lies_on_the_largest_passable_piece() -> None:
    polygon = ((0.0, 0.0), (0.0, 160.0), (120.0, 160.0), (120.0, 0.0))
    sand = np.zeros((120, 160), bool)
    sand[5:30, 5:30] = True
    sand[60:115, 20:140] = True
    row, col = survey.start_cell(FRAME, sand, sand, polygon)
    assert row >= 60
    depth_m = ndimage.distance_transform_edt(sand) * FRAME.pixel_m
    assert depth_m[row, col] >= 1.0


def test_hot_spots_hold_their_peaks_and_keep_apart() -> None:
    allowed = np.zeros((120, 160), bool)
    allowed[:, :90] = True
    ambient = np.where(allowed, 30.0, 22.0)
    field, spots = thermal.thermal_layer(FRAME, ambient, allowed, seed=2)
    assert field.dtype == np.float32
    assert 6 <= len(spots) <= 12
    for spot in spots:
        assert allowed[spot.row, spot.col]
        assert 60.0 <= spot.peak_c <= 300.0
        assert 0.5 <= spot.diameter_m <= 2.0
        assert field[spot.row, spot.col] == pytest.approx(spot.peak_c, abs=1e-3)
    far = np.ones_like(allowed)
    for spot in spots:
        y, x = np.indices(allowed.shape)
        far &= np.hypot(y - spot.row, x - spot.col) * FRAME.pixel_m > 2.5 * spot.diameter_m
    assert field[far].max() < 35.0
    assert field[far & allowed].mean() > field[far & ~allowed].mean() + 5.0
