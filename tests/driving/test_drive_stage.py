"""From a plan and a folder to a log: what stands in it, where the robot is put down, and what is refused."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from pyproj import Transformer
from raster_files import UTM33
from world_files import ground_site, map_xy, place_of, put_drive_log, put_plan, put_world

from hrt_cli.artifacts.drivelog import drive_provenance
from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.stage import Existing
from hrt_cli.driving.field import cost_map, inside_rim, rim_distance
from hrt_cli.driving.route import planned_course
from hrt_cli.driving.stage import DriveRequest, DriveSummary, drive_file
from hrt_cli.driving.vehicle import UGV
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.logs.read import read_drive_log
from hrt_cli.main import cli
from hrt_cli.world.site import Site, load_site

ROWS, COLS = 100, 140  # 10 m by 14 m
KNOWN = {"t", "x", "y", "speed_m_s", "commanded_m_s", "heading_deg", "pitch_deg", "depth_m", "event"}


def classes(box: tuple[slice, slice] | None = None) -> np.ndarray:
    out = np.zeros((ROWS, COLS), np.uint8)
    if box is not None:
        out[box] = 1
    return out


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Level ground with a wall from (6, 3) to (7, 7)."""
    return put_world(tmp_path_factory.mktemp("world"), np.zeros((ROWS, COLS)), classes=classes(np.s_[30:70, 60:70]))


