"""Recordings for learners: frames and labels, whose they are, and whose folder it is."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from world_files import ground_site, map_xy, put_plan, put_world

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.stage import Existing
from hrt_cli.driving.album import ABOUT, FRAMES, LABELS, prepare_folder
from hrt_cli.driving.course import Course
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.record import EVERY_S, Recorder
from hrt_cli.driving.simulator import Setting, simulate
from hrt_cli.driving.stage import DriveRequest, DriveSummary, drive_file
from hrt_cli.driving.teacher import teacher_of
from hrt_cli.driving.vehicle import UGV
from hrt_cli.errors import OutputError
from hrt_cli.main import cli

ROWS, COLS = 80, 120  # 8 m by 12 m
OTHERS = ["other_goals_deg", "other_costs_s"]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_world(tmp_path_factory.mktemp("land"), np.zeros((ROWS, COLS)), classes=np.zeros((ROWS, COLS)))


@pytest.fixture(scope="module")
def reef(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bottom that rises to the east."""
    bottom = np.broadcast_to(np.linspace(-8, -4, COLS), (ROWS, COLS))
    return put_world(tmp_path_factory.mktemp("reef"), bottom, classes=np.zeros((ROWS, COLS)), scene="reef")


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return put_plan(tmp_path / "p.json", [map_xy(*place) for place in ((2.0, 2.0), (6.0, 2.0), (6.0, 6.0))])


def drive(plan: Path, world: Path, folder: Path, **options: object) -> DriveSummary:
    existing = options.pop("existing", Existing())
    output = options.pop("output", folder.with_suffix(".jsonl"))
    return drive_file(plan, world, output, DriveRequest(**options), record=folder, existing=existing)


