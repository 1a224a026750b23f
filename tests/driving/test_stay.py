"""`hrt drive --stay`: the log of a leg that was left out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bag_files import fix, odometry, write
from click.testing import CliRunner

from hrt_cli.artifacts.npz import write_npz
from hrt_cli.logs.read import read_drive_log
from hrt_cli.main import cli

REAL = '{"format": "hrt-drive-log", "crs": "EPSG:32633"}\n{"t": 3.0, "x": 400012.5, "y": 4999980.5}\n'


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    write_npz(tmp_path / "s.npz", {"score": np.ones((4, 4)), "cell_size_m": np.float64(1.0)})
    ran("plan", tmp_path / "s.npz", "-o", tmp_path / "plan.json", "--start", "cell:1,2", "--budget", 3, "--effort", 0.1)
    return tmp_path / "plan.json"


def ran(*words: object) -> dict[str, object]:
    done = CliRunner().invoke(cli, [*map(str, words), "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_the_robot_stands_where_the_drive_before_ended(plan: Path, tmp_path: Path) -> None:
    for name, text in {
        "xy": REAL,
        "lonlat": '{"format": "hrt-drive-log"}\n{"t": 0, "lon": 8, "lat": 47}\n{"t": 9, "lon": 8.5, "lat": 47.5}\n',
    }.items():
        before, log = tmp_path / f"{name}.jsonl", tmp_path / f"{name}-stay.jsonl"
        before.write_text(text)
        said = ran("drive", plan, "--stay", "--after", before, "-o", log)
        assert (said["end"], said["distance_m"], said["duration_s"]) == ("arrived", 0.0, 0.0)
        found, wanted = read_drive_log(log), read_drive_log(before)
        assert len(found.time_s) == 1
        assert found.place.tolist() == wanted.place[-1:].tolist()
        assert (found.crs, found.geographic) == (wanted.crs, wanted.geographic)
        assert ran("drive", plan, "--stay", "--after", before, "-o", log)["up_to_date"]


def test_the_drive_before_may_be_a_bag_if_it_is_on_the_map(plan: Path, tmp_path: Path) -> None:
    before = write(tmp_path, [fix(k, 8.0 + k, 47.0) for k in range(3)], "folder")
    said = ran("drive", plan, "--stay", "--after", before, "-o", tmp_path / "stay.jsonl")
    assert said["notes"] == [f"{before}: takes places from /fix"]
    assert read_drive_log(tmp_path / "stay.jsonl").place.tolist() == [[10.0, 47.0]]
    wheels = write(tmp_path, [odometry(k, k, 0) for k in range(3)], "bag")
    done = CliRunner().invoke(
        cli, ["drive", str(plan), "--stay", "--after", str(wheels), "-o", str(tmp_path / "x.jsonl")]
    )
    assert "own frame odom, which is not on the map" in str(done.exception)
    assert not (tmp_path / "x.jsonl").exists()


def test_without_a_drive_before_it_stands_at_the_start(plan: Path, tmp_path: Path) -> None:
    ran("drive", plan, "--stay", "-o", tmp_path / "log.jsonl")
    start = json.loads(plan.read_text())["xy"][0]
    assert read_drive_log(tmp_path / "log.jsonl").place.tolist() == [start]


def test_what_was_driven_is_not_replaced(plan: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    log.write_text(REAL)
    done = CliRunner().invoke(cli, ["drive", str(plan), "--stay", "-o", str(log)])
    assert done.exit_code == 1
    assert log.read_text() == REAL


@pytest.mark.parametrize("words", [[], ["--stay", "--world", "site"]])
def test_a_world_or_none(plan: Path, tmp_path: Path, words: list[str]) -> None:
    done = CliRunner().invoke(cli, ["drive", str(plan), "-o", str(tmp_path / "log.jsonl"), *words])
    assert done.exit_code == 2
    assert "one of the two" in done.output
