"""Pictures from random places: where they are taken, what they teach, and the command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from world_files import ground_site, put_world

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.driving.album import Lesson
from hrt_cli.driving.elsewhere import GOALS
from hrt_cli.driving.glances import IN_ONE_WEATHER, Glances
from hrt_cli.driving.local import Pose
from hrt_cli.driving.turns import ANGLES
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.errors import ArgumentError
from hrt_cli.main import cli
from hrt_cli.steering.recordings.samples import read_samples
from hrt_cli.world.site import Site

ROWS, COLS = 120, 160  # 12 m by 16 m


def posts() -> NDArray[np.bool_]:
    obstacle = np.zeros((ROWS, COLS), np.bool_)
    obstacle[40:46, 70:76] = obstacle[80:86, 90:96] = True
    return obstacle


def poses(site: Site, count: int, *, near: float, seed: int = 0, vehicle: object = UGV) -> list[Pose]:
    glances, rng = Glances(site, vehicle, near, seed), np.random.default_rng(seed)  # type: ignore[arg-type]
    return [glances._place(bool(rng.random() < near), rng)[0] for _ in range(count)]


def test_near_means_something_ahead() -> None:
    site = ground_site(posts())
    middles = np.array([(7.3, 4.3), (9.3, 8.3)])
    away: dict[float, NDArray[np.float64]] = {}
    for near in (0.0, 1.0):
        found = []
        for pose in poses(site, 60, near=near):
            east, south = (middles - (pose.east_m, pose.south_m)).T
            ahead = east * np.sin(pose.heading_rad) - south * np.cos(pose.heading_rad)
            found.append(np.where(ahead > 0, np.hypot(east, south), 99.0).min())
        away[near] = np.array(found)
    # The rim blocks goals, too.
    assert np.median(away[1.0]) < 4.0 < np.median(away[0.0])
    assert away[0.0].min() > 1.2


def test_it_stands_where_it_may_and_could_get_to() -> None:
    obstacle = posts()
    obstacle[:, 130:134] = True  # a wall from rim to rim; most of the site lies west of it
    site = ground_site(obstacle)
    for pose in poses(site, 60, near=0.5):
        row, col = site.pixel(pose.east_m, pose.south_m)
        assert site.clearance_m[row, col] > UGV.radius_m - 0.05
        assert 1.5 + UGV.radius_m - 0.1 < pose.south_m < 12 - 1.5 - UGV.radius_m + 0.1
        assert pose.east_m < 13.0


def test_an_auv_swims_clear_of_the_bottom_and_the_surface() -> None:
    bottom = np.full((ROWS, COLS), -4.0)
    bottom[50:60, 60:90] = -2.6
    site = ground_site(np.zeros((ROWS, COLS), np.bool_), bottom_m=bottom, under_water=True)
    found = poses(site, 60, near=0.0, vehicle=AUV)
    for pose in found:
        row, col = site.pixel(pose.east_m, pose.south_m)
        assert site.surface_m[row, col] + AUV.radius_m < pose.height_m < -AUV.radius_m - 0.1
        assert abs(pose.pitch_rad) <= AUV.pitch_limit_rad
    assert np.std([pose.pitch_rad for pose in found]) > 0.1
    lessons = [lesson for _, lesson in Glances(site, AUV, 0.0, 1)(40)]
    # The lower it swims, the more it has to climb.
    assert min(each.pitch for each in lessons) < 0 < max(each.pitch for each in lessons)


def test_the_steering_is_the_turn_that_costs_least() -> None:
    lessons: list[Lesson] = []
    for rgb, lesson in Glances(ground_site(posts()), UGV, 0.6, 5)(8):
        assert (rgb.dtype, rgb.shape) == (np.uint8, (120, 160, 3))
        assert lesson.costs_s[np.abs(ANGLES - lesson.yaw).argmin()] == 0.0
        assert lesson.others_rad.shape == (GOALS,)
        assert lesson.other_costs_s.shape == (GOALS, ANGLES.size)
        lessons.append(lesson)
    assert len({each.bearing_rad for each in lessons}) == 8


def test_each_bearing_has_its_own_costs() -> None:
    told = 0
    for _, lesson in Glances(ground_site(np.zeros((200, 200), np.bool_)), UGV, 0.0, 2)(12):
        goals = [lesson.bearing_rad, *lesson.others_rad]
        for bearing, costs in zip(goals, [lesson.costs_s, *lesson.other_costs_s], strict=True):
            if 0.5 < abs(bearing) < 2.0:
                told += np.sign(ANGLES[int(costs.argmin())]) == np.sign(bearing)
                told -= np.sign(ANGLES[int(costs.argmin())]) == -np.sign(bearing)
    assert told > 30


def test_all_is_drawn_from_the_seed() -> None:
    site = ground_site(posts())
    one, same, other = (list(Glances(site, UGV, 0.5, seed)(3)) for seed in (1, 1, 2))
    for (a, left), (b, right) in zip(one, same, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(left.other_costs_s, right.other_costs_s)
    assert not np.array_equal(one[0][0], other[0][0])


def test_what_a_site_has_not_is_refused() -> None:
    full = ground_site(np.ones((ROWS, COLS), np.bool_))
    with pytest.raises(ArgumentError, match="no place where the robot may be"):
        Glances(full, UGV, 0.5, 0)


def test_what_a_site_has_not_it_does_without() -> None:
    alley = np.ones((ROWS, COLS), np.bool_)
    alley[54:66] = False  # 1.2 m wide: something is nearly always in the way
    crowded, empty = (
        Glances(ground_site(each), UGV, share, 0) for each, share in ((alley, 0.0), (~alley & False, 1.0))
    )
    assert len(list(crowded(4))) == len(list(empty(4))) == 4
    assert crowded.near >= 2
    assert empty.near == 0


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_world(tmp_path_factory.mktemp("land"), posts().astype(float), classes=posts().astype(int))


class TestCommand:
    def record(self, *args: object) -> Result:
        return CliRunner().invoke(cli, ["record", *map(str, args)])

    def test_what_it_writes_can_be_trained_on(self, world: Path, tmp_path: Path) -> None:
        folder, count = tmp_path / "g", IN_ONE_WEATHER + 3
        done = self.record(world, "-o", folder, "--frames", count, "--json")
        assert done.exit_code == 0, done.output
        found = json.loads(done.stdout)
        assert found.pop("near") == pytest.approx(0.8 * count, abs=0.12 * count)
        assert found == {"output": str(folder), "up_to_date": False, "frames": count, "resumed_at": 0}
        samples = read_samples([folder])
        assert len(samples.paths) == len(list((folder / "frames").iterdir())) == count
        assert samples.sessions == ("g/g-0-0", "g/g-0-1")
        assert samples.other_goals is not None
        assert samples.other_costs_s is not None
        assert samples.other_goals.shape == (count, GOALS)
        assert 0.5 < samples.other_goals.std() < 1.0
        assert samples.other_costs_s.shape == (count, GOALS, ANGLES.size)
        made = json_provenance(folder / "recording.json")
        assert made is not None
        assert (made.stage, made.parameters["near"]) == ("record", 0.8)
        checked = CliRunner().invoke(cli, ["verify", str(folder / "recording.json")])
        assert checked.exit_code == 0, checked.output

    def test_a_folder_of_any_name(self, world: Path, tmp_path: Path) -> None:
        folder = tmp_path / 'north, "steep" side'
        assert self.record(world, "-o", folder, "--frames", 2, "--figure", tmp_path / "f.png").exit_code == 0
        assert read_samples([folder]).sessions == (f"{folder.name}/{folder.name}-0-0",)
        sheet = png_provenance(tmp_path / "f.png")
        assert sheet is not None
        assert [each.name for each in sheet.inputs] == ["recording.json"]

    def test_it_is_not_made_twice_and_not_replaced_unasked(self, world: Path, tmp_path: Path) -> None:
        folder = tmp_path / "g"
        assert self.record(world, "-o", folder, "--frames", 2).exit_code == 0
        stamp = (folder / "labels.csv").stat().st_mtime_ns
        again = self.record(world, "-o", folder, "--frames", 2, "--json")
        assert json.loads(again.stdout)["up_to_date"]
        assert (folder / "labels.csv").stat().st_mtime_ns == stamp
        refused = self.record(world, "-o", folder, "--frames", 3)
        assert refused.exit_code == 1
        assert "use --overwrite" in str(refused.exception)
        assert self.record(world, "-o", folder, "--frames", 3, "--overwrite").exit_code == 0
        assert len(read_samples([folder]).paths) == 3

    def test_a_foreign_folder_is_left_alone(self, world: Path, tmp_path: Path) -> None:
        (tmp_path / "thesis.tex").write_text("all of it")
        for folder in (tmp_path, world):
            refused = self.record(world, "-o", folder, "--frames", 2, "--overwrite")
            assert refused.exit_code == 1
        assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
        assert (world / "ortho.tif").exists()

    @pytest.mark.parametrize(
        "words", [["--frames", "0"], ["--near", "1.1"], ["--near", "nan"], ["--vehicle", "car"], ["--frames", "x"]]
    )
    def test_usage(self, world: Path, tmp_path: Path, words: list[str]) -> None:
        done = self.record(world, "-o", tmp_path / "g", *words)
        assert done.exit_code == 2
        assert words[0] in done.stderr
        assert not (tmp_path / "g").exists()
