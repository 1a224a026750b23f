from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_readers import read_positions
from mission_samples import (
    SQUARE,
    UTM_SOUTH,
    WEB_MERCATOR,
    assert_at_cells,
    cells_of,
    sample_plan,
    ungeoreferenced_plan,
    waypoint_cells,
)

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions.formats import FORMATS, format_for
from hrt_cli.missions.mission import MissionOptions, mission_of

MOVES_4 = [(0, 1), (1, 0), (0, -1), (-1, 0)]
MOVES_8 = [*MOVES_4, (1, 1), (1, -1), (-1, 1), (-1, -1)]
CRS_REGIONS = {
    UTM_SOUTH: ((138.1, 143.9), (-79.0, -1.0)),
    "EPSG:32633": ((12.1, 17.9), (1.0, 83.0)),
    WEB_MERCATOR: ((-179.9, 179.9), (-80.0, 80.0)),
    "EPSG:2225": ((-124.0, -119.9), (39.3, 41.9)),
}


@st.composite
def plans(draw: st.DrawFn) -> PlanDocument:
    connectivity = draw(st.sampled_from([4, 8]))
    moves = draw(st.lists(st.sampled_from(MOVES_4 if connectivity == 4 else MOVES_8), max_size=40))
    crs = draw(st.sampled_from(sorted(CRS_REGIONS)))
    (west, east), (south, north) = CRS_REGIONS[crs]
    start = (1000, 1000)
    home = cells_of(start, moves)[-1] == start
    return sample_plan(
        moves,
        crs=crs,
        lonlat=(draw(st.floats(west, east)), draw(st.floats(south, north))),
        cell=draw(st.floats(0.05, 20.0)),
        turn_deg=draw(st.sampled_from([0.0, 30.0, -117.0])),
        start=start,
        connectivity=connectivity,
        return_home=home,
    )


@settings(max_examples=25, deadline=None)
@given(plan=plans())
def test_every_format_puts_every_waypoint_on_its_cell(
    plan: PlanDocument, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.getbasetemp()
    for name, entry in FORMATS.items():
        text = entry.write(mission_of(plan, MissionOptions()))
        assert_at_cells(plan, read_positions(name, text, folder), waypoint_cells(plan))


@pytest.mark.parametrize("name", FORMATS)
def test_text_is_plain_final_and_the_same_each_time(name: str) -> None:
    options = MissionOptions(name="Nord-Süd")
    text = FORMATS[name].write(mission_of(sample_plan(SQUARE), options))
    assert text == FORMATS[name].write(mission_of(sample_plan(SQUARE), options))
    assert text.isascii()
    assert text.endswith("\n")
    assert not text.endswith("\n\n")
    assert "\r" not in text


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("georeference", ["none", "fake"])
def test_no_format_takes_a_plan_without_real_coordinates(name: str, georeference: str) -> None:
    with pytest.raises(ArgumentError, match="georeference"):
        FORMATS[name].write(mission_of(ungeoreferenced_plan(georeference), MissionOptions()))


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("out/mission.plan", "qgc"),
        ("MISSION.PLAN", "qgc"),
        ("m.waypoints", "wpl"),
        ("m.txt", "wpl"),
        ("m.gpx", "gpx"),
        ("m.geojson", "geojson"),
        ("m.json", "geojson"),
        ("m.kml", "kml"),
        ("m.csv", "csv"),
        ("m.yaml", "nav2"),
        ("m.YML", "nav2"),
        ("m.bhv", "moos"),
    ],
)
def test_the_suffix_names_the_format(path: str, name: str) -> None:
    assert format_for(path) is FORMATS[name]
    assert format_for(Path(path)) is FORMATS[name]


def test_a_name_is_stronger_than_the_suffix() -> None:
    assert format_for("m.gpx", "wpl") is FORMATS["wpl"]


@pytest.mark.parametrize(
    ("path", "name"), [("m.kmz", None), ("m", None), (".gpx", None), ("m.gpx", "gpx2"), ("m.gpx", "")]
)
def test_an_unknown_format_is_refused_with_the_known_ones(path: str, name: str | None) -> None:
    with pytest.raises(ArgumentError, match=r"qgc.*wpl.*gpx.*geojson.*kml.*csv.*nav2.*moos"):
        format_for(path, name)


def test_only_a_format_of_several_files_fills_a_folder() -> None:
    assert [name for name, entry in FORMATS.items() if entry.is_folder(Path("out/site"))] == ["nav2"]
    assert not FORMATS["nav2"].is_folder(Path("out/site.yaml"))


def test_no_two_formats_share_a_suffix() -> None:
    suffixes = [suffix for entry in FORMATS.values() for suffix in entry.suffixes]
    assert len(suffixes) == len(set(suffixes))
    assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in suffixes)
