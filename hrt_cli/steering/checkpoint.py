"""The unfinished training beside its output, so that one that was stopped goes on where it was."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from time import monotonic

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import sweep
from hrt_cli.errors import InputError, OutputError
from hrt_cli.progress import Note, unheard
from hrt_cli.steering.model import publish_tensors, read_tensors
from hrt_cli.steering.state import packed, unpacked
from hrt_cli.steering.train import Trainer

EVERY_S = 30.0
"""Time between two writes."""
_SHARE = 0.05
"""Of the time, at most, that goes into writing where the disk is slow."""
FORMAT = "hrt-steering-checkpoint"


class Checkpoint:
    """A file `.<output>.hrt-checkpoint` that holds a training under way and what it is a training of.

    It is safetensors like the model: published in one piece, stamped with the provenance that the model will bear and
    with a hash of what it holds. A training is never stopped by it: where it cannot be read, the training begins anew,
    and where it cannot be written, the training goes on without.

    Parameters
    ----------
    output : Path
        The model that the training will write.
    provenance : Provenance
        What makes it; a checkpoint of another fingerprint or version of hrt is not used.
    note : callable
        Told, in one line each, what became of the checkpoint.
    """

    def __init__(self, output: Path, provenance: Provenance, note: Note = unheard) -> None:
        self.path = output.with_name(f".{output.name}.hrt-checkpoint")
        self._provenance = provenance
        self._note = note
        self._written = 0
        self._warned = False
        self._due = monotonic() + EVERY_S

    def resume(self, trainer: Trainer) -> bool:
        """Put a training that has not begun where the kept one was; return whether there was one that can be used."""
        if not os.path.lexists(self.path):
            return False
        try:
            tensors, document, found = read_tensors(self.path)
            if found is None:
                raise InputError(self.path, "carries no provenance")
            if not self._is_ours(found):
                self._note(f"Note: {self.path}: is of a training with other settings and will be replaced")
                return False
            if document.pop("format", None) != FORMAT:
                raise InputError(self.path, "is no checkpoint of a training")
            course = unpacked(tensors, document, trainer.net, trainer.optimiser)
        except InputError as error:
            self._note(f"Warning: {error}; the training begins anew")
            return False
        except ValueError as error:
            self._note(f"Warning: {self.path}: {error}; the training begins anew")
            return False
        trainer.course = course
        self._written = trainer.step
        self._note(f"Note: going on after step {trainer.step} of {trainer.steps} ({self.path})")
        return True

    def keep(self, trainer: Trainer) -> None:
        """Write the training where the last writing is long enough ago."""
        if monotonic() >= self._due:
            began = monotonic()
            self.write(trainer)
            now = monotonic()
            self._due = now + max(EVERY_S, (now - began) / _SHARE)

    def write(self, trainer: Trainer) -> bool:
        """Write the training; return whether all that can be kept of it is in the file."""
        if not trainer.whole:
            return False
        if trainer.step != self._written:
            tensors, document = packed(trainer.net, trainer.optimiser, trainer.course)
            try:
                publish_tensors(self.path, tensors, {"format": FORMAT, **document}, self._provenance)
            except OutputError as error:
                if not self._warned:
                    self._note(f"Warning: {error}; should the training be stopped, this part of it is lost")
                self._warned = True
                return False
            self._written = trainer.step
        return trainer.step > 0

    def stopped(self, trainer: Trainer) -> None:
        """Write the training and say how to go on: it ends before its time."""
        if self.write(trainer):
            self._note(
                f"Note: stopped; the same command goes on after step {self._written} of {trainer.steps}"
                f" (epoch {self._written // trainer.batches + 1})"
            )

    def remove(self) -> None:
        """Delete the file, and what a killed process left of it: the output is there."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
            sweep(self.path)

    def remove_own(self) -> None:
        """Delete the file where it is of this very training, which an earlier run ended."""
        with suppress(InputError):
            if self._is_ours(read_tensors(self.path)[2]):
                self.remove()

    def _is_ours(self, found: Provenance | None) -> bool:
        wanted = self._provenance
        return found is not None and (found.fingerprint, found.version) == (wanted.fingerprint, wanted.version)
