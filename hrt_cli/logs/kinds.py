"""What kind of drive log a file is: as its name says, if it begins as files of that kind do."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.provenance import file_sha256
from hrt_cli.errors import InputError


@dataclass(frozen=True)
class Kind:
    """A kind of drive log.

    Attributes
    ----------
    name : str
        As `hrt inspect --json` tells it.
    title : str
        As messages tell it.
    suffixes : tuple of str
        How names of such files end; none where the log is a folder.
    begins : bytes
        How such files begin; nothing where that is not fixed.
    version : int
        Raised when the reader makes something else of the same bytes: stages compute anew then.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    begins: bytes = b""
    version: int = 1


LINES = Kind("jsonl", "a drive log of JSON lines", (".jsonl",))
TABLE = Kind("csv", "a table", (".csv", ".tsv"), version=2)
GPX = Kind("gpx", "a GPX", (".gpx",))
BAG = Kind("rosbag1", "a ROS 1 bag", (".bag",), b"#ROSBAG V")
MCAP = Kind("mcap", "an MCAP file", (".mcap",), b"\x89MCAP0\r\n")
SQLITE = Kind("rosbag2-sqlite3", "an SQLite file of a ROS 2 bag", (".db3",), b"SQLite format 3\0")
FOLDER = Kind("rosbag2", "a ROS 2 bag", ())
DATAFLASH = Kind("dataflash", "an ArduPilot DataFlash log", (".bin",), b"\xa3\x95")

_FILES = (LINES, TABLE, GPX, BAG, MCAP, SQLITE, DATAFLASH)
_LONGEST = max(len(kind.begins) for kind in _FILES)
_METADATA = "metadata.yaml"


def is_log(path: Path) -> bool:
    """Whether a file or folder is meant to be a drive log, by its name and its first bytes; it may be a broken one."""
    if path.is_dir():
        # A bag that lost its metadata holds nothing but data; a project's folder may hold a bag among other things.
        files = [each for each in _inside(path) if not each.name.startswith(".")]
        data = bool(files) and all(each.suffix in (".db3", ".mcap") for each in files)
        return data or any(each.name == _METADATA for each in files)
    if _named(path) is not None:
        return True
    found = _begun(path)
    # SQLite files are of many kinds, and two bytes tell little.
    return found is not None and found not in (SQLITE, DATAFLASH)


def kind_of(path: Path) -> Kind:
    """Return what kind of log a file or folder is; a name that says nothing is taken to be that of JSON lines.

    Raises
    ------
    InputError
        There is nothing there, a folder is no bag, or a file begins otherwise than its name says.
    """
    if path.is_dir():
        if not (path / _METADATA).is_file():
            remedy = "`ros2 bag reindex` writes it; or give its .mcap or .db3 file itself"
            raise InputError(path, f"is a folder without {_METADATA}: no ROS 2 bag", remedy)
        return FOLDER
    if not path.is_file():
        raise InputError(path, "no such file")
    kind, found = _named(path) or LINES, _begun(path)
    if kind.begins and path.stat().st_size == 0:
        raise InputError(path, "is empty")
    if found is not None and found != kind:
        raise InputError(
            path, f"begins as {found.title} does, but is not named so", f"name it .{found.suffixes[0][1:]}"
        )
    if kind.begins and found is None:
        raise InputError(path, f"is not {kind.title}: it does not begin as one does")
    return kind


def files_of(role: str, path: Path) -> dict[str, Path]:
    """Return the files of a log by their roles, for the provenance: itself, or those in the folder of a bag."""
    if not path.is_dir():
        return {role: path}
    return {f"{role}/{each.name}": each for each in _inside(path) if each.is_file()}


def log_sha256(path: Path) -> str:
    """Hash what was logged: the bytes of the file, or of the data files of a bag's folder.

    A bag of one data file is the same drive as that file by itself.

    Raises
    ------
    InputError
        There is nothing there, or it cannot be read.
    """
    hashes = [file_sha256(each) for each in files_of("", path).values() if each == path or each.name != _METADATA]
    return hashes[0] if len(hashes) == 1 else hashlib.sha256("".join(hashes).encode()).hexdigest()


def reading(paths: Iterable[Path]) -> dict[str, Any]:
    """Return what the parameters of a stage tell of how its logs are read: versions of readers, but for the first."""
    kinds = {_named(path) for path in paths} - {None}
    versions = {kind.name: kind.version for kind in kinds if kind is not None and kind.version > 1}
    return {"log_readers": dict(sorted(versions.items()))} if versions else {}


def _inside(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(folder, f"cannot be read: {error.strerror or error}") from error


def _named(path: Path) -> Kind | None:
    return next((kind for kind in _FILES if path.suffix.lower() in kind.suffixes), None)


def _begun(path: Path) -> Kind | None:
    try:
        with open(path, "rb") as file:
            start = file.read(_LONGEST)
    except OSError:
        return None
    return next((kind for kind in _FILES if kind.begins and start.startswith(kind.begins)), None)
