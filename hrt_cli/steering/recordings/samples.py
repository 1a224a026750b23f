"""What a network learns from: pictures with steering, from folders of several kinds."""

from __future__ import annotations

import os
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Note, unheard
from hrt_cli.steering.network.angles import nearest_class
from hrt_cli.steering.network.net import Output
from hrt_cli.steering.recordings.dronet import COLLISIONS, STEERING, read_dronet
from hrt_cli.steering.recordings.labels import LABELS, read_labels
from hrt_cli.steering.recordings.rows import Recording
from hrt_cli.steering.recordings.tub import MANIFEST, read_tub
from hrt_cli.steering.recordings.udacity import DRIVING_LOG, read_udacity

T = TypeVar("T", NDArray[np.float32], NDArray[np.int32])

_DEEPEST = 4
"""Levels of folders below a given one in which recordings are looked for."""
_NAMED = 3
"""Malformed rows that are named one by one."""


@dataclass(frozen=True)
class Samples:
    """Frames with their labels.

    Attributes
    ----------
    paths : tuple of Path, [n]
        The picture of each frame.
    steering : float32 [n, outputs]
        In [-1, 1].
    outputs : ('yaw',) or ('yaw', 'pitch')
    session : int32 [n]
        Index into `sessions`; the frames of a session are in the order in which they were taken.
    sessions : tuple of str
        Unique names.
    goal : float32 [n], optional
        Bearings in radians, right positive; all frames have one, or none.
    turn_costs_s : float32 [n, turns], optional
        What turning by each of `turns` angles from -1 to 1 costs; all frames have them, or none.
    other_goals : float32 [n, goals], optional
        Bearings of other goals, radians; all frames have as many.
    other_costs_s : float32 [n, goals, turns], optional
        What turning costs on the way to those.
    hfov_deg : float, optional
        Horizontal field of view of the lens, where the recordings tell it.
    skipped : int
        Frames left out because their row or picture is damaged.
    files : tuple of Path
        The label files.
    moment : int32 [n], optional
        Number of the moment in the recording, ascending within a session: cameras that looked at the same time share
        it, and a frame that is left out leaves a gap. Without it each frame is the next moment.
    """

    paths: tuple[Path, ...]
    steering: NDArray[np.float32]
    outputs: tuple[Output, ...]
    session: NDArray[np.int32]
    sessions: tuple[str, ...]
    goal: NDArray[np.float32] | None
    skipped: int
    files: tuple[Path, ...]
    moment: NDArray[np.int32] | None = None
    turn_costs_s: NDArray[np.float32] | None = None
    other_goals: NDArray[np.float32] | None = None
    other_costs_s: NDArray[np.float32] | None = None
    hfov_deg: float | None = None

    def take(self, index: ArrayLike) -> Samples:
        """Return the frames at `index` (integers, or bool [n]), in that order."""
        chosen = np.arange(len(self.paths))[np.asarray(index)]

        def taken(each: T | None) -> T | None:
            return None if each is None else each[chosen]

        return replace(
            self,
            paths=tuple(self.paths[each] for each in chosen.tolist()),
            steering=self.steering[chosen],
            session=self.session[chosen],
            goal=taken(self.goal),
            moment=taken(self.moment),
            turn_costs_s=taken(self.turn_costs_s),
            other_goals=taken(self.other_goals),
            other_costs_s=taken(self.other_costs_s),
        )


def read_samples(
    folders: Sequence[Path], *, skip_bad: bool = False, correction: float = 0.2, note: Note = unheard
) -> Samples:
    """Read the labels of recordings; the pictures are not opened.

    Parameters
    ----------
    folders : sequence of Path
        Each a recording of hrt (`labels.csv`), a Donkeycar tub v2, a recording of Udacity's simulator, a DroNet folder,
        or a folder that holds such folders. Sessions of different recordings stay apart whatever their names.
    skip_bad : bool
        Leave malformed rows out, counted and noted, instead of refusing them.
    correction : float
        For Udacity's outer cameras; see `udacity.read_udacity`.
    note : Note
        Told what is left out.

    Raises
    ------
    InputError
        A folder is no recording, a row is malformed, or recordings do not go together.
    ArgumentError
        No folder is given, or the correction is not in [0, 1].
    """
    if not folders:
        raise ArgumentError("no folder with steering data is given")
    if not 0.0 <= correction <= 1.0:
        raise ArgumentError(f"the correction of the outer cameras is {correction:g}; it must lie in [0, 1]")
    found = [(name, path) for folder in folders for name, path in _recordings(folder, note)]
    read: list[tuple[str, Recording]] = []
    skipped = 0
    for name, path in found:
        recording = _read(path, correction, note)
        recording.drop_doubles()
        skipped += _leave_out(recording, skip_bad, note)
        read.append((name, recording))
    _check_alike([recording for _, recording in read])
    _check_apart([recording for _, recording in read])
    return _gathered(read, skipped)


