"""What `steer` looks at: pictures, folders of them, recordings with their labels, videos; one frame at a time."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.jsonio import canonical
from hrt_cli.artifacts.provenance import file_sha256
from hrt_cli.errors import InputError
from hrt_cli.progress import Note, unheard
from hrt_cli.steering.network.net import Output
from hrt_cli.steering.prediction.video import SUFFIXES, check_video, shots, told_frames
from hrt_cli.steering.recordings.decode import read_picture
from hrt_cli.steering.recordings.samples import read_samples

PICTURES = (".jpg", ".jpeg", ".png")
LABELLED = ("labels.csv", "manifest.json", "driving_log.csv", "sync_steering.txt")
"""Files by which a folder is known to be a recording."""
_TOLD = 3
"""Bad pictures named one by one."""


@dataclass(frozen=True)
class Still:
    """A picture to look at.

    Attributes
    ----------
    name : str
        Within the input, with forward slashes.
    goal : float or None
        Bearing in radians, right positive, where the recording says so.
    label : dict or None
        By output, what was steered, likewise.
    """

    path: Path
    name: str
    goal: float | None = None
    label: dict[Output, float] | None = None


@dataclass(frozen=True)
class Source:
    """One input: pictures in order, or a video where `stills` is None.

    Attributes
    ----------
    name : str
        Of the input, without the folder that it lies in.
    files : tuple of Path
        Besides the pictures of a folder, what it was read from: a picture or a video given by itself, label files.
    skipped : int
        Rows of the labels that were left out.
    """

    path: Path
    name: str
    stills: tuple[Still, ...] | None
    files: tuple[Path, ...]
    skipped: int = 0


@dataclass(frozen=True)
class Frame:
    """A frame read: uint8 RGB [rows, cols, 3] and where it is from; `index` and `time_s` where that is a video."""

    rgb: NDArray[np.uint8]
    input: int
    name: str
    index: int | None = None
    time_s: float | None = None
    goal: float | None = None
    label: dict[Output, float] | None = None


def find_sources(inputs: Sequence[Path], *, skip_bad: bool = False, note: Note = unheard) -> list[Source]:
    """Say what each input is.

    A folder is a recording if one of `LABELLED` lies in it; else the pictures in it are taken by name, numbers in
    names by their value, and its sub-folders are not searched.

    Raises
    ------
    InputError
        An input is absent, a folder without pictures, or a recording or video that cannot be used.
    """
    return [_source(path, skip_bad, note) for path in inputs]


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a sort key by which `9.jpg` comes before `10.jpg`."""
    parts = re.findall(r"([0-9]+)|([^0-9]+)", name)
    return tuple((0, int(digits), "") if digits else (1, 0, text) for digits, text in parts)


def stills_digest(sources: Sequence[Source]) -> str:
    """Hash names, goals, labels and bytes of every picture, in order, wherever they lie."""
    digest = hashlib.sha256()
    for number, source in enumerate(sources):
        digest.update(canonical([number, source.name]))
        for still in source.stills or ():
            content = file_sha256(still.path) if still.path.is_file() else ""
            digest.update(canonical([still.name, content, still.goal, still.label]))
    return digest.hexdigest()


class Reader:
    """Reads the frames of sources, once.

    Parameters
    ----------
    every : int
        Of videos, take each `every`-th frame.
    skip_bad : bool
        Leave out what cannot be read, and count it, instead of refusing.

    Attributes
    ----------
    skipped : int
        Pictures, rows and ends of videos left out so far.
    """

    def __init__(self, sources: Sequence[Source], *, every: int, skip_bad: bool, note: Note = unheard) -> None:
        self._sources, self._every, self._skip_bad, self._note = sources, every, skip_bad, note
        self.skipped = sum(source.skipped for source in sources)
        self._told = 0

    @property
    def first(self) -> Path:
        """The first input, to name where there is none better."""
        return self._sources[0].path

    @property
    def expected(self) -> int:
        """About how many frames there are: videos do not always know."""
        return sum(
            told_frames(source.path, self._every) if source.stills is None else len(source.stills)
            for source in self._sources
        )

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order.

        Raises
        ------
        InputError
            One cannot be read, and bad ones are not skipped.
        """
        for number, source in enumerate(self._sources):
            if source.stills is None:
                yield from self._of_video(number, source)
                continue
            for still in source.stills:
                try:
                    rgb = read_picture(still.path)
                except InputError as error:
                    self._bad(error)
                    continue
                yield Frame(rgb, number, still.name, goal=still.goal, label=still.label)

    def _of_video(self, number: int, source: Source) -> Iterator[Frame]:
        try:
            for shot in shots(source.path, self._every):
                yield Frame(shot.rgb, number, source.name, index=shot.index, time_s=shot.time_s)
        except InputError as error:
            self._bad(error)

    def _bad(self, error: InputError) -> None:
        if not self._skip_bad:
            raise error
        self.skipped += 1
        self._told += 1
        if self._told <= _TOLD:
            self._note(f"Warning: left out: {error}")


def _source(path: Path, skip_bad: bool, note: Note) -> Source:
    name = _plain(path.name or path.resolve().name)
    if path.is_dir():
        if any((path / label).is_file() for label in LABELLED):
            return _recording(path, name, skip_bad, note)
        return Source(path, name, _pictures(path, note), ())
    if path.suffix.lower() in SUFFIXES:
        try:
            check_video(path)
        except InputError as error:
            if not (skip_bad and path.is_file()):
                raise
            note(f"Warning: taken as far as it goes: {error}")
        return Source(path, name, None, (path,))
    if not path.is_file():
        raise InputError(path, "no such file")
    return Source(path, name, (Still(path, name),), (path,))


def _recording(folder: Path, name: str, skip_bad: bool, note: Note) -> Source:
    found = read_samples([folder], skip_bad=skip_bad, note=note)
    stills = []
    for index, path in enumerate(found.paths):
        label = {output: float(value) for output, value in zip(found.outputs, found.steering[index], strict=True)}
        goal = None if found.goal is None else float(found.goal[index])
        stills.append(Still(path, _plain(os.path.relpath(path, folder)), goal, label))
    return Source(folder, name, tuple(stills), found.files, found.skipped)


def _pictures(folder: Path, note: Note) -> tuple[Still, ...]:
    files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    taken = sorted((p for p in files if p.suffix.lower() in PICTURES), key=lambda p: (natural(p.name), p.name))
    if not taken:
        raise InputError(folder, "holds no JPEG or PNG pictures (its sub-folders are not searched)")
    if len(taken) < len(files):
        note(f"Note: {folder}: {len(files) - len(taken)} files that are no JPEG or PNG by name are left out")
    return tuple(Still(path, _plain(path.name)) for path in taken)


def _plain(name: str) -> str:
    """Return a name as JSON can hold it."""
    return os.fsencode(name).decode("utf-8", "backslashreplace").replace(os.sep, "/")


def goal_deg(goal: float) -> float:
    """Return a bearing in degrees, in [-180, 180]."""
    return math.degrees(math.remainder(goal, math.tau))