@pytest.fixture(scope="module")
def reef(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_world(
        tmp_path_factory.mktemp("reef"), np.full((ROWS, COLS), -6.0), classes=classes(), scene="reef"
    )  # fmt: skip


def straight(path: Path, *places: tuple[float, float], **more: object) -> Path:
    return put_plan(path, [map_xy(*place) for place in places or ((2.0, 2.0), (4.0, 2.0), (12.0, 2.0))], **more)


def drive(plan_path: Path, world: Path, output: Path, **options: object) -> DriveSummary:
    after, existing = options.pop("after", None), options.pop("existing", Existing())
    return drive_file(plan_path, world, output, DriveRequest(**options), after=after, existing=existing)


def test_a_log_says_what_a_robot_knows_and_nothing_else(world: Path, tmp_path: Path) -> None:
    output = tmp_path / "d.jsonl"
    found = drive(straight(tmp_path / "p.json"), world, output)
    lines = [json.loads(line) for line in output.read_text().splitlines()]
    assert set(lines[0]) == {"format", "version", "crs", "robot", "end", "provenance"}
    assert lines[0]["crs"] == UTM33
    assert lines[0]["robot"] == {"kind": "ugv", "radius_m": pytest.approx(0.35, abs=0.3)}
    assert lines[0]["end"] == found.end == "arrived"
    for record in lines[1:]:
        assert set(record) <= KNOWN - {"pitch_deg", "depth_m"}
    assert drive_provenance(output) is not None
    log = read_drive_log(output)
    assert log.place[0] == pytest.approx(map_xy(2.0, 2.0), abs=0.7)
    assert log.place[-1] == pytest.approx(map_xy(12.0, 2.0), abs=1.0)
    assert found.place == tuple(log.place[-1])
    assert np.median(log.heading_deg) == pytest.approx(90, abs=4)
    assert found.distance_m == pytest.approx(10.0, abs=1.0)
    assert found.duration_s == log.time_s[-1] > 9
    assert (found.collisions, found.interventions, found.notes, found.up_to_date) == (0, 0, [], False)


def test_an_underwater_robot_logs_pitch_and_depth(reef: Path, tmp_path: Path) -> None:
    output = tmp_path / "d.jsonl"
    assert drive(straight(tmp_path / "p.json"), reef, output, local="expert").end == "arrived"
    log = read_drive_log(output)
    assert log.robot.kind == "auv"
    assert np.isfinite(log.depth_m).all()
    assert np.isfinite(log.pitch_deg).all()
    assert 3.0 < np.median(log.depth_m) < 6.0
    drive(straight(tmp_path / "p.json"), reef, tmp_path / "u.jsonl", vehicle="ugv")
    assert read_drive_log(tmp_path / "u.jsonl").robot.kind == "ugv"


@pytest.mark.parametrize("local", ["pursuit", "expert"])
def test_the_seed_is_all_that_chance_depends_on(world: Path, tmp_path: Path, local: str) -> None:
    plan_path = straight(tmp_path / "p.json")
    logs = [tmp_path / f"{k}.jsonl" for k in range(3)]
    for path, seed in zip(logs, (4, 4, 5), strict=True):
        drive(plan_path, world, path, local=local, seed=seed)
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert logs[0].read_text().splitlines()[1:] != logs[2].read_text().splitlines()[1:]


def test_a_robot_that_is_stuck_says_so_at_the_end(world: Path, tmp_path: Path) -> None:
    output = tmp_path / "d.jsonl"
    found = drive(straight(tmp_path / "p.json", (2.0, 5.0), (12.0, 5.0)), world, output)
    log = read_drive_log(output)
    assert log.end == found.end == "stuck"
    assert log.events[-1] == (len(log.time_s) - 1, "stuck")
    assert found.collisions >= 1
    assert sum(event == "collision" for _, event in log.events) == found.collisions
    assert map_xy(4.5, 0)[0] < log.place[-1, 0] < map_xy(6.5, 0)[0]
    # Going on, it has backed up: by less than half a metre, give or take the errors of two fixes.
    drive(straight(tmp_path / "q.json", (2.0, 5.0), (2.0, 8.0)), world, tmp_path / "e.jsonl", after=output)
    back = log.place[-1, 0] - read_drive_log(tmp_path / "e.jsonl").place[0, 0]
    assert -0.2 < back < 1.0


def test_time_is_the_budget_of_a_plan_in_minutes(world: Path, tmp_path: Path) -> None:
    plan_path = straight(tmp_path / "p.json", budget=(0.1, "min"))
    found = drive(plan_path, world, tmp_path / "a.jsonl")
    assert (found.end, found.duration_s) == ("out of time", pytest.approx(6.0, abs=0.11))
    found = drive(plan_path, world, tmp_path / "b.jsonl", time_limit_s=3.0)
    assert (found.end, found.duration_s) == ("out of time", pytest.approx(3.0, abs=0.11))
    found = drive(plan_path, world, tmp_path / "c.jsonl", time_limit_s=300.0)
    assert found.end == "arrived"
    assert json.loads((tmp_path / "a.jsonl").read_text().splitlines()[0])["end"] == "out of time"


def test_a_drive_goes_on_where_the_other_ended(world: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "1.jsonl", tmp_path / "2.jsonl"
    plan_path = straight(tmp_path / "p.json", (2.0, 2.0), (12.0, 2.0))
    drive(plan_path, world, first, time_limit_s=5.0)
    found = drive(plan_path, world, second, after=first)
    before, after = read_drive_log(first), read_drive_log(second)
    assert math.dist(before.place[-1], after.place[0]) < 0.8
    assert found.end == "arrived"
    assert found.distance_m < 9.0
    lonlat = tmp_path / "lonlat.jsonl"
    lon, lat = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True).transform(*map_xy(9.0, 2.0))
    put_drive_log(lonlat, [{"t": 0, "lon": lon, "lat": lat}], None)
    assert drive(plan_path, world, tmp_path / "3.jsonl", after=lonlat).distance_m < 4.5


def test_a_start_on_an_obstacle_is_moved_a_little_and_said_so(world: Path, tmp_path: Path) -> None:
    found = drive(straight(tmp_path / "p.json", (6.1, 5.0), (2.0, 5.0)), world, tmp_path / "d.jsonl", local="expert")
    assert found.end == "arrived"
    assert found.collisions == 0
    assert "beside the start, which is blocked" in found.notes[0]
    assert drive(straight(tmp_path / "p.json", (6.1, 5.0), (2.0, 5.0)), world, tmp_path / "d.jsonl",
                 local="expert").up_to_date  # fmt: skip


def test_a_start_far_inside_an_obstacle_or_off_the_survey_is_refused(tmp_path: Path) -> None:
    world = put_world(tmp_path / "w", np.zeros((ROWS, COLS)), classes=classes(np.s_[:, :90]))
    for start in ((4.5, 5.0), (-30.0, 5.0), (4.0, 900.0)):
        with pytest.raises(ArgumentError, match="no free ground is near"):
            drive(straight(tmp_path / "p.json", start, (12.0, 5.0)), world, tmp_path / "d.jsonl")
    assert not (tmp_path / "d.jsonl").exists()


def test_a_start_a_little_off_the_survey_is_moved_onto_it(world: Path, tmp_path: Path) -> None:
    found = drive(straight(tmp_path / "p.json", (-1.0, 2.0), (5.0, 2.0)), world, tmp_path / "d.jsonl", local="expert")
    assert found.end == "arrived"
    assert found.notes


@pytest.fixture(scope="module")
def islands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Surveys on land and under water that have heights only in an octagon, 1 m from the raster's edges."""
    row, col = np.mgrid[:ROWS, :COLS]
    inside = (row >= 10) & (row < ROWS - 10) & (col >= 10) & (col < COLS - 10)
    inside &= (row + col > 50) & (row + COLS - col > 50) & (ROWS - row + col > 50) & (ROWS - row + COLS - col > 50)
    made = {}
    for name, height, more in (("ugv", 0.0, {}), ("auv", -6.0, {"scene": "reef"})):
        surface = np.where(inside, height, np.nan)
        made[name] = put_world(tmp_path_factory.mktemp(name), surface, classes=classes(), **more)
    return made


def around(inset_m: float) -> list[tuple[float, float]]:
    """A way around the octagon's box, so far inside it (outside, where that is below 0), a place every half metre."""
    low, right, bottom = 1.0 + inset_m, COLS / 10 - 1.0 - inset_m, ROWS / 10 - 1.0 - inset_m
    corners = [(4.0, low), (right - 3, low), (right, 4.0), (right, bottom - 3), (right - 3, bottom), (4.0, bottom)]
    places = []
    for (e0, s0), (e1, s1) in pairwise(corners):
        parts = np.linspace(0, 1, 2 * round(math.hypot(e1 - e0, s1 - s0)), endpoint=False)
        places += [(e0 + float(p) * (e1 - e0), s0 + float(p) * (s1 - s0)) for p in parts]
    return [*places, corners[-1]]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("local", ["pursuit", "expert"])
@pytest.mark.parametrize("kind", ["ugv", "auv"])
@pytest.mark.parametrize("inset_m", [-0.3, 0.0, 0.2])
def test_a_plan_along_the_rim_is_driven_inside_it(
    islands: dict[str, Path], tmp_path: Path, kind: str, local: str, inset_m: float, seed: int
) -> None:
    places = around(inset_m)
    plan_path = straight(tmp_path / "p.json", *places)
    found = drive(plan_path, islands[kind], tmp_path / "d.jsonl", local=local, seed=seed)
    assert (found.end, found.collisions, found.interventions) == ("arrived", 0, 0)
    said = [note for note in found.notes if "places" in note]
    assert re.fullmatch(rf"(\d+) of {len(places) - 1} places lie at the rim of the survey: moved inside", said[0])
    assert len(said) == 1
    assert math.dist(found.place, map_xy(*places[-1])) < 1.4


def course_of(path: Path, site: Site, cell_m: float, *places: tuple[float, float]) -> tuple[np.ndarray, list[str]]:
    plan = read_plan(straight(path, *places, cell_m=cell_m))
    course, notes = planned_course(plan, path, site, UGV, None)
    return course.points, notes


def test_places_at_the_rim_are_moved_to_the_nearest_inside(tmp_path: Path) -> None:
    seen = np.ones((ROWS, COLS), np.bool_)
    seen[40:60, 60:80] = False  # from (6, 4) to (8, 6)
    site = ground_site(np.zeros((ROWS, COLS), np.bool_), seen=seen)
    places = [(2.0, 2.0), (5.8, 5.0), (6.2, 4.3), (7.0, 3.9), (9.0, 5.0), (7.0, 5.0), (13.9, 0.1), (-0.4, 5.0)]
    points, notes = course_of(tmp_path / "p.json", site, 1.0, *places)
    room = rim_distance(site)
    for east, south in points:
        assert room[site.pixel(east, south)] >= UGV.radius_m
    # (7, 5) is a metre from any ground that was seen, and more from where the robot has room.
    kept = [place for place in places if place != (7.0, 5.0)]
    assert len(points) == len(kept)
    assert notes == [
        "5 of 7 places lie at the rim of the survey: moved inside",
        "1 of 7 places lie off the survey: left out",
    ]
    inside = inside_rim(site, UGV.radius_m)
    ends = np.argwhere(inside) * 0.1 + 0.05
    for point, place in zip(points, kept, strict=True):
        if site.is_seen(*place) and inside[site.pixel(*place)]:
            assert tuple(point) == pytest.approx(place, abs=1e-6)
        else:
            away = np.hypot(ends[:, 1] - place[0], ends[:, 0] - place[1])
            assert math.dist(point, place) == pytest.approx(away.min(), abs=1e-3)
            assert math.dist(point, place) <= 1.0
    # With larger cells it is not too far.
    assert course_of(tmp_path / "q.json", site, 2.0, *places)[1] == [
        "6 of 7 places lie at the rim of the survey: moved inside"
    ]
    # With smaller ones others are, and where nothing is left the robot stays.
    points, notes = course_of(tmp_path / "r.json", site, 0.25, (2.0, 2.0), (7.0, 5.0))
    assert len(points) == 1
    assert notes == ["1 of 1 places lie off the survey: left out"]


def test_a_plan_within_the_survey_is_driven_as_it_is(tmp_path: Path) -> None:
    site = ground_site(np.zeros((ROWS, COLS), np.bool_))
    places = [(2.0, 2.0), (4.03, 2.01), (12.0, 9.0)]
    points, notes = course_of(tmp_path / "p.json", site, 1.0, *places)
    np.testing.assert_allclose(points, places, atol=1e-6)
    assert notes == []


@pytest.mark.parametrize("pixel_m", [0.05, 0.1, 0.3])
def test_ground_inside_the_rim_is_ground_that_the_expert_enters(pixel_m: float) -> None:
    seen = np.random.default_rng(0).random((20, 27)) > 0.03
    seen = np.kron(seen, np.ones((5, 5))).astype(np.bool_)
    site = ground_site(np.zeros(seen.shape, np.bool_), seen=seen, pixel_m=pixel_m)
    inside, costs = inside_rim(site, 0.3), cost_map(site, 0.3)
    assert 0 < inside.sum() < seen.sum()
    assert (rim_distance(site)[inside] >= 0.3).all()
    for row, col in np.ndindex(seen.shape):
        place = ((col + 0.5) * site.pixel_m, (row + 0.5) * site.pixel_m)
        assert inside[row, col] == costs.passable(*place)


def test_a_plan_in_another_crs_is_laid_on_the_site(world: Path, tmp_path: Path) -> None:
    to = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True)
    places = [to.transform(*map_xy(*place)) for place in ((2.0, 2.0), (12.0, 2.0))]
    found = drive(put_plan(tmp_path / "p.json", places, crs="EPSG:4326"), world, tmp_path / "d.jsonl")
    assert found.end == "arrived"
    assert found.place == pytest.approx(map_xy(12.0, 2.0), abs=1.0)


