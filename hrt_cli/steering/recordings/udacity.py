"""Recordings of Udacity's simulator: `driving_log.csv` and `IMG/` with a left, a centre and a right camera.

The steering is in [-1, 1] (of 25 degrees), right positive, as ours.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath, PureWindowsPath

from hrt_cli.errors import InputError
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

DRIVING_LOG = "driving_log.csv"
_COLUMNS = ["center", "left", "right", "steering", "throttle", "brake", "speed"]


def read_udacity(folder: Path, correction: float) -> Recording:
    """Read a recording of Udacity's simulator; see `rows.Recording`.

    Absolute paths are those of the machine that recorded: the picture is looked for in `IMG/` by its name.

    Parameters
    ----------
    correction : float
        By how much more to the right the left camera has to steer, and the right one to the left, so that the car
        comes back to the middle (Bojarski et al. 2016, arXiv:1604.07316); clipped to [-1, 1].

    Raises
    ------
    InputError
        The file is empty, or its first line names other columns.
    """
    file = folder / DRIVING_LOG
    lines = read_lines(file)
    columns = _COLUMNS
    try:
        first = lines[0].cells()
    except MalformedRowError:
        first = []
    if "steering" in first:
        if sorted(first) != sorted(_COLUMNS):
            raise InputError(file, f"its first line names other columns than {','.join(_COLUMNS)}")
        columns, lines = first, lines[1:]
    recording = Recording((file,))
    below = Below(folder)
    for line in lines:
        with recording.row(file, line.row):
            recording.frames.extend(_frames(file, line, columns, below, correction))
    return recording


def _frames(file: Path, line: Line, columns: list[str], below: Below, correction: float) -> list[Frame]:
    cells = line.cells()
    if len(cells) != len(columns):
        raise MalformedRowError(f"has {len(cells)} fields, not {len(columns)}")
    values = dict(zip(columns, cells, strict=True))
    steering = checked_angle("steering", real_number("steering", values["steering"]))
    frames = []
    for camera, change in (("center", 0.0), ("left", correction), ("right", -correction)):
        if camera != "center" and not values[camera]:
            continue
        path, real = below.find(_local(values[camera]))
        angle = min(1.0, max(-1.0, steering + change))
        frames.append(Frame(path, real, (angle,), "", line.number, file, line.row))
    if len({frame.real for frame in frames}) != len(frames):
        raise MalformedRowError("names one image for two cameras")
    return frames


def _local(name: str) -> str:
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive:
        return "IMG/" + re.split(r"[/\\]", name)[-1]
    return name.replace("\\", "/")
