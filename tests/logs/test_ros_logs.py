"""ROS bags read as drive logs, against what was written into them."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from pathlib import Path
from typing import Any

import bag_files as bags
import numpy as np
import pytest
from bag_files import T0, Said, command, fix, imu, odometry, write
from scipy.spatial.transform import Rotation

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.logs import bag as bag_module
from hrt_cli.logs.kinds import log_sha256
from hrt_cli.logs.read import read_drive_log

TURN = Rotation.from_euler("ZYX", [70, -8, 11], degrees=True)
"""Yaw, then pitch, then roll about the robot's own axes: ROS's nose is up by 8 degrees, the right side down by 11."""


def lon(t: float) -> float:
    return 15.0 + 1e-5 * t


def drive() -> list[Said]:
    """20 s at 5 places a second, wheels at 10 Hz, commands for the first 10 s only, an IMU, and pictures."""
    said = [fix(k / 5, lon(k / 5), 45.0) for k in range(101)]
    said += [odometry(k / 10, k / 10, 0.0, (-0.3, 0.4)) for k in range(201)]
    said += [command(0.5 + k / 10, -0.75) for k in range(96)]
    said += [imu(k / 50, TURN.as_quat()) for k in range(1001)]
    said += [Said("/camera", "image", k / 2, stamp_s=k / 2) for k in range(41)]
    return sorted(said, key=lambda each: each.time_s)


def both(tmp_path: Path, said: list[Said]) -> list[DriveLog]:
    said = sorted(said, key=lambda each: each.time_s)
    return [read_drive_log(write(tmp_path / kind.replace(" ", ""), said, kind)) for kind in ("bag", "mcap")]


@pytest.mark.parametrize("kind", bags.KINDS)
def test_every_kind_of_bag_tells_the_same_drive(tmp_path: Path, kind: str) -> None:
    log = read_drive_log(write(tmp_path, drive(), kind))
    when = np.arange(101) / 5
    np.testing.assert_allclose(log.time_s, T0 + when, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(log.place, np.stack([lon(when), np.full(101, 45.0)], axis=1))
    assert (log.geographic, log.own_frame, log.crs, log.events, log.breaks) == (True, None, None, (), ())
    np.testing.assert_allclose(log.speed_m_s, 0.5)
    told = (when > 0.5 - 1e-6) & (when < 11.0 + 1e-6)
    np.testing.assert_array_equal(log.commanded_m_s, np.where(told, 0.75, np.nan))
    # By the axes of the turned robot: how much of its nose points up, and of its right side down.
    nose, right = TURN.apply([1, 0, 0]), TURN.apply([0, -1, 0])
    np.testing.assert_allclose(log.pitch_deg, np.degrees(np.arcsin(nose[2])), atol=1e-9)
    np.testing.assert_allclose(np.sin(np.radians(log.roll_deg)), -right[2] / np.cos(np.arcsin(nose[2])), atol=1e-9)
    assert log.pitch_deg[0] == pytest.approx(8)
    assert log.roll_deg[0] == pytest.approx(11)
    assert np.isnan(log.heading_deg).all()
    assert np.isnan(log.depth_m).all()
    assert log.notes == (
        "takes places from /fix, achieved speed from /odom, commanded speed from /cmd_vel, "
        "roll and pitch from /imu, as if mounted like the robot (x forward, z up)",
    )


@pytest.mark.parametrize(
    ("kind", "compression"),
    [("bag", "BZ2"), ("bag", "LZ4"), ("folder", "FILE"), ("folder", "MESSAGE"), ("mcap folder", "FILE"),
     ("mcap folder", "MESSAGE"), ("mcap", "STORAGE")],
)  # fmt: skip
def test_compressed_bags_are_read(tmp_path: Path, kind: str, compression: str) -> None:
    log = read_drive_log(write(tmp_path, drive(), kind, compression=compression))
    np.testing.assert_array_equal(log.place[:, 0], lon(np.arange(101) / 5))
    np.testing.assert_allclose(log.pitch_deg, 8)


def test_a_receiver_without_a_fix_is_dropped(tmp_path: Path) -> None:
    said = [fix(k, lon(k), 45.0, status=-1 if k in (2, 3) else 0) for k in range(10)]
    said[5].values["lat"] = np.nan
    said[6].values |= {"lon": 0.0, "lat": 0.0}
    for log in both(tmp_path, said):
        np.testing.assert_allclose(log.time_s - T0, [0, 1, 4, 7, 8, 9], atol=1e-6)
        assert log.notes[1:] == ("drops 4 of 10 places: the receiver had no fix",)


def test_wheels_alone_are_not_on_the_map(tmp_path: Path) -> None:
    said = [odometry(k / 10, 0.1 * k, 5.0, (1.0, 0.0)) for k in range(50)]
    for log in (*both(tmp_path, said), *both(tmp_path / "no", [*said, fix(1.0, 15.0, 45.0, status=-1)])):
        assert (log.own_frame, log.geographic, log.crs) == ("odom", False, None)
        np.testing.assert_allclose(log.place, np.stack([0.1 * np.arange(50), np.full(50, 5.0)], axis=1))
        np.testing.assert_allclose(log.speed_m_s, 1.0)
        assert np.isnan(log.roll_deg).all()
        assert np.isnan(log.pitch_deg).all()
        assert any("in the robot's own frame odom, not on the map" in note for note in log.notes)


def test_the_fused_topic_is_taken_else_the_one_with_the_most_and_the_others_are_named(tmp_path: Path) -> None:
    said = [fix(k, 10.0, 40.0, topic="/gps/filtered") for k in range(3)]
    said += [fix(k, 20.0, 40.0, topic="/gps/fix") for k in range(9)]
    said += [odometry(k, k, 0, (1.0, 0.0), topic="/a/odom") for k in range(9)]
    said += [odometry(k / 2, k, 0, (2.0, 0.0), topic="/z/odom") for k in range(18)]
    said += [command(k, 1.5, topic="/joy/cmd_vel") for k in range(5)]
    said += [command(k, 1.0, topic="/base/cmd_vel", stamped=True) for k in range(9)]
    said += [command(k, 9.0, topic="/gps/vel") for k in range(99)]
    for log in both(tmp_path, said):
        assert log.place[:, 0].tolist() == [10.0] * 3
        np.testing.assert_allclose(log.speed_m_s, 2.0)
        np.testing.assert_allclose(log.commanded_m_s, 1.0)
        assert log.notes == (
            "takes places from /gps/filtered, achieved speed from /z/odom, commanded speed from /base/cmd_vel",
            "passes over /a/odom, /gps/fix, /gps/vel, /joy/cmd_vel",
        )


def test_a_second_receiver_counts_by_its_fixes(tmp_path: Path) -> None:
    said = [fix(k, 10.0, 40.0, topic="/a", status=-1) for k in range(50)]
    said += [fix(k, 20.0, 40.0, topic="/b") for k in range(5)]
    assert both(tmp_path, said)[0].place[:, 0].tolist() == [20.0] * 5


def test_places_that_come_as_odometry_without_speed_tell_no_speed(tmp_path: Path) -> None:
    said = [fix(k, lon(k), 45.0) for k in range(10)] + [odometry(k, k, 0, topic="/odometry/gps") for k in range(10)]
    for log in both(tmp_path, said):
        assert np.isnan(log.speed_m_s).all()
        assert "/odometry/gps moves at a speed of 0: its speeds are passed over" in log.notes


def test_an_imu_that_tells_no_orientation_or_is_mounted_otherwise_tells_nothing(tmp_path: Path) -> None:
    places = [fix(k, lon(k), 45.0) for k in range(5)]
    sideways = Rotation.from_euler("X", 90, degrees=True).as_quat()
    for name, messages in {
        "unknown": [imu(k, TURN.as_quat(), known=False) for k in range(5)],
        "zero": [imu(k, (0, 0, 0, 0)) for k in range(5)],
        "sideways": [imu(k, sideways) for k in range(5)],
    }.items():
        for log in both(tmp_path / name, places + messages):
            assert np.isnan(log.roll_deg).all()
            assert ("/imu leans by 90°: it is not mounted as the robot is" in log.notes) == (name == "sideways")


def test_wheels_that_lean_tell_roll_and_pitch_where_no_imu_does(tmp_path: Path) -> None:
    said = [fix(k, lon(k), 45.0) for k in range(5)]
    said += [odometry(k, k, 0, (1.0, 0.0), turn=TURN.as_quat()) for k in range(5)]
    for log in both(tmp_path, said):
        np.testing.assert_allclose(log.pitch_deg, 8)
        np.testing.assert_allclose(log.roll_deg, 11)


def test_what_was_measured_seconds_away_is_not_known(tmp_path: Path) -> None:
    said = [fix(k, lon(k), 45.0) for k in range(20)] + [odometry(k, k, 0, (1.0, 0.0)) for k in (3, 4, 10, 11)]
    for log in both(tmp_path, said):
        assert np.flatnonzero(np.isfinite(log.speed_m_s)).tolist() == [3, 4, 10, 11]


def test_clocks_that_differ_are_set_right_by_the_recording(tmp_path: Path) -> None:
    # The receiver stamps with the satellites' time, an hour ahead of the robot's.
    said = [fix(k, lon(k), 45.0, stamp_s=k + 3600) for k in range(10)]
    said += [odometry(k, k, 0, (0.1 * k, 0.0)) for k in range(10)]
    said += [command(k, 0.2 * k) for k in range(10)]
    for log in both(tmp_path, said):
        np.testing.assert_allclose(log.time_s, T0 + 3600 + np.arange(10), rtol=0, atol=1e-6)
        np.testing.assert_allclose(log.speed_m_s, 0.1 * np.arange(10), atol=1e-6)
        np.testing.assert_allclose(log.commanded_m_s, 0.2 * np.arange(10), atol=1e-6)
        assert "the clock of /odom is -3600.0 s off that of /fix: set right by when they were recorded" in log.notes


def test_messages_without_stamps_have_the_time_of_their_recording(tmp_path: Path) -> None:
    said = [fix(k, lon(k), 45.0, stamp_s=None) for k in range(10)]
    said += [odometry(k, k, 0, (0.1 * k, 0.0), stamp_s=k + 500) for k in range(10)]
    for log in both(tmp_path, said):
        np.testing.assert_allclose(log.time_s, T0 + np.arange(10), rtol=0, atol=1e-6)
        np.testing.assert_allclose(log.speed_m_s, 0.1 * np.arange(10), atol=1e-6)


def test_only_the_topics_that_tell_of_a_drive_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    whole = bag_module._rows

    def rows(reader: Any, wanted: Any, *more: Any) -> Any:
        seen.extend(each.topic for each in wanted)
        return whole(reader, wanted, *more)

    monkeypatch.setattr(bag_module, "_rows", rows)
    read_drive_log(write(tmp_path, drive(), "mcap"))
    assert sorted(seen) == ["/cmd_vel", "/fix", "/imu", "/odom"]


def test_a_database_that_brings_no_message_layouts_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, drive(), "db3")
    whole = read_drive_log(path)
    # As ROS 2 wrote them before Iron.
    with sqlite3.connect(path) as data:
        data.executescript("DROP TABLE message_definitions; DROP TABLE schema; DROP TABLE metadata;")
    found = read_drive_log(path)
    np.testing.assert_array_equal(found.place, whole.place)
    np.testing.assert_array_equal(found.roll_deg, whole.roll_deg)


@pytest.mark.parametrize("name", ["a%20b", "a#b", "a?b"])
def test_a_database_with_a_mark_in_its_name_says_so(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, drive(), "db3").rename(tmp_path / f"{name}.db3")
    with pytest.raises(InputError, match=r"cannot be opened.*rename it"):
        read_drive_log(path)


def test_a_database_that_was_not_closed_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, drive(), "db3")
    for side in ("-wal", "-journal"):
        journal = path.with_name(path.name + side)
        journal.write_bytes(b"x")
        for each in (path, path.parent):
            with pytest.raises(InputError, match=r"was not closed: its last messages are in drive\.db3-"):
                read_drive_log(each)
        journal.write_bytes(b"")
        assert read_drive_log(path).time_s.size == 101
        journal.unlink()


def test_messages_that_the_index_promises_and_that_are_not_there_are_told(tmp_path: Path) -> None:
    folder = write(tmp_path, drive(), "folder")
    with sqlite3.connect(folder / "drive.db3") as data:
        data.execute("DELETE FROM messages WHERE topic_id = (SELECT id FROM topics WHERE name = '/fix') AND id % 2 = 0")
    log = read_drive_log(folder)
    assert f"is damaged: /fix has {log.time_s.size} of 101 messages" in log.notes


def test_a_folder_and_its_one_file_are_the_same_drive(tmp_path: Path) -> None:
    path = write(tmp_path, drive(), "mcap")
    assert log_sha256(path) == log_sha256(path.parent)
    other = write(tmp_path, drive()[1:], "mcap folder", name="other")
    assert log_sha256(other) != log_sha256(path.parent)


def test_a_bag_that_tells_no_places_is_refused(tmp_path: Path) -> None:
    for kind in ("bag", "mcap"):
        for name, said, problem in (
            ("a", [command(0, 1.0)], "no NavSatFix and no Odometry"),
            ("b", [fix(0, 1.0, 1.0, status=-1)], "none with a fix"),
            ("c", [Said("/camera", "image", 0.0, stamp_s=0.0)], "no NavSatFix and no Odometry"),
            ("d", [fix(0, 15.0, 91.0)], "no place on Earth"),
            ("e", [fix(0, 15.0, 45.0), fix(1, 15.0, 45.0, stamp_s=-1)], "time goes backwards"),
        ):
            with pytest.raises(InputError, match=problem):
                read_drive_log(write(tmp_path / kind, said, kind, name=name))


def damaged(path: Path, how: str) -> Path:
    """Damage a bag's file on the spot."""
    whole = path.read_bytes()
    junk = np.random.default_rng(1).integers(0, 256, 4000, np.uint8).tobytes()
    path.write_bytes(
        {
            "empty": b"",
            "begun": whole[:20],
            "half": whole[: len(whole) // 2],
            "nearly whole": whole[:-40],
            "garbage": junk,
            "begun, then garbage": whole[:30] + junk,
            "holes": whole[:4096] + b"\0" * (len(whole) - 8192) + whole[-4096:],
        }[how]
    )
    return path


HOW = ("empty", "begun", "half", "nearly whole", "garbage", "begun, then garbage", "holes")


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
@pytest.mark.parametrize("how", HOW)
def test_what_is_damaged_is_one_refusal(tmp_path: Path, kind: str, how: str) -> None:
    path = damaged(write(tmp_path, drive(), kind), how)
    for each in (path,) if kind == "bag" else (path, path.parent):
        with pytest.raises(InputError) as refusal:
            read_drive_log(each)
        assert len(str(refusal.value).splitlines()) == 1
        assert len(str(refusal.value)) < 600
        assert str(each) in str(refusal.value)


def test_a_bag_without_its_index_says_what_to_do(tmp_path: Path) -> None:
    path = write(tmp_path, drive(), "bag")
    whole = path.read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(whole[:at] + bytes(8) + whole[at + 8 :])
    with pytest.raises(InputError, match=r"not indexed.*`rosbag reindex`"):
        read_drive_log(path)


def test_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, drive(), "mcap")
    whole = bytearray(path.read_bytes())
    # The first chunk: op 6, length (8), times (16), size (8), then its CRC, of which 0 means that there is none.
    at = next(k for k in range(len(whole)) if whole[k] == 6 and k > 40)
    whole[at + 33 : at + 37] = b"\1\2\3\4"
    path.write_bytes(whole)
    with pytest.raises(InputError, match="checksum"):
        read_drive_log(path)


@pytest.mark.parametrize(
    "yaml", ["", "[1, 2", "a: 1\n", "rosbag2_bagfile_information: 7\n", "!!python/object:os.system x"]
)
def test_a_folder_whose_metadata_is_none_is_refused(tmp_path: Path, yaml: str) -> None:
    folder = write(tmp_path, drive(), "folder")
    (folder / "metadata.yaml").write_text(yaml)
    with pytest.raises(InputError, match="not a bag that can be read"):
        read_drive_log(folder)


def test_a_folder_that_lacks_something_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path, drive(), "folder")
    (folder / "metadata.yaml").rename(tmp_path / "metadata.yaml")
    with pytest.raises(InputError, match=r"without metadata\.yaml.*reindex"):
        read_drive_log(folder)
    shutil.move(tmp_path / "metadata.yaml", folder)
    (folder / "drive.db3").unlink()
    with pytest.raises(InputError, match="missing"):
        read_drive_log(folder)


def test_without_rosbags_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, drive(), "bag")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(InputError) as refusal:
        read_drive_log(path)
    assert str(refusal.value) == f"{path}: needs rosbags: pip install 'hrt[ros]'"
