"""ArduPilot's DataFlash logs, written here byte by byte as ArduPilot lays them out.

A message is A3 95, its type, and its fields; types are defined by FMT messages (type 128, "BBnNZ"). Format characters:
Q uint64, I uint32, H uint16, B uint8, h int16, f float, c int16 / 100, C uint16 / 100, L int32 / 1e7
(https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import DFReader_binary

from hrt_cli.errors import InputError
from hrt_cli.logs.dataflash import Messages
from hrt_cli.logs.read import read_drive_log

CODES = {"Q": "Q", "I": "I", "H": "H", "B": "B", "h": "h", "f": "f", "c": "h", "C": "H", "L": "i"}
LAYOUTS = {
    "GPS": (130, "QBBIHBcLLeffffB".replace("e", "f"),
            "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "POS": (131, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "ATT": (132, "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    "THR": (133, "Qhffff", "TimeUS,ThrIn,ThrOut,DesSpeed,Speed,AccX"),
    "MODE": (134, "QBBB", "TimeUS,Mode,ModeNum,Rsn"),
}  # fmt: skip
WEEK, T0_MS = 2290, 200_000_000
# Week 2290 of GPS began on Sunday 2023-11-26; 200000 s on it is Tuesday 07:33:20 of GPS, 18 s less of UTC.
T0 = 1_701_156_800.0 - 18


def layout(name: str) -> bytes:
    number, codes, columns = LAYOUTS[name]
    length = 3 + struct.calcsize("<" + "".join(CODES[c] for c in codes))
    return b"\xa3\x95\x80" + struct.pack(
        "<BB4s16s64s", number, length, name.encode(), codes.encode(), columns.encode()
    )  # fmt: skip


HEAD = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")


def message(name: str, *values: float) -> bytes:
    number, codes, _ = LAYOUTS[name]
    scale = {"c": 100, "C": 100, "L": 1e7}
    raw = [v if c == "f" else round(v * scale.get(c, 1)) for v, c in zip(values, codes, strict=True)]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES[c] for c in codes), *raw)


def gps(t: float, *, number: int = 0, status: int = 3, lat: float = 45.0, lng: float = 15.0, spd: float = 1.0,
        week: int = WEEK) -> bytes:  # fmt: skip
    return message("GPS", t * 1e6, number, status, T0_MS + t * 1000, week, 12, 0.8, lat, lng, 200, spd, 90, 0, 0, 1)


def pos(t: float, lat: float, lng: float) -> bytes:
    return message("POS", t * 1e6, lat, lng, 200, 0, 0)


def att(t: float, roll: float, pitch: float, yaw: float) -> bytes:
    return message("ATT", t * 1e6, 0, roll, 0, pitch, 0, yaw, 3)


def thr(t: float, wanted: float) -> bytes:
    return message("THR", t * 1e6, 0, 0, wanted, 0, 0)


def put(path: Path, messages: Sequence[bytes], names: Sequence[str] = tuple(LAYOUTS)) -> Path:
    path.write_bytes(HEAD + b"".join(map(layout, names)) + b"".join(messages))
    return path


def lng(t: float) -> float:
    return 15.0 + 1e-5 * t


def drive(seconds: int = 20) -> list[bytes]:
    """Return a Rover's drive: fused places at 10 Hz, GPS at 5 Hz, attitude, commands backwards for the first 10 s."""
    tenths = np.arange(10 * seconds + 1) / 10
    said = [(t, pos(t, 45.0, lng(t))) for t in tenths]
    said += [(t, gps(t, lat=45.5, spd=0.1 * t)) for t in tenths[::2]]
    said += [(t, att(t, 11.0, -8.0, (350 + 2 * t) % 360)) for t in tenths]
    said += [(t, thr(t, -0.75 if t <= 10 else np.nan)) for t in tenths]
    said += [(5.0, message("MODE", 5e6, 10, 10, 1))]
    return [data for _, data in sorted(said, key=lambda each: each[0])]


