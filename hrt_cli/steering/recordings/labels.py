"""hrt's own recordings: `labels.csv` with the columns image and yaw, and maybe others.

Those are pitch, session, goal_deg, and turn_costs_s: an odd number of costs in seconds, with spaces between them. Then
there may be other_goals_deg, as many in each row, and other_costs_s: as many costs for each of them.
"""

from __future__ import annotations

import math
from collections import Counter
from contextlib import suppress
from pathlib import Path

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.errors import InputError
from hrt_cli.steering.network.net import Output
from hrt_cli.steering.recordings.rows import (
    Below,
    Frame,
    Line,
    MalformedRowError,
    Recording,
    checked_angle,
    read_lines,
    real_number,
)

LABELS, ABOUT = "labels.csv", "recording.json"
_OTHERS = ("other_goals_deg", "other_costs_s")
_NEEDED, _OPTIONAL = ("image", "yaw"), ("pitch", "session", "goal_deg", "turn_costs_s", *_OTHERS)
_LONGEST_SESSION = 200
_FEWEST_TURNS = 3
_DEAREST_S = 1e6


def read_labels(folder: Path) -> Recording:
    """Read a folder with `labels.csv`; see `rows.Recording`.

    Raises
    ------
    InputError
        The file is empty, or its first line does not name the columns that it may have.
    """
    file = folder / LABELS
    header, *lines = read_lines(file)
    columns = _columns(file, header)
    outputs: tuple[Output, ...] = ("yaw", "pitch") if "pitch" in columns else ("yaw",)
    recording = Recording((file,), outputs, "goal_deg" in columns)
    recording.hfov_deg = _hfov_deg(folder / ABOUT)
    if "turn_costs_s" in columns:
        recording.turns = _count(lines, columns.index("turn_costs_s"))
        if _OTHERS[0] in columns:
            recording.other_goals = _count(lines, columns.index(_OTHERS[0]))
    below = Below(folder)
    for line in lines:
        with recording.row(file, line.row):
            recording.frames.append(_frame(line, columns, recording, below))
    return recording


def _hfov_deg(path: Path) -> float | None:
    """Return the field of view that a recording of hrt tells."""
    if not path.is_file():
        return None
    about = parse_strict(path, read_text(path))
    if not isinstance(about, dict) or about.get("format") != "hrt-recording":
        return None
    lens = about.get("lens")
    hfov = lens.get("hfov_deg") if isinstance(lens, dict) else None
    if isinstance(hfov, bool) or not isinstance(hfov, int | float) or not 0.0 < hfov < 180.0:
        raise InputError(path, f"its lens.hfov_deg is {hfov!r}, and must be an angle between 0 and 180")
    return float(hfov)


def _columns(file: Path, header: Line) -> list[str]:
    try:
        columns = header.cells()
    except MalformedRowError as error:
        raise InputError(file, f"its first line {error}") from error
    lacking = [name for name in _NEEDED if name not in columns]
    if lacking:
        raise InputError(file, f"has no column {lacking[0]} (its first line must name image, yaw, ...)")
    unknown = [name for name in columns if name not in (*_NEEDED, *_OPTIONAL)]
    if unknown:
        known = ", ".join((*_NEEDED, *_OPTIONAL))
        raise InputError(file, f"has the unknown column {unknown[0][:40]!r} (known: {known})")
    if len(set(columns)) != len(columns):
        raise InputError(file, "names a column twice")
    if set(_OTHERS) & set(columns) and not {*_OTHERS, "goal_deg", "turn_costs_s"} <= set(columns):
        raise InputError(
            file, f"needs all of goal_deg, turn_costs_s, {_OTHERS[0]} and {_OTHERS[1]}, or none of the last two"
        )
    return columns


def _frame(line: Line, columns: list[str], recording: Recording, below: Below) -> Frame:
    cells = line.cells()
    if len(cells) != len(columns):
        raise MalformedRowError(f"has {len(cells)} fields, and the first line names {len(columns)}")
    values = dict(zip(columns, cells, strict=True))
    steering = tuple(checked_angle(name, real_number(name, values[name])) for name in recording.outputs)
    session = values.get("session", "")
    if "session" in values and not 0 < len(session) <= _LONGEST_SESSION:
        raise MalformedRowError("names no session" if not session else "has too long a name of the session")
    goal_rad = None
    if recording.has_goal:
        goal_rad = _bearing("goal_deg", values["goal_deg"])
    costs = _costs(values["turn_costs_s"], recording.turns) if recording.turns else None
    others = _others(values, recording) if recording.other_goals else ((), ())
    path, real = below.find(values["image"])
    return Frame(path, real, steering, session, line.number, recording.files[0], line.row, goal_rad, costs, *others)


def _bearing(name: str, text: str) -> float:
    goal_deg = real_number(name, text)
    if abs(goal_deg) > 180.0:
        raise MalformedRowError(f"{name} is {goal_deg:g}, outside [-180, 180]")
    return math.radians(goal_deg)


def _others(values: dict[str, str], recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the bearings of other goals and what each turn costs on the way to each."""
    goals = tuple(_bearing(_OTHERS[0], each) for each in values[_OTHERS[0]].split())
    costs = values[_OTHERS[1]].split()
    if len(goals) != recording.other_goals or len(costs) != len(goals) * recording.turns:
        raise MalformedRowError(
            f"has {len(goals)} {_OTHERS[0]} and {len(costs)} {_OTHERS[1]}, and each row must have as many goals "
            f"and {recording.turns} costs for each"
        )
    return goals, tuple(_cost(_OTHERS[1], each) for each in costs)


def _count(lines: list[Line], column: int) -> int:
    """Return how many numbers most rows have in a column."""
    counts: Counter[int] = Counter()
    for line in lines:
        with suppress(MalformedRowError, IndexError):  # such rows are told of when they are read
            counts[len(line.cells()[column].split())] += 1
    return counts.most_common(1)[0][0] if counts else 0


def _costs(text: str, turns: int) -> tuple[float, ...]:
    costs = tuple(_cost("turn_costs_s", each) for each in text.split())
    if len(costs) != turns or turns < _FEWEST_TURNS or turns % 2 == 0:
        raise MalformedRowError(
            f"turn_costs_s has {len(costs)} costs, and must have an odd number, in each row as many"
        )
    return costs


def _cost(name: str, text: str) -> float:
    cost = real_number(name, text)
    if not 0.0 <= cost <= _DEAREST_S:
        raise MalformedRowError(f"{name} has a cost outside [0, {_DEAREST_S:g}]")
    return cost
