"""The compiled steps of the two robots, against plain Python and what motion must obey."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from world_files import ground_site

from hrt_cli.driving.motion import CONTACT, FREE, RIM, bottom_clearance, is_seen, roll_on, sample, swim_on

PIXEL_M, DT, RADIUS_M = 0.1, 0.05, 0.35
OPEN = np.zeros((120, 160), np.bool_)


def roll(site, state, speed, yaw=0.0, slip=1.0, steps=1, radius=RADIUS_M) -> int:
    return int(
        roll_on(
            state, speed, yaw, slip, steps, DT, radius, site.clearance_m, site.speed_factor, site.ground_m, site.seen,
            site.pixel_m,
        )
    )  # fmt: skip


def swim(site, state, speed, yaw=0.0, pitch=0.0, current=(0.0, 0.0), steps=1, radius=0.3, limit=0.9) -> int:
    return int(
        swim_on(state, speed, yaw, pitch, *current, steps, DT, radius, limit, site.surface_m, site.seen, site.pixel_m)
    )


def at(east: float, south: float, heading: float = 0.0, height: float = 0.0, pitch: float = 0.0) -> np.ndarray:
    return np.array([east, south, height, heading, pitch, 0.0])


@settings(max_examples=60)
@given(east=st.floats(-3, 20), south=st.floats(-3, 20), seed=st.integers(0, 50), rows=st.integers(1, 9))
def test_sampling_interpolates_between_pixel_centres(east: float, south: float, seed: int, rows: int) -> None:
    layer = np.random.default_rng(seed).normal(size=(rows, 7)).astype(np.float32)
    at_pixel = [[south / 0.5 - 0.5], [east / 0.5 - 0.5]]
    expected = ndimage.map_coordinates(layer.astype(float), at_pixel, order=1, mode="nearest")[0]
    assert sample(layer, 0.5, east, south) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("heading", [0.0, 0.7, math.pi / 2, math.pi, -2.0])
@pytest.mark.parametrize("factor", [1.0, 0.4, 0.0])
def test_a_straight_way_is_as_long_as_the_ground_allows(heading: float, factor: float) -> None:
    site = ground_site(OPEN, factor=factor, bottom_m=7.0)
    state = at(8.0, 6.0, heading)
    assert roll(site, state, 0.8, steps=40, slip=1.1) == FREE
    length = 0.8 * min(1.0, factor * 1.1) * 40 * DT
    assert state[:2] == pytest.approx([8 + length * math.sin(heading), 6 - length * math.cos(heading)], abs=1e-6)
    assert state[2] == pytest.approx(7.0)
    assert state[5] == pytest.approx(0.8 * min(1.0, factor * 1.1), abs=1e-6)


def test_it_turns_on_the_spot() -> None:
    state = at(8.0, 6.0, 0.3)
    roll(ground_site(OPEN), state, 0.0, yaw=1.2, steps=30)
    assert state[:2].tolist() == [8.0, 6.0]
    assert state[3] == pytest.approx(0.3 + 1.2 * 30 * DT)
    assert state[5] == 0.0


def test_rolling_is_what_plain_python_says() -> None:
    rng = np.random.default_rng(3)
    obstacle = rng.random(OPEN.shape) < 0.002
    site = ground_site(obstacle, factor=rng.random(OPEN.shape), bottom_m=rng.random(OPEN.shape))
    checked = set()
    for _ in range(60):
        state = at(*rng.uniform((0, 0), (16, 12)), rng.uniform(-4, 4))
        twin, speed, yaw = state.copy(), rng.uniform(0, 2), rng.uniform(-1, 1)
        met = roll(site, state, speed, yaw, 0.9, 5)
        expected = FREE
        for _ in range(5):
            twin[3] += yaw * DT
            places = [(twin[0], twin[1])]
            for wheel in range(4):
                angle = twin[3] + math.radians(45 + 90 * wheel)
                reach = 0.7 * RADIUS_M
                places.append((twin[0] + reach * math.sin(angle), twin[1] - reach * math.cos(angle)))
            grip = np.mean([sample(site.speed_factor, PIXEL_M, *place) for place in places])
            got = speed * min(1.0, grip * 0.9)
            ahead = (twin[0] + got * DT * math.sin(twin[3]), twin[1] - got * DT * math.cos(twin[3]))
            room, now = (sample(site.clearance_m, PIXEL_M, *p) for p in (ahead, twin[:2]))
            if not site.is_seen(*ahead):
                expected, got = max(expected, RIM), 0.0
            elif room < RADIUS_M and room < now:
                expected, got = max(expected, CONTACT), 0.0
            else:
                twin[:2] = ahead
            twin[5] = got
        twin[2] = sample(site.ground_m, PIXEL_M, *twin[:2])
        np.testing.assert_allclose(state, twin, atol=1e-9)
        assert met == expected
        checked.add(met)
    assert checked == {FREE, CONTACT, RIM}


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), heading=st.floats(-4, 4), speed=st.floats(0.1, 2.0))
def test_no_step_ends_nearer_to_an_obstacle_than_the_radius_unless_it_leads_away(
    seed: int, heading: float, speed: float
) -> None:
    rng = np.random.default_rng(seed)
    site = ground_site(rng.random(OPEN.shape) < 0.003)
    state = at(*rng.uniform((0, 0), (16, 12)), heading)
    for _ in range(60):
        before = sample(site.clearance_m, PIXEL_M, state[0], state[1])
        roll(site, state, speed, rng.uniform(-1, 1))
        after = sample(site.clearance_m, PIXEL_M, state[0], state[1])
        assert after >= min(RADIUS_M, before) - 1e-9
        assert is_seen(site.seen, PIXEL_M, state[0], state[1])


def test_what_it_runs_into_stops_it_and_it_gets_away_again() -> None:
    wall = OPEN.copy()
    wall[:, 100:] = True
    site = ground_site(wall)
    state = at(9.0, 6.0, math.pi / 2)
    assert roll(site, state, 1.0, steps=40) == CONTACT
    assert 10.05 - state[0] == pytest.approx(RADIUS_M, abs=0.06)
    assert state[5] == 0.0
    state[3] = -math.pi / 2
    assert roll(site, state, 1.0, steps=20) == FREE
    assert state[0] == pytest.approx(8.7, abs=0.1)


def test_it_is_stopped_at_the_rim_of_the_survey() -> None:
    seen = ~OPEN
    seen[:20] = False
    site = ground_site(OPEN, seen=seen)
    state = at(8.0, 3.0, 0.0)
    assert roll(site, state, 1.0, steps=60) == RIM
    assert 2.0 <= state[1] < 2.06
    state = at(15.0, 6.0, math.pi / 2)
    assert roll(site, state, 1.0, steps=60) == RIM
    assert 15.9 < state[0] <= 16.0


def test_where_there_is_no_obstacle_clearance_is_a_number() -> None:
    site = ground_site(OPEN)
    assert math.isfinite(sample(site.clearance_m, PIXEL_M, 3.33, 4.44))


@pytest.mark.parametrize(("heading", "pitch"), [(0.0, 0.0), (1.0, 0.5), (-2.0, -0.4)])
def test_a_straight_swim_with_a_current(heading: float, pitch: float) -> None:
    site = ground_site(OPEN, bottom_m=-20.0)
    state = at(8.0, 6.0, heading, -8.0, pitch)
    assert swim(site, state, 0.5, current=(0.06, -0.04), steps=40) == FREE
    flat, time_s = 0.5 * math.cos(pitch), 40 * DT
    expected = [
        8 + (flat * math.sin(heading) + 0.06) * time_s,
        6 + (-flat * math.cos(heading) - 0.04) * time_s,
        -8 + 0.5 * math.sin(pitch) * time_s,
    ]
    assert state[:3] == pytest.approx(expected)
    over_ground = np.array([flat * math.sin(heading) + 0.06, -flat * math.cos(heading) - 0.04, 0.5 * math.sin(pitch)])
    assert state[5] == pytest.approx(np.linalg.norm(over_ground))


def test_pitch_has_its_limit_and_it_stays_under_the_surface() -> None:
    site = ground_site(OPEN, bottom_m=-20.0)
    state = at(8.0, 6.0, 0.0, -1.0)
    for _ in range(100):
        swim(site, state, 0.6, pitch=0.5)
        assert state[4] <= 0.9
        assert state[2] <= -0.3
    assert state[4] == 0.9
    assert state[2] == pytest.approx(-0.3)
    for _ in range(100):
        swim(site, state, 0.0, pitch=-0.5)
    assert state[4] == -0.9


def test_the_bottom_stops_it_and_it_floats_up_but_not_out_of_the_water() -> None:
    rng = np.random.default_rng(1)
    cliff = np.full(OPEN.shape, -3.0)
    cliff[:, 100:] = -0.1
    site = ground_site(OPEN, bottom_m=cliff)
    state = at(9.0, 6.0, math.pi / 2, -2.5)
    met = set()
    for _ in range(400):
        before = bottom_clearance(site.surface_m, PIXEL_M, *state[:3], 1.0)
        met.add(swim(site, state, 0.6, yaw=rng.uniform(-0.2, 0.2)))
        after = bottom_clearance(site.surface_m, PIXEL_M, *state[:3], 1.0)
        assert after >= min(0.3, before) - 1e-6
        assert state[2] <= -0.3 + 1e-12
    assert CONTACT in met
    assert state[2] > -2.5


def test_a_swimmer_is_stopped_at_the_rim() -> None:
    state = at(15.5, 6.0, math.pi / 2, -2.0)
    assert swim(ground_site(OPEN, bottom_m=-9.0), state, 0.6, steps=40) == RIM
    assert state[0] <= 16.0
    assert state[5] == 0.0


@settings(max_examples=80)
@given(
    seed=st.integers(0, 999), east=st.floats(0, 3), south=st.floats(0, 2), over=st.floats(-0.5, 2.0),
    reach=st.floats(0.1, 1.5),
)  # fmt: skip
def test_the_clearance_over_the_bottom_is_that_of_brute_force(
    seed: int, east: float, south: float, over: float, reach: float
) -> None:
    bottom = np.random.default_rng(seed).uniform(-5, -4, (20, 30)).astype(np.float32)
    under = sample(bottom, PIXEL_M, east, south)
    height = under + over
    found = bottom_clearance(bottom, PIXEL_M, east, south, height, reach)
    if height <= under:
        assert found == pytest.approx(height - under)
        return
    row, col = np.mgrid[:20, :30]
    flat = np.hypot((row + 0.5) * PIXEL_M - south, (col + 0.5) * PIXEL_M - east)
    far = np.hypot(flat, np.maximum(height - bottom, 0.0))
    assert found == pytest.approx(min(far.min(), reach), abs=1e-5)
