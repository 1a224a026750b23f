"""Whole drives in memory: who arrives, who collides, who says that it is stuck."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage
from world_files import ground_site

from hrt_cli.driving import expert as module
from hrt_cli.driving.course import Course
from hrt_cli.driving.expert import GroundExpert, WaterExpert
from hrt_cli.driving.field import cost_map, ways_to
from hrt_cli.driving.local import LocalPlanner, Pose, Pursuit
from hrt_cli.driving.motion import bottom_clearance
from hrt_cli.driving.simulator import Drive, Setting, first_heading, simulate
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.world.site import Site

SIDE = 140  # 14 m


class Track:
    """The true poses of a drive."""

    def __init__(self) -> None:
        self.poses: list[Pose] = []

    def __call__(self, time_s: float, known: Pose, true: Pose, command: object) -> None:
        self.poses.append(true)

    @property
    def places(self) -> np.ndarray:
        return np.array([(each.east_m, each.south_m) for each in self.poses])


def drive(
    site: Site, points: list[tuple[float, float]], kind: str = "expert", seed: int = 0, limit_s: float = 900.0
) -> tuple[Drive, Track]:
    vehicle = AUV if site.under_water else UGV
    course, track = Course(np.array(points, float)), Track()
    setting = Setting(site, vehicle, course, 0.7 if site.under_water else 1.0, limit_s, first_heading(course), seed)
    local: LocalPlanner = Pursuit(course, vehicle)
    if kind == "expert":
        local = WaterExpert(site, course, vehicle) if site.under_water else GroundExpert(site, course, vehicle)
    return simulate(setting, local, watch=track), track


def boxes(seed: int, count: int = 14) -> np.ndarray:
    rng = np.random.default_rng(seed)
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    for _ in range(count):
        row, col, high, wide = rng.integers((10, 10, 2, 2), (SIDE - 30, SIDE - 30, 20, 20))
        obstacle[row : row + high, col : col + wide] = True
    return obstacle


def goals(site: Site, rng: np.random.Generator) -> list[tuple[float, float]] | None:
    """A start and an end at least 7 m apart with a way between them, and what lies straight between, free or not."""
    made = cost_map(site, UGV.radius_m + 0.1)
    free = np.argwhere(np.isfinite(made.cost))
    to_go = np.empty_like(made.cost)
    for _ in range(30):
        (r0, c0), (r1, c1) = free[rng.integers(len(free), size=2)]
        far = math.hypot(r1 - r0, c1 - c0) * made.cell_m
        if far > 7 and math.isfinite(ways_to(made.cost, made.cell_m, r1, c1, r0, c0, 60.0, to_go)):
            parts = np.linspace(0, 1, max(2, round(far)))[:, None]
            ends = (np.array([[c0, r0], [c1, r1]]) + 0.5) * made.cell_m
            return [tuple(place) for place in (1 - parts) * ends[0] + parts * ends[1]]
    return None


def test_where_there_is_a_way_the_expert_finds_it_and_touches_nothing() -> None:
    driven, blocked_courses = 0, 0
    for seed in range(24):
        site = ground_site(boxes(seed))
        points = goals(site, np.random.default_rng(seed))
        if points is None:
            continue
        found, track = drive(site, points, seed=seed)
        assert found.end == "arrived", seed
        assert found.events == [], seed
        assert math.dist(track.places[-1], points[-1]) < 0.5
        assert all(site.is_seen(*place) for place in track.places)
        blocked_courses += any(site.obstacle[site.pixel(*place)] for place in points)
        driven += 1
    assert driven >= 20
    assert blocked_courses >= 8


def test_waypoints_inside_obstacles_are_left_out() -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[60:80, 50:90] = True
    found, track = drive(ground_site(obstacle), [(2.0, 7.0), (7.0, 7.0), (12.0, 7.0)])
    assert (found.end, found.events) == ("arrived", [])
    assert math.dist(track.places[-1], (12.0, 7.0)) < 0.5
    assert found.along_m > 9


def test_an_end_inside_an_obstacle_is_never_reached_but_said_so() -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[50:90, 90:130] = True
    found, track = drive(ground_site(obstacle), [(2.0, 7.0), (11.0, 7.0)])
    assert found.end == "stuck"
    assert [name for _, name in found.events] == ["stuck"]
    assert track.places[:, 0].max() > 6.0


def test_a_robot_that_is_walled_in_says_so_and_searches_only_once(monkeypatch: pytest.MonkeyPatch) -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[20:60, 20:60] = True
    obstacle[25:55, 25:55] = False
    searches = []

    def counted(*arguments: object) -> float:
        searches.append(arguments)
        return float(ways_to(*arguments))

    monkeypatch.setattr(module, "ways_to", counted)
    there_and_back = [(4.0, 4.0), *[(12.0, 12.0 - 2 * (k % 2)) for k in range(40)]]
    found, _ = drive(ground_site(obstacle), there_and_back)
    assert found.end == "stuck"
    assert found.events[-1] == (len(found.records) - 1, "stuck")
    assert len(searches) <= 12, "it searches from every place on the course"


def test_good_ground_is_worth_a_detour() -> None:
    factor = np.ones((SIDE, SIDE), np.float32)
    factor[58:82, 66:74] = 0.1
    found, track = drive(ground_site(np.zeros((SIDE, SIDE), np.bool_), factor=factor), [(3.0, 7.0), (11.0, 7.0)])
    assert found.end == "arrived"
    slow = (np.abs(track.places[:, 0] - 7.0) < 0.4) & (np.abs(track.places[:, 1] - 7.0) < 0.9)
    assert not slow.any()


def test_pursuit_sees_nothing_and_runs_into_things() -> None:
    obstacle = np.zeros((SIDE, SIDE), np.bool_)
    obstacle[40:100, 65:75] = True
    found, _ = drive(ground_site(obstacle), [(2.0, 7.0), (12.0, 7.0)], "pursuit")
    assert found.end == "stuck"
    assert next(name for _, name in found.events) == "collision"
    assert found.events[-1] == (len(found.records) - 1, "stuck")


def test_pursuit_follows_its_course_on_open_ground() -> None:
    points = [(2.0, 2.0), (8.0, 2.0), (8.0, 3.0), (2.0, 3.0), (2.0, 10.0), (2.0, 4.0), (12.0, 12.0)]
    found, track = drive(ground_site(np.zeros((SIDE, SIDE), np.bool_)), points, "pursuit")
    assert (found.end, found.events) == ("arrived", [])
    for point in points:
        assert np.hypot(*(track.places - point).T).min() < 1.0, point


def test_on_ground_that_does_not_carry_the_robot_is_stuck() -> None:
    factor = np.ones((SIDE, SIDE), np.float32)
    factor[:, 70:] = 0.0
    found, track = drive(
        ground_site(np.zeros((SIDE, SIDE), np.bool_), factor=factor), [(3.0, 7.0), (12.0, 7.0)], "pursuit"
    )
    assert found.end == "stuck"
    assert found.events == [(len(found.records) - 1, "stuck")]
    assert 6.5 < track.places[-1, 0] < 7.6


def test_the_rim_of_the_survey_is_an_intervention() -> None:
    found, _ = drive(ground_site(np.zeros((SIDE, SIDE), np.bool_)), [(7.0, 7.0), (20.0, 7.0)], "pursuit")
    assert found.end == "stuck"
    assert next(name for _, name in found.events) == "intervention"


def test_time_runs_out() -> None:
    site = ground_site(np.zeros((SIDE, SIDE), np.bool_))
    found, _ = drive(site, [(2.0, 7.0), (12.0, 7.0)], limit_s=4.0)
    assert found.end == "out of time"
    assert found.records[-1, 0] == pytest.approx(4.0)
    assert found.events == []


@pytest.mark.parametrize("kind", ["pursuit", "expert"])
def test_a_course_of_one_place_is_arrived_at(kind: str) -> None:
    found, _ = drive(ground_site(np.zeros((SIDE, SIDE), np.bool_)), [(7.0, 7.0)], kind)
    assert found.end == "arrived"
    assert len(found.records) == 1


def test_the_records_are_a_measurement_not_the_truth() -> None:
    site = ground_site(np.zeros((SIDE, SIDE), np.bool_))
    found, track = drive(site, [(2.0, 7.0), (12.0, 7.0)])
    assert (np.diff(found.records[:, 0]) > 0).all()
    assert found.records[0, 0] == 0.0
    off = np.hypot(*(found.records[-1, 1:3] - track.places[-1]))
    assert 0.0 < off < 1.5
    assert (found.records[:, 6] >= 0).all()
    assert (found.records[:, 7] <= 1.0 + 1e-9).all()


def bumpy(seed: int, rise_m: float = 1.2) -> np.ndarray:
    rolling = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(200, 260)), 12)
    return -6.0 + rise_m * rolling / np.abs(rolling).max()


@pytest.mark.parametrize("seed", range(6))
def test_a_diving_expert_keeps_off_the_bottom_and_near_it(seed: int) -> None:
    site = ground_site(np.zeros((200, 260), np.bool_), bottom_m=bumpy(seed), under_water=True)
    found, track = drive(site, [(4.0, 4.0), (22.0, 5.0), (22.0, 15.0), (4.0, 16.0)], seed=seed)
    assert (found.end, found.events) == ("arrived", [])
    over = [
        bottom_clearance(site.surface_m, site.pixel_m, each.east_m, each.south_m, each.height_m, 5.0)
        for each in track.poses
    ]
    assert min(over) > AUV.radius_m
    assert np.mean(over) == pytest.approx(AUV.altitude_m, abs=0.5)
    assert max(each.height_m for each in track.poses) <= -AUV.radius_m
    assert max(abs(each.pitch_rad) for each in track.poses) <= AUV.pitch_limit_rad + 1e-9


def test_a_diving_expert_climbs_over_a_reef() -> None:
    bottom = np.full((200, 260), -8.0)
    bottom[:, 120:140] = -5.5
    site = ground_site(np.zeros(bottom.shape, np.bool_), bottom_m=bottom, under_water=True)
    found, track = drive(site, [(4.0, 10.0), (22.0, 10.0)])
    assert (found.end, found.events) == ("arrived", [])
    assert min(math.inf, *(abs(each.height_m + 8.0) for each in track.poses)) > AUV.radius_m
    blind, _ = drive(site, [(4.0, 10.0), (22.0, 10.0)], "pursuit")
    assert "collision" in [name for _, name in blind.events]
