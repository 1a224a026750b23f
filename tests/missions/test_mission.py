from __future__ import annotations

from typing import Any

import pytest
from mission_samples import DIAGONAL, LAWNMOWER, SQUARE, plan_members, sample_plan, ungeoreferenced_plan

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions.mission import (
    MissionOptions,
    fixed,
    mission_of,
    printable,
    rounded_longitude,
)


def test_mission_holds_the_plans_waypoints_home_and_speed() -> None:
    plan = sample_plan()
    mission = mission_of(plan, MissionOptions())
    assert [(p.lon_deg, p.lat_deg) for p in mission.points] == [(w.lon, w.lat) for w in plan.waypoints]
    assert (mission.home.lon_deg, mission.home.lat_deg) == plan.lonlat[0]
    assert mission.speed_m_s == plan.speed_m_s
    assert mission.time_s == pytest.approx(plan.time_s)


def test_speed_and_holds_change_the_time() -> None:
    plan = sample_plan()
    mission = mission_of(plan, MissionOptions(speed_m_s=2 * plan.speed_m_s, hold_s=3))
    assert mission.time_s == pytest.approx(plan.time_s / 2 + 3 * len(plan.waypoints))


def test_depth_is_at_the_waypoints_and_not_at_home() -> None:
    mission = mission_of(sample_plan(), MissionOptions(vehicle="submarine", altitude_m=-4.5))
    assert {p.alt_m for p in mission.points} == {-4.5}
    assert mission.home.alt_m == 0
    assert "altitude -4.5 m" in mission.description


def test_return_home_ends_at_home() -> None:
    mission = mission_of(sample_plan(SQUARE, return_home=True), MissionOptions())
    assert mission.points[-1] == mission.points[0] == mission.home


def test_return_home_that_does_not_return_is_refused() -> None:
    with pytest.raises(ArgumentError, match="returns home"):
        mission_of(sample_plan(LAWNMOWER, return_home=True), MissionOptions())


def test_return_home_to_other_coordinates_is_refused() -> None:
    members = plan_members(SQUARE, return_home=True)
    lon, lat = members["lonlat"][-1]
    members["lonlat"][-1] = (lon + 5e-8, lat)
    with pytest.raises(ArgumentError, match="returns home"):
        mission_of(PlanDocument.model_validate(members), MissionOptions())


def test_a_plan_without_georeference_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"^plan has no georeference: .*CRS"):
        mission_of(ungeoreferenced_plan(), MissionOptions())


@pytest.mark.parametrize("lonlat", [True, False])
def test_a_fake_georeference_is_refused_with_the_reason(lonlat: bool) -> None:
    members = plan_members()
    members["grid"]["georeference"] = "fake"
    plan = PlanDocument.model_validate(members) if lonlat else ungeoreferenced_plan("fake")
    with pytest.raises(ArgumentError, match=r"placeholder.*no GPS"):
        mission_of(plan, MissionOptions())


def _renumber(members: dict[str, Any]) -> None:
    for index, waypoint in enumerate(members["waypoints"]):
        waypoint["index"] = index


def _without_lonlat(members: dict[str, Any]) -> None:
    members["lonlat"] = None


def _lonlat_swapped(members: dict[str, Any]) -> None:
    members["lonlat"] = [(lat, lon) for lon, lat in members["lonlat"]]


def _waypoint_lonlat_missing(members: dict[str, Any]) -> None:
    members["waypoints"][2]["lon"] = None


def _waypoint_moved(members: dict[str, Any]) -> None:
    members["waypoints"][2]["lat"] += 3e-7


def _waypoint_moved_east(members: dict[str, Any]) -> None:
    members["waypoints"][2]["lon"] -= 3e-7


def _waypoint_of_another_cell(members: dict[str, Any]) -> None:
    members["waypoints"][2]["cell"] = (0, 0)


def _index_out_of_order(members: dict[str, Any]) -> None:
    members["waypoints"][2]["index"] = 7


def _turn_without_waypoint(members: dict[str, Any]) -> None:
    del members["waypoints"][2]
    _renumber(members)


def _start_without_waypoint(members: dict[str, Any]) -> None:
    del members["waypoints"][0]
    _renumber(members)


def _end_without_waypoint(members: dict[str, Any]) -> None:
    del members["waypoints"][-1]


def _step_twice(members: dict[str, Any]) -> None:
    members["waypoints"].insert(1, dict(members["waypoints"][0]))
    _renumber(members)


def _too_fast(members: dict[str, Any]) -> None:
    members["speed_m_s"] = 1e300


def _endless(members: dict[str, Any]) -> None:
    members["length_m"] = 1.7e308
    members["speed_m_s"] = 0.01


@pytest.mark.parametrize(
    "damage",
    [
        _without_lonlat,
        _lonlat_swapped,
        _waypoint_lonlat_missing,
        _waypoint_moved,
        _waypoint_moved_east,
        _waypoint_of_another_cell,
        _index_out_of_order,
        _turn_without_waypoint,
        _start_without_waypoint,
        _end_without_waypoint,
        _step_twice,
        _too_fast,
        _endless,
    ],
)
def test_a_plan_at_odds_with_itself_is_refused(damage: Any) -> None:
    members = plan_members(DIAGONAL)
    damage(members)
    with pytest.raises(ArgumentError, match=r"^(plan|speed)"):
        mission_of(PlanDocument.model_validate(members), MissionOptions())


@pytest.mark.parametrize(
    "values",
    [
        {"vehicle": "plane"},
        {"firmware": "betaflight"},
        {"speed_m_s": 0.0},
        {"speed_m_s": -1.0},
        {"speed_m_s": 1e-9},
        {"speed_m_s": float("nan")},
        {"speed_m_s": float("inf")},
        {"altitude_m": -1.0},
        {"altitude_m": float("nan")},
        {"altitude_m": 1e308},
        {"vehicle": "boat", "altitude_m": -0.1},
        {"vehicle": "submarine", "altitude_m": 1.0},
        {"hold_s": -1},
        {"hold_s": 70_000},
        {"hold_s": 0.5},
        {"hold_s": float("nan")},
        {"waypoint_radius_m": -1.0},
        {"waypoint_radius_m": float("inf")},
        {"max_items": 0},
        {"max_items": 100_000},
    ],
)
def test_options_out_of_range_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError):
        MissionOptions(**values)


def test_printable_replaces_controls_and_surrogates_only() -> None:
    assert printable("Ä <&> ok") == "Ä <&> ok"
    assert printable("a\x00b\nc\ud800\ufffe") == "a?b?c??"


def test_numbers_are_never_negative_zero_or_the_meridian_180() -> None:
    assert fixed(-1e-12, 8) == "0.00000000"
    assert fixed(1e-7, 8) == "0.00000010"
    assert rounded_longitude(180.0, 8) == -180.0
    assert rounded_longitude(179.9999999999, 8) == -180.0
    assert rounded_longitude(-180.0, 8) == -180.0
    assert rounded_longitude(179.99999999, 8) == 179.99999999