def test_a_rover_s_drive(tmp_path: Path) -> None:
    log = read_drive_log(put(tmp_path / "00000012.BIN", drive()))
    when = np.arange(201) / 10
    np.testing.assert_allclose(log.time_s, T0 + when, rtol=0, atol=1e-6)
    np.testing.assert_allclose(log.place, np.stack([lng(when), np.full(201, 45.0)], axis=1), atol=1e-7)
    np.testing.assert_allclose(log.speed_m_s, 0.1 * when, atol=1e-6)
    np.testing.assert_allclose(log.commanded_m_s, np.where(when <= 10, 0.75, np.nan), atol=1e-6)
    # ArduPilot's body axes are forward, right, down: nose up and right side down are positive already.
    np.testing.assert_allclose(log.roll_deg, 11)
    np.testing.assert_allclose(log.pitch_deg, -8)
    np.testing.assert_allclose(log.heading_deg, (350 + 2 * when) % 360, atol=0.01)
    assert np.isnan(log.depth_m).all()
    assert (log.geographic, log.own_frame, log.events, log.notes) == (
        True,
        None,
        (),
        ("takes places from POS (fused)",),
    )


def test_without_fused_places_those_of_the_receiver_with_a_3d_fix_count(tmp_path: Path) -> None:
    said = [gps(k, status=2 if k < 3 else 4, lng=lng(k), week=0 if k < 3 else WEEK) for k in range(10)]
    log = read_drive_log(put(tmp_path / "a.bin", said, ("GPS",)))
    np.testing.assert_allclose(log.time_s, T0 + np.arange(3, 10), rtol=0, atol=1e-6)
    np.testing.assert_allclose(log.place[:, 0], lng(np.arange(3, 10)), atol=1e-7)
    assert np.isnan(log.commanded_m_s).all()
    assert np.isnan(log.roll_deg).all()
    assert log.notes == ("takes places from GPS",)


def test_of_several_receivers_the_one_with_the_most_fixes_counts(tmp_path: Path) -> None:
    said = [gps(k, number=k % 2, status=1 if k % 2 == 0 and k < 5 else 3, lng=15 + k % 2) for k in range(20)]
    log = read_drive_log(put(tmp_path / "a.bin", said))
    np.testing.assert_array_equal(log.place[:, 0], 16)
    assert "takes GPS 1, and passes over 0" in log.notes


def test_without_a_date_times_count_from_when_it_was_switched_on(tmp_path: Path) -> None:
    log = read_drive_log(put(tmp_path / "a.bin", [pos(k, 45.0, lng(k)) for k in range(5)]))
    np.testing.assert_allclose(log.time_s, np.arange(5))
    assert "tells no date: its times are seconds since it was switched on" in log.notes
    assert np.isnan(log.speed_m_s).all()


def test_headings_go_through_north_between_two_that_were_logged(tmp_path: Path) -> None:
    said = [att(0, 0, 0, 350), pos(0.5, 45.0, 15.0), att(1, 0, 0, 20)]
    assert read_drive_log(put(tmp_path / "a.bin", said)).heading_deg.tolist() == [pytest.approx(5)]


def test_places_at_0_0_are_dropped(tmp_path: Path) -> None:
    log = read_drive_log(put(tmp_path / "a.bin", [pos(0, 0, 0), pos(1, 0, 15), pos(2, 45, 0)]))
    assert log.time_s.tolist() == [1, 2]
    assert "drops 1 places at 0, 0" in log.notes


def test_a_command_that_is_old_is_not_known(tmp_path: Path) -> None:
    said = [thr(0, 0.5), *(pos(k / 2, 45.0, lng(k)) for k in range(10))]
    log = read_drive_log(put(tmp_path / "a.bin", said))
    np.testing.assert_array_equal(log.commanded_m_s, [0.5] * 3 + [np.nan] * 7)


def test_a_log_that_ends_within_a_message_is_taken_up_to_there(tmp_path: Path) -> None:
    whole = b"".join([HEAD, *map(layout, LAYOUTS), *drive()])
    last = len(drive()[-1])
    path = tmp_path / "a.bin"
    full = put(path, drive())
    records = read_drive_log(full).time_s.size
    for cut in (1, last - 3, last - 1):
        path.write_bytes(whole[:-cut])
        log = read_drive_log(path)
        assert log.notes[1:] == (f"ends within a message: its last {last - cut} bytes are left out",)
        assert records - 1 <= log.time_s.size <= records
    path.write_bytes(whole + b"\0" * 200)
    assert read_drive_log(path).notes[1:] == ("ends within a message: its last 200 bytes are left out",)


