from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from mission_samples import (
    DIAGONAL,
    SQUARE,
    UTM_SOUTH,
    WEB_MERCATOR,
    ZIGZAG,
    assert_at_cells,
    sample_plan,
    waypoint_cells,
)

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions import qgc
from hrt_cli.missions.formats import require_room
from hrt_cli.missions.mission import MissionOptions, mission_of

SCHEMA = json.loads((Path(__file__).parent / "qgc_plan.schema.json").read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def written(plan: PlanDocument, **options: Any) -> dict[str, Any]:
    mission = mission_of(plan, MissionOptions(**options))
    require_room(mission, None)
    text = qgc.to_text(mission)
    assert text.endswith("}\n")
    assert text.isascii()
    document: dict[str, Any] = json.loads(text)
    VALIDATOR.validate(document)
    return document


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_waypoints_are_at_the_plans_cells(crs: str) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    mission = written(plan)["mission"]
    params = [item["params"] for item in mission["items"] if item["command"] == 16]
    assert_at_cells(plan, [(p[5], p[4]) for p in params], waypoint_cells(plan))
    lat, lon, alt = mission["plannedHomePosition"]
    assert_at_cells(plan, [(lon, lat)], [plan.start])
    assert alt == 0


def test_items_set_the_speed_then_drive_the_waypoints() -> None:
    plan = sample_plan()
    mission = written(plan, speed_m_s=1.25, hold_s=4, waypoint_radius_m=0.7)["mission"]
    items = mission["items"]
    assert [item["command"] for item in items] == [178] + [16] * len(plan.waypoints)
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    assert items[0]["frame"] == 2
    assert items[0]["params"] == [1, 1.25, -1, 0, 0, 0, 0]
    assert all(item["params"][:4] == [4, 0.7, 0, None] for item in items[1:])
    assert mission["cruiseSpeed"] == 1.25


@pytest.mark.parametrize(
    ("vehicle", "firmware", "altitude_m", "vehicle_type", "firmware_type"),
    [("rover", "ardupilot", 0.0, 10, 3), ("boat", "px4", 0.0, 11, 12), ("submarine", "ardupilot", -3.0, 12, 3)],
)
def test_vehicle_firmware_and_depth(
    vehicle: str, firmware: str, altitude_m: float, vehicle_type: int, firmware_type: int
) -> None:
    mission = written(sample_plan(), vehicle=vehicle, firmware=firmware, altitude_m=altitude_m)["mission"]
    assert (mission["vehicleType"], mission["firmwareType"]) == (vehicle_type, firmware_type)
    for item in mission["items"][1:]:
        assert item["frame"] == 3
        assert item["params"][6] == item["Altitude"] == altitude_m
        assert item["AltitudeMode"] == 1
        assert item["AMSLAltAboveTerrain"] is None


def test_return_home_ends_at_home() -> None:
    mission = written(sample_plan(SQUARE, return_home=True))["mission"]
    assert mission["items"][-1]["params"][4:6] == mission["plannedHomePosition"][:2]


def test_a_plan_without_moves_is_one_waypoint() -> None:
    assert len(written(sample_plan([]))["mission"]["items"]) == 2


def test_more_items_than_the_autopilot_stores_are_refused() -> None:
    plan = sample_plan(ZIGZAG * 100)
    count = len(plan.waypoints) + 2
    with pytest.raises(ArgumentError, match=rf"{count} items .* 718 .*--cell.*--budget"):
        written(plan)
    with pytest.raises(ArgumentError, match=r" 500 .*px4"):
        written(plan, firmware="px4")
    assert len(written(plan, max_items=count)["mission"]["items"]) == count - 1
    with pytest.raises(ArgumentError, match=f"{count - 1} that the autopilot"):
        written(plan, max_items=count - 1)


def test_the_limits_count_home_and_speed() -> None:
    for firmware, limit in (("ardupilot", 718), ("px4", 500)):
        moves = (ZIGZAG * 100)[: limit - 3]
        assert len(written(sample_plan(moves), firmware=firmware)["mission"]["items"]) == limit - 1
        with pytest.raises(ArgumentError, match=f"{limit + 1} items"):
            written(sample_plan((ZIGZAG * 100)[: limit - 2]), firmware=firmware)


def _six_parameters(document: dict[str, Any]) -> None:
    document["mission"]["items"][1]["params"].pop()


def _no_rally_points(document: dict[str, Any]) -> None:
    del document["rallyPoints"]


def _home_without_altitude(document: dict[str, Any]) -> None:
    document["mission"]["plannedHomePosition"].pop()


def _one_altitude_member(document: dict[str, Any]) -> None:
    del document["mission"]["items"][1]["AMSLAltAboveTerrain"]


def _no_items(document: dict[str, Any]) -> None:
    document["mission"]["items"] = []


def _no_firmware(document: dict[str, Any]) -> None:
    del document["mission"]["firmwareType"]


def _home_lon_lat_swapped(document: dict[str, Any]) -> None:
    lat, lon, alt = document["mission"]["plannedHomePosition"]
    document["mission"]["plannedHomePosition"] = [lon, lat, alt]


@pytest.mark.parametrize(
    "damage",
    [
        _six_parameters,
        _no_rally_points,
        _home_without_altitude,
        _one_altitude_member,
        _no_items,
        _no_firmware,
        _home_lon_lat_swapped,
    ],
)
def test_the_schema_rejects_a_damaged_plan(damage: Callable[[dict[str, Any]], None]) -> None:
    document = written(sample_plan())
    damage(document)
    assert not VALIDATOR.is_valid(document)
