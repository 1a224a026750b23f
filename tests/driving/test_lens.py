"""How a robot stands on a slope, and that its picture tilts with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from world_files import ground_site

from hrt_cli.driving.lens import attitude, camera_of, clear_camera, look
from hrt_cli.driving.local import Pose
from hrt_cli.driving.vehicle import AUV, UGV, Vehicle
from hrt_cli.world.camera import Camera, Lens, Weather
from hrt_cli.world.site import Site

SIDE = 200  # 20 m
MIDDLE = 10.0


def plane(east: float, south: float, base_m: float = 0.0, **more: object) -> Site:
    """A plane that rises by `east` and `south` metres a metre."""
    row, col = (np.mgrid[:SIDE, :SIDE] + 0.5) * 0.1
    return ground_site(np.zeros((SIDE, SIDE), np.bool_), bottom_m=base_m + east * col + south * row, **more)


def at(heading_deg: float, height_m: float = 0.0, pitch_deg: float = 0.0) -> Pose:
    return Pose(MIDDLE, MIDDLE, height_m, math.radians(heading_deg), math.radians(pitch_deg))


@pytest.mark.parametrize("vehicle", [UGV, AUV])
def test_a_robots_camera_has_the_lens_of_its_mounting(vehicle: Vehicle) -> None:
    site = plane(0.0, 0.0)
    for camera in (camera_of(site, vehicle, 3), clear_camera(site, vehicle)):
        assert camera.lens.hfov_deg == vehicle.lens_hfov_deg


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 90.0, 137.0, 180.0, 270.0, -30.0])
@pytest.mark.parametrize(("east", "south"), [(0.3, 0.0), (0.0, 0.2), (-0.2, 0.1), (0.0, 0.0)])
def test_attitude_on_a_plane(heading_deg: float, east: float, south: float) -> None:
    pitch, roll = attitude(plane(east, south), UGV, at(heading_deg))
    h = math.radians(heading_deg)
    # What the plane rises by a metre ahead (sin, -cos), and a metre to the right (cos, sin).
    ahead = east * math.sin(h) - south * math.cos(h)
    right = east * math.cos(h) + south * math.sin(h)
    assert pitch == pytest.approx(math.atan(ahead), abs=2e-3)
    assert roll == pytest.approx(-math.atan(right), abs=2e-3)


@pytest.mark.parametrize(
    ("heading_deg", "pitch_sign", "roll_sign"), [(90.0, 1, 0), (270.0, -1, 0), (0.0, 0, -1), (180.0, 0, 1)]
)
def test_signs_where_the_ground_rises_to_the_east(heading_deg: float, pitch_sign: int, roll_sign: int) -> None:
    """Eastwards the nose is up; northwards the right side is, which is a roll below 0."""
    pitch, roll = attitude(plane(0.3, 0.0), UGV, at(heading_deg))
    assert (round(pitch, 2) > 0) - (round(pitch, 2) < 0) == pitch_sign
    assert (round(roll, 2) > 0) - (round(roll, 2) < 0) == roll_sign


def horizon(site: Site, pose: Pose, vehicle=UGV) -> tuple[float, float]:
    """Row of the lowest sky in the left and in the right quarter of the picture; more is further down."""
    camera = Camera(site, Lens(), Weather.clear(), reach_m=60.0)
    sky = np.isinf(look(camera, site, vehicle, pose).range_m)
    rows, quarter = sky.sum(axis=0), sky.shape[1] // 4
    return float(rows[:quarter].mean()), float(rows[-quarter:].mean())


def test_the_horizon_tilts_the_other_way_than_the_robot() -> None:
    """Ridge: the ground under the robot leans, and far away all is level."""
    _row, col = (np.mgrid[:SIDE, :SIDE] + 0.5) * 0.1
    lean = 0.25 * np.clip(col - MIDDLE, -1.0, 1.0)
    site = ground_site(np.zeros((SIDE, SIDE), np.bool_), bottom_m=lean)
    level = horizon(plane(0.0, 0.0), at(0.0))
    assert level[0] == pytest.approx(level[1], abs=0.5)
    # Its right side up, the robot sees the horizon fall to the right: more sky there.
    left, right = horizon(site, at(0.0))
    assert right - left > 10
    left, right = horizon(site, at(180.0))
    assert left - right > 10


def test_with_the_nose_up_more_sky_is_seen() -> None:
    _row, col = (np.mgrid[:SIDE, :SIDE] + 0.5) * 0.1
    site = ground_site(np.zeros((SIDE, SIDE), np.bool_), bottom_m=0.25 * np.clip(col - MIDDLE, -1.0, 1.0))
    level = np.mean(horizon(plane(0.0, 0.0), at(90.0)))
    assert np.mean(horizon(site, at(270.0))) < level - 5 < level + 5 < np.mean(horizon(site, at(90.0)))


def test_a_ground_robot_is_on_the_ground_whatever_height_it_is_told() -> None:
    site = plane(0.1, 0.1, 50.0)
    camera = Camera(site, Lens(), Weather.clear())
    frames = [look(camera, site, UGV, at(20.0, height_m, pitch)).rgb for height_m, pitch in ((0.0, 0.0), (99.0, 30.0))]
    np.testing.assert_array_equal(*frames)


def test_the_lens_is_mounted_above_the_ground_and_looks_down() -> None:
    site = plane(0.0, 0.0)
    camera = Camera(site, Lens(), Weather.clear())
    found = look(camera, site, UGV, at(90.0))
    expected = camera.view(MIDDLE, MIDDLE, UGV.lens_height_m, math.pi / 2, UGV.lens_pitch_rad, 0.0)
    np.testing.assert_array_equal(found.rgb, expected.rgb)
    # The middle of the picture looks at the ground where a ray of that pitch meets it.
    middle = found.range_m[found.range_m.shape[0] // 2, found.range_m.shape[1] // 2]
    assert middle == pytest.approx(UGV.lens_height_m / math.sin(-UGV.lens_pitch_rad), rel=0.06)
    higher = look(camera, site, replace(UGV, lens_height_m=2.0), at(90.0))
    assert not np.array_equal(higher.rgb, found.rgb)


def test_a_diver_looks_from_its_own_height_and_pitch_and_never_rolls() -> None:
    site = plane(0.3, 0.0, -8.0, under_water=True)
    camera = Camera(site, Lens(), Weather.clear())
    pose = at(0.0, -3.0, 20.0)
    found = look(camera, site, AUV, pose)
    expected = camera.view(MIDDLE, MIDDLE, -3.0 + AUV.lens_height_m, 0.0, pose.pitch_rad + AUV.lens_pitch_rad, 0.0)
    np.testing.assert_array_equal(found.rgb, expected.rgb)
    np.testing.assert_array_equal(found.range_m, expected.range_m)


def test_noise_is_that_of_its_seed() -> None:
    site = plane(0.0, 0.0)
    camera = Camera(site, Lens(), Weather.clear())
    one, same, other, none = (look(camera, site, UGV, at(0.0), noise_seed=seed).rgb for seed in (1, 1, 2, None))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, none)
