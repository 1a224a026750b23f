"""DroNet's recordings (Loquercio et al. 2018, github.com/uzh-rpg/rpg_public_dronet): `images/`, `sync_steering.txt`.

The n-th row belongs to the n-th picture, by the first number in its name (its utils.py). The first column is the angle
of the steering wheel in radians, left positive: its controller sends it on as a ROS yaw rate, clipped to [-1, 1]
(deep_navigation.cpp). So our yaw is minus that, clipped alike.
"""

from __future__ import annotations

import re
from pathlib import Path

from hrt_cli.errors import InputError
from hrt_cli.progress import Note
from hrt_cli.steering.recordings.rows import Below, Frame, Line, MalformedRowError, Recording, read_lines, real_number

STEERING, COLLISIONS = "sync_steering.txt", "labels.txt"
_ENDINGS = {".jpg", ".jpeg", ".png"}
_MOST_RAD = 15.0
"""More than two turns to one side: then the angles are degrees."""


def read_dronet(folder: Path, note: Note) -> Recording:
    """Read a folder with `sync_steering.txt`; see `rows.Recording`.

    Raises
    ------
    InputError
        The first line is no header that begins with the angle, or rows and pictures cannot be matched.
    """
    file = folder / STEERING
    header, *lines = read_lines(file)
    columns = [name.strip().lower() for name in header.text.lstrip("# ").split(",")]
    if not re.search("angle|steer", columns[0]):
        raise InputError(file, "its first line is no header with the steering angle as the first column")
    images = _images(folder)
    if len(images) != len(lines):
        raise InputError(file, f"has {len(lines)} rows for {len(images)} images, so that they cannot be matched")
    recording = Recording((file,))
    below = Below(folder)
    clipped = 0
    for line, image in zip(lines, images, strict=True):
        with recording.row(file, line.row):
            yaw = 0.0 - _angle(line, len(columns))  # 0 - 0 is no negative zero
            clipped += abs(yaw) > 1.0
            path, real = below.find(f"images/{image}")
            label = min(1.0, max(-1.0, yaw))
            recording.frames.append(Frame(path, real, (label,), "", line.number, file, line.row))
    if clipped:
        note(f"Note: {file}: {clipped} of {len(lines)} angles are beyond 1 rad and taken as 1, as DroNet does")
    return recording


def _images(folder: Path) -> list[str]:
    try:
        names = [each.name for each in (folder / "images").iterdir() if not each.name.startswith(".")]
    except OSError as error:
        raise InputError(folder / "images", f"cannot be read: {error.strerror}") from error
    numbered: dict[int, str] = {}
    for name in sorted(names):
        number = re.search("[0-9]+", name)
        if number is None or Path(name).suffix.lower() not in _ENDINGS:
            raise InputError(folder / "images" / name, "is not a numbered .jpg or .png, so that rows cannot be matched")
        if int(number[0]) in numbered:
            other = numbered[int(number[0])]
            raise InputError(
                folder / "images" / name, f"has the same number as {other}, so that rows cannot be matched"
            )
        numbered[int(number[0])] = name
    return [numbered[number] for number in sorted(numbered)]


def _angle(line: Line, columns: int) -> float:
    cells = line.cells()
    if len(cells) != columns:
        raise MalformedRowError(f"has {len(cells)} fields, and the first line names {columns}")
    angle_rad = real_number("the angle", cells[0])
    if abs(angle_rad) > _MOST_RAD:
        raise MalformedRowError(f"the angle is {angle_rad:g}; no steering wheel turns that far in radians")
    return angle_rad
