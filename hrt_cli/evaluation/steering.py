"""How good a steering model is on recorded drives that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.metrics import (
    Measure,
    Reliability,
    confusion,
    expected_angles,
    measure,
    median_angles,
    reliability,
    spreads,
)
from hrt_cli.steering.network.net import Output, SteeringConfig
from hrt_cli.steering.network.predictor import Distributions, Predictor
from hrt_cli.steering.prediction.load import load_predictor
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import Samples, check_lens, read_samples

BATCH = 32


@dataclass(frozen=True)
class SteerMeasure:
    """The figures of a steering model, and what they are made of.

    Attributes
    ----------
    total : Measure
        Over all frames. The constant that it is compared with steers the median of the very labels that are measured:
        of all constants the hardest to beat, since none has a smaller mean absolute error on them.
    sessions : dict of str to Measure
        Over the frames of each session, beside the same constant.
    constant : dict of str to float
        That constant by output.
    reliability : dict of str to Reliability
    confusion : dict of str to int64 [classes, classes]
        By class of the label and likeliest class.
    skipped : int
        Frames left out as unusable.
    expected, spread : float64 [n, outputs]
        Mean and standard deviation of the angle under each prediction.
    steering : float32 [n, outputs]
        The labels.
    session : int32 [n]
        Of each frame, an index into `sessions`.
    files : tuple of Path
        The label files read.
    digest : str
        Hash of the frames and their labels.
    """

    total: Measure
    sessions: dict[str, Measure]
    constant: dict[Output, float]
    reliability: dict[Output, Reliability]
    confusion: dict[Output, NDArray[np.int64]]
    skipped: int
    expected: NDArray[np.float64]
    spread: NDArray[np.float64]
    steering: NDArray[np.float32]
    session: NDArray[np.int32]
    files: tuple[Path, ...]
    digest: str


def evaluate_steer(
    model: Path,
    folders: Sequence[Path],
    *,
    skip_bad: bool = False,
    correction: float = 0.2,
    batch: int = BATCH,
    progress: Progress = silent,
    note: Note = unheard,
) -> SteerMeasure:
    """Measure a steering model on labelled frames.

    Parameters
    ----------
    model : Path
        What `hrt train-steer` or `hrt export-steer` wrote.
    folders : sequence of Path
        Steering data (`read_samples`).
    skip_bad : bool
        Leave out frames that cannot be used instead of refusing them.
    correction : float
        What is added to the steering of side cameras.
    batch : int
        Frames predicted at once.
    progress : Progress
        Called with (frames predicted, frames).
    note : Note
        Told what was left out.

    Raises
    ------
    InputError
        The model or the data cannot be used, the data have no labels or goals that the model needs, or the model
        predicts no finite numbers.
    """
    predictor = load_predictor(model)
    config = predictor.config
    samples = read_samples(folders, skip_bad=skip_bad, correction=correction, note=note)
    check_lens(folders[0], samples.hfov_deg, config.hfov_deg)
    columns = _columns_of(samples, config, folders[0])
    samples, pictures, digest = load_pictures(samples, config, skip_bad=skip_bad, note=note)
    if not len(pictures):
        raise InputError(folders[0], "has no frame that can be used")
    steering = samples.steering[:, columns]
    predicted = _predict(model, predictor, pictures, samples.goal if config.goal else None, batch, progress)
    constant = median_angles(steering)
    half = config.half_classes
    sessions = {}
    for number, name in enumerate(samples.sessions):
        of_it = np.flatnonzero(samples.session == number)
        if of_it.size:
            part = {output: values[of_it] for output, values in predicted.items()}
            sessions[name] = measure(part, steering[of_it], half, constant)
    label = dict(zip(config.outputs, steering.T, strict=True))
    return SteerMeasure(
        total=measure(predicted, steering, half, constant),
        sessions=sessions,
        constant=dict(zip(config.outputs, constant.tolist(), strict=True)),
        reliability={name: reliability(each, label[name], half) for name, each in predicted.items()},
        confusion={name: confusion(each, label[name], half) for name, each in predicted.items()},
        skipped=samples.skipped,
        expected=np.stack([expected_angles(each) for each in predicted.values()], axis=1),
        spread=np.stack([spreads(each) for each in predicted.values()], axis=1),
        steering=steering,
        session=np.unique(samples.session, return_inverse=True)[1].astype(np.int32),
        files=samples.files,
        digest=digest,
    )


def _columns_of(samples: Samples, config: SteeringConfig, data: Path) -> list[int]:
    """Return the columns of the labels that a model predicts; refuse data that lack any, or the goals that it needs."""
    for name in config.outputs:
        if name not in samples.outputs:
            raise InputError(data, f"has no labels of {name}, which the model predicts")
    if config.goal and samples.goal is None:
        raise InputError(data, "does not say where to go, and the model must be told (the column goal_deg)")
    return [samples.outputs.index(name) for name in config.outputs]


def _predict(
    model: Path,
    predictor: Predictor,
    pictures: NDArray[np.uint8],
    goal: NDArray[np.float32] | None,
    batch: int,
    progress: Progress,
) -> Distributions:
    parts = []
    for first in range(0, len(pictures), batch):
        these = slice(first, first + batch)
        parts.append(predictor.probabilities(pictures[these], None if goal is None else goal[these]))
        progress(min(first + batch, len(pictures)), len(pictures))
    whole = {name: np.concatenate([part[name] for part in parts]) for name in predictor.config.outputs}
    if not all(np.isfinite(each).all() for each in whole.values()):
        raise InputError(model, "predicts numbers that are not finite: its weights are of no use")
    return whole
