"""The unfinished work beside its output, so that what was stopped goes on where it was.

A file `.<output>.hrt-checkpoint`, published in one piece like any artifact and stamped with the provenance that the
output will bear. Work is never stopped by it: where it cannot be read the work begins anew, and where it cannot be
written the work goes on without.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import sweep
from hrt_cli.errors import InputError, OutputError
from hrt_cli.progress import Note, unheard

C = TypeVar("C")
S = TypeVar("S")


def checkpoint_path(output: Path) -> Path:
    """Return where the unfinished work of an output lies."""
    return output.with_name(f".{output.name}.hrt-checkpoint")


class Unfinished:
    """The checkpoint of some long work.

    Parameters
    ----------
    output : Path
        The file that the work will write in the end.
    provenance : Provenance
        What makes it; a checkpoint of another fingerprint or version of hrt is not used.
    note : callable
        Told, in one line each, what became of the checkpoint.
    work : str
        What to call the work in notes.
    """

    def __init__(self, output: Path, provenance: Provenance, note: Note = unheard, work: str = "training") -> None:
        self.path = checkpoint_path(output)
        self._provenance = provenance
        self._note = note
        self._work = work
        self._warned = False

    def load(self, read: Callable[[Path], tuple[C, Provenance | None]], use: Callable[[C], S]) -> S | None:
        """Return what `use` makes of the file's content; None where there is none that can be used.

        Parameters
        ----------
        read : callable
            Returns what a file holds, and its provenance. Raises InputError where it is damaged.
        use : callable
            Raises ValueError or InputError where the content is not what it should be.
        """
        if not os.path.lexists(self.path):
            return None
        try:
            content, found = read(self.path)
            if found is None:
                raise InputError(self.path, "carries no provenance")
            if not self._is_ours(found):
                self._note(f"Note: {self.path}: is of a {self._work} with other settings and will be replaced")
                return None
            return use(content)
        except InputError as error:
            self._note(f"Warning: {error}; the {self._work} begins anew")
        except ValueError as error:
            self._note(f"Warning: {self.path}: {error}; the {self._work} begins anew")
        return None

    def save(self, publish: Callable[[Path, Provenance], None]) -> bool:
        """Write the file; return whether it could be. The first time that it cannot, a note tells."""
        try:
            publish(self.path, self._provenance)
        except OutputError as error:
            if not self._warned:
                self._note(f"Warning: {error}; should the {self._work} be stopped, this part of it is lost")
            self._warned = True
            return False
        return True

    def remove(self) -> None:
        """Delete the file, and what a killed process left of it: the output is there."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
            sweep(self.path)

    def remove_own(self, read_provenance: Callable[[Path], Provenance | None]) -> None:
        """Delete the file where it is of this very work, which an earlier run ended."""
        with suppress(InputError):
            if self._is_ours(read_provenance(self.path)):
                self.remove()

    def _is_ours(self, found: Provenance | None) -> bool:
        wanted = self._provenance
        return found is not None and (found.fingerprint, found.version) == (wanted.fingerprint, wanted.version)
