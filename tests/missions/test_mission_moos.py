from __future__ import annotations

import re
from typing import Any

import pytest
from mission_samples import DIAGONAL, SQUARE, UTM_SOUTH, ZIGZAG, assert_at_cells, sample_plan, waypoint_cells
from moos_reader import read_behaviors, read_points
from pyproj import CRS, Transformer

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions import moos
from hrt_cli.missions.mission import MissionOptions, mission_of


def text_of(plan: PlanDocument, **options: Any) -> str:
    return moos.to_text(mission_of(plan, MissionOptions(**options)))


def datum_of(text: str) -> tuple[float, float]:
    """Longitude and latitude of the datum, as they are to be put into the .moos file."""
    (lat,) = re.findall(r"^// +LatOrigin += (\S+)$", text, re.M)
    (lon,) = re.findall(r"^// +LongOrigin = (\S+)$", text, re.M)
    return float(lon), float(lat)


def moos_lonlat(text: str) -> list[tuple[float, float]]:
    """Where MOOS built with USE_UTM drives: CMOOSGeodesy counts zones of 6 degrees and knows no southern ones."""
    lon, lat = datum_of(text)
    zone = int((lon + 180) // 6) + 1
    utm = CRS.from_proj4(f"+proj=utm +ellps=WGS84 +zone={zone}")
    forth = Transformer.from_crs("EPSG:4326", utm, always_xy=True)
    east, north = forth.transform(lon, lat)
    back = Transformer.from_crs(utm, "EPSG:4326", always_xy=True)
    waypoints = read_behaviors(text)[1][0]
    return [back.transform(x + east, y + north) for x, y in read_points(waypoints.only("points"))]


@pytest.mark.parametrize(
    ("crs", "lonlat"),
    [
        (UTM_SOUTH, (138.6012345, -34.9287654)),
        ("EPSG:32633", (14.2, 52.1)),
        ("EPSG:32632", (5.3, 60.4)),  # Bergen lies in zone 32, and for MOOS in 31
        ("EPSG:32633", (15.6, 78.2)),  # Svalbard
        ("EPSG:32632", (11.5, 79.0)),  # Svalbard: in 33, and for MOOS in 32
        ("EPSG:3857", (-122.3, 47.6)),
    ],
)
def test_the_helm_drives_to_the_plans_cells(crs: str, lonlat: tuple[float, float]) -> None:
    plan = sample_plan(DIAGONAL, crs=crs, lonlat=lonlat, cell=3.0)
    assert_at_cells(plan, moos_lonlat(text_of(plan)), waypoint_cells(plan))


def test_true_east_and_north_where_asked_for() -> None:
    plan = sample_plan(DIAGONAL)
    text = text_of(plan, frame="enu")
    lon, lat = datum_of(text)
    back = Transformer.from_crs(f"+proj=aeqd +lon_0={lon} +lat_0={lat} +datum=WGS84", "EPSG:4326", always_xy=True)
    points = read_points(read_behaviors(text)[1][0].only("points"))
    assert_at_cells(plan, [back.transform(x, y) for x, y in points], waypoint_cells(plan))
    assert "true east" in text


def test_the_behavior_waits_to_be_deployed_and_ends_itself() -> None:
    initial, (waypoints,) = read_behaviors(text_of(sample_plan(), speed_m_s=1.5))
    assert initial == {"DEPLOY": "false"}
    assert waypoints.only("condition") == "DEPLOY = true"
    assert waypoints.only("endflag") == "DEPLOY = false"
    assert (waypoints.only("speed"), waypoints.only("order"), waypoints.only("repeat")) == ("1.500", "normal", "0")


def test_waypoints_are_reached_within_their_cell_or_as_asked_for() -> None:
    _, (waypoints,) = read_behaviors(text_of(sample_plan(cell=4.0)))
    assert (waypoints.only("capture_radius"), waypoints.only("slip_radius")) == ("2.000", "4.000")
    _, (waypoints,) = read_behaviors(text_of(sample_plan(), waypoint_radius_m=3.0))
    assert (waypoints.only("capture_radius"), waypoints.only("slip_radius")) == ("3.000", "6.000")


@pytest.mark.parametrize(("altitude_m", "depth"), [(-12.5, "12.500"), (0.0, "0.000")])
def test_a_submarine_keeps_its_depth(altitude_m: float, depth: str) -> None:
    _, (_, keep) = read_behaviors(text_of(sample_plan(), vehicle="submarine", altitude_m=altitude_m))
    assert keep.kind == "BHV_ConstantDepth"
    assert keep.only("depth") == depth
    assert keep.only("duration") == "no-time-limit"
    assert keep.only("condition") == "DEPLOY = true"


@pytest.mark.parametrize(
    ("options", "reason"),
    [({"vehicle": "submarine", "above_bottom_m": 2.0}, "height above the bottom"), ({"hold_s": 5}, "does not wait")],
)
def test_what_the_behaviors_cannot_do_is_refused(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ArgumentError, match=reason):
        text_of(sample_plan(), **options)


def test_a_thousand_waypoints_stand_in_lines_that_the_helm_reads() -> None:
    plan = sample_plan(ZIGZAG * 150)
    text = text_of(plan)
    assert max(map(len, text.splitlines())) < 200
    assert_at_cells(plan, moos_lonlat(text), waypoint_cells(plan))
    line = next(line for line in text_of(sample_plan(ZIGZAG * 20)).splitlines() if line.startswith("  points "))
    assert line.count(",") == 161


@pytest.mark.parametrize("name", ["a\\", "x // y", "{", "}", "ü", "# no"])
def test_a_name_changes_nothing_but_a_comment(name: str) -> None:
    text = text_of(sample_plan(SQUARE), name=name)
    assert read_behaviors(text) == read_behaviors(text_of(sample_plan(SQUARE)))
    assert datum_of(text) == datum_of(text_of(sample_plan(SQUARE)))


@pytest.mark.parametrize(
    ("sound", "broken"),
    [
        (r"Behavior = BHV_Waypoint", "Behavior = BHV_Waypoints"),
        (r"\n\{", ""),
        (r"\n\}", ""),
        (r"speed  ", "sped  "),
        (r"points( *)= (.*)", r"points\1= pts={\2}"),  # the brace at the end closes the behavior
        (r"(speed .*)", r"\1 }"),
        (r"points *= .*", "points = "),
        (r"(points *= .*)", r"\1" + ":1,2" * 2000),
    ],
)
def test_the_reader_refuses_what_the_helm_refuses(sound: str, broken: str) -> None:
    text, count = re.subn(sound, broken, text_of(sample_plan()), count=1)
    assert count == 1
    with pytest.raises(ValueError, match=r"."):
        read_behaviors(text)


@pytest.mark.parametrize("value", ["1,2:x,3", "1,2:3", "1,2:", "1,nan"])
def test_the_reader_refuses_broken_points(value: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_points(value)
