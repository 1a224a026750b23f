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
from hrt_cli.planning.train import TrainSpec, train
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.scoremap import read_scoremap

STAGE = "train-plan"
STAGE_VERSION = 1


@dataclass(frozen=True)
class Training:
    """What the train-plan stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    steps : int
        Rollout steps made.
    seconds : float
        Wall-clock time of the training.
    learning_curve : float64 [iterations]
        Mean share of the best T cells of the map that a rollout collected, per iteration.
    """

    up_to_date: bool
    steps: int
    seconds: float
    learning_curve: NDArray[np.float64]


def train_file(
    scoremap_paths: tuple[Path, ...],
    output: Path,
    spec: TrainSpec,
    *,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> Training:
    """Train a policy on the scoremaps given, or on generated maps where there is none, and write it to `output`.

    Raises
    ------
    InputError
        A scoremap cannot be used.
    ArgumentError
        No map has a cell to start from.
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
    if job.up_to_date:
        arrays, _ = read_stamped_npz(output)
        return Training(True, steps, 0.0, arrays["learning_curve"].astype(np.float64))
    maps = [read_scoremap(path).score for path in scoremap_paths]
    began = time.monotonic()
    policy, curve = train(spec, maps or None, progress)
    seconds = time.monotonic() - began
    publish_npz(output, {**policy.to_arrays(), "learning_curve": curve}, job.provenance)
    return Training(False, steps, seconds, curve)
