"""Tables read as drive logs: by which names, with which separators, and what is told of the rest."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.logs.read import read_drive_log
from hrt_cli.logs.table import _NAMES


def put(folder: Path, *lines: str, name: str = "d.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(folder: Path, *lines: str) -> DriveLog:
    return read_drive_log(put(folder, *lines))


def test_a_table_is_read(tmp_path: Path) -> None:
    log = read(tmp_path, "t, x ,y,event,battery", "0,1,2,,99", "1,1,3,stuck,98")
    assert log.events == ((1, "stuck"),)
    assert log.place.tolist() == [[1, 2], [1, 3]]
    assert log.notes == ("passes over the columns battery",)
    with pytest.raises(InputError, match="has no records"):
        read(tmp_path, "t,x,y")


def test_our_own_names_are_taken_as_they_are_without_a_note(tmp_path: Path) -> None:
    names = "t,lon,lat,speed_m_s,commanded_m_s,heading_deg,pitch_deg,roll_deg,depth_m"
    log = read(tmp_path, names, "0,15,45,1,2,3,4,5,6", "1,15,45,,,,,,")
    told = [log.speed_m_s, log.commanded_m_s, log.heading_deg, log.pitch_deg, log.roll_deg, log.depth_m]
    np.testing.assert_array_equal(told, [[k, np.nan] for k in range(1, 7)])
    assert log.notes == ()


@pytest.mark.parametrize("field", _NAMES)
def test_every_usual_name_is_read_in_its_unit(tmp_path: Path, field: str) -> None:
    for name, factor in _NAMES[field].items():
        columns = {"t": "1", "x": "2", "y": "3"}
        columns.pop(field, None)
        if field in ("lon", "lat"):
            columns = {"t": "1", "lon": "2", "lat": "3"}
            del columns[field]
        columns[name.upper()] = "0.5"
        log = read(tmp_path, ",".join(columns), ",".join(columns.values()))
        lon_or_x, lat_or_y = log.place[0]
        found = {"t": log.time_s[0], "x": lon_or_x, "y": lat_or_y, "lon": lon_or_x, "lat": lat_or_y}
        value = found[field] if field in found else getattr(log, field)[0]
        assert value == pytest.approx(0.5 * factor), name


def test_factors_are_those_of_the_units() -> None:
    assert _NAMES["speed_m_s"]["speed_kmh"] * 36 == pytest.approx(10)
    assert _NAMES["speed_m_s"]["speed_knots"] * 3600 == pytest.approx(1852)
    assert _NAMES["pitch_deg"]["pitch_rad"] == _NAMES["heading_deg"]["course_rad"] == pytest.approx(np.degrees(1))
    assert (_NAMES["t"]["time_ms"], _NAMES["t"]["timestamp_us"], _NAMES["t"]["t_ns"]) == (1e-3, 1e-6, 1e-9)


def test_units_in_brackets_are_part_of_the_name(tmp_path: Path) -> None:
    log = read(tmp_path, "Time (s),Longitude [deg],Latitude [deg],Speed (km/h)", "4,15,45,36")
    assert (log.time_s[0], log.place[0].tolist(), log.speed_m_s[0]) == (4, [15, 45], pytest.approx(10))
    assert log.notes == ()


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("bom", ["", "\ufeff"])
def test_separators_and_byte_order_marks(tmp_path: Path, separator: str, bom: str) -> None:
    lines = ["t,lon,lat,note;more".replace(",", separator), "0,15,45,a".replace(",", separator)]
    path = put(tmp_path, bom + lines[0], lines[1], name="d.tsv" if separator == "\t" else "d.csv")
    assert read_drive_log(path).place.tolist() == [[15, 45]]


@pytest.mark.parametrize(
    "text", ["2024-05-01T12:00:00Z", "2024-05-01 14:00:00+02:00", "2024-05-01T12:00:00", "2024-05-01T12:00:00.000000"]
)
def test_times_of_day_are_unix_seconds(tmp_path: Path, text: str) -> None:
    log = read(tmp_path, "timestamp,x,y", f"{text},0,0")
    assert log.time_s[0] == datetime(2024, 5, 1, 12, tzinfo=UTC).timestamp()
    assert ("takes times without a zone to be UTC" in log.notes) == ("Z" not in text and "+" not in text)


def test_what_has_no_unit_is_told(tmp_path: Path) -> None:
    log = read(tmp_path, "t,x,y,v,cmd_vel,yaw,heading,pitch_rad,depth,yaw_deg", "0,1,2,-0.5,-1,1,2,0.1,7,9")
    assert (log.speed_m_s[0], log.commanded_m_s[0]) == (0.5, 1.0)
    assert log.pitch_deg[0] == pytest.approx(np.degrees(0.1))
    assert np.isnan(log.heading_deg).all()
    assert np.isnan(log.depth_m).all()
    assert log.notes == (
        "takes v and cmd_vel to be in m/s",
        "takes pitch_rad to count up with the nose up and the right side down",
        "passes over yaw, heading, depth, yaw_deg: in what unit, or from where, it counts is not known",
        "takes cmd_vel and v below 0 to be driven backwards, as fast",
    )


def test_our_own_names_come_first(tmp_path: Path) -> None:
    names = "t,time,lon,longitude,lat,Lat,speed_m_s,speed,easting,northing"
    log = read(tmp_path, names, "1,9,15,99,45,99,2,9,5,6")
    assert (log.time_s[0], log.place[0].tolist(), log.speed_m_s[0]) == (1, [15, 45], 2)
    assert log.notes == ("passes over the columns time, longitude, Lat, speed, easting, northing",)
    log = read(tmp_path, "t,x,y,latitude,longitude", "1,5,6,45,15")
    assert (log.geographic, log.place.tolist()) == (False, [[5, 6]])


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        ("time,timestamp,x,y", "time and timestamp tell the same"),
        ("t,x,y,v,speed", "v and speed tell the same"),
        ("t,x,y,cmd_vel,target_speed", "cmd_vel and target_speed tell the same"),
        ("t,latitude,lat_deg,lon", "latitude and lat_deg tell the same"),
        ("t,lon,lat,x,y", "in more than one way"),
        ("t,longitude,latitude,easting,northing", "in more than one way"),
        ("t,x,x,y", "names a column twice"),
        ("when,x,y", "has no column t"),
        ("t,lat", "needs either x and y, or lon and lat"),
    ],
)
def test_columns_that_are_ambiguous_or_absent_are_refused(tmp_path: Path, names: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read(tmp_path, names, ",".join("1" for _ in names.split(",")))


@pytest.mark.parametrize(
    ("names", "row", "problem"),
    [
        ("time,x,y", "1700000000000,0,0", "line 2: time is 1700000000000, not in seconds .*time_ms"),
        ("time,x,y", "noon,0,0", "neither a finite number nor an ISO 8601 time"),
        ("time,x,y", "nan,0,0", "not a finite number"),
        ("time_ms,x,y", "2024-05-01T12:00:00,0,0", "line 2: time_ms is '2024-05-01T12:00:00', not a finite number"),
        ("t,x,y,v", "0,0,0,inf", "v is 'inf', not a finite number"),
        ("t,x,y", "0,1", "needs either"),
        ("t,x,y", "0,1,2,3", "more fields"),
        ("t,lon,lat", "0,1,91", "lat"),
        ("t,x,y,event", "0,1,1,fell", "event"),
        ("t,x,y,speed_m_s", "0,1,1,-1", "speed_m_s"),
        ("t,lon,lat", "0,45;1,2", "not a finite number"),
    ],
)
def test_rows_that_are_no_record_are_refused(tmp_path: Path, names: str, row: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read(tmp_path, names, row)


def test_numbers_and_dates_do_not_mix(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 3"):
        read(tmp_path, "time,x,y", "0,0,0", "2024-05-01T12:00:00,0,0")
    with pytest.raises(InputError, match="line 3"):
        read(tmp_path, "time,x,y", "2024-05-01T12:00:00,0,0", "20240502,0,0")


def test_rows_without_a_fix_are_dropped(tmp_path: Path) -> None:
    rows = ["0,0,15,45", "1,-1,nan,nan", "2,2,0.000,-0.0", "3,,15,45", "4,1,15,45"]
    log = read(tmp_path, "t,Status,lon,lat", *rows)
    assert log.time_s.tolist() == [0, 3, 4]
    assert log.notes == ("drops 2 rows in which the receiver had no fix",)
    with pytest.raises(InputError, match="no fix in any of its 2 rows"):
        read(tmp_path, "t,Status,lon,lat", *rows[1:3])
    log = read(tmp_path, "t,status,x,y", "0,OK,0,0", "1,-1,0,0")
    assert log.time_s.tolist() == [0]
    assert log.notes[-1] == "passes over status where it is not a number"


def test_a_table_that_python_cannot_split_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"d\.csv"):
        read(tmp_path, "t,x,y", f'0,1,"{"a" * 200_000}"')


NAMES = ["t", "time", "lon", "lat", "x", "y", "v", "speed_m_s", "status", "event", "yaw", ""]
CELLS = st.sampled_from(["", "0", "-1", "1e400", "nan", "2024-05-01", "stuck", "15.5", "x", '"'])


@given(names=st.lists(st.sampled_from(NAMES), max_size=6), rows=st.lists(st.lists(CELLS, max_size=7), max_size=4))
def test_any_table_is_read_or_refused(
    names: list[str], rows: list[list[str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    try:
        log = read(tmp_path_factory.getbasetemp(), ",".join(names), *map(",".join, rows))
    except InputError:
        return
    assert len(log.time_s) == len(log.place) > 0
    assert np.isfinite(log.place).all()
