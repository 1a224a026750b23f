"""The train-plan stage: score maps (or generated ones) become a policy, from file to file."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import npz_provenance, publish_npz, read_stamped_npz
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import InputError
from hrt_cli.planning.checkpoint import Checkpoint
from hrt_cli.planning.train import TrainSpec, start_cells, train
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.raster.scoremap import read_scoremap

STAGE = "train-plan"
STAGE_VERSION = 2


@dataclass(frozen=True)
class Training:
    """What the train-plan stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    resumed_at : int
        Iterations that an earlier run had done before it was stopped; 0 where there was none.
    steps : int
        Rollout steps of the whole training.
    seconds : float
        Wall-clock time of this run's share of it.
    learning_curve : float64 [iterations]
        Mean share of the best T cells of the map that a rollout collected, per iteration.
    """

    up_to_date: bool
    resumed_at: int
    steps: int
    seconds: float
    learning_curve: NDArray[np.float64]

    @property
    def last(self) -> int:
        """Iterations at the end whose mean is `final_share`: a tenth of them, ten at most."""
        return min(10, max(1, self.learning_curve.size // 10))

    @property
    def final_share(self) -> float:
        """What the training reached: the mean of the last values of the learning curve."""
        return float(self.learning_curve[-self.last :].mean())

    @property
    def steps_per_second(self) -> float | None:
        """Rollout steps a second in this run; None where it made none."""
        made = self.steps * (1.0 - self.resumed_at / self.learning_curve.size)
        return None if self.up_to_date or made == 0 or self.seconds == 0 else made / self.seconds


def train_file(
    scoremap_paths: tuple[Path, ...],
    output: Path,
    spec: TrainSpec,
    *,
    existing: Existing = REFUSE,
    progress: Progress = silent,
    note: Note = unheard,
) -> Training:
    """Train a policy on the scoremaps given, or on generated maps where there is none, and write it to `output`.

    A training that is stopped, even by a power cut, leaves a `Checkpoint` beside `output`; the next run with the same
    scoremaps and `spec` goes on from there and writes the bytes that one run would have written.

    Parameters
    ----------
    scoremap_paths : tuple of Path
        Scoremaps (see `read_scoremap`), of any shapes.
    output : Path
        The policy to write, an NPZ that also holds the array `learning_curve`.
    spec : TrainSpec
        Hyper-parameters.
    existing : Existing
        What to do where `output` exists.
    progress : Progress
        Called with (iterations done, iterations).
    note : Note
        Told what became of a checkpoint.

    Raises
    ------
    InputError
        A scoremap cannot be used, or has no cell to start from.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {f"scoremap/{index}": path for index, path in enumerate(scoremap_paths)}
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=inputs,
        parameters=json.loads(json.dumps(asdict(spec))),
        outputs={output: npz_provenance},
        existing=existing,
    )
    steps = spec.iterations * spec.maps_per_iteration * spec.rollouts * spec.moves
    checkpoint = Checkpoint(output, job.provenance, note)
    if job.up_to_date:
        checkpoint.remove_own()
        arrays, _ = read_stamped_npz(output)
        return Training(True, 0, steps, 0.0, arrays["learning_curve"].astype(np.float64))
    maps = [_read_map(path, spec) for path in scoremap_paths]
    state = checkpoint.resume(spec)
    resumed_at = state.done if state else 0
    began = time.monotonic()
    try:
        policy, curve = train(spec, maps or None, progress, state=state, keep=checkpoint.keep)
        seconds = time.monotonic() - began
        publish_npz(output, {**policy.to_arrays(), "learning_curve": curve}, job.provenance)
    except BaseException:  # a signal, too
        checkpoint.stopped()
        raise
    checkpoint.remove()
    return Training(False, resumed_at, steps, seconds, curve)


def _read_map(path: Path, spec: TrainSpec) -> NDArray[np.float32]:
    score = read_scoremap(path).score
    if not start_cells(score, 4 if spec.eight < 1 else 8).any():
        raise InputError(path, "has no cell a robot could start from: every cell that may be entered is walled in")
    return score
