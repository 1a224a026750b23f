"""Heights above the bottom, and waypoints set on long legs, in the formats that autopilots open."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_samples import LAWNMOWER, distance_m, sample_plan

from hrt_cli.errors import ArgumentError
from hrt_cli.missions import qgc, wpl
from hrt_cli.missions.mission import MissionOptions, mission_of

ABOVE = MissionOptions(vehicle="submarine", above_bottom_m=2.5)


def test_a_height_above_the_bottom_is_above_terrain_in_a_plan() -> None:
    document = json.loads(qgc.to_text(mission_of(sample_plan(), ABOVE)))["mission"]
    waypoints = [item for item in document["items"] if item["command"] == 16]
    assert document["globalPlanAltitudeMode"] == 4
    assert {(i["frame"], i["AltitudeMode"], i["Altitude"], i["params"][6]) for i in waypoints} == {(10, 4, 2.5, 2.5)}
    assert document["plannedHomePosition"][2] == 0


def test_a_height_above_the_bottom_is_above_terrain_in_waypoints() -> None:
    rows = [row.split("\t") for row in wpl.to_text(mission_of(sample_plan(), ABOVE)).splitlines()[1:]]
    assert {(row[2], row[10]) for row in rows[2:]} == {("10", "2.500000")}
    assert rows[0][10] == "0.000000"


@pytest.mark.parametrize(
    "values",
    [
        {"above_bottom_m": 2.0},
        {"vehicle": "boat", "above_bottom_m": 2.0},
        {"vehicle": "submarine", "above_bottom_m": 2.0, "altitude_m": -1.0},
        {"vehicle": "submarine", "above_bottom_m": 0.0},
        {"vehicle": "submarine", "above_bottom_m": float("nan")},
    ],
)
def test_a_height_above_the_bottom_is_a_submarines_alone(values: dict) -> None:
    with pytest.raises(ArgumentError):
        MissionOptions(**values)


@settings(max_examples=40)
@given(spacing_m=st.floats(0.1, 20.0), turn_deg=st.sampled_from([0.0, 40.0]))
def test_no_leg_is_longer_than_the_spacing_and_none_is_cut_for_nothing(spacing_m: float, turn_deg: float) -> None:
    plan = sample_plan(LAWNMOWER, turn_deg=turn_deg, cell=1.0)
    plain, spaced = (mission_of(plan, MissionOptions(spacing_m=s)) for s in (None, spacing_m))
    places = [(p.lon_deg, p.lat_deg) for p in spaced.points]
    legs = [distance_m(*pair) for pair in pairwise(places)]
    # UTM's metres are not the ground's.
    scale = sum(distance_m(*pair) for pair in pairwise((p.lon_deg, p.lat_deg) for p in plain.points)) / plain.length_m
    assert max(legs) <= spacing_m * scale * 1.001 + 1e-6
    corners = [stop for stop in spaced.stops if stop.cell is not None]
    assert [stop.step for stop in corners] == [stop.step for stop in plain.stops]
    assert spaced.length_m == plain.length_m
    for (before, after), (start, end) in zip(pairwise(plain.points), pairwise(plain.stops), strict=True):
        at = spaced.stops.index(start), spaced.stops.index(end)
        parts = at[1] - at[0]
        whole = distance_m((before.lon_deg, before.lat_deg), (after.lon_deg, after.lat_deg))
        assert parts == 1 or whole / (parts - 1) > spacing_m * scale * 0.999
        between = places[at[0] : at[1] + 1]
        assert [distance_m(*pair) for pair in pairwise(between)] == pytest.approx([whole / parts] * parts, abs=1e-5)


def test_a_leg_of_a_whole_number_of_spacings_has_no_one_more() -> None:
    assert len(mission_of(sample_plan([(0, 1)] * 30, cell=0.1), MissionOptions(spacing_m=0.3)).stops) == 11


def test_waypoints_are_spaced_across_the_meridian_180() -> None:
    plan = sample_plan([(0, 1)] * 20, crs="EPSG:32760", lonlat=(179.9996, -16.8), cell=5.0)
    spaced = mission_of(plan, MissionOptions(spacing_m=10.0))
    places = [(p.lon_deg, p.lat_deg) for p in spaced.points]
    assert len({lon > 0 for lon, _ in places}) == 2
    assert [distance_m(*pair) for pair in pairwise(places)] == pytest.approx([10.0] * 10, abs=0.05)
