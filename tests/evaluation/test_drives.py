"""Figures of drives from logs made by hand, whose distance, clearance, stalls and score are known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_files import fix, odometry, write
from click.testing import CliRunner, Result
from pyproj import Transformer
from raster_files import UTM33
from rasterio.crs import CRS
from world_files import map_xy, place_of, put_drive_log, put_truth, put_world

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import ArgumentError, DifferenceError, InputError
from hrt_cli.evaluation.drives import evaluate_drives
from hrt_cli.main import cli
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.world.camera import Camera, Lens, Weather
from hrt_cli.world.site import load_site

ROWS, COLS = 100, 240  # 10 m by 24 m
UGV = {"kind": "ugv", "radius_m": 0.35}
AUV = {"kind": "auv", "radius_m": 0.3}


def eastward(seconds: float, *, south_m: float = 5.0, east_m: float = 1.0, speed: float = 1.0, step_s: float = 0.5,
             t0: float = 0.0, **more: Any) -> list[dict[str, Any]]:  # fmt: skip
    """A drive to the east as the simulator logs it."""
    times = np.arange(round(seconds / step_s) + 1) * step_s
    out = []
    for t in times.tolist():
        x, y = map_xy(east_m + speed * t, south_m)
        out.append(
            {"t": t0 + t, "x": x, "y": y, "speed_m_s": speed, "commanded_m_s": speed, "heading_deg": 90.0, **more}
        )
    return out


def like_a_receiver(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Only time, longitude and latitude."""
    to = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True)
    out = []
    for each in records:
        lon, lat = to.transform(each["x"], each["y"])
        out.append({"t": each["t"], "lon": lon, "lat": lat})
    return out


