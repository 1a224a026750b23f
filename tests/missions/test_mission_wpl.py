from __future__ import annotations

from pathlib import Path
from typing import Any

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
from pymavlink import mavwp

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions import wpl
from hrt_cli.missions.formats import require_room
from hrt_cli.missions.mission import MissionOptions, mission_of


def text_of(plan: PlanDocument, **options: Any) -> str:
    mission = mission_of(plan, MissionOptions(**options))
    require_room(mission, None)
    return wpl.to_text(mission)


def loaded(text: str, folder: Path) -> list[Any]:
    """The items that pymavlink reads."""
    path = folder / "mission.waypoints"
    path.write_bytes(text.encode())
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(path)) == loader.count()
    return [loader.wp(index) for index in range(loader.count())]


@pytest.mark.parametrize("crs", [UTM_SOUTH, WEB_MERCATOR])
def test_pymavlink_reads_home_speed_and_the_plans_cells(crs: str, tmp_path: Path) -> None:
    plan = sample_plan(DIAGONAL, crs=crs)
    home, speed, *waypoints = loaded(text_of(plan, speed_m_s=1.25), tmp_path)
    assert (home.seq, home.current, home.frame, home.command) == (0, 1, 0, 16)
    assert_at_cells(plan, [(home.y, home.x)], [plan.start])
    assert (speed.command, speed.param1, speed.param2, speed.param3) == (178, 1, 1.25, -1)
    assert {(w.frame, w.command, w.current, w.autocontinue) for w in waypoints} == {(3, 16, 0, 1)}
    assert_at_cells(plan, [(w.y, w.x) for w in waypoints], waypoint_cells(plan))


def test_positions_survive_the_integers_of_the_link(tmp_path: Path) -> None:
    plan = sample_plan(DIAGONAL, cell=0.05)
    _, _, *waypoints = loaded(text_of(plan), tmp_path)
    sent = [(round(w.y * 1e7) / 1e7, round(w.x * 1e7) / 1e7) for w in waypoints]
    assert_at_cells(plan, sent, waypoint_cells(plan))


def test_depth_hold_and_radius(tmp_path: Path) -> None:
    text = text_of(sample_plan(), vehicle="submarine", altitude_m=-2.5, hold_s=5, waypoint_radius_m=1.5)
    home, _, *waypoints = loaded(text, tmp_path)
    assert home.z == 0
    assert {(w.z, w.param1, w.param2, w.param4) for w in waypoints} == {(-2.5, 5, 1.5, 0)}


def test_return_home_ends_at_home(tmp_path: Path) -> None:
    home, *_, last = loaded(text_of(sample_plan(SQUARE, return_home=True)), tmp_path)
    assert (last.x, last.y) == (home.x, home.y)


def test_the_layout_that_strict_readers_ask_for() -> None:
    plan = sample_plan()
    text = text_of(plan)
    header, *rows = text.removesuffix("\n").split("\n")
    assert header == "QGC WPL 110"
    assert text.isascii()
    assert len(rows) == len(plan.waypoints) + 2
    for index, row in enumerate(rows):
        fields = row.split("\t")
        assert len(fields) == 12
        assert fields[0] == str(index)
        assert all(len(degrees.partition(".")[2]) >= 8 for degrees in fields[8:10])
        assert not any(field.startswith("-0.") and float(field) == 0 for field in fields)


def test_more_items_than_the_autopilot_stores_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"803 items"):
        text_of(sample_plan(ZIGZAG * 100))


@pytest.mark.parametrize(
    ("sound", "broken"),
    [("\t1\n", "\n"), ("QGC WPL 110", "QGC WPL 120"), ("\t178\t", "\tfast\t"), ("\t1\n", "\t1\t1\n")],
)
def test_pymavlink_rejects_a_damaged_file(sound: str, broken: str, tmp_path: Path) -> None:
    text = text_of(sample_plan())
    assert sound in text
    with pytest.raises((mavwp.MAVWPError, ValueError)):
        loaded(text.replace(sound, broken), tmp_path)