def test_a_site_in_degrees_makes_a_log_in_degrees(tmp_path: Path) -> None:
    step = 1e-6
    world = put_world(
        tmp_path / "w", np.zeros((100, 140)), crs="EPSG:4326", transform=Affine(step, 0, 15.0, 0, -step, 45.0)
    )
    plan_path = put_plan(tmp_path / "p.json", [(15.0 + 2e-5, 45 - 3e-5), (15.0 + 12e-5, 45 - 3e-5)], crs="EPSG:4326")
    assert drive(plan_path, world, tmp_path / "d.jsonl").end == "arrived"
    log = read_drive_log(tmp_path / "d.jsonl")
    assert log.place[-1] == pytest.approx([15.0 + 12e-5, 45 - 3e-5], abs=1e-5)
    assert len(np.unique(log.place[:, 0])) > 10


def test_headings_are_compass_headings_on_a_turned_site(tmp_path: Path) -> None:
    transform = place_of(0.1) @ Affine.rotation(-90)
    world = put_world(tmp_path / "w", np.zeros((100, 140)), transform=transform)
    site = load_site(world)
    x, y = site.map_xy(np.array([[2.0, 2.0], [12.0, 2.0]]))
    drive(put_plan(tmp_path / "p.json", zip(x, y, strict=True)), world, tmp_path / "d.jsonl")
    log = read_drive_log(tmp_path / "d.jsonl")
    east, north = np.diff(log.place[[0, -1]], axis=0)[0]
    off = log.heading_deg - math.degrees(math.atan2(east, north))
    assert np.median((off + 180) % 360 - 180) == pytest.approx(0, abs=5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: straight(path, crs=None), "has no coordinate reference system"),
        (lambda path: straight(path, (500.0, 2.0), (600.0, 2.0)), "lies wholly off the site"),
        (lambda path: path.write_text("{}"), "p.json"),
        (lambda path: straight(path, crs="EPSG:4326"), "p.json"),
    ],
)
def test_a_plan_that_does_not_belong_to_the_site_is_refused(world: Path, tmp_path: Path, make, message: str) -> None:
    make(tmp_path / "p.json")
    with pytest.raises(InputError, match=message):
        drive(tmp_path / "p.json", world, tmp_path / "d.jsonl")