def check_varied(samples: Samples, half_classes: int) -> None:
    """Refuse samples that teach nothing.

    Parameters
    ----------
    half_classes : int
        M, of the 2M + 1 classes.

    Raises
    ------
    InputError
        All labels of an output fall into one class.
    """
    for column, name in enumerate(samples.outputs):
        classes = nearest_class(torch.from_numpy(samples.steering[:, column]), half_classes)
        if len(torch.unique(classes)) < 2:
            angle = float(classes[0] - half_classes) / half_classes if len(classes) else 0.0
            where = samples.files[0] if samples.files else "the samples"
            problem = f"all {len(classes)} labels of {name} fall into one class, {angle:+.2f}: nothing to be learnt"
            raise InputError(where, problem, "record turns, too" if name == "yaw" else "or leave the column pitch out")


def check_lens(where: Path, hfov_deg: float | None, wanted_deg: float | None) -> None:
    """Refuse what was seen through another lens: there things lie elsewhere than they seem.

    Raises
    ------
    InputError
        Both fields of view are known, and differ.
    """
    if hfov_deg is not None and wanted_deg is not None and hfov_deg != wanted_deg:
        raise InputError(where, f"is of a lens {hfov_deg:g} degrees wide, and it must be one of {wanted_deg:g}")


def _kind(folder: Path) -> str | None:
    kinds = [name for name in (LABELS, MANIFEST, DRIVING_LOG, STEERING) if (folder / name).is_file()]
    if len(kinds) > 1:
        raise InputError(folder, f"holds both {kinds[0]} and {kinds[1]}, so that its kind cannot be told")
    return kinds[0] if kinds else None


def _recordings(folder: Path, note: Note) -> list[tuple[str, Path]]:
    """Return name and path of each recording in a folder, sorted by name."""
    if not folder.is_dir():
        raise InputError(folder, "is a file, and steering data is a folder" if folder.exists() else "no such folder")
    real = folder.resolve()
    found: list[tuple[str, Path]] = []
    collisions: list[Path] = []

    def visit(path: Path, name: str, depth: int) -> None:
        if _kind(path) is not None:
            found.append((name, path))
        elif (path / COLLISIONS).is_file():
            collisions.append(path)
        elif depth < _DEEPEST:
            for inner in sorted(path.iterdir()):
                # A link to a recording that is found anyhow (`latest`) is no other recording.
                again = inner.is_symlink() and inner.resolve().is_relative_to(real)
                if inner.is_dir() and not inner.name.startswith(".") and not again:
                    visit(inner, f"{name}/{inner.name}", depth + 1)

    try:
        visit(folder, real.name, 0)
    except OSError as error:
        raise InputError(error.filename or folder, f"cannot be read: {error.strerror}") from error
    if not found and collisions:
        raise InputError(collisions[0], f"has collision labels ({COLLISIONS}) and no steering ({STEERING})")
    if not found:
        kinds = f"{LABELS}, {MANIFEST} of a Donkeycar tub, {DRIVING_LOG} or {STEERING}"
        raise InputError(folder, f"holds no steering data that is known: {kinds}, in it or in folders below")
    if collisions:
        note(f"Note: {folder}: {len(collisions)} folders with collision labels only are left out")
    return found


def _read(folder: Path, correction: float, note: Note) -> Recording:
    readers: dict[str | None, Callable[[], Recording]] = {
        LABELS: lambda: read_labels(folder),
        MANIFEST: lambda: read_tub(folder, note),
        DRIVING_LOG: lambda: read_udacity(folder, correction),
        STEERING: lambda: read_dronet(folder, note),
    }
    return readers[_kind(folder)]()


