"""`hrt inspect` of drive logs: figures against other programs, what is known, and one line where a log is none."""

from __future__ import annotations

import csv
import json
import pickle
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import gpxpy.gpx
import numpy as np
import pytest
from bag_files import T0, Said, fix, odometry, write
from click.testing import CliRunner
from pyproj import Geod
from raster_files import write_raster

from hrt_cli.errors import InputError
from hrt_cli.inspection.drives import inspect_log
from hrt_cli.logs.kinds import is_log, reading
from hrt_cli.logs.read import read_drive_log
from hrt_cli.main import cli, main

HUSKY = Path(__file__).parents[2].parent / "shared" / "data" / "husky"
HEADER = '{"format": "hrt-drive-log"}'


def inspect(path: Path) -> dict[str, Any]:
    done = CliRunner().invoke(cli, ["inspect", "--json", str(path)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def put(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.real
@pytest.mark.skipif(not HUSKY.exists(), reason="the Husky's logs are not here")
def test_a_real_drive_is_as_long_in_every_format(tmp_path: Path) -> None:
    with open(HUSKY / "husky_gps.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    track = gpxpy.gpx.GPXTrackSegment()
    for row in rows:
        time = datetime.fromtimestamp(float(row["t"]), UTC)
        track.points.append(gpxpy.gpx.GPXTrackPoint(float(row["lat"]), float(row["lon"]), time=time))
    gpx = gpxpy.gpx.GPX()
    gpx.tracks.append(gpxpy.gpx.GPXTrack())
    gpx.tracks[0].segments.append(track)
    (tmp_path / "husky.gpx").write_text(gpx.to_xml())
    wanted = Geod(ellps="WGS84").line_length([float(r["lon"]) for r in rows], [float(r["lat"]) for r in rows])
    assert wanted == pytest.approx(395, rel=0.01)
    for path in (HUSKY / "test1.bag", HUSKY / "husky_gps.csv", tmp_path / "husky.gpx"):
        found = inspect(path)
        assert found["distance_m"] == pytest.approx(wanted, rel=0.001)
        assert found["duration_s"] == pytest.approx(395, abs=1)
        assert found["records"] == len(rows)
        assert found["mean_speed_m_s"] == pytest.approx(1.0, rel=0.01)
        assert found["usable"]
    bag = inspect(HUSKY / "test1.bag")
    assert bag["known"] == ["speed_m_s"]
    assert {each["topic"]: each["messages"] for each in bag["topics"]}["/imu/data"] == 11_865
    # This robot's IMU lies on its side.
    assert "/imu/data leans by 90°: it is not mounted as the robot is" in bag["notes"]


def test_distances_are_those_of_the_ellipsoid_and_stop_at_breaks(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    geod = Geod(ellps="WGS84")
    for lat in (-60.0, 0.0, 45.0, 80.0):
        place = np.array([179.9999, lat]) + rng.uniform(-1e-3, 1e-3, (30, 2))
        place[:, 0] = (place[:, 0] + 180) % 360 - 180
        path = put(
            tmp_path / "a.csv", "t,lon,lat", *(f"{k},{lon!r},{lat!r}" for k, (lon, lat) in enumerate(place.tolist()))
        )
        found = inspect(path)
        assert found["distance_m"] == pytest.approx(geod.line_length(*place.T), rel=1e-5)
        west, south, east, north = found["bounds"]
        assert west > 179.99 > -179.99 > east
        assert (south, north) == (place[:, 1].min(), place[:, 1].max())
    point = '<trkpt lat="45.{}" lon="15"><time>2024-01-01T00:00:{:02}Z</time></trkpt>'
    cut = "".join(point.format(lat, k) + ("</trkseg><trkseg>" if k == 1 else "") for k, lat in enumerate((0, 1, 5, 6)))
    put(tmp_path / "a.gpx", f'<gpx version="1.1"><trk><trkseg>{cut}</trkseg></trk></gpx>')
    found = inspect(tmp_path / "a.gpx")
    wanted = geod.line_length([15, 15], [45.0, 45.1]) + geod.line_length([15, 15], [45.5, 45.6])
    assert (found["distance_m"], found["segments"]) == (pytest.approx(wanted, rel=1e-4), 2)


def test_what_a_log_of_ours_tells(tmp_path: Path) -> None:
    header = (
        '{"format": "hrt-drive-log", "crs": "EPSG:32633", "robot": {"kind": "ugv", "radius_m": 0.3}, "end": "stuck"}'
    )
    records = [
        {"t": 0.0, "x": 500_000.0, "y": 5_000_000.0, "speed_m_s": 1.0},
        {"t": 10.0, "x": 500_009.996, "y": 5_000_000.0, "roll_deg": 3.0, "event": "stuck"},
        {"t": 20.0, "x": 500_009.996, "y": 5_000_009.996, "event": "stuck"},
    ]
    found = inspect(put(tmp_path / "d.jsonl", header, *map(json.dumps, records)))
    assert found == {
        "file": "d.jsonl",
        "bytes": (tmp_path / "d.jsonl").stat().st_size,
        "format": "jsonl",
        "records": 3,
        "begins_s": 0.0,
        "duration_s": 20.0,
        "distance_m": pytest.approx(20.0, rel=1e-4),
        "mean_speed_m_s": pytest.approx(1.0, rel=1e-4),
        "geographic": False,
        "crs": "EPSG:32633",
        "own_frame": None,
        "start": [500_000.0, 5_000_000.0],
        "end": [500_009.996, 5_000_009.996],
        "bounds": [500_000.0, 5_000_000.0, 500_009.996, 5_000_009.996],
        "segments": 1,
        "robot": "ugv",
        "ended": "stuck",
        "known": ["speed_m_s", "roll_deg", "events"],
        "unknown": ["commanded_m_s", "heading_deg", "pitch_deg", "depth_m"],
        "events": {"stuck": 2},
        "notes": [],
        "usable": True,
        "refusal": None,
    }


def test_the_lines_for_a_reader(tmp_path: Path) -> None:
    said = [fix(k, 15 + 1e-5 * k, 45.0) for k in range(5)] + [odometry(k, k, 0, (1.0, 0.0)) for k in range(5)]
    path = write(tmp_path, sorted(said, key=lambda each: each.time_s), "bag")
    shown = CliRunner().invoke(cli, ["inspect", str(path)], catch_exceptions=False).stdout.splitlines()
    assert shown == [
        "drive.bag: drive log (rosbag1), 5 records in 4.0 s",
        "  way        3.2 m, 0.79 m/s on average; 1 segment",
        "  place      from 15.0000000, 45.0000000 to 15.0000400, 45.0000000 (lon, lat)",
        "  tells      speed_m_s",
        "  not told   commanded_m_s, heading_deg, pitch_deg, roll_deg, depth_m, events",
        "  topic      /fix: 5 sensor_msgs/msg/NavSatFix",
        "  topic      /odom: 5 nav_msgs/msg/Odometry",
        "  note       takes places from /fix, achieved speed from /odom",
        "  feedback   would take it",
    ]


def test_a_log_that_no_raster_can_take_says_so(tmp_path: Path) -> None:
    bag = write(tmp_path, [odometry(k, 3.0 * k, 4.0 * k, (5.0, 0.0)) for k in range(5)], "mcap folder")
    found = inspect(bag)
    assert (found["own_frame"], found["distance_m"], found["usable"]) == ("odom", 20.0, False)
    assert "own frame odom, which is not on the map" in found["refusal"]
    log = put(tmp_path / "d.jsonl", '{"format": "hrt-drive-log", "crs": "EPSG:1"}', '{"t": 0, "x": 1, "y": 2}')
    found = inspect(log)
    assert (found["distance_m"], found["mean_speed_m_s"], found["usable"]) == (None, None, False)
    found = inspect(put(tmp_path / "d.csv", "t,x,y", "0,1,2", "0,4,6"))
    assert (found["distance_m"], found["mean_speed_m_s"], found["usable"]) == (5.0, None, True)
    assert any("names no CRS" in note for note in found["notes"])


def test_what_is_meant_to_be_a_log(tmp_path: Path) -> None:
    said = [fix(0, 15.0, 45.0)]
    for kind in ("bag", "folder", "mcap folder", "mcap", "db3"):
        assert is_log(write(tmp_path / kind, said, kind))
    assert is_log(write(tmp_path, said, "bag").rename(tmp_path / "recording"))
    for name in ("a.jsonl", "a.CSV", "a.tsv", "a.gpx", "a.bin"):
        assert is_log(tmp_path / name), name
    raster = write_raster(tmp_path / "a.tif", np.zeros((3, 4, 4), np.uint8))
    (tmp_path / "tiles").mkdir()
    lost = write(tmp_path / "lost", said, "mcap").parent
    (lost / "metadata.yaml").unlink()
    assert is_log(lost)
    (lost / "ortho.tif").touch()
    assert not is_log(lost)
    for path in (raster, tmp_path / "tiles", tmp_path / "nothing.tif", tmp_path / "a.png", tmp_path / "plan.json"):
        assert not is_log(path), path


def test_a_raster_is_inspected_as_a_raster(tmp_path: Path) -> None:
    raster = write_raster(tmp_path / "a.tif", np.zeros((3, 40, 40), np.uint8))
    done = CliRunner().invoke(cli, ["inspect", "--json", str(raster)], catch_exceptions=False)
    assert json.loads(done.stdout)["driver"] == "GTiff"


@pytest.mark.parametrize("name", ["a.jsonl", "a.csv", "a.tsv", "a.gpx", "a.bag", "a.mcap", "a.db3", "a.bin"])
@pytest.mark.parametrize("kind", ["empty", "blank", "pickle", "noise", "another kind"])
def test_what_is_no_log_is_one_error_line(
    tmp_path: Path, name: str, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    said: list[Said] = [fix(k, 15.0, 45.0) for k in range(3)]
    other = write(tmp_path, said, "mcap" if name != "a.mcap" else "bag")
    content = {
        "empty": b"",
        "blank": b"\n\n \n",
        "pickle": pickle.dumps({"t": [0, 1], "x": print}),
        "noise": np.random.default_rng(0).integers(0, 256, 10_000, np.uint8).tobytes(),
        "another kind": other.read_bytes(),
    }[kind]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SystemExit) as stop:
        main(["inspect", str(path)])
    out, err = capfd.readouterr()
    assert (stop.value.code, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"Error: {path}: ")
    if kind == "another kind":
        assert "name it ." in err


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    for name in ("a.bag", "a.jsonl", "a.bin"):
        with pytest.raises(InputError, match="no such file"):
            inspect_log(tmp_path / name)


def test_times_of_a_bag_are_those_of_its_stamps(tmp_path: Path) -> None:
    path = write(tmp_path, [fix(0, 15.0, 45.0, stamp_s=-100.0)], "db3")
    assert read_drive_log(path).time_s.tolist() == [T0 - 100.0]


def test_the_version_of_a_reader_counts_only_for_logs_of_its_kind() -> None:
    assert reading([Path("a.jsonl"), Path("b.gpx"), Path("folder")]) == {}
    assert reading([Path("a.jsonl"), Path("b.CSV"), Path("c.tsv")]) == {"log_readers": {"csv": 2}}