def test_a_log_without_place_on_the_site_cannot_be_gone_on_from(world: Path, tmp_path: Path) -> None:
    for crs, record in ((None, {"x": 1.0, "y": 1.0}), (UTM33, {"x": 0.0, "y": 0.0})):
        log = put_drive_log(tmp_path / "a.jsonl", [{"t": 0.0, **record}], crs)
        with pytest.raises(InputError, match=r"a\.jsonl"):
            drive(straight(tmp_path / "p.json"), world, tmp_path / "d.jsonl", after=log)


def test_what_is_done_is_not_done_again(world: Path, tmp_path: Path) -> None:
    plan_path, output = straight(tmp_path / "p.json"), tmp_path / "d.jsonl"
    first = drive(plan_path, world, output, seed=1)
    before = output.read_bytes()
    again = drive(plan_path, world, output, seed=1)
    assert again.up_to_date
    assert asdict(again) | {"up_to_date": False} == asdict(first)
    (tmp_path / "x.jsonl").write_bytes(before)
    for change in ({"seed": 2}, {"local": "expert"}, {"time_limit_s": 50.0}, {"after": tmp_path / "x.jsonl"}):
        with pytest.raises(OutputError, match="exists and was not made by this run"):
            drive(plan_path, world, output, **{"seed": 1, **change})
    assert output.read_bytes() == before
    assert not drive(plan_path, world, output, seed=2, existing=Existing(overwrite=True)).up_to_date
    assert output.read_bytes() != before


