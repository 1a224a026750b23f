"""The drive log: what is read, what is refused, and that what is written is read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.artifacts.drivelog import Header, Robot, drive_provenance, publish_drive_log
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.logs.read import read_drive_log

HEADER = '{"format": "hrt-drive-log"}'
PLACE = {"x": 1.0, "y": 2.0}


def put(path: Path, *records: dict[str, Any], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *map(json.dumps, records)]) + "\n")
    return path


def publish(path: Path, records: list[dict[str, Any]]) -> Path:
    header = Header(
        format="hrt-drive-log", crs="EPSG:32633", robot=Robot(kind="auv", radius_m=0.3), end="out of time"
    )  # fmt: skip
    publish_drive_log(path, header, records, record("test", 1, {}, {}))
    return path


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    records = [
        {"t": 0.0, "x": 500000.123, "y": 1.0, "speed_m_s": 0.5, "commanded_m_s": 0.6, "heading_deg": 359.9,
         "pitch_deg": -5.5, "roll_deg": 4.5, "depth_m": 3.25},
        {"t": 0.4, "x": 500000.223, "y": 1.0, "event": "collision"},
        {"t": 0.4, "x": 500000.223, "y": 1.1, "event": "stuck"},
    ]  # fmt: skip
    path = publish(tmp_path / "d.jsonl", records)
    log = read_drive_log(path)
    assert (log.crs, log.robot, log.end) == ("EPSG:32633", Robot(kind="auv", radius_m=0.3), "out of time")
    assert (log.geographic, log.breaks, log.own_frame, log.notes) == (False, (), None, ())
    assert log.events == ((1, "collision"), (2, "stuck"))
    np.testing.assert_array_equal(log.time_s, [0.0, 0.4, 0.4])
    np.testing.assert_array_equal(log.place, [[each["x"], each["y"]] for each in records])
    for name in ("speed_m_s", "commanded_m_s", "heading_deg", "pitch_deg", "roll_deg", "depth_m"):
        np.testing.assert_array_equal(getattr(log, name), [records[0][name], np.nan, np.nan])
    assert drive_provenance(path).stage == "test"


def test_the_same_drive_is_the_same_bytes(tmp_path: Path) -> None:
    records = [{"t": 0.0, **PLACE}]
    assert publish(tmp_path / "a.jsonl", records).read_bytes() == publish(tmp_path / "b.jsonl", records).read_bytes()


@pytest.mark.parametrize("line", [0, 1, 2])
def test_a_log_that_was_edited_is_refused(tmp_path: Path, line: int) -> None:
    path = publish(tmp_path / "d.jsonl", [{"t": float(k), **PLACE} for k in range(3)])
    lines = path.read_text().splitlines()
    lines[line + 1] = lines[line + 1].replace('"x": 1.0', '"x": 1.5')
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"d\.jsonl"):
        read_drive_log(path)
    del lines[line + 1]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"d\.jsonl"):
        read_drive_log(path)


def test_a_log_of_another_program(tmp_path: Path) -> None:
    path = put(tmp_path / "d.jsonl", {"t": -5, "lon": 15.0, "lat": 45.0}, {"t": 3, "lon": 15.1, "lat": 45.0})
    log = read_drive_log(path)
    assert log.geographic
    assert (log.crs, log.robot, log.end, log.events) == (None, None, None, ())
    assert np.isnan(log.speed_m_s).all()
    assert drive_provenance(path) is None


@pytest.mark.parametrize(
    ("records", "message"),
    [
        ([], "has no records"),
        ([{"t": 0, "x": 1}], "line 2"),
        ([{"t": 0}], "needs either x and y, or lon and lat"),
        ([{"t": 0, **PLACE, "lon": 1.0}], "needs either x and y, or lon and lat"),
        ([{"t": 0, **PLACE, "lon": 1.0, "lat": 1.0}], "needs either x and y, or lon and lat"),
        ([{"t": 0, **PLACE}, {"t": 1, "lon": 1, "lat": 1}], "mixes places"),
        ([{"t": 1, **PLACE}, {"t": 0.5, **PLACE}], "time goes backwards at record 2"),
        ([{**PLACE}], "line 2"),
        ([{"t": "0", **PLACE}], "line 2"),
        ([{"t": 0, **PLACE, "speed_m_s": -1}], "speed_m_s"),
        ([{"t": 0, **PLACE, "event": "fell over"}], "event"),
        ([{"t": 0, **PLACE, "heading_deg": 400}], "heading_deg"),
        ([{"t": 0, **PLACE, "roll_deg": 181}], "roll_deg"),
        ([{"t": 0, "lon": 181, "lat": 0}], "lon"),
        ([{"t": 0, **PLACE, "drivability": 0.3}], "drivability"),
    ],
)
def test_what_is_no_drive_is_refused(tmp_path: Path, records: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_drive_log(put(tmp_path / "d.jsonl", *records))
    assert "d.jsonl" in str(error.value)


@pytest.mark.parametrize(
    "header",
    [
        '{"format": "hrt-plan"}',
        '{"format": "hrt-drive-log", "version": 2}',
        '{"format": "hrt-drive-log", "end": "bored"}',
        '{"format": "hrt-drive-log", "robot": {"kind": "ugv", "radius_m": 0}}',
        '{"format": "hrt-drive-log", "robot": {"kind": "hexapod", "radius_m": 1}}',
        '{"format": "hrt-drive-log", "format": "hrt-drive-log"}',
        "[]",
        "",
    ],
)
def test_a_header_that_is_none_is_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(InputError, match=r"d\.jsonl"):
        read_drive_log(put(tmp_path / "d.jsonl", {"t": 0, **PLACE}, header=header))


@pytest.mark.parametrize("text", ["", "\n\n", HEADER, HEADER + '\n{"t": 0, "x": 1, "y": 2}', '{"t"\n'])
def test_a_log_that_is_cut_off_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "d.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=r"d\.jsonl"):
        read_drive_log(path)


def test_line_ends_and_empty_lines_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "d.jsonl"
    path.write_bytes(HEADER.encode() + b'\r\n{"t": 0, "x": 1, "y": 2}\r\n\r\n{"t": 1, "x": 1, "y": 3}\r\n')
    assert len(read_drive_log(path).time_s) == 2


@given(text=st.text(alphabet='{}[]":,0129.-eEtxylonau \n', max_size=120))
def test_any_text_is_read_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.getbasetemp()
    for name in ("any.jsonl", "any.csv", "any.gpx"):
        for content in (text, f"{HEADER}\n{text}\n", f"t,x,y\n{text}\n"):
            path = folder / name
            path.write_text(content)
            try:
                log = read_drive_log(path)
            except InputError:
                continue
            assert len(log.time_s) == len(log.place) > 0