def _leave_out(recording: Recording, skip_bad: bool, note: Note) -> int:
    """Refuse malformed rows, or note them; return how many there are."""
    bad, total = recording.malformed, len(recording.malformed) + len(recording.frames)
    if bad and not skip_bad:
        file, problem = bad[0]
        more = f"; {len(bad)} rows are malformed in all" if len(bad) > 1 else ""
        raise InputError(file, problem + more, "correct them, or leave them out with --skip-bad")
    for file, problem in bad[:_NAMED]:
        note(f"Warning: {file}: {problem}; left out")
    if len(bad) > _NAMED:
        note(f"Warning: {bad[0][0]}: {len(bad) - _NAMED} more rows are malformed and left out")
    if not recording.frames:
        problem = "holds no frames" if not total else "holds no frame whose row is well formed"
        raise InputError(recording.files[0], problem)
    return len(bad)


def _check_alike(recordings: list[Recording]) -> None:
    first = recordings[0]
    lens = next((each.hfov_deg for each in recordings if each.hfov_deg is not None), None)
    for other in recordings[1:]:
        check_lens(other.files[0], other.hfov_deg, lens)
        if other.outputs != first.outputs:
            has, lacks = (first, other) if "pitch" in first.outputs else (other, first)
            raise InputError(lacks.files[0], f"has no pitch, and {has.files[0]} has: they cannot be learnt together")
        if other.has_goal != first.has_goal:
            has, lacks = (first, other) if first.has_goal else (other, first)
            raise InputError(lacks.files[0], f"has no goal_deg, and {has.files[0]} has: they cannot be learnt together")
        if other.turns != first.turns:
            problem = f"has {other.turns} turn_costs_s a row, and {first.files[0]} {first.turns}"
            raise InputError(other.files[0], f"{problem}: they cannot be learnt together")
        if other.other_goals != first.other_goals:
            problem = f"has {other.other_goals} other_goals_deg a row, and {first.files[0]} {first.other_goals}"
            raise InputError(other.files[0], f"{problem}: they cannot be learnt together")


def _check_apart(recordings: list[Recording]) -> None:
    """Refuse a picture that two recordings hold: it would stand on both sides of a split."""
    owners: dict[str, Recording] = {}
    for recording in recordings:
        for frame in recording.frames:
            owner = owners.setdefault(frame.real, recording)
            if owner is not recording:
                twice = os.path.realpath(owner.files[0]) == os.path.realpath(recording.files[0])
                problem = "is given twice" if twice else f"and {owner.files[0]} both name {frame.path}"
                raise InputError(recording.files[0], problem)


def _gathered(read: list[tuple[str, Recording]], skipped: int) -> Samples:
    sessions: dict[tuple[int, str], int] = {}
    names: dict[str, None] = {}
    session: list[int] = []
    for number, (name, recording) in enumerate(read):
        for frame in recording.frames:
            key = (number, frame.session)
            if key not in sessions:
                sessions[key] = len(names)
                names[_unused(f"{name}/{frame.session}" if frame.session else name, names)] = None
            session.append(sessions[key])
    frames = [frame for _, recording in read for frame in recording.frames]
    first = read[0][1]

    def told(values: Iterable[object], shape: tuple[int, ...], known: bool) -> NDArray[np.float32] | None:
        return np.array(list(values), np.float32).reshape(len(frames), *shape) if known else None

    return Samples(
        paths=tuple(frame.path for frame in frames),
        steering=np.array([frame.steering for frame in frames], np.float32),
        outputs=first.outputs,
        session=np.array(session, np.int32),
        sessions=tuple(names),
        goal=told((frame.goal_rad for frame in frames), (), first.has_goal),
        skipped=skipped,
        files=tuple(file for _, recording in read for file in recording.files),
        moment=np.array([frame.moment for frame in frames], np.int32),
        turn_costs_s=told((frame.turn_costs_s for frame in frames), (first.turns,), first.turns > 0),
        hfov_deg=first.hfov_deg if len({each.hfov_deg for _, each in read}) == 1 else None,
        other_goals=told((each.other_goals_rad for each in frames), (first.other_goals,), first.other_goals > 0),
        other_costs_s=told(
            (each.other_costs_s for each in frames), (first.other_goals, first.turns), first.other_goals > 0
        ),
    )


def _unused(name: str, taken: Container[str]) -> str:
    unused, count = name, 1
    while unused in taken:
        count += 1
        unused = f"{name} ({count})"
    return unused
