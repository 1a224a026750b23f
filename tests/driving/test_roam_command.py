"""`hrt drive --roam` and `--disturb` as a user runs them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from world_files import map_xy, put_plan, put_world

from hrt_cli.artifacts.drivelog import drive_provenance
from hrt_cli.driving.stage import DriveRequest, drive_file
from hrt_cli.errors import ArgumentError
from hrt_cli.logs.read import read_drive_log
from hrt_cli.main import cli


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Level ground of 12 m by 8 m with a wall from (6, 3) to (6.5, 6)."""
    classes = np.zeros((80, 120), np.uint8)
    classes[30:60, 60:65] = 1
    return put_world(tmp_path_factory.mktemp("world"), np.zeros((80, 120)), classes=classes)


def drive(*args: object) -> Result:
    return CliRunner().invoke(cli, ["drive", *map(str, args)])


def roam(world: Path, output: Path, *more: object) -> dict[str, object]:
    done = drive("--world", world, "--roam", "12", "--local", "expert", "-o", output, "--json", *more)
    assert done.exit_code == 0, f"{done.output} {done.exception}"
    found: dict[str, object] = json.loads(done.stdout)
    return found


def test_a_plan_or_metres_to_roam(world: Path, tmp_path: Path) -> None:
    plan, output = put_plan(tmp_path / "p.json", [map_xy(2, 2), map_xy(5, 2)]), tmp_path / "d.jsonl"
    one = "give a PLAN to drive, or --roam METRES: one of the two"
    for words, told in (
        (["--world", world], one),
        ([plan, "--world", world, "--roam", "9"], one),
        (["--world", world, "--roam", "9", "--after", plan], "--stay and --after are of a PLAN"),
        (["--world", world, "--roam", "9", "--rescue"], "--rescue is for --local steer"),
        (["--stay", "--roam", "9"], "--stay and --after are of a PLAN"),
        (["--roam", "9"], "give the --world"),
        (["--world", world, "--stay", "--roam", "9"], "give the --world"),
    ):
        done = drive(*words, "-o", output)
        assert done.exit_code == 2, words
        assert told in done.stderr, words
    assert not output.exists()


@pytest.mark.parametrize("value", ["0.9", "0", "-5", "nan", "inf", "100001", "far"])
def test_metres_that_are_none(world: Path, tmp_path: Path, value: str) -> None:
    done = drive("--world", world, "--roam", value, "-o", tmp_path / "d.jsonl")
    assert done.exit_code == 2
    assert "--roam" in done.stderr
    assert not (tmp_path / "d.jsonl").exists()


@pytest.mark.parametrize("value", ["-0.1", "0.91", "1", "nan", "often"])
def test_shares_that_are_none(world: Path, tmp_path: Path, value: str) -> None:
    done = drive("--world", world, "--roam", "9", "--disturb", value, "-o", tmp_path / "d.jsonl")
    assert done.exit_code == 2
    assert "--disturb" in done.stderr
    assert not (tmp_path / "d.jsonl").exists()


def test_the_library_takes_a_plan_or_metres_too(world: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="follows a plan or roams"):
        drive_file(None, world, tmp_path / "d.jsonl", DriveRequest())
    with pytest.raises(ArgumentError, match="goes on from no other"):
        drive_file(None, world, tmp_path / "d.jsonl", DriveRequest(roam_m=9.0), after=tmp_path / "b.jsonl")


def test_the_same_seed_drives_the_same_way(world: Path, tmp_path: Path) -> None:
    logs = [tmp_path / f"{number}.jsonl" for number in range(4)]
    plain = roam(world, logs[0], "--seed", 3)
    assert plain["end"] == "arrived"
    assert plain["collisions"] == 0
    assert 8.0 < float(str(plain["distance_m"])) < 40.0
    roam(world, logs[1], "--seed", 3)
    roam(world, logs[2], "--seed", 4)
    assert logs[0].read_bytes() == logs[1].read_bytes()
    places = [read_drive_log(path).place for path in (logs[0], logs[2])]
    assert np.hypot(*(places[0][0] - places[1][0])) > 0.5, "another seed begins elsewhere"
    assert roam(world, logs[0], "--seed", 3)["up_to_date"]
    refused = drive("--world", world, "--roam", "13", "--local", "expert", "-o", logs[0], "--seed", 3)
    assert refused.exit_code == 1
    found = drive_provenance(logs[0])
    assert found is not None
    assert (found.parameters["roam_m"], found.parameters["disturb"]) == (12.0, 0.0)
    assert "plan" not in {each.role for each in found.inputs}


def test_pushes_are_by_the_seed_and_can_be_seen(world: Path, tmp_path: Path) -> None:
    plain, one, same = (tmp_path / f"{name}.jsonl" for name in ("plain", "one", "same"))
    roam(world, plain)
    for path in (one, same):
        roam(world, path, "--disturb", 0.5)
    assert one.read_bytes() == same.read_bytes()

    def turning(path: Path) -> float:
        heading = np.unwrap(np.radians(read_drive_log(path).heading_deg))
        return float(np.abs(np.diff(heading)).sum() / len(heading))

    assert turning(one) > 1.25 * turning(plain)
    found = drive_provenance(one)
    assert found is not None
    assert found.parameters["disturb"] == 0.5


def rows_of(folder: Path) -> list[dict[str, str]]:
    with open(folder / "labels.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_recording_of_a_roaming_robot_says_where_it_had_to_go(tmp_path: Path) -> None:
    world = put_world(tmp_path / "open", np.zeros((120, 120)), classes=np.zeros((120, 120)))
    folder = tmp_path / "frames"
    roam(world, tmp_path / "d.jsonl", "--disturb", 0.4, "--record", folder, "--seed", 5)
    rows = rows_of(folder)
    assert list(rows[0]) == ["image", "yaw", "session", "goal_deg", "turn_costs_s", "other_goals_deg", "other_costs_s"]
    assert len(rows) == len(list((folder / "frames").iterdir())) > 15
    assert {row["session"] for row in rows} == {"d-5"}
    goal = np.array([float(row["goal_deg"]) for row in rows])
    yaw = np.array([float(row["yaw"]) for row in rows])
    assert (np.abs(goal) <= 180).all()
    assert np.abs(goal).max() > 20, "pushed off its way, it had to turn"
    # Nothing is in the way: where the goal is well to one side the teacher turns there.
    aside = np.abs(goal) > 45
    assert aside.sum() > 3
    assert (np.sign(yaw[aside]) == np.sign(goal[aside])).all()
    roam(world, tmp_path / "again.jsonl", "--disturb", 0.4, "--record", tmp_path / "again", "--seed", 5)
    assert [row | {"session": ""} for row in rows_of(tmp_path / "again")] == [row | {"session": ""} for row in rows]
