"""A training under way, kept beside its output (`artifacts.unfinished`) as safetensors like the model."""

from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import Any

from torch import Tensor

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.unfinished import Unfinished
from hrt_cli.errors import InputError
from hrt_cli.progress import Note, unheard
from hrt_cli.steering.network.model import model_provenance, publish_tensors, read_tensors
from hrt_cli.steering.training.state import Course, packed, unpacked
from hrt_cli.steering.training.train import Trainer

EVERY_S = 30.0
"""Time between two writes."""
_SHARE = 0.05
"""Of the time, at most, that goes into writing where the disk is slow."""
FORMAT = "hrt-steering-checkpoint"

_Content = tuple[dict[str, Tensor], dict[str, Any]]


class Checkpoint:
    """Keeps a `Trainer`; parameters as of `Unfinished`."""

    def __init__(self, output: Path, provenance: Provenance, note: Note = unheard) -> None:
        self._file = Unfinished(output, provenance, note)
        self._note = note
        self._written = 0
        self._due = monotonic() + EVERY_S

    def resume(self, trainer: Trainer) -> bool:
        """Put a training that has not begun where the kept one was; return whether there was one that can be used."""

        def use(content: _Content) -> Course:
            tensors, document = content
            if document.pop("format", None) != FORMAT:
                raise InputError(self._file.path, "is no checkpoint of a training")
            return unpacked(tensors, document, trainer.net, trainer.optimiser)

        course = self._file.load(_read, use)
        if course is None:
            return False
        trainer.course = course
        self._written = trainer.step
        self._note(f"Note: going on after step {trainer.step} of {trainer.steps} ({self._file.path})")
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
            document = {"format": FORMAT, **document}
            if not self._file.save(lambda path, provenance: publish_tensors(path, tensors, document, provenance)):
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
        """See `Unfinished.remove`."""
        self._file.remove()

    def remove_own(self) -> None:
        """See `Unfinished.remove_own`."""
        self._file.remove_own(model_provenance)


def _read(path: Path) -> tuple[_Content, Provenance | None]:
    tensors, document, found = read_tensors(path)
    return (tensors, document), found
