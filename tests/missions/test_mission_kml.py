from __future__ import annotations

import re
from typing import Any

import pytest
from fastkml import KML, LineString, Placemark, Point, validator
from fastkml.exceptions import KMLParseError
from fastkml.utils import find_all
from lxml import etree
from mission_samples import DIAGONAL, SQUARE, UTM_SOUTH, WEB_MERCATOR, ZIGZAG, assert_at_cells, sample_plan

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.missions import kml
from hrt_cli.missions.mission import MissionOptions, mission_of

FIJI_UTM = "EPSG:32760"


def is_valid(text: str) -> bool:
    """Whether the OGC's schema (fastkml brings it) takes the file."""
    return bool(validator.get_schema_parser().validate(etree.fromstring(text.encode())))


def text_of(plan: PlanDocument, **options: Any) -> str:
    text = kml.to_text(mission_of(plan, MissionOptions(**options)))
    assert is_valid(text), validator.get_schema_parser().error_log
    assert text.isascii()
    return text


def peer(text: str) -> KML:
    """The file as fastkml reads it, strictly (of text lxml takes no declaration)."""
    return KML.from_string(text.split("?>\n", 1)[1], strict=True)


def placemarks(text: str) -> tuple[list[Placemark], list[Placemark]]:
    """Those of the lines, and those of the points."""
    found = list(find_all(peer(text), of_type=Placemark))
    points = [place for place in found if isinstance(place.kml_geometry, Point)]
    return [place for place in found if place not in points], points


def data_of(place: Placemark) -> dict[str, str]:
    assert place.extended_data is not None
    return {each.name: each.value for each in place.extended_data.elements}


def coordinates(line: LineString) -> list[tuple[float, float]]:
    return [(lon, lat) for lon, lat in line.kml_coordinates.coords]


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_the_line_and_the_points_are_at_the_plans_waypoints(crs: str) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    (line,), points = placemarks(text_of(plan))
    cells = [waypoint.cell for waypoint in plan.waypoints]
    assert isinstance(line.kml_geometry, LineString)
    assert line.kml_geometry.tessellate
    assert_at_cells(plan, coordinates(line.kml_geometry), cells)
    assert_at_cells(plan, [tuple(p.kml_geometry.kml_coordinates.coords[0]) for p in points], cells)
    assert [p.name for p in points] == [f"WP{i:03d}" for i in range(1, len(cells) + 1)]
    assert [(int(data_of(p)["row"]), int(data_of(p)["col"])) for p in points] == cells


def test_nothing_is_at_a_height_above_the_sea() -> None:
    text = text_of(sample_plan(), vehicle="submarine", altitude_m=-4.0)
    assert set(re.findall("<altitudeMode>(.*)</altitudeMode>", text)) == {"clampToGround"}


@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        ({"vehicle": "submarine", "altitude_m": -4.5}, "altitude_m", "-4.500"),
        ({"vehicle": "submarine", "above_bottom_m": 2.0}, "above_bottom_m", "2.000"),
        ({"speed_m_s": 1.25}, "speed_m_s", "1.250"),
        ({"hold_s": 3}, "hold_s", "3"),
    ],
)
def test_the_points_hold_depth_speed_and_wait(options: dict[str, Any], name: str, value: str) -> None:
    _, points = placemarks(text_of(sample_plan(), **options))
    assert {data_of(point)[name] for point in points} == {value}


def test_waypoints_between_cells_claim_none() -> None:
    _, points = placemarks(text_of(sample_plan([(0, 1)] * 8), spacing_m=1.0))
    assert [("row" in data_of(point), point.description) for point in points][:2] == [
        (True, "step 0, row 3, col 2"),
        (False, "between"),
    ]


def test_a_plan_without_moves_is_a_point() -> None:
    lines, points = placemarks(text_of(sample_plan([])))
    assert (len(lines), len(points)) == (0, 1)


def test_names_sort_as_they_are_driven() -> None:
    names = re.findall("<name>(WP.*)</name>", text_of(sample_plan(ZIGZAG * 150)))
    assert len(names) > 1000
    assert names == sorted(names)


def test_any_name_and_method_is_valid_xml() -> None:
    text = text_of(sample_plan(SQUARE, method="<&>\x01"), name='a<b & "c" ]]> \x00\x0b\ud800 é 漢 🚜')
    document = peer(text).features[0]
    assert document.name == 'a<b & "c" ]]> ??? é 漢 🚜'
    assert "method <&>?" in document.description


@pytest.mark.parametrize("there_and_back", [False, True])
def test_a_line_across_the_meridian_180_is_cut_there(there_and_back: bool) -> None:
    moves = [(0, 1)] * 9 + ([(1, 0)] + [(0, -1)] * 9 if there_and_back else [])
    plan = sample_plan(moves, crs=FIJI_UTM, lonlat=(179.9996, -16.8), cell=5.0)
    (line,), points = placemarks(text_of(plan))
    parts = [coordinates(part) for part in line.kml_geometry.kml_geometries]
    assert len(parts) == 2 + there_and_back
    assert all(len({lon > 0 for lon, _ in part}) == 1 for part in parts)
    assert (parts[0][-1][0], parts[1][0]) == (180.0, (-180.0, parts[0][-1][1]))
    cells = [waypoint.cell for waypoint in plan.waypoints]
    assert_at_cells(plan, [p for part in parts for p in part if abs(p[0]) < 180], cells)
    assert_at_cells(plan, [tuple(p.kml_geometry.kml_coordinates.coords[0]) for p in points], cells)


@pytest.mark.parametrize(
    ("sound", "broken"),
    [
        (r"(<name>WP001</name>)\s*(<description>.*</description>)", r"\2\1"),
        (r"(?s)(<ExtendedData>.*?</ExtendedData>)\s*(<Point>.*?</Point>)", r"\2\1"),
        (r"(<tessellate>1</tessellate>)\s*(<altitudeMode>.*</altitudeMode>)", r"\2\1"),
        (r"<tessellate>1<", "<tessellate>yes<"),
        (r"clampToGround", "clampToSea"),
        (r"<value>(.*?)</value>", r"<worth>\1</worth>"),
        (r"<Point>", "<Point><coordinate>1,2</coordinate>"),
        (r"kml/2\.2", "kml/2.9"),
        (r"</Document>", "</Document><Document/>"),
    ],
)
def test_the_ogcs_schema_rejects_a_damaged_file(sound: str, broken: str) -> None:
    text, count = re.subn(sound, broken, text_of(sample_plan()), count=1)
    assert count == 1
    assert not is_valid(text)


def test_the_peer_finds_text_in_place_of_numbers() -> None:
    """To the schema coordinates are text: that they are numbers only a reader sees."""
    text = re.sub("<coordinates>[^,]*,", "<coordinates>east,", text_of(sample_plan()), count=1)
    with pytest.raises(KMLParseError):
        placemarks(text)
