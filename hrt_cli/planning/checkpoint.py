"""The unfinished training beside its output, so that one that was stopped goes on where it was."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from time import monotonic

from hrt_cli.artifacts.carriers import publish_npz, read_stamped_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import sweep
from hrt_cli.errors import InputError, OutputError
from hrt_cli.planning.train import TrainSpec, TrainState
from hrt_cli.progress import Note, unheard

EVERY_S = 5.0
"""Time between two writes: little is lost with the power, and nothing is felt of the writing."""


class Checkpoint:
    """A file `.<output>.hrt-checkpoint` that holds a `TrainState` and what it is a state of.

    It is an NPZ like any artifact: published in one piece, stamped with the provenance that the output will bear and
    with a hash of what it holds. A training is never stopped by it: where it cannot be read, the training begins anew,
    and where it cannot be written, the training goes on without.

    Parameters
    ----------
    output : Path
        The file that the training will write.
    provenance : Provenance
        What makes it; a checkpoint of another fingerprint or version of hrt is not used.
    note : callable
        Told, in one line each, what became of the checkpoint.
    """

    def __init__(self, output: Path, provenance: Provenance, note: Note = unheard) -> None:
        self.path = output.with_name(f".{output.name}.hrt-checkpoint")
        self._provenance = provenance
        self._note = note
        self._newest: TrainState | None = None
        self._written = -1
        self._warned = False
        self._due = monotonic() + EVERY_S

    def resume(self, spec: TrainSpec) -> TrainState | None:
        """Return the state that was kept; None where there is none that can be used."""
        if not os.path.lexists(self.path):
            return None
        try:
            arrays, found = read_stamped_npz(self.path)
            if found is None:
                raise InputError(self.path, "carries no provenance")
            if not self._is_ours(found):
                self._note(f"Note: {self.path}: is of a training with other settings and will be replaced")
                return None
            self._newest = TrainState.from_arrays(spec, arrays)
        except InputError as error:
            self._note(f"Warning: {error}; the training begins anew")
            return None
        except ValueError as error:
            self._note(f"Warning: {self.path}: {error}; the training begins anew")
            return None
        self._written = self._newest.done
        self._note(f"Note: going on after iteration {self._written} of {spec.iterations} ({self.path})")
        return self._newest

    def keep(self, state: TrainState) -> None:
        """Remember a state, and write it where the last one was written `EVERY_S` ago."""
        self._newest = state
        if monotonic() >= self._due:
            self.write()
            self._due = monotonic() + EVERY_S

    def write(self) -> bool:
        """Write the newest state; return whether it is in the file."""
        state = self._newest
        if state is None:
            return False
        if state.done != self._written:
            try:
                publish_npz(self.path, state.to_arrays(), self._provenance)
            except OutputError as error:
                if not self._warned:
                    self._note(f"Warning: {error}; should the training be stopped, this part of it is lost")
                self._warned = True
                return False
            self._written = state.done
        return True

    def stopped(self) -> None:
        """Write the newest state and say how to go on: the training ends before its time."""
        if self.write() and self._newest is not None:
            done, whole = self._newest.done, self._newest.curve.size
            self._note(f"Note: stopped after iteration {done} of {whole}; the same command goes on from there")

    def remove(self) -> None:
        """Delete the file, and what a killed process left of it: the output is there."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
            sweep(self.path)

    def remove_own(self) -> None:
        """Delete the file where it is of this very training, which an earlier run ended."""
        with suppress(InputError):
            if self._is_ours(read_stamped_npz(self.path)[1]):
                self.remove()

    def _is_ours(self, found: Provenance | None) -> bool:
        wanted = self._provenance
        return found is not None and (found.fingerprint, found.version) == (wanted.fingerprint, wanted.version)