@pytest.fixture(scope="module")
def walled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Level ground; a wall 1 m wide along the top, its lower edge at 2 m; the target is the grass."""
    classes = np.zeros((ROWS, COLS), np.uint8)
    classes[10:20] = 1
    return put_world(
        tmp_path_factory.mktemp("walled"), np.zeros((ROWS, COLS)), classes=classes, target_class="grass"
    )  # fmt: skip


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_world(tmp_path_factory.mktemp("bare"), np.zeros((ROWS, COLS)))


@pytest.fixture
def scoremap(tmp_path: Path) -> Path:
    """Cells of 1 m that score their number, but for one that is no-go."""
    path = tmp_path / "s.tif"
    score = np.arange(240, dtype=np.float32).reshape(10, 24)
    score[5, 8] = np.nan
    grid = Grid(10, 24, place_of(1.0), CRS.from_string(UTM33))
    made = Scoremap(score, np.zeros_like(score), grid, 1.0)
    publish_scoremap(path, made, record("test", 1, {}, {}), tags={}, creation={})
    return path


def put(path: Path, records: list[dict[str, Any]], crs: str | None = UTM33, **header: Any) -> Path:
    return put_drive_log(path, records, crs, **header)


def test_distance_duration_and_events(tmp_path: Path) -> None:
    records = eastward(12.0)
    records[4]["event"] = records[9]["event"] = "collision"
    records[11]["event"] = "intervention"
    records[-1]["event"] = "stuck"
    total = evaluate_drives([put(tmp_path / "d.jsonl", records)]).total
    assert total.distance_m == pytest.approx(12.0)
    assert total.duration_s == 12.0
    assert (total.collisions, total.interventions, total.stuck) == (2, 1, 1)
    assert total.stalled_s == 0.0
    assert total.min_clearance_m is total.mean_clearance_m is total.target_in_view is total.score_collected is None


def test_stalls_are_where_it_was_told_to_drive_and_did_not(tmp_path: Path) -> None:
    records = eastward(10.0)
    for each in records[5:9]:
        each["speed_m_s"] = 0.05
    for each in records[12:15]:
        each["speed_m_s"], each["commanded_m_s"] = 0.0, 0.03  # hardly told to
    total = evaluate_drives([put(tmp_path / "d.jsonl", records)]).total
    assert total.stalled_s == pytest.approx(4 * 0.5)


def test_a_real_robots_log_is_measured_by_its_places(tmp_path: Path, bare: Path) -> None:
    rng = np.random.default_rng(0)
    records = eastward(20.0, step_s=0.1)
    for each in records:
        each["x"] += rng.normal(0, 0.02)
        each["y"] += rng.normal(0, 0.02)
    stands = [dict(records[-1], t=20.0 + 0.1 * k, x=records[-1]["x"] + rng.normal(0, 0.02)) for k in range(1, 200)]
    log = put(tmp_path / "d.jsonl", like_a_receiver(records + stands), None)
    found = evaluate_drives([log], world=bare)
    assert found.total.distance_m == pytest.approx(20.0, abs=0.7)
    assert found.total.stalled_s is None
    assert found.total.min_clearance_m == 5.0


def test_places_in_an_unknown_plane_are_metres(tmp_path: Path) -> None:
    records = [{"t": float(k), "x": float(3 * k), "y": float(4 * k)} for k in range(5)]
    assert evaluate_drives([put(tmp_path / "d.jsonl", records, None)]).total.distance_m == pytest.approx(20.0)
    feet = put(tmp_path / "f.jsonl", [{"t": float(k), "x": 6_000_000.0 + 10 * k, "y": 2_000_000.0} for k in range(9)],
               "EPSG:2229")  # fmt: skip
    assert evaluate_drives([feet]).total.distance_m == pytest.approx(80 * 0.3048, rel=1e-3)


def test_nobody_drove_over_the_break_of_a_gpx_track(tmp_path: Path) -> None:
    def segment(minute: int, lat: float) -> str:
        points = "".join(
            f'<trkpt lat="{lat + 1e-5 * k}" lon="15"><time>2024-05-01T10:{minute:02}:{k:02}Z</time></trkpt>'
            for k in range(11)
        )
        return f"<trkseg>{points}</trkseg>"

    log = tmp_path / "d.gpx"
    log.write_text(
        '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1"><trk>'
        + segment(0, 45.0) + segment(10, 45.01) + "</trk></gpx>"
    )  # fmt: skip
    total = evaluate_drives([log]).total
    assert total.distance_m == pytest.approx(2 * 1e-4 * 111_130, abs=0.8)


@pytest.mark.parametrize("south_m", [3.0, 4.0, 5.5])
def test_clearance_is_from_the_hull_to_the_wall(tmp_path: Path, walled: Path, south_m: float) -> None:
    log = put(tmp_path / "d.jsonl", eastward(10.0, south_m=south_m), robot=UGV)
    found = evaluate_drives([log], world=walled)
    assert found.total.min_clearance_m == pytest.approx(south_m - 2.0 - 0.35, abs=0.06)
    assert found.total.mean_clearance_m == pytest.approx(found.total.min_clearance_m, abs=0.02)
    assert found.weight_s.sum() == pytest.approx(10.0)


def test_the_mean_clearance_is_over_time(tmp_path: Path, walled: Path) -> None:
    near, far = eastward(4.0, south_m=3.0), eastward(12.0, south_m=6.0, t0=4.5)
    found = evaluate_drives([put(tmp_path / "d.jsonl", near + far, robot=UGV)], world=walled)
    expected = (0.65 * 4.25 + 3.65 * 12.25) / 16.5
    assert found.total.mean_clearance_m == pytest.approx(expected, abs=0.1)
    touching = put(tmp_path / "t.jsonl", eastward(4.0, south_m=2.2), robot=UGV)
    assert evaluate_drives([touching], world=walled).total.min_clearance_m == 0.0


def test_clearance_is_a_number_where_there_is_no_obstacle(tmp_path: Path, bare: Path) -> None:
    total = evaluate_drives([put(tmp_path / "d.jsonl", eastward(5.3, step_s=0.37))], world=bare).total
    assert total.min_clearance_m == pytest.approx(5.0)
    assert total.mean_clearance_m == pytest.approx(5.0)


def test_a_divers_clearance_is_to_the_bottom(tmp_path: Path) -> None:
    reef = put_world(
        tmp_path / "reef", np.full((ROWS, COLS), -6.0), classes=np.zeros((ROWS, COLS)), scene="reef"
    )  # fmt: skip
    log = put(tmp_path / "d.jsonl", eastward(8.0, depth_m=4.5, pitch_deg=0.0), robot=AUV)
    found = evaluate_drives([log], world=reef, target="grass")
    assert found.total.min_clearance_m == pytest.approx(1.5 - 0.3, abs=0.02)
    assert found.total.target_in_view > 0.3
    # One that says nothing of its depth has no clearance, and is looked from at its usual height.
    plain = evaluate_drives([put(tmp_path / "e.jsonl", eastward(8.0))], world=reef, target="grass").total
    assert plain.min_clearance_m is plain.mean_clearance_m is None
    assert plain.target_in_view > 0.3
    mixed = eastward(8.0)
    mixed[3]["depth_m"] = 5.0
    found = evaluate_drives([put(tmp_path / "m.jsonl", mixed, robot=AUV)], world=reef)
    assert found.total.min_clearance_m == pytest.approx(1.0 - 0.3, abs=0.02)
    assert found.clearance_m.size == found.weight_s.size == 1


def test_the_target_covers_all_that_is_not_sky_where_there_is_no_other_class(tmp_path: Path) -> None:
    world = put_world(tmp_path / "w", np.zeros((ROWS, COLS)), classes=np.zeros((ROWS, COLS)), target_class="grass")
    log = put(tmp_path / "d.jsonl", eastward(0.0, east_m=12.0))
    found = evaluate_drives([log], world=world)
    camera = Camera(load_site(world), Lens(hfov_deg=100.0), Weather.clear())
    frame = camera.view(12.0, 5.0, 0.8, math.pi / 2, math.radians(-10.0))
    assert found.total.target_in_view == pytest.approx(frame.share(0), abs=0.02)
    assert 0.2 < found.total.target_in_view <= np.isfinite(frame.range_m).mean()
    assert evaluate_drives([log], world=world, target="0").total == found.total
    assert evaluate_drives([log], world=world, target="wall").total.target_in_view == 0.0


def test_the_target_is_looked_for_once_a_second(tmp_path: Path, walled: Path) -> None:
    log = put(tmp_path / "d.jsonl", eastward(10.0, step_s=0.25))
    found = evaluate_drives([log, log.rename(tmp_path / "e.jsonl")][1:], world=walled)
    assert [gone for gone, _ in found.view] == pytest.approx(list(range(11)))


def test_a_log_without_headings_looks_where_it_goes(tmp_path: Path) -> None:
    """The right half of the site is the target: driving east it is in view, driving west it is not."""
    classes = np.zeros((ROWS, COLS), np.uint8)
    classes[:, 120:] = 1
    world = put_world(tmp_path / "w", np.zeros((ROWS, COLS)))
    put_truth(world, classes, {"0": {"drivability": 1}, "1": {"name": "moss", "drivability": 1}},
              transform=place_of(0.1), target_class="moss")  # fmt: skip
    there = like_a_receiver(eastward(6.0, east_m=4.0))
    back = [dict(each, t=k * 0.5) for k, each in enumerate(reversed(there))]
    shares = [
        evaluate_drives([put(tmp_path / f"{name}.jsonl", records, None)], world=world).total.target_in_view
        for name, records in (("there", there), ("back", back))
    ]
    assert shares[0] > 0.04
    assert shares[1] == 0.0


def test_score_is_that_of_the_distinct_cells(tmp_path: Path, scoremap: Path) -> None:
    # Cells (5, 1) to (5, 11), of which (5, 8) is no-go; there and back.
    there = eastward(10.0, south_m=5.5, east_m=1.2)
    back = [dict(each, t=10.0 + 0.5 * k) for k, each in enumerate(reversed(there))]
    expected = sum(120 + k for k in range(1, 12) if k != 8)
    first = put(tmp_path / "a.jsonl", there + back)
    assert evaluate_drives([first], scoremap=scoremap).total.score_collected == expected
    second = put(tmp_path / "b.jsonl", eastward(4.0, south_m=5.5, east_m=9.2, t0=3.0))
    found = evaluate_drives([first, second], scoremap=scoremap)
    assert found.drives[str(second)].score_collected == sum(range(129, 134))
    assert found.total.score_collected == expected + 132 + 133


def test_a_drive_may_end_off_the_scoremap_or_on_no_go_ground(tmp_path: Path, scoremap: Path) -> None:
    log = put(tmp_path / "a.jsonl", eastward(5.0, south_m=5.5, east_m=21.2))
    assert evaluate_drives([log], scoremap=scoremap).total.score_collected == 141 + 142 + 143
    log = put(tmp_path / "b.jsonl", eastward(0.0, south_m=5.5, east_m=8.5))
    assert evaluate_drives([log], scoremap=scoremap).total.score_collected == 0.0


def test_several_logs_are_one_drive(tmp_path: Path, walled: Path) -> None:
    logs = [
        put(tmp_path / "a.jsonl", eastward(4.0, south_m=3.0), robot=UGV),
        put(tmp_path / "b.jsonl", eastward(8.0, south_m=6.0), robot=UGV),
    ]
    found = evaluate_drives(logs, world=walled)
    one, two = (found.drives[str(path)] for path in logs)
    assert found.total.distance_m == one.distance_m + two.distance_m == pytest.approx(12.0)
    assert found.total.duration_s == 12.0
    assert found.total.min_clearance_m == one.min_clearance_m < two.min_clearance_m
    assert found.total.mean_clearance_m == pytest.approx((4 * one.mean_clearance_m + 8 * two.mean_clearance_m) / 12)
    gone = [m for m, _ in found.view]
    assert gone == sorted(gone)
    assert gone[-1] == pytest.approx(12.0)
    measured = evaluate_drives([logs[0], put(tmp_path / "c.jsonl", like_a_receiver(eastward(4.0)), None)])
    assert measured.total.stalled_s is None


def test_a_log_of_one_record(tmp_path: Path, walled: Path, scoremap: Path) -> None:
    for name, records, crs in (("a", eastward(0.0), UTM33), ("b", like_a_receiver(eastward(0.0)), None)):
        log = put(tmp_path / f"{name}.jsonl", records, crs)
        total = evaluate_drives([log], world=walled, scoremap=scoremap).total
        assert (total.distance_m, total.duration_s) == (0.0, 0.0)
        assert total.min_clearance_m == total.mean_clearance_m > 2
        assert total.target_in_view > 0
        assert total.score_collected in (120.0, 121.0)  # it stands on the border of two cells


def test_what_cannot_be_measured_is_refused(tmp_path: Path, walled: Path, bare: Path, scoremap: Path) -> None:
    log = put(tmp_path / "d.jsonl", eastward(5.0))
    with pytest.raises(ArgumentError, match="needs a --world"):
        evaluate_drives([log], target="grass")
    with pytest.raises(ArgumentError, match=r"no class 'moss' to look for \(it has: grass, wall\)"):
        evaluate_drives([log], world=walled, target="moss")
    with pytest.raises(ArgumentError, match=r"it has: none"):
        evaluate_drives([log], world=bare, target="grass")
    far = put(tmp_path / "far.jsonl", eastward(5.0, east_m=900.0))
    with pytest.raises(InputError, match=r"far\.jsonl: lies wholly off the world"):
        evaluate_drives([far], world=bare)
    with pytest.raises(InputError, match=r"far\.jsonl: lies wholly off the scoremap"):
        evaluate_drives([far], scoremap=scoremap)
    odd = put(tmp_path / "odd.jsonl", [{"t": 0, "x": 1.0, "y": 1.0}, {"t": 1, "x": 2.0, "y": 1.0}], "EPSG:1")
    with pytest.raises(InputError, match=r"odd\.jsonl: names a coordinate reference system"):
        evaluate_drives([odd])
    with pytest.raises(InputError, match="absent"):
        evaluate_drives([tmp_path / "absent.jsonl"])


def hrt(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def test_the_command(tmp_path: Path, walled: Path, scoremap: Path) -> None:
    records = eastward(8.0)
    log, figure = put(tmp_path / "d.jsonl", records, robot=UGV), tmp_path / "f.png"
    words = ["evaluate", "drive", log, "--world", walled, "--scoremap", scoremap, "--figure", figure]
    done = hrt(*words, "--json", "--require", "collisions==0")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert set(said) >= {
        "distance_m", "duration_s", "collisions", "interventions", "min_clearance_m", "mean_clearance_m",
        "on_drivable", "target_in_view", "score_collected", "target_curve", "drives",
    }  # fmt: skip
    assert said["target_curve"][-1][0] == pytest.approx(8.0)
    assert said["drives"][str(log)]["collisions"] == 0
    before = figure.read_bytes()
    assert cv2.imread(str(figure)).std() > 10
    found = png_provenance(figure)
    assert {each.role for each in found.inputs} == {"log/0", "ortho", "dsm", "truth", "world"}
    line = hrt(*words)
    assert line.exit_code == 0
    assert "8 m in 8 s, 0 collisions" in line.stdout
    assert figure.read_bytes() == before
    records[3]["event"] = "collision"
    put(log, records, robot=UGV)
    worse = hrt(*words[:-2], "--require", "collisions==0")
    assert isinstance(worse.exception, DifferenceError)
    assert worse.exception.exit_code == 3
    assert str(worse.exception) == "collisions is 1, and collisions==0 is required"
    assert "1 collisions" in worse.stdout
    unknown = hrt("evaluate", "drive", log, "--require", "min_clearance_m>=0")  # without a world nobody knows it
    assert str(unknown.exception) == "min_clearance_m is not known, and min_clearance_m>=0 is required"
    assert hrt(*words).exit_code != 0, "the figure is another's"
    assert hrt(*words, "--overwrite").exit_code == 0
    assert figure.read_bytes() != before


def test_a_bag_is_measured_and_what_was_chosen_is_told(tmp_path: Path, walled: Path) -> None:
    said = [fix(each["t"], each["lon"], each["lat"]) for each in like_a_receiver(eastward(8.0))]
    bag = write(tmp_path, said, "folder")
    done = hrt("evaluate", "drive", bag, "--world", walled, "--figure", tmp_path / "f.png", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["distance_m"] == pytest.approx(8.0, rel=0.01)
    assert found["notes"] == [f"{bag}: takes places from /fix"]
    assert done.stderr == f"Note: {bag}: takes places from /fix\n"
    wheels = write(tmp_path / "wheels", [odometry(k, k, 0.0, (1.0, 0.0)) for k in range(9)], "mcap")
    assert json.loads(hrt("evaluate", "drive", wheels, "--json").stdout)["distance_m"] == pytest.approx(8.0)
    refused = hrt("evaluate", "drive", wheels, "--world", walled)
    assert "own frame odom, which is not on the map" in str(refused.exception)


def test_a_figure_needs_a_world(tmp_path: Path) -> None:
    log = put(tmp_path / "d.jsonl", eastward(8.0))
    done = hrt("evaluate", "drive", log, "--figure", tmp_path / "f.png")
    assert "nothing to draw without a --world" in str(done.exception)
    assert not (tmp_path / "f.png").exists()


def test_how_much_of_the_way_led_over_drivable_ground(tmp_path: Path) -> None:
    """Mud from 7 m on, of which 4 of the 10 m are on; a drive beside it weighs by its own metres."""
    classes = np.zeros((ROWS, COLS), np.uint8)
    classes[:60, 70:] = 1
    table = {"0": {"name": "grass", "drivability": 0.9}, "1": {"name": "mud", "drivability": 0.1}}
    world = put_world(tmp_path / "mud", np.zeros((ROWS, COLS)), classes=classes, table=table)
    into = put(tmp_path / "into.jsonl", eastward(10.0), robot=UGV)
    beside = put(tmp_path / "beside.jsonl", eastward(10.0, south_m=7.0, speed=0.5), robot=UGV)
    found = evaluate_drives([into, beside], world=world)
    assert found.drives[str(into)].on_drivable == pytest.approx(0.6, abs=0.03)
    assert found.drives[str(beside)].on_drivable == 1.0
    assert found.total.on_drivable == pytest.approx((6.0 + 5.0) / 15.0, abs=0.02)
    assert evaluate_drives([into]).total.on_drivable is None
