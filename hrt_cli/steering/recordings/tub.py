"""Donkeycar's tub v2: `manifest.json`, catalogs of JSON lines, and `images/`.

The format is that of donkeycar/parts/datastore_v2.py and tub_v2.py. `user/angle` is in [-1, 1], right positive as
ours is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hrt_cli.artifacts.jsonio import parse_strict
from hrt_cli.errors import InputError
from hrt_cli.progress import Note
from hrt_cli.steering.recordings.rows import Below, Frame, Line, MalformedRowError, Recording, checked_angle, read_lines

MANIFEST = "manifest.json"
_IMAGE, _ANGLE, _MODE = "cam/image_array", "user/angle", "user/mode"
_MANIFEST_LINES = 5


def read_tub(folder: Path, note: Note) -> Recording:
    """Read a tub; see `rows.Recording`.

    Records that the manifest marks as deleted are left out, and so are those that the car drove by itself: there
    `user/angle` is an idle joystick.

    Raises
    ------
    InputError
        The manifest or a catalog is absent or damaged, or it cannot be told which records are deleted.
    """
    manifest = folder / MANIFEST
    catalogs, deleted, count = _read_manifest(folder, manifest)
    recording = Recording((manifest, *catalogs))
    below = Below(folder / "images")
    position, driven = 0, 0
    for catalog in catalogs:
        for line in read_lines(catalog, may_be_empty=True):
            with recording.row(catalog, line.row):
                record = _record(catalog, line)
                index = _integer(record, "_index")
                if deleted and index != position:
                    problem = (
                        f"{line.row}: is record {position}, but numbered {index}: which are deleted cannot be told"
                    )
                    raise InputError(catalog, problem)
                if record.get(_MODE, "user") != "user":
                    driven += 1
                elif index not in deleted:
                    recording.frames.append(_frame(record, index, (catalog, line.row), below))
            position += 1
    if position < count:
        note(f"Warning: {manifest}: speaks of {count} records, and there are {position}")
    if driven:
        note(f"Note: {folder}: {driven} records that the car drove by itself are left out")
    _check_numbers(recording)
    recording.frames.sort(key=lambda frame: frame.moment)
    return recording


def _read_manifest(folder: Path, manifest: Path) -> tuple[list[Path], set[int], int]:
    """Return the catalogs, the numbers of the deleted records, and how many records there have been."""
    lines = read_lines(manifest)
    if len(lines) != _MANIFEST_LINES:
        raise InputError(manifest, f"is not that of a Donkeycar tub v2: it has {len(lines)} lines, not five")
    state = parse_strict(manifest, lines[-1].text)
    if not isinstance(state, dict):
        raise InputError(manifest, "is not that of a Donkeycar tub v2: its last line is no JSON object")
    paths, deleted, count = state.get("paths"), state.get("deleted_indexes"), state.get("current_index")
    if not isinstance(paths, list) or not paths or not all(isinstance(each, str) for each in paths):
        raise InputError(manifest, "is not that of a Donkeycar tub v2: it names no catalogs")
    if not isinstance(deleted, list) or not all(type(each) is int for each in deleted) or type(count) is not int:
        raise InputError(manifest, "is damaged: deleted_indexes or current_index are not whole numbers")
    below = Below(folder)
    try:
        catalogs = [below.find(name)[0] for name in paths]
    except MalformedRowError as error:
        raise InputError(manifest, f"a catalog cannot be used: {error}".replace("the image ", "")) from error
    if len(set(catalogs)) != len(catalogs):
        raise InputError(manifest, "names a catalog twice")
    return catalogs, set(deleted), count


def _record(catalog: Path, line: Line) -> dict[str, Any]:
    # No check of the end of line: an object is whole once its brace is closed.
    try:
        record = parse_strict(catalog, line.text)
    except InputError as error:
        raise MalformedRowError(error.problem) from error
    if not isinstance(record, dict):
        raise MalformedRowError("is no JSON object")
    return record


def _integer(record: dict[str, Any], key: str) -> int:
    value = record.get(key)
    if type(value) is not int or not 0 <= value < 2**31:
        raise MalformedRowError(f"{key} is {value!r:.40}, not a whole number")
    return value


def _frame(record: dict[str, Any], index: int, place: tuple[Path, str], below: Below) -> Frame:
    angle, name, session = record.get(_ANGLE), record.get(_IMAGE), record.get("_session_id", "")
    if isinstance(angle, bool) or not isinstance(angle, int | float):
        raise MalformedRowError(f"{_ANGLE} is {angle!r:.40}, not a number")
    if not isinstance(name, str) or not isinstance(session, str):
        raise MalformedRowError(f"{_IMAGE} or _session_id is no text")
    path, real = below.find(name)
    return Frame(path, real, (checked_angle(_ANGLE, float(angle)),), session, index, *place)


def _check_numbers(recording: Recording) -> None:
    seen: set[int] = set()
    for frame in recording.frames:
        if frame.moment in seen:
            raise InputError(recording.files[0], f"two records are numbered {frame.moment}")
        seen.add(frame.moment)
