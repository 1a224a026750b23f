"""The state of a policy's training, kept beside its output (`artifacts.unfinished`) as an NPZ."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

from hrt_cli.artifacts.carriers import npz_provenance, publish_npz, read_stamped_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.unfinished import Unfinished
from hrt_cli.planning.train import TrainSpec, TrainState
from hrt_cli.progress import Note, unheard

EVERY_S = 5.0
"""Time between two writes: little is lost with the power, and nothing is felt of the writing."""


class Checkpoint:
    """Keeps a `TrainState`; parameters as of `Unfinished`."""

    def __init__(self, output: Path, provenance: Provenance, note: Note = unheard) -> None:
        self._file = Unfinished(output, provenance, note)
        self._note = note
        self._newest: TrainState | None = None
        self._written = -1
        self._due = monotonic() + EVERY_S

    def resume(self, spec: TrainSpec) -> TrainState | None:
        """Return the state that was kept; None where there is none that can be used."""
        found = self._file.load(read_stamped_npz, lambda arrays: TrainState.from_arrays(spec, arrays))
        if found is not None:
            self._newest, self._written = found, found.done
            self._note(f"Note: going on after iteration {found.done} of {spec.iterations} ({self._file.path})")
        return found

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
            if not self._file.save(lambda path, provenance: publish_npz(path, state.to_arrays(), provenance)):
                return False
            self._written = state.done
        return True

    def stopped(self) -> None:
        """Write the newest state and say how to go on: the training ends before its time."""
        if self.write() and self._newest is not None:
            done, whole = self._newest.done, self._newest.curve.size
            self._note(f"Note: stopped after iteration {done} of {whole}; the same command goes on from there")

    def remove(self) -> None:
        """See `Unfinished.remove`."""
        self._file.remove()

    def remove_own(self) -> None:
        """See `Unfinished.remove_own`."""
        self._file.remove_own(npz_provenance)
