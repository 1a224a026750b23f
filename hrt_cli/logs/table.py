"""A table with named columns (CSV, or with `;` or tabs) as a drive log.

Columns are known by their names (`_NAMES`), whatever the case, with `Speed (m/s)` read as `speed_m_s`. The tool's own
names, those of `Record`, come first: other columns that tell the same are passed over beside them. What is passed over
or taken for granted is told in notes.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from hrt_cli.artifacts.drivelog import DriveLog, Record, line_model
from hrt_cli.errors import InputError
from hrt_cli.logs.assemble import NO_HEADER, log_of_records

_OWN = tuple(Record.model_fields)
_KM_H, _KNOT, _RADIAN = 1 / 3.6, 1852 / 3600, 180 / math.pi
_NAMES: dict[str, dict[str, float]] = {
    "t": {"time": 1, "timestamp": 1, "datetime": 1, "time_s": 1, "timestamp_s": 1}
    | {f"{name}_{unit}": factor for name in ("t", "time", "timestamp")
       for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))},
    "lon": dict.fromkeys(("lng", "long", "longitude", "lon_deg", "longitude_deg"), 1),
    "lat": dict.fromkeys(("latitude", "lat_deg", "latitude_deg"), 1),
    "x": dict.fromkeys(("easting", "x_m", "easting_m"), 1),
    "y": dict.fromkeys(("northing", "y_m", "northing_m"), 1),
    "speed_m_s": {"speed": 1, "v": 1, "speed_mps": 1, "speed_kmh": _KM_H, "speed_km_h": _KM_H, "speed_kph": _KM_H,
                  "speed_kn": _KNOT, "speed_knots": _KNOT},
    "commanded_m_s": {f"{name}{unit}": 1 for unit in ("", "_m_s", "_mps") for name in (
        "commanded", "commanded_speed", "cmd_speed", "cmd_vel", "cmd_v", "desired_speed", "target_speed")},
    "heading_deg": {"course_deg": 1, "cog_deg": 1, "heading_rad": _RADIAN, "course_rad": _RADIAN},
    "pitch_deg": {"pitch_rad": _RADIAN},
    "roll_deg": {"roll_rad": _RADIAN},
}  # fmt: skip
"""Names besides ours by what they tell, each with what its values are multiplied by."""
_NO_UNIT = re.compile(r"(speed|v|commanded|(commanded|cmd|desired|target)_(speed|vel|v))")
"""Names of speeds, taken to be in m/s, that do not tell their unit."""
_VAGUE = re.compile(r"(heading|course|cog|bearing|pitch|roll|depth)|yaw.*")
"""Names of what would count if its unit, and the sense of a yaw, were known."""
_STATUS = "status"
"""NavSatStatus of ROS: less than 0 where the receiver had no fix."""
_MOST_S = 1e11
"""A time beyond this (the year 5138) is not in seconds."""
_SEPARATORS = ",;\t"


@dataclass(frozen=True)
class _Column:
    """A column that is read: what it tells, its name in the file, and what its values are multiplied by."""

    field: str
    name: str
    factor: float

    @property
    def own(self) -> bool:
        """Whether the column has our name, and so our meaning to the letter."""
        return self.name == self.field


def read_table(path: Path, text: str) -> DriveLog:
    """Return the rows of a table as a drive log; rows of a receiver without a fix are dropped.

    Raises
    ------
    InputError
        Time or place are told by no column or by several, or a row is no record.
    """
    separator = max(_SEPARATORS, key=text.split("\n", 1)[0].count)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator)
    try:
        names = [name.strip() for name in reader.fieldnames or []]
        columns, notes = _columns(path, names)
        status = next((name for name in names if _plain(name) == _STATUS), None)
        rows = _Rows(path, columns, status)
        records = list(rows.records(reader))
    except csv.Error as error:
        raise InputError(path, f"line {reader.line_num}: {error}") from error
    if rows.dropped and not records:
        raise InputError(path, f"has no fix in any of its {rows.dropped} rows")
    return log_of_records(path, NO_HEADER, records, notes=[*notes, *rows.notes()])


def _columns(path: Path, names: list[str]) -> tuple[list[_Column], list[str]]:
    """Return the columns to read, and what the user ought to know of the others."""
    if len(set(names)) != len(names):
        raise InputError(path, "names a column twice")
    found: dict[str, list[_Column]] = {}
    for name in names:
        for column in _meanings(name):
            found.setdefault(column.field, []).append(column)
    chosen = {field: _one(path, columns) for field, columns in found.items()}
    if "t" not in chosen:
        remedy = "name that of the seconds, or ISO 8601 times, t or time"
        raise InputError(path, f"has no column t (it has: {', '.join(names) or 'none'})", remedy)
    _drop_second_place(path, chosen)
    read = list(chosen.values())
    used = {column.name for column in read}
    left = [name for name in names if name and name not in used and _plain(name) != _STATUS]
    notes = []
    if bare := [c.name for c in read if not c.own and _NO_UNIT.fullmatch(_plain(c.name))]:
        notes.append(f"takes {' and '.join(bare)} to be in m/s")
    if angles := [c.name for c in read if not c.own and c.field in ("pitch_deg", "roll_deg")]:
        notes.append(f"takes {' and '.join(angles)} to count up with the nose up and the right side down")
    if vague := [name for name in left if _VAGUE.fullmatch(_plain(name))]:
        notes.append(f"passes over {', '.join(vague)}: in what unit, or from where, it counts is not known")
    if rest := [name for name in left if name not in vague]:
        notes.append(f"passes over the columns {', '.join(rest)}")
    return read, notes


def _meanings(name: str) -> Iterator[_Column]:
    plain = _plain(name)
    if name in _OWN or plain in _OWN:
        yield _Column(name if name in _OWN else plain, name, 1.0)
    else:
        yield from (_Column(field, name, names[plain]) for field, names in _NAMES.items() if plain in names)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _one(path: Path, columns: list[_Column]) -> _Column:
    own = [column for column in columns if column.own]
    if len(columns) > 1 and not own:
        both = " and ".join(column.name for column in columns)
        raise InputError(path, f"{both} tell the same: which one is meant is not known", "leave one, or rename it")
    return (own or columns)[0]


def _drop_second_place(path: Path, chosen: dict[str, _Column]) -> None:
    """Keep one of two pairs of columns that both tell the place: that of our own names."""
    globe, plane = ({"lon", "lat"} & set(chosen), {"x", "y"} & set(chosen))
    if not (globe and plane):
        return
    foreign = [pair for pair in (globe, plane) if not any(chosen[field].own for field in pair)]
    if len(foreign) != 1:
        names = ", ".join(chosen[field].name for field in ("lon", "lat", "x", "y") if field in chosen)
        raise InputError(path, f"tells places in more than one way ({names})", "leave lon and lat, or x and y")
    for field in foreign[0]:
        del chosen[field]


class _Rows:
    """The rows of a table, one after the other, and what was met on the way."""

    def __init__(self, path: Path, columns: list[_Column], status: str | None) -> None:
        self._path, self._columns, self._status = path, columns, status
        self._dates: bool | None = None
        self._no_zone = self._odd_status = False
        self._reversed: set[str] = set()
        self.dropped = 0

    def records(self, reader: csv.DictReader[str]) -> Iterator[Record]:
        for row in reader:
            if None in row:
                raise InputError(self._path, f"line {reader.line_num} has more fields than the first line names")
            values = {name.strip(): text for name, text in row.items() if name is not None and text}
            if self._has_fix(values):
                yield line_model(self._path, reader.line_num, Record, self._record(reader.line_num, values))

    def notes(self) -> list[str]:
        notes = []
        if self.dropped:
            notes.append(f"drops {self.dropped} rows in which the receiver had no fix")
        if self._odd_status:
            notes.append(f"passes over {self._status} where it is not a number")
        if self._reversed:
            notes.append(f"takes {' and '.join(sorted(self._reversed))} below 0 to be driven backwards, as fast")
        if self._no_zone:
            notes.append("takes times without a zone to be UTC")
        return notes

    def _has_fix(self, values: dict[str, str]) -> bool:
        status = _real(values.get(self._status or "", "0"))
        self._odd_status |= status is None
        place = [_real(values.get(c.name, "")) for c in self._columns if c.field in ("lon", "lat")]
        # Receivers write 0, 0 for what they do not know, a place in the sea south of Ghana.
        fix = (status is None or status >= 0) and place != [0, 0]
        self.dropped += not fix
        return fix

    def _record(self, line: int, values: dict[str, str]) -> dict[str, float | str]:
        record: dict[str, float | str] = {}
        for column in self._columns:
            text = values.get(column.name)
            if text is None:
                continue
            if column.field == "event":
                record["event"] = text
            elif column.field == "t":
                record["t"] = self._seconds(line, column, text)
            else:
                record[column.field] = self._measure(line, column, text)
        return record

    def _measure(self, line: int, column: _Column, text: str) -> float:
        value = _number(self._path, line, column.name, text)
        if value < 0 and not column.own and column.field in ("speed_m_s", "commanded_m_s"):
            self._reversed.add(column.name)
            value = -value
        return value if column.factor == 1 else value * column.factor

    def _seconds(self, line: int, column: _Column, text: str) -> float:
        """Return a time in seconds; all are numbers, or all dates and times of day, as the first one is."""
        if self._dates is None:
            self._dates = _real(text) is None
        if column.factor != 1 or not self._dates:
            value = _number(self._path, line, column.name, text) * column.factor
            if not column.own and abs(value) > _MOST_S:
                remedy = "name the column time_ms, time_us or time_ns"
                raise InputError(self._path, f"line {line}: {column.name} is {text.strip()}, not in seconds", remedy)
            return value
        try:
            return self._unix_seconds(text.strip())
        except (ValueError, OverflowError) as error:
            problem = f"line {line}: {column.name} is {text.strip()!r}, neither a finite number nor an ISO 8601 time"
            raise InputError(self._path, problem) from error

    def _unix_seconds(self, text: str) -> float:
        if _real(text) is not None:
            raise ValueError("a number among dates")
        time = datetime.fromisoformat(text)
        if time.tzinfo is None:
            self._no_zone = True
            time = time.replace(tzinfo=UTC)
        return time.timestamp()


def _real(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _number(path: Path, line: int, name: str, text: str) -> float:
    value = _real(text)
    if value is None or not math.isfinite(value):
        raise InputError(path, f"line {line}: {name} is {text.strip()!r}, not a finite number")
    return value
