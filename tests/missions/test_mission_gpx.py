from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gpxpy
import pytest
from lxml import etree
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
from hrt_cli.missions import gpx
from hrt_cli.missions.mission import MissionOptions, mission_of

XSD = etree.XMLSchema(etree.parse(Path(__file__).parent / "gpx_route.xsd"))


def is_valid(text: str) -> bool:
    return bool(XSD.validate(etree.fromstring(text.encode())))


def text_of(plan: PlanDocument, **options: Any) -> str:
    text = gpx.to_text(mission_of(plan, MissionOptions(**options)))
    XSD.assertValid(etree.fromstring(text.encode()))
    assert text.isascii()
    assert text.endswith("</gpx>\n")
    return text


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_the_route_is_at_the_plans_cells(crs: str) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    read = gpxpy.parse(text_of(plan))
    assert (read.version, read.creator, read.name) == ("1.1", "hrt", "hrt plan")
    (route,) = read.routes
    assert not read.waypoints
    assert not read.tracks
    assert_at_cells(plan, [(p.longitude, p.latitude) for p in route.points], waypoint_cells(plan))
    assert [p.name for p in route.points] == [f"WP{i:03d}" for i in range(1, len(route.points) + 1)]
    assert {(p.time, p.elevation) for p in route.points} == {(None, None)}


def test_degrees_have_eight_decimals() -> None:
    degrees = re.findall(r'l(?:at|on)="([^"]*)"', text_of(sample_plan()))
    assert degrees
    assert all(re.fullmatch(r"-?\d+\.\d{8}", value) for value in degrees)


def test_return_home_ends_at_home() -> None:
    points = gpxpy.parse(text_of(sample_plan(SQUARE, return_home=True))).routes[0].points
    assert (points[0].latitude, points[0].longitude) == (points[-1].latitude, points[-1].longitude)


def test_names_sort_as_they_are_driven() -> None:
    names = [p.name for p in gpxpy.parse(text_of(sample_plan(ZIGZAG * 150))).routes[0].points]
    assert len(names) > 1000
    assert names == sorted(names)


def test_any_name_and_method_is_valid_xml() -> None:
    name = 'a<b & "c" ]]> \x00\x0b\ud800 é 漢 🚜'
    read = gpxpy.parse(text_of(sample_plan(method="<&>\x01"), name=name))
    assert read.name == 'a<b & "c" ]]> ??? é 漢 🚜'
    assert "method <&>?" in read.description


def test_the_meridian_180_is_minus_180() -> None:
    members = sample_plan([]).model_dump()
    members["lonlat"] = [(180.0, -16.8)]
    members["waypoints"][0] |= {"lon": 180.0, "lat": -16.8}
    assert 'lon="-180.00000000"' in text_of(PlanDocument.model_validate(members))


@pytest.mark.parametrize(
    ("sound", "broken"),
    [
        (r' lat="[^"]*"', ' lat="91.0"'),
        (r' lon="[^"]*"', ' lon="180.0"'),
        (r' lat="[^"]*"', ""),
        (r"(<name>WP001</name>)\s*(<desc>.*</desc>)", r"\2\1"),
        (r"(?s)(  <metadata>.*</metadata>\n)(.*</rte>\n)", r"\2\1"),
        (r"</rte>", '</rte><wpt lat="1" lon="1"/>'),
        (r' version="1.1" creator', ' version="1.0" creator'),
        (r"GPX/1/1", "GPX/1/0"),
    ],
)
def test_the_xsd_rejects_a_damaged_route(sound: str, broken: str) -> None:
    text, count = re.subn(sound, broken, text_of(sample_plan()), count=1)
    assert count == 1
    assert not is_valid(text)
