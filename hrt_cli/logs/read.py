"""The one door to drive logs: a file or folder of any kind in, a `DriveLog` out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hrt_cli.artifacts.drivelog import MAX_BYTES, DriveLog
from hrt_cli.artifacts.jsonio import read_text
from hrt_cli.errors import InputError
from hrt_cli.logs.ardupilot import read_ardupilot
from hrt_cli.logs.gpx import read_gpx
from hrt_cli.logs.kinds import DATAFLASH, GPX, LINES, TABLE, Kind, kind_of
from hrt_cli.logs.lines import read_lines
from hrt_cli.logs.ros import read_ros
from hrt_cli.logs.table import read_table

_TEXTS: dict[Kind, Callable[[Path, str], DriveLog]] = {TABLE: read_table, GPX: read_gpx}


def read_drive_log(path: Path, *, as_it_stands: bool = False) -> DriveLog:
    """Read a drive log of any kind (`kinds`). One of ours with provenance is checked against it.

    Read `as_it_stands` it is not, for what only tells of it.

    Raises
    ------
    InputError
        The file is no log, is cut off or damaged, time goes backwards, a record has no place, or a package that reads
        its kind is not installed.
    """
    kind = kind_of(path)
    if kind == LINES:
        return read_lines(path, _text(path, kind), as_it_stands=as_it_stands)
    if kind in _TEXTS:
        return _TEXTS[kind](path, _text(path, kind))
    return read_ardupilot(path) if kind == DATAFLASH else read_ros(path, kind)


def _text(path: Path, kind: Kind) -> str:
    text = read_text(path, MAX_BYTES)
    if not text.strip():
        raise InputError(path, "is empty")
    if kind != GPX and not text.endswith("\n"):
        # A number cut in its digits still reads as a number: the missing end of line is the only sign.
        raise InputError(path, "ends within a line: the log was cut off", "drop its last line if that is all")
    return text


def log_notes(path: Path, log: DriveLog) -> list[str]:
    """Return what was chosen, dropped or taken for granted in reading a log, each naming the file."""
    return [f"{path}: {note}" for note in log.notes]
