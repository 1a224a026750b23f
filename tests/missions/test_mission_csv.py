from __future__ import annotations

import csv
import io
import re
from typing import Any

import numpy as np
import pytest
from mission_samples import (
    DIAGONAL,
    LAWNMOWER,
    UTM_SOUTH,
    WEB_MERCATOR,
    WGS84,
    assert_at_cells,
    sample_plan,
    waypoint_cells,
)
from pyproj import Transformer

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.missions import points_csv
from hrt_cli.missions.mission import MissionOptions, mission_of

COLUMNS = "index,lat,lon,altitude_m,x_m,y_m,distance_m,heading_deg,speed_m_s,hold_s,step,row,col"


def text_of(plan: PlanDocument, **options: Any) -> str:
    return points_csv.to_text(mission_of(plan, MissionOptions(**options)))


def read(text: str) -> np.ndarray:
    """The table as NumPy reads it; an empty field is NaN."""
    return np.genfromtxt(io.StringIO(text), delimiter=",", names=True, dtype=float, ndmin=1)


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_rows_are_at_the_plans_cells(crs: str) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    table = read(text_of(plan))
    assert_at_cells(plan, list(zip(table["lon"], table["lat"], strict=True)), waypoint_cells(plan))
    assert [tuple(cell) for cell in np.stack([table["row"], table["col"]], 1)] == waypoint_cells(plan)
    assert table["index"].tolist() == list(range(len(plan.waypoints)))
    assert table["step"].tolist() == [waypoint.step for waypoint in plan.waypoints]


def test_the_text_is_what_every_reader_of_csv_takes() -> None:
    text = text_of(sample_plan(), hold_s=4, speed_m_s=1.5)
    rows = list(csv.DictReader(io.StringIO(text), strict=True))
    assert text.splitlines()[0] == COLUMNS
    assert {len(row) for row in rows} == {13}
    assert {(row["speed_m_s"], row["hold_s"]) for row in rows} == {("1.500", "4")}
    assert all(re.fullmatch(r"-?\d+\.\d{8}", row["lat"]) for row in rows)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, -117.0])
def test_distance_and_heading_are_those_of_the_geodesic(turn_deg: float) -> None:
    plan = sample_plan(LAWNMOWER, turn_deg=turn_deg, cell=20.0)
    table = read(text_of(plan))
    bearings, _, legs = WGS84.inv(table["lon"][:-1], table["lat"][:-1], table["lon"][1:], table["lat"][1:])
    assert table["distance_m"] == pytest.approx(np.concatenate([[0], np.cumsum(legs)]), abs=0.01)
    # Apart by up to half a turn: compared as directions on the circle.
    off = (table["heading_deg"][:-1] - bearings + 180) % 360 - 180
    assert np.abs(off).max() < 0.01
    assert table["heading_deg"][-1] == table["heading_deg"][-2]
    assert table["heading_deg"].min() >= 0
    assert table["heading_deg"].max() < 360


def test_north_is_0_and_never_360() -> None:
    members = sample_plan([(-1, 0)]).model_dump()
    lon, lat = members["lonlat"][0]
    members["lonlat"] = [(lon, lat), (lon - 1e-12, lat + 1e-5)]
    for waypoint in members["waypoints"]:
        waypoint["lon"], waypoint["lat"] = members["lonlat"][waypoint["step"]]
    assert read(text_of(PlanDocument.model_validate(members)))["heading_deg"].tolist() == [0, 0]


@pytest.mark.parametrize("frame", ["utm", "enu"])
def test_metres_are_in_the_local_frame(frame: str) -> None:
    plan = sample_plan(DIAGONAL)
    datum = plan.lonlat[0]
    table = read(text_of(plan, frame=frame, datum=datum))
    crs = UTM_SOUTH if frame == "utm" else f"+proj=aeqd +lon_0={datum[0]} +lat_0={datum[1]} +datum=WGS84"
    to_metres = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x, y = to_metres.transform(table["lon"], table["lat"])
    x0, y0 = to_metres.transform(*datum)
    assert table["x_m"] == pytest.approx(x - x0, abs=0.002)
    assert table["y_m"] == pytest.approx(y - y0, abs=0.002)


def test_depth_and_height_above_the_bottom_have_their_own_columns() -> None:
    depth = read(text_of(sample_plan(), vehicle="submarine", altitude_m=-3.25))
    assert set(depth["altitude_m"]) == {-3.25}
    above = text_of(sample_plan(), vehicle="submarine", above_bottom_m=2.5)
    assert above.startswith(COLUMNS.replace("altitude_m", "above_bottom_m"))
    assert set(read(above)["above_bottom_m"]) == {2.5}


def test_waypoints_between_cells_have_no_step() -> None:
    table = read(text_of(sample_plan([(0, 1)] * 8), spacing_m=1.0))
    assert np.isnan(table["step"]).tolist() == [False, True, True, True, False]
    assert np.diff(table["distance_m"]) == pytest.approx(1.0, abs=0.002)


def test_a_single_waypoint_has_no_heading() -> None:
    table = read(text_of(sample_plan([])))
    assert np.isnan(table["heading_deg"]).all()
    assert table["distance_m"].tolist() == [0]
