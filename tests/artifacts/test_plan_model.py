from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError

Members = dict[str, Any]


@pytest.fixture
def members() -> Members:
    """A plan of three moves, east, east and south, in cells of half a metre."""
    cells = [[2, 3], [2, 4], [2, 5], [3, 5]]
    xy = [[100 + 0.5 * (col + 0.5), 200 - 0.5 * (row + 0.5)] for row, col in cells]
    lonlat = [[13.0 + col * 1e-6, 52.0 - row * 1e-6] for row, col in cells]
    waypoints = [
        {
            "index": i,
            "step": s,
            "cell": cells[s],
            "x": xy[s][0],
            "y": xy[s][1],
            "lon": lonlat[s][0],
            "lat": lonlat[s][1],
        }
        for i, s in enumerate([0, 2, 3])
    ]
    return {
        "format": "hrt-plan",
        "version": 1,
        "method": "refined",
        "seed": 0,
        "objective": "total",
        "gamma": 0.99,
        "connectivity": 4,
        "return_home": False,
        "budget": {"value": 3.0, "unit": "steps", "cells": 3.0},
        "grid": {
            "rows": 10,
            "cols": 20,
            "transform": [0.5, 0.0, 100.0, 0.0, -0.5, 200.0],
            "crs": "EPSG:32633",
            "cell_size_m": 0.5,
            "georeference": "real",
        },
        "start": [2, 3],
        "steps": 3,
        "score": 3.0,
        "discounted_score": 2.9,
        "upper_bound": 4.0,
        "gap": 0.25,
        "length_m": 1.5,
        "speed_m_s": 0.5,
        "time_s": 3.0,
        "waypoints": waypoints,
        "cells": cells,
        "xy": xy,
        "lonlat": lonlat,
    }


def read(folder: Path, members: Members) -> PlanDocument:
    (folder / "plan.json").write_text(json.dumps(members))
    return read_model(folder / "plan.json", PlanDocument)


def test_a_published_plan_is_read_back_the_same(tmp_path: Path, members: Members) -> None:
    document = read(tmp_path, members)
    target = tmp_path / "out.json"
    publish_json(target, document.model_dump(mode="json", exclude={"provenance"}), record("plan", 1, {}, {}))
    back = read_model(target, PlanDocument)
    assert back.provenance is not None
    assert back.model_copy(update={"provenance": None}) == document
    lines = target.read_text().splitlines()
    assert sum('"index"' in line for line in lines) == 3


def test_a_plan_of_one_cell_is_a_plan(tmp_path: Path, members: Members) -> None:
    for key in ("cells", "xy", "lonlat", "waypoints"):
        members[key] = members[key][:1]
    assert read(tmp_path, members | {"steps": 0, "length_m": 0.0, "time_s": 0.0}).cells == [(2, 3)]


def test_a_plan_without_georeference_is_a_plan(tmp_path: Path, members: Members) -> None:
    members["lonlat"] = None
    members["grid"] |= {"crs": None, "georeference": "none"}
    for waypoint in members["waypoints"]:
        waypoint |= {"lon": None, "lat": None}
    assert read(tmp_path, members).lonlat is None


def test_a_diagonal_is_a_move_between_8_neighbours_only(tmp_path: Path, members: Members) -> None:
    members["cells"][3] = members["waypoints"][2]["cell"] = [3, 6]
    with pytest.raises(InputError, match=r"cells \(2, 5\) and \(3, 6\) are not neighbours"):
        read(tmp_path, members)
    assert read(tmp_path, members | {"connectivity": 8}).cells[3] == (3, 6)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("format", "hrt-policy"),
        ("version", 2),
        ("objective", "both"),
        ("gamma", 0.0),
        ("gamma", 1.01),
        ("connectivity", 6),
        ("return_home", 1),
        ("steps", 2),
        ("steps", 3.0),
        ("steps", -1),
        ("score", -0.1),
        ("score", None),
        ("gap", 1.5),
        ("speed_m_s", 0.0),
        ("time_s", "3"),
        ("start", [2, 4]),
        ("start", [2, 3, 4]),
        ("start", [2.0, 3.0]),
        ("cells", []),
        ("cells", [[2, 3], [2, 4], [2, 4], [3, 4]]),
        ("cells", [[2, 3], [2, 4], [2, 6], [3, 6]]),
        ("cells", [[2, 3], [2, 4], [2, 5]]),
        ("xy", [[0.0, 0.0]]),
        ("lonlat", [[0.0, 0.0]]),
        ("waypoints", []),
        ("unknown", 0),
    ],
)
def test_a_member_out_of_its_range_is_refused(tmp_path: Path, members: Members, key: str, value: object) -> None:
    with pytest.raises(InputError, match=r"plan\.json: "):
        read(tmp_path, members | {key: value})


@pytest.mark.parametrize("key", ["method", "grid", "budget", "start", "cells", "waypoints", "upper_bound", "lonlat"])
def test_a_missing_member_is_refused(tmp_path: Path, members: Members, key: str) -> None:
    del members[key]
    with pytest.raises(InputError, match=f"{key}: Field required"):
        read(tmp_path, members)


def test_cells_outside_the_grid_are_refused(tmp_path: Path, members: Members) -> None:
    for rows, cols in ((3, 20), (10, 5)):
        with pytest.raises(InputError, match="a cell lies outside the grid"):
            read(tmp_path, members | {"grid": members["grid"] | {"rows": rows, "cols": cols}})


@pytest.mark.parametrize(
    "wrong",
    [{"lat": 91.0}, {"lon": -181.0}, {"cell": [2]}, {"step": -1}, {"index": 0.5}, {"x": None}, {"depth": 3.0}],
)
def test_a_waypoint_that_is_none_is_refused(tmp_path: Path, members: Members, wrong: Members) -> None:
    members["waypoints"][1] |= wrong
    with pytest.raises(InputError, match=rf"waypoints\.1\.{next(iter(wrong))}"):
        read(tmp_path, members)


@pytest.mark.parametrize(
    "grid",
    [
        {"rows": 0},
        {"cell_size_m": 0.0},
        {"georeference": "maybe"},
        {"transform": [0.5, 0.0, 100.0, 0.0, -0.5]},
        {"crs": 32633},
    ],
)
def test_a_grid_that_is_none_is_refused(tmp_path: Path, members: Members, grid: Members) -> None:
    with pytest.raises(InputError, match=r"grid\."):
        read(tmp_path, members | {"grid": members["grid"] | grid})
