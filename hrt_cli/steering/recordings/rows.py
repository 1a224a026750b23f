"""Rows of label files: each is a frame or it is malformed, and nothing is guessed."""

from __future__ import annotations

import csv
import math
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath

from hrt_cli.artifacts.jsonio import read_text
from hrt_cli.errors import InputError
from hrt_cli.steering.network.net import Output

JITTER = 1e-4
"""By how much a label may lie beyond -1 or 1: joysticks are read as n / 32767, and the lowest n is -32768."""
_LONGEST_LINE = 10_000
_LONGEST_NAME = 1_000


class MalformedRowError(ValueError):
    """Says what is wrong with a row; it never leaves the readers."""


@dataclass(frozen=True)
class Frame:
    """One picture and its labels.

    Attributes
    ----------
    path, real : Path, str
        The picture as the folder names it, and where it lies once links are followed.
    steering : floats
        Of each output, in [-1, 1].
    session : str
        Its name in its folder; '' where the folder knows of no sessions.
    moment : int
        Number of the moment in the recording: cameras that looked at the same time share it.
    file, row : Path, str
        Where its labels stand.
    goal_rad : float, optional
        Bearing of the goal, right positive.
    turn_costs_s : tuple of floats, optional
        What turning by each of as many evenly spaced angles from -1 to 1 costs.
    other_goals_rad, other_costs_s : tuples of floats
        Bearings of other goals, and what each turn would cost on the way to each of them, goal by goal.
    """

    path: Path
    real: str
    steering: tuple[float, ...]
    session: str
    moment: int
    file: Path
    row: str
    goal_rad: float | None = None
    turn_costs_s: tuple[float, ...] | None = None
    other_goals_rad: tuple[float, ...] = ()
    other_costs_s: tuple[float, ...] = ()


class Recording:
    """What one folder holds, filled by its reader.

    Attributes
    ----------
    files : tuple of Path
        The label files.
    outputs : ('yaw',) or ('yaw', 'pitch')
    has_goal : bool
    turns : int
        How many angles the costs of turning are known for; 0 where they are not.
    other_goals : int
        For how many other goals they are known.
    hfov_deg : float, optional
        Of the lens, where the recording tells it.
    frames : list of Frame
        In the order in which they were taken.
    malformed : list of (Path, str)
        File and problem of each row that is no frame.
    """

    def __init__(self, files: tuple[Path, ...], outputs: tuple[Output, ...] = ("yaw",), has_goal: bool = False) -> None:
        self.files, self.outputs, self.has_goal = files, outputs, has_goal
        self.turns = self.other_goals = 0
        self.hfov_deg: float | None = None
        self.frames: list[Frame] = []
        self.malformed: list[tuple[Path, str]] = []

    @contextmanager
    def row(self, file: Path, row: str) -> Iterator[None]:
        """Note the row as malformed where a `MalformedRowError` comes out of the block."""
        try:
            yield
        except MalformedRowError as error:
            self.malformed.append((file, f"{row}: {error}"))

    def drop_doubles(self) -> None:
        """Take out every frame whose picture is named twice: which of its rows is right cannot be told."""
        count = Counter(frame.real for frame in self.frames)
        for frame in self.frames:
            if count[frame.real] > 1:
                problem = f"{frame.row}: names the image {frame.path.name}, which {count[frame.real]} rows name"
                self.malformed.append((frame.file, problem))
        self.frames = [frame for frame in self.frames if count[frame.real] == 1]


class Below:
    """Finds files below a folder, and nothing outside it.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._real = os.path.realpath(folder).rstrip(os.sep) + os.sep
        self._parents: dict[Path, str] = {}

    def find(self, name: str) -> tuple[Path, str]:
        """Return the path of a file and where it lies once links are followed; the file need not be there.

        Raises
        ------
        MalformedRowError
            The name is absolute or empty, or leads out of the folder, be it through a link.
        """
        if not name or "\0" in name or len(name) > _LONGEST_NAME:
            raise MalformedRowError("names no image")
        if PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or name.startswith("\\"):
            raise MalformedRowError(f"the image {name!r} is an absolute path, and must be one below the folder")
        path = self.folder / name
        if ".." in path.parts or path.is_symlink():
            real = os.path.realpath(path)
        else:
            if path.parent not in self._parents:
                self._parents[path.parent] = os.path.realpath(path.parent)
            real = os.path.join(self._parents[path.parent], path.name)
        if not real.startswith(self._real):
            raise MalformedRowError(f"the image {name!r} lies outside the folder")
        return path, real


@dataclass(frozen=True)
class Line:
    """One line of a text file; `whole` says whether it has its end of line."""

    number: int
    text: str
    whole: bool

    @property
    def row(self) -> str:
        """How messages call it."""
        return f"line {self.number}"

    def cells(self) -> list[str]:
        """Return its comma-separated fields, white space around them removed.

        Raises
        ------
        MalformedRowError
            It has no end of line (then its last number may be cut), is too long, or has a quote that is not closed.
        """
        if not self.whole:
            raise MalformedRowError("has no end of line, so it may be cut short")
        if len(self.text) > _LONGEST_LINE:
            raise MalformedRowError(f"is longer than {_LONGEST_LINE} characters")
        try:
            return [cell.strip() for cell in next(csv.reader([self.text], strict=True, skipinitialspace=True))]
        except csv.Error as error:
            raise MalformedRowError(f"is not CSV ({error})") from error


def read_lines(path: Path, *, may_be_empty: bool = False) -> list[Line]:
    """Return the lines of a UTF-8 file that are not blank; with or without a byte-order mark, any end of line.

    Raises
    ------
    InputError
        The file is absent, too large, not text, or empty where it may not be.
    """
    *whole, last = read_text(path).split("\n")
    lines = [Line(number, text, True) for number, text in enumerate(whole, start=1) if text.strip()]
    if last.strip():
        lines.append(Line(len(whole) + 1, last, False))
    if not lines and not may_be_empty:
        raise InputError(path, "is empty")
    return lines


def real_number(name: str, text: str) -> float:
    """Return a finite number written in plain decimal notation, else raise `MalformedRowError`."""
    try:
        # `float` also takes 1_000 and the digits of other scripts.
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise MalformedRowError(f"{name} is {text[:40]!r}, not a finite number")
    return value


def checked_angle(name: str, value: float) -> float:
    """Return a steering angle in [-1, 1], else raise `MalformedRowError`; `JITTER` beyond is clipped."""
    if not abs(value) <= 1.0 + JITTER:
        raise MalformedRowError(f"{name} is {value:g}, outside [-1, 1]")
    return min(1.0, max(-1.0, value))