def test_a_few_bytes_between_messages_are_told_and_many_refused(tmp_path: Path) -> None:
    said = drive()
    path = put(tmp_path / "a.bin", [*said[:300], b"\0" * 40, *said[300:]])
    log = read_drive_log(path)
    lost = 40 + len(said[299])  # the message before them may have been cut as well
    assert f"is damaged: {lost} bytes between its messages are passed over" in log.notes
    assert log.time_s.size >= 200
    put(path, [*said[:300], b"\0" * 4000, *said[300:]])
    with pytest.raises(InputError, match=r"is damaged: 40\d\d of its"):
        read_drive_log(path)


def test_time_that_goes_backwards_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="time goes backwards at record 2"):
        read_drive_log(put(tmp_path / "a.bin", [pos(3, 45.0, 15.0), pos(2, 45.0, 15.0)]))


JUNK = np.random.default_rng(2).integers(0, 256, 5000, np.uint8).tobytes()
BAD = {
    "empty": (b"", "is empty"),
    "another file": (b"PK\3\4" + JUNK, "does not begin as one does"),
    "garbage": (b"\xa3\x95" + JUNK, "damaged|cannot be read|can be read|tells no places"),
    "layouts only": (HEAD + layout("GPS"), "tells no places"),
    "no fix": (HEAD + layout("GPS") + gps(0, status=1), "tells no places"),
    "an unknown letter": (
        HEAD + layout("POS").replace(b"QLLfff", b"QLLff?") + pos(0, 45, 15), "lays out the message POS in a way"
    ),
    "nowhere": (HEAD + layout("POS") + pos(0, 95, 15), "no place on Earth"),
    "another layout": (
        HEAD + layout("POS").replace(b"TimeUS,Lat", b"TimeMS,Lat") + pos(0, 45, 15), "tells no places"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_log_is_one_refusal(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    content, problem = BAD[name]
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as refusal:
        read_drive_log(path)
    assert len(str(refusal.value).splitlines()) == 1
    assert capfd.readouterr() == ("", "")


def test_columns_are_those_that_pymavlink_reads(tmp_path: Path) -> None:
    path = put(tmp_path / "a.bin", drive())
    found = Messages(path).read({name: tuple(fields.split(",")) for name, (_, _, fields) in LAYOUTS.items()})
    with DFReader_binary(str(path)) as peer:
        for name, columns in found.items():
            peer.rewind()
            rows = list(iter(lambda name=name: peer.recv_match(type=[name], strict=True), None))
            assert len(rows) == len(columns["TimeUS"]) > 0
            for field, values in columns.items():
                np.testing.assert_array_equal(values, [getattr(row, field) for row in rows], err_msg=f"{name}.{field}")
        clock = [row._timestamp for row in rows]
    assert clock[0] == pytest.approx(T0 + 5, abs=1e-6)


@settings(max_examples=150)
@given(data=st.data())
def test_damage_never_passes_silently(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Bytes put in, taken out or exchanged between messages: told or refused, and the rest is what it was."""
    said, path = drive(3), tmp_path_factory.getbasetemp() / "damaged.bin"
    at = data.draw(st.integers(1, len(said) - 2))
    how = data.draw(st.sampled_from(["in", "cut", "header"]))
    junk = data.draw(st.binary(min_size=1, max_size=60))
    if how == "in":
        said.insert(at, junk)
    elif how == "cut":
        said[at] = said[at][: data.draw(st.integers(1, len(said[at]) - 1))]
    else:
        said.insert(at, b"\xa3\x95" + bytes([data.draw(st.integers(128, 140))]))
    put(path, said)
    try:
        log = read_drive_log(path)
    except InputError:
        return
    assert any("passed over" in note for note in log.notes)
    whole = np.round(lng(np.arange(31) / 10), 7)
    assert np.isin(np.round(log.place[:, 0], 7), whole).all()
    assert log.time_s.size >= 29
