"""A recording under way, kept in its folder (`artifacts.unfinished`), so that what was stopped goes on where it was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any, Literal

from pydantic import ValidationError

from hrt_cli.artifacts.carriers import json_provenance, publish_json, read_stamped_json
from hrt_cli.artifacts.jsonio import Document, describe
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.unfinished import Unfinished
from hrt_cli.driving.album import ABOUT
from hrt_cli.progress import Note, unheard

EVERY_S = 20.0
"""Time between two writes."""
_SHARE = 0.05
"""Of the time, at most, that goes into writing: the longer a recording, the more there is to write."""


class Kept(Document):
    """A recording up to some picture.

    Attributes
    ----------
    near : int
        Of the pictures so far, how many have something in the way.
    random : str
        State of the generator (`Glances.random`).
    rows : list of str
        Lines of the labels so far.
    pictures_sha256 : str
        Over the files of the pictures so far, one after the other.
    """

    format: Literal["hrt-record-checkpoint"] = "hrt-record-checkpoint"
    near: int
    random: str
    rows: list[str]
    pictures_sha256: str


class Checkpoint:
    """Keeps a recording.

    Parameters
    ----------
    folder : Path
        Of the recording.
    frames : int
        That it will have.
    provenance, note
        As of `Unfinished`.
    """

    def __init__(self, folder: Path, frames: int, provenance: Provenance, note: Note = unheard) -> None:
        self._file = Unfinished(folder / ABOUT, provenance, note, "recording")
        self._frames = frames
        self._note = note
        self._newest: Kept | None = None
        self._written = 0
        self._due = monotonic() + EVERY_S

    def resume(self, use: Callable[[Kept], None]) -> bool:
        """Give the kept recording to `use`, which raises ValueError where it cannot go on from it; return whether."""

        def begin(document: dict[str, Any]) -> Kept:
            try:
                kept = Kept.model_validate(document)
            except ValidationError as error:
                raise ValueError(describe(error)) from error
            use(kept)
            return kept

        kept = self._file.load(read_stamped_json, begin)
        if kept is not None:
            self._written = len(kept.rows)
            self._note(f"Note: going on after frame {self._written} of {self._frames} ({self._file.path})")
        return kept is not None

    def keep(self, kept: Kept) -> None:
        """Remember a recording, and write it where the last writing is long enough ago."""
        self._newest = kept
        if monotonic() >= self._due:
            began = monotonic()
            self.write()
            now = monotonic()
            self._due = now + max(EVERY_S, (now - began) / _SHARE)

    def write(self) -> bool:
        """Write the newest recording; return whether it is in the file."""
        kept = self._newest
        if kept is None:
            return False
        if len(kept.rows) != self._written:
            if not self._file.save(lambda path, provenance: publish_json(path, kept.model_dump(), provenance)):
                return False
            self._written = len(kept.rows)
        return True

    def stopped(self) -> None:
        """Write the newest recording and say how to go on: it ends before its time."""
        if self.write():
            self._note(f"Note: stopped; the same command goes on after frame {self._written} of {self._frames}")

    def remove(self) -> None:
        """See `Unfinished.remove`."""
        self._file.remove()

    def remove_own(self) -> None:
        """See `Unfinished.remove_own`."""
        self._file.remove_own(json_provenance)
