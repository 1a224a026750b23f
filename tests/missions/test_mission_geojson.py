from __future__ import annotations

import json
import re
from itertools import pairwise
from typing import Any

import geojson as peer
import pytest
from mission_samples import (
    DIAGONAL,
    SQUARE,
    UTM_SOUTH,
    WEB_MERCATOR,
    assert_at_cells,
    sample_plan,
    waypoint_cells,
)

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.missions import geojson
from hrt_cli.missions.mission import MissionOptions, mission_of

FIJI_UTM = "EPSG:32760"


def written(plan: PlanDocument, **options: Any) -> Any:
    """The collection as plain JSON, after the peer found it valid (the peer itself rounds to 6 decimals)."""
    text = geojson.to_text(mission_of(plan, MissionOptions(**options)))
    assert text.isascii()
    assert text.endswith("]}\n")
    collection = peer.loads(text)
    assert isinstance(collection, peer.FeatureCollection)
    assert collection.is_valid, collection.errors()
    assert "crs" not in collection
    return json.loads(text)


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_the_line_and_the_points_are_at_the_plans_cells(crs: str) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    line, *points = written(plan)["features"]
    assert line["geometry"]["type"] == "LineString"
    assert_at_cells(plan, [tuple(p) for p in line["geometry"]["coordinates"]], plan.cells)
    positions = [tuple(p["geometry"]["coordinates"]) for p in points]
    assert_at_cells(plan, positions, waypoint_cells(plan))
    assert [(p["properties"]["row"], p["properties"]["col"]) for p in points] == waypoint_cells(plan)
    assert [(p["properties"]["index"], p["properties"]["step"]) for p in points] == [
        (w.index, w.step) for w in plan.waypoints
    ]


def test_the_lines_properties_are_the_plans_figures() -> None:
    plan = sample_plan()
    properties = written(plan, speed_m_s=1.6)["features"][0]["properties"]
    for name in ("method", "seed", "steps", "score", "discounted_score", "upper_bound", "gap", "length_m"):
        assert properties[name] == getattr(plan, name)
    assert (properties["speed_m_s"], properties["vehicle"]) == (1.6, "rover")
    assert properties["time_s"] == pytest.approx(plan.length_m / 1.6)


def test_coordinates_have_at_most_seven_decimals() -> None:
    text = geojson.to_text(mission_of(sample_plan(), MissionOptions()))
    decimals = [len(number) for number in re.findall(r"[\[ ]-?\d+\.(\d+)[,\]]", text.split("properties")[0])]
    assert len(decimals) > 2 * len(sample_plan().cells)
    assert max(decimals) == 7


def test_bbox_holds_every_position() -> None:
    plan = sample_plan(DIAGONAL)
    west, south, east, north = written(plan)["bbox"]
    lons, lats = zip(*plan.lonlat, strict=True)
    assert (west, south, east, north) == pytest.approx((min(lons), min(lats), max(lons), max(lats)), abs=6e-8)


def test_return_home_closes_the_line() -> None:
    line = written(sample_plan(SQUARE, return_home=True))["features"][0]["geometry"]["coordinates"]
    assert line[0] == line[-1]


def test_a_plan_without_moves_is_a_point() -> None:
    path, waypoint = written(sample_plan([]))["features"]
    assert path["geometry"] == waypoint["geometry"]
    assert path["geometry"]["type"] == "Point"


@pytest.mark.parametrize("there_and_back", [False, True])
def test_a_walk_across_the_meridian_180_is_cut_there(there_and_back: bool) -> None:
    moves = [(0, 1)] * 9 + ([(1, 0)] + [(0, -1)] * 9 if there_and_back else [])
    plan = sample_plan(moves, crs=FIJI_UTM, lonlat=(179.9996, -16.8), cell=5.0)
    collection = written(plan)
    line, *points = collection["features"]
    parts = line["geometry"]["coordinates"]
    assert line["geometry"]["type"] == "MultiLineString"
    assert len(parts) == 2 + there_and_back
    for before, after in pairwise(parts):
        assert abs(before[-1][0]) == 180
        assert after[0] == [-before[-1][0], before[-1][1]]
        assert abs(before[-1][1] - before[-2][1]) < 1e-6
    for part in parts:
        assert len({lon > 0 for lon, _ in part}) == 1
    inner = [tuple(p) for part in parts for p in part if abs(p[0]) < 180]
    assert_at_cells(plan, inner, plan.cells)
    assert_at_cells(plan, [tuple(p["geometry"]["coordinates"]) for p in points], waypoint_cells(plan))
    west, _, east, _ = collection["bbox"]
    assert west > 179.99
    assert east < -179.99


def test_positions_on_the_meridian_180_itself() -> None:
    members = sample_plan([(0, 1)] * 2).model_dump()
    members["lonlat"] = [(179.9999, -16.8), (180.0, -16.8), (-179.9999, -16.8)]
    for waypoint in members["waypoints"]:
        waypoint["lon"], waypoint["lat"] = members["lonlat"][waypoint["step"]]
    parts = written(PlanDocument.model_validate(members))["features"][0]["geometry"]["coordinates"]
    assert parts[0] == [[179.9999, -16.8], [180, -16.8]]
    assert parts[1][0] == [-180, -16.8]
    assert parts[1][-1] == [-179.9999, -16.8]


@pytest.mark.parametrize("side", [1, -1])
def test_the_cut_is_where_the_line_meets_the_meridian(side: int) -> None:
    members = sample_plan([(0, 1)]).model_dump()
    members["lonlat"] = [(side * 179.9999, -16.8), (side * -179.9997, -16.4)]
    for waypoint in members["waypoints"]:
        waypoint["lon"], waypoint["lat"] = members["lonlat"][waypoint["step"]]
    parts = written(PlanDocument.model_validate(members))["features"][0]["geometry"]["coordinates"]
    assert parts == [
        [[side * 179.9999, -16.8], [side * 180, -16.7]],
        [[side * -180, -16.7], [side * -179.9997, -16.4]],
    ]


@pytest.mark.parametrize("damage", ["one position", "text position", "four numbers"])
def test_the_peer_rejects_a_damaged_collection(damage: str) -> None:
    collection = peer.loads(geojson.to_text(mission_of(sample_plan(), MissionOptions())))
    assert collection.is_valid
    line = collection["features"][0]["geometry"]["coordinates"]
    if damage == "one position":
        del line[1:]
    elif damage == "text position":
        line[0] = ["138.6", "-34.9"]
    else:
        line[0] = [138.6, -34.9, 0.0, 0.0]
    assert not collection.is_valid
    assert collection.errors()