def labels(folder: Path) -> list[dict[str, str]]:
    with open(folder / LABELS, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("local", ["pursuit", "expert"])
def test_frames_and_labels_of_a_ground_robot(world: Path, plan: Path, tmp_path: Path, local: str) -> None:
    folder = tmp_path / "rec"
    found = drive(plan, world, folder, local=local, seed=3)
    assert found.end == "arrived"
    rows = labels(folder)
    assert list(rows[0]) == ["image", "yaw", "session", "goal_deg", "turn_costs_s", *OTHERS]
    assert len(rows) == pytest.approx(found.duration_s / EVERY_S, abs=2)
    assert [row["image"] for row in rows] == [f"{FRAMES}/{k:06d}.jpg" for k in range(len(rows))]
    assert sorted(p.name for p in (folder / FRAMES).iterdir()) == [f"{k:06d}.jpg" for k in range(len(rows))]
    assert {row["session"] for row in rows} == {"rec-3"}
    yaw = np.array([float(row["yaw"]) for row in rows])
    assert (np.abs(yaw) <= 1).all()
    assert yaw.max() > 0.5, "it turns right once"
    costs = np.array([[float(each) for each in row["turn_costs_s"].split()] for row in rows])
    assert costs.shape == (len(rows), 15)
    assert (costs.min(axis=1) == 0).all()
    best = np.linspace(-1, 1, 15)[costs.argmin(axis=1)]
    assert np.abs(best - yaw).mean() < 0.35, "what costs least is about what the expert does"
    about = json.loads((folder / ABOUT).read_text())
    assert (about["format"], about["frames"], about["vehicle"]) == ("hrt-recording", len(rows), "ugv")
    assert json_provenance(folder / ABOUT) is not None
    for row in rows:
        frame = cv2.imread(str(folder / row["image"]))
        assert frame.shape == (about["lens"]["height"], about["lens"]["width"], 3)
        assert frame.std() > 5
    # In clear weather the sky above is bluer than the grey ground: channels are in the order of JPEG.
    blue, _green, red = frame[0].mean(axis=0)
    assert blue > red


def test_a_divers_labels_have_a_pitch(reef: Path, plan: Path, tmp_path: Path) -> None:
    drive(plan, reef, tmp_path / "rec", local="expert")
    rows = labels(tmp_path / "rec")
    assert list(rows[0]) == ["image", "yaw", "pitch", "session", "goal_deg", "turn_costs_s", *OTHERS]
    pitch = np.array([float(row["pitch"]) for row in rows])
    assert (np.abs(pitch) <= 1).all()
    assert pitch.max() > 0.1, "the bottom rises"
    assert json.loads((tmp_path / "rec" / ABOUT).read_text())["vehicle"] == "auv"


class Stray:
    """Drives straight on, whatever the course is, and knows how far along it would have come."""

    name = "stray"

    def __init__(self) -> None:
        self.along_m = 0.0

    def decide(self, known: Pose, true: Pose) -> Command | None:
        return Command(0.0)


@pytest.mark.parametrize(("off_deg", "side"), [(25.0, -1), (-25.0, 1)])
def test_labels_are_the_experts_whoever_drives(tmp_path: Path, off_deg: float, side: int) -> None:
    """A robot that strays to the right is told to steer left, and the other way round, ever more."""
    site = ground_site(np.zeros((160, 160), np.bool_))
    course = Course(np.array([[2.0, 8.0], [14.0, 8.0]]))
    setting = Setting(site, UGV, course, 1.0, 8.0, math.radians(90.0 + off_deg), 0)
    prepare_folder(tmp_path / "rec", [], overwrite=False)
    recorder = Recorder(setting, teacher_of(setting), tmp_path / "rec", "rec")
    seen: list[tuple[float, Command]] = []

    def watch(time_s: float, known: Pose, true: Pose, command: Command) -> None:
        seen.append((true.south_m, command))
        recorder.watch(time_s, known, true, command)

    found = simulate(setting, Stray(), watch=watch)
    assert found.end == "out of time"
    assert abs(seen[-1][0] - 8.0) > 1.5
    assert {command.yaw for _, command in seen} == {0.0}
    yaw = [float(row.split(",")[1]) for row in recorder._album._rows]
    assert len(yaw) >= 14
    assert all(side * each > 0.15 for each in yaw[2:])


def test_a_pursuit_off_its_course_is_labelled_with_the_way_back(world: Path, tmp_path: Path) -> None:
    """Its position drifts and the expert knows the truth: the labels are not what was commanded."""
    plan = put_plan(tmp_path / "p.json", [map_xy(*place) for place in ((2.0, 4.0), (11.0, 4.0))])
    for local in ("pursuit", "expert"):
        drive(plan, world, tmp_path / local, local=local, seed=1)
    one, other = ([row["yaw"] for row in labels(tmp_path / local)] for local in ("pursuit", "expert"))
    assert one != other


def test_where_the_expert_sees_no_way_on_nothing_is_taught(tmp_path: Path) -> None:
    obstacle = np.zeros((160, 160), np.bool_)
    obstacle[:, 80:] = True  # the course leads into it
    site = ground_site(obstacle)
    setting = Setting(site, UGV, Course(np.array([[2.0, 8.0], [14.0, 8.0]])), 1.0, 4.0, math.pi / 2, 0)
    prepare_folder(tmp_path / "rec", [], overwrite=False)
    recorder = Recorder(setting, teacher_of(setting), tmp_path / "rec", "rec")
    pose = Pose(11.0, 8.0, 0.0, math.pi / 2, 0.0)  # in the midst of it
    recorder.watch(0.0, pose, pose, Command(0.0))
    assert len(recorder._album) == 0
    assert not list((tmp_path / "rec" / FRAMES).iterdir())


@pytest.mark.parametrize("local", ["pursuit", "expert"])
def test_same_seed_same_bytes(world: Path, plan: Path, tmp_path: Path, local: str) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        drive(plan, world, tmp_path / name / "rec", local=local, seed=4)
    drive(plan, world, tmp_path / "c" / "rec", local=local, seed=5, output=tmp_path / "c.jsonl")
    one, same, other = (content(tmp_path / name / "rec") for name in "abc")
    assert one == same
    first = f"{FRAMES}/000000.jpg"
    assert one[first] != other[first], "the weather and the sensor's noise are those of the seed"


def test_recording_changes_no_drive(world: Path, plan: Path, tmp_path: Path) -> None:
    drive(plan, world, tmp_path / "rec", seed=2)
    drive_file(plan, world, tmp_path / "plain.jsonl", DriveRequest(seed=2))
    one, other = ((tmp_path / f"{name}.jsonl").read_text().splitlines()[1:] for name in ("rec", "plain"))
    assert one == other


def test_what_is_recorded_is_not_recorded_again(world: Path, plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    first = drive(plan, world, folder)
    before = content(folder)
    stamp = (folder / FRAMES / "000000.jpg").stat().st_mtime_ns
    again = drive(plan, world, folder)
    assert (first.up_to_date, again.up_to_date) == (False, True)
    assert (folder / FRAMES / "000000.jpg").stat().st_mtime_ns == stamp
    # Neither the log nor the recording alone is the whole of it.
    (tmp_path / "rec.jsonl").unlink()
    with pytest.raises(OutputError, match="use --overwrite"):
        drive(plan, world, folder)
    assert content(folder) == before
    assert not drive(plan, world, folder, existing=Existing(overwrite=True)).up_to_date
    assert content(folder) == before


def test_another_recording_is_replaced_only_on_request(world: Path, plan: Path, tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    drive(plan, world, folder, seed=1)
    before = content(folder)
    with pytest.raises(OutputError, match="was not made by this run"):
        drive(plan, world, folder, seed=2)
    with pytest.raises(OutputError, match="use --overwrite"):
        drive(plan, world, folder, seed=2, output=tmp_path / "other.jsonl")
    assert content(folder) == before
    (folder / FRAMES / "999999.jpg").write_bytes(b"left over from a longer drive")
    drive(plan, world, folder, seed=2, existing=Existing(overwrite=True))
    assert content(folder) != before
    assert sorted(p.name for p in (folder / FRAMES).iterdir())[-1] < "000100.jpg"
    assert len(labels(folder)) == len(list((folder / FRAMES).iterdir()))


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_foreign_folder_is_left_alone(world: Path, plan: Path, tmp_path: Path, overwrite: bool) -> None:
    folder = tmp_path / "rec"
    folder.mkdir()
    (folder / "thesis.tex").write_text("all of it")
    with pytest.raises(OutputError, match=r"rec: holds 'thesis\.tex', which is no part of a recording"):
        drive(plan, world, folder, existing=Existing(overwrite=overwrite))
    assert content(folder) == {"thesis.tex": b"all of it"}
    with pytest.raises(OutputError, match="holds an input"):
        drive(plan, world, world, output=tmp_path / "d.jsonl", existing=Existing(overwrite=overwrite))
    assert (world / "ortho.tif").exists()


def test_a_recording_that_was_cut_short_is_begun_anew(world: Path, plan: Path, tmp_path: Path) -> None:
    """Frames without labels are those of a run that was stopped."""
    folder = tmp_path / "rec"
    (folder / FRAMES).mkdir(parents=True)
    (folder / FRAMES / "000000.jpg").write_bytes(b"half of i")
    assert drive(plan, world, folder).end == "arrived"
    assert cv2.imread(str(folder / FRAMES / "000000.jpg")) is not None


def test_the_command(world: Path, plan: Path, tmp_path: Path) -> None:
    words = ["drive", plan, "--world", world, "-o", tmp_path / "d.jsonl", "--record", tmp_path / "rec"]
    done = CliRunner().invoke(cli, list(map(str, words)))
    assert done.exit_code == 0, done.output
    assert labels(tmp_path / "rec")
    for output in ("rec/recording.json", "d.jsonl"):
        checked = CliRunner().invoke(cli, ["verify", str(tmp_path / output)])
        assert checked.exit_code == 0, checked.output


def test_a_file_in_the_place_of_the_folder_is_refused(world: Path, plan: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    with pytest.raises(OutputError, match=r"taken: cannot be written: File exists"):
        drive_file(plan, world, tmp_path / "d.jsonl", DriveRequest(), record=taken)
    assert taken.read_text() == "mine"
    assert not (tmp_path / "d.jsonl").exists()
