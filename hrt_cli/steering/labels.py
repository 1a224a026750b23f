"""hrt's own recordings: `labels.csv` with the columns image and yaw, and maybe others.

Those are pitch, session, goal_deg, and turn_costs_s: an odd number of costs in seconds, with spaces between them.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

from hrt_cli.errors import InputError
from hrt_cli.steering.network import Output
from hrt_cli.steering.rows import (
    Below,
    Frame,
    Line,
    MalformedRowError,
    Recording,
    checked_angle,
    read_lines,
    real_number,
)

LABELS = "labels.csv"
_NEEDED, _OPTIONAL = ("image", "yaw"), ("pitch", "session", "goal_deg", "turn_costs_s")
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
    if "turn_costs_s" in columns:
        recording.turns = _count_turns(lines, columns.index("turn_costs_s"))
    below = Below(folder)
    for line in lines:
        with recording.row(file, line.row):
            recording.frames.append(_frame(line, columns, recording, below))
    return recording


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
        goal_deg = real_number("goal_deg", values["goal_deg"])
        if abs(goal_deg) > 180.0:
            raise MalformedRowError(f"goal_deg is {goal_deg:g}, outside [-180, 180]")
        goal_rad = math.radians(goal_deg)
    costs = _costs(values["turn_costs_s"], recording.turns) if recording.turns else None
    path, real = below.find(values["image"])
    return Frame(path, real, steering, session, line.number, recording.files[0], line.row, goal_rad, costs)


def _count_turns(lines: list[Line], column: int) -> int:
    """Return how many costs most rows have."""
    counts = Counter(len(line.text.split(",")[column].split()) for line in lines if line.text.count(",") >= column)
    return counts.most_common(1)[0][0] if counts else 0


def _costs(text: str, turns: int) -> tuple[float, ...]:
    costs = tuple(real_number("turn_costs_s", each) for each in text.split())
    if len(costs) != turns or turns < _FEWEST_TURNS or turns % 2 == 0:
        raise MalformedRowError(
            f"turn_costs_s has {len(costs)} costs, and must have an odd number, in each row as many"
        )
    if min(costs) < 0.0 or max(costs) > _DEAREST_S:
        raise MalformedRowError(f"turn_costs_s has a cost outside [0, {_DEAREST_S:g}]")
    return costs