def test_a_log_is_jsonl_and_planners_have_names(world: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"d\.csv: a drive log is written as \.jsonl"):
        drive(straight(tmp_path / "p.json"), world, tmp_path / "d.csv")
    with pytest.raises(ArgumentError, match="no local planner 'psychic'"):
        drive(straight(tmp_path / "p.json"), world, tmp_path / "d.jsonl", local="psychic")
    assert not (tmp_path / "d.jsonl").exists()


def test_the_command(world: Path, tmp_path: Path) -> None:
    output = tmp_path / "d.jsonl"
    words = ["drive", straight(tmp_path / "p.json", (6.1, 5.0), (2.0, 5.0)), "--world", world, "-o", output]
    done = CliRunner().invoke(cli, list(map(str, [*words, "--local", "expert", "--json"])))
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["end"] == "arrived"
    assert "Note: the robot is put down" in done.stderr
    line = CliRunner().invoke(cli, list(map(str, [*words, "--local", "expert"]))).stdout
    assert "arrived at" in line
    assert "0 collisions, 0 interventions (up to date)" in line
    assert CliRunner().invoke(cli, list(map(str, [*words, "--time-limit", "0"]))).exit_code == 2


@pytest.mark.parametrize("scene", ["meadow", "reef"])
def test_a_sample_site_is_planned_and_driven(tmp_path: Path, scene: str) -> None:
    """What `hrt synth` makes can be driven; the plan's places are those of the map that it was made on."""
    site, output = tmp_path / "site", tmp_path / "d.jsonl"
    for words in (
        ["synth", site, "--scene", scene, "--size", "16", "--pixel", "0.1"],
        ["scoremap", site / "truth.tif", "-o", tmp_path / "s.tif"],
        [
            "plan",
            tmp_path / "s.tif",
            "-o",
            tmp_path / "p.json",
            "--start",
            "auto",
            "--budget",
            "12",
            "--effort",
            "0.05",
        ],
        ["drive", tmp_path / "p.json", "--world", site, "-o", output, "--local", "expert"],
    ):
        done = CliRunner().invoke(cli, list(map(str, words)))
        assert done.exit_code == 0, f"{words}: {done.output} {done.exception}"
    log = read_drive_log(output)
    assert log.end is not None
    assert len(log.time_s) > 10
    assert not [event for _, event in log.events if event == "collision"]
