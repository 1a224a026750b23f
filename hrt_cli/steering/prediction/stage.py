"""The steer stage: a model and pictures become predictions, and if asked pictures with the predictions drawn in."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import json_provenance, publish_json
from hrt_cli.artifacts.provenance import Provenance, file_sha256, record
from hrt_cli.artifacts.publish import publishing_folder
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.net import Output
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.steering.network.predictor import Predictor, TorchPredictor
from hrt_cli.steering.network.saliency import Layer
from hrt_cli.steering.prediction.load import load_predictor
from hrt_cli.steering.prediction.overlay import canvas, draw_overlay
from hrt_cli.steering.prediction.overlays import OverlayWriter, check_overlays, overlays_current
from hrt_cli.steering.prediction.predictions import FORMAT, VERSION, prediction, read_predictions
from hrt_cli.steering.prediction.sources import Frame, Reader, Source, find_sources, goal_deg, stills_digest
from hrt_cli.steering.prediction.uncertainty import uncertainty

STAGE, OVERLAY_STAGE = "steer", "steer-overlay"
STAGE_VERSION, OVERLAY_VERSION = 2, 2
SEED = 0
PASSES = 50
SALIENCY_LAYER: Layer = "layer3"
"""Of a small picture the last stage sees a few cells: too few to show anything."""
_NOTHING = np.empty((0, 0, 3), np.uint8)
"""In place of a picture that nobody needs any more."""


@dataclass(frozen=True)
class SteerRequest:
    """What to predict, besides of what.

    Attributes
    ----------
    passes : int
        Networks to draw by dropout for the uncertainty; 0 for none.
    every : int
        Of videos, take each `every`-th frame.
    goal_deg : float or None
        Bearing of the goal, right positive, for frames whose labels give none.
    batch : int
        Pictures at a time. The last bits of the arithmetic depend on it.
    skip_bad : bool
        Leave out what cannot be read instead of refusing it.
    seed : int
        Of the dropout masks.
    """

    passes: int = PASSES
    every: int = 1
    goal_deg: float | None = None
    batch: int = 16
    skip_bad: bool = False
    seed: int = SEED


@dataclass(frozen=True)
class Steering:
    """What the steer stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    frames, skipped : int
        Predicted, and left out.
    seconds : float
        Wall-clock time, with reading and drawing.
    mean : dict of str to float
        By output, the mean of the expected angles.
    mean_spread : dict of str to float
        By output, the mean of the standard deviations of the angle.
    two_ways : int
        Frames in which some output's distribution has more than one mode.
    passes : int
        Networks drawn.
    """

    up_to_date: bool
    frames: int
    skipped: int
    seconds: float
    mean: dict[str, float]
    mean_spread: dict[str, float]
    two_ways: int
    passes: int


def steer_files(
    model: Path,
    inputs: Sequence[Path],
    output: Path,
    request: SteerRequest | None = None,
    *,
    overlay: Path | None = None,
    saliency: bool = False,
    existing: Existing = REFUSE,
    progress: Progress = silent,
    note: Note = unheard,
) -> Steering:
    """Predict the steering of every frame and write it to `output` (see `predictions`).

    Parameters
    ----------
    model : Path
        A steering model of hrt.
    inputs : sequence of Path
        Pictures, folders and videos (see `sources.find_sources`).
    output : Path
        The predictions, JSON.
    overlay : Path, optional
        Folder for a JPEG of each frame with its prediction drawn in. It appears whole, when all is done.
    saliency : bool
        Show there, too, what in the picture turned yaw.
    existing : Existing
        What to do where `output` or `overlay` exists.
    progress : Progress
        Called with (frames done, frames expected).
    note : Note
        Told what was left out.

    Raises
    ------
    InputError
        The model or an input cannot be used, or nothing is left of the inputs.
    ArgumentError
        What is asked does not fit the model.
    OutputError
        See `hrt_cli.artifacts.stage.begin`; or `overlay` holds something else.
    """
    request = request or SteerRequest()
    predictor = load_predictor(model)
    passes = _passes(model, predictor, request, saliency, note)
    sources = find_sources(inputs, skip_bad=request.skip_bad, note=note)
    _check_goals(model, predictor, sources, request)
    files = {"model": model} | {
        f"input/{number}/{index}": file
        for number, source in enumerate(sources)
        for index, file in enumerate(source.files)
    }
    parameters = _parameters(request, passes, stills_digest(sources))
    outputs = {output: json_provenance}
    job = begin(STAGE, STAGE_VERSION, inputs=files, parameters=parameters, outputs=outputs, existing=existing)
    drawn: Provenance | None = None
    if overlay is not None:
        drawn = record(OVERLAY_STAGE, OVERLAY_VERSION, parameters | {"saliency": saliency}, files)
        apart = [output, *files.values(), *(source.path for source in sources)]
        if overlays_current(overlay, drawn, apart, existing):
            overlay = None
    if job.up_to_date and overlay is None:
        return _summary(output, True, 0.0)
    began = time.monotonic()
    reader = Reader(sources, every=request.every, skip_bad=request.skip_bad, note=note)
    work = _Work(model, predictor, request, passes, saliency)
    if overlay is None or drawn is None:
        frames = work.run(reader, None, progress)
    else:
        with publishing_folder(overlay, check_overlays) as folder:
            writer = OverlayWriter(folder)
            frames = work.run(reader, writer, progress)
            writer.finish(drawn)
    if not job.up_to_date:
        document = _document(model, predictor, sources, passes, frames, reader.skipped)
        publish_json(output, document, job.provenance)
    return _summary(output, False, time.monotonic() - began)


class _Work:
    """Predicts, and draws, batch by batch."""

    def __init__(self, model: Path, predictor: Predictor, request: SteerRequest, passes: int, saliency: bool) -> None:
        self._model, self._predictor, self._config = model, predictor, predictor.config
        self._request, self._passes, self._saliency = request, passes, saliency

    def run(self, reader: Reader, writer: OverlayWriter | None, progress: Progress) -> list[dict[str, Any]]:
        """Return what is said of each frame; with a writer, draw each, too."""
        done: list[dict[str, Any]] = []
        expected, frames = reader.expected, reader.frames()
        # A camera's own pictures are large: only what is still needed of them waits for its batch.
        prepared = (
            (fitted(f.rgb, self._config), replace(f, rgb=canvas(f.rgb) if writer else _NOTHING)) for f in frames
        )
        while batch := list(islice(prepared, self._request.batch)):
            done += self._batch([frame for _, frame in batch], np.stack([seen for seen, _ in batch]), writer)
            progress(len(done), max(expected, len(done)))
        if not done:
            raise InputError(reader.first, "holds no frame that can be read")
        return done

    def _batch(
        self, batch: list[Frame], pictures: NDArray[np.uint8], writer: OverlayWriter | None
    ) -> list[dict[str, Any]]:
        predictor, config = self._predictor, self._config
        goals = [self._goal(frame) for frame in batch] if config.goal else None
        goal = None if goals is None else np.array(goals, np.float32)
        distribution = predictor.probabilities(pictures, goal)
        if not all(np.isfinite(each).all() for each in distribution.values()):
            raise InputError(
                self._model, f"gives no number for {batch[0].name} or one after it: its weights are no good"
            )
        sure = None
        if self._passes and isinstance(predictor, TorchPredictor):
            drawn = predictor.sampled(pictures, goal, self._passes, self._request.seed)
            sure = {name: uncertainty(each) for name, each in drawn.items()}
        heat = None
        if writer is not None and self._saliency and isinstance(predictor, TorchPredictor):
            heat = predictor.saliency(pictures, goal, "yaw", SALIENCY_LAYER)
        said = []
        for at, frame in enumerate(batch):
            label = _known(frame.label, config.outputs)
            where = _where(frame) | ({} if goals is None else {"goal_deg": round(goal_deg(goals[at]), 4)})
            said.append(where | prediction(distribution, sure, at, label))
            if writer is not None:
                picture = draw_overlay(
                    frame.rgb,
                    {name: each[at] for name, each in distribution.items()},
                    spread=None if sure is None else {name: float(each.spread[at]) for name, each in sure.items()},
                    label=label,
                    heat=None if heat is None else heat[at],
                    crop_top=config.crop_top,
                    title=frame.name if frame.time_s is None else f"{frame.name} {frame.time_s:.2f} s",
                )
                writer.add(picture, frame.name)
        return said

    def _goal(self, frame: Frame) -> float:
        if frame.goal is not None:
            return frame.goal
        return float(np.radians(self._request.goal_deg or 0.0))  # `_check_goals`: it is given where labels have none


def _passes(model: Path, predictor: Predictor, request: SteerRequest, saliency: bool, note: Note) -> int:
    """Return how many networks to draw: an exported model is one network, without dropout and without gradients."""
    if isinstance(predictor, TorchPredictor):
        return request.passes
    if saliency:
        raise ArgumentError(f"{model}: an exported model cannot show saliency; give the model that it was made from")
    if request.passes:
        note(f"Note: {model}: an exported model draws no dropout masks; predictions carry their own spread alone")
    return 0


def _check_goals(model: Path, predictor: Predictor, sources: Sequence[Source], request: SteerRequest) -> None:
    if not predictor.config.goal:
        if request.goal_deg is not None:
            raise ArgumentError(f"{model}: this model takes no goal; leave --goal out")
        return
    if request.goal_deg is not None:
        return
    for source in sources:
        if source.stills is None or any(still.goal is None for still in source.stills):
            raise ArgumentError(f"{source.path}: {model} must be told where to go, and no labels say it; give --goal")


def _parameters(request: SteerRequest, passes: int, digest: str) -> dict[str, Any]:
    return {
        "passes": passes,
        "seed": request.seed,
        "every": request.every,
        "goal_deg": request.goal_deg,
        "batch": request.batch,
        "skip_bad": request.skip_bad,
        "pictures_sha256": digest,
    }


def _known(label: dict[Output, float] | None, outputs: tuple[Output, ...]) -> dict[Output, float] | None:
    return None if label is None else {name: label[name] for name in outputs if name in label}


def _where(frame: Frame) -> dict[str, Any]:
    where: dict[str, Any] = {"input": frame.input, "image": frame.name}
    if frame.index is not None and frame.time_s is not None:
        where |= {"index": frame.index, "time_s": round(frame.time_s, 6)}
    return where


def _document(
    model: Path,
    predictor: Predictor,
    sources: Sequence[Source],
    passes: int,
    frames: list[dict[str, Any]],
    skipped: int,
) -> dict[str, Any]:
    half = predictor.config.half_classes
    return {
        "format": FORMAT,
        "version": VERSION,
        "model": {
            "name": model.name,
            "sha256": file_sha256(model),
            "outputs": list(predictor.config.outputs),
            "half_classes": half,
            "angles": [round(index / half, 6) for index in range(-half, half + 1)],
        },
        "inputs": [source.name for source in sources],
        "passes": passes,
        "frames": frames,
        "skipped": skipped,
    }


def _summary(output: Path, up_to_date: bool, seconds: float) -> Steering:
    found = read_predictions(output)
    outputs = found.model.outputs

    def mean(member: str) -> dict[str, float]:
        return {name: float(np.mean([getattr(f, member.format(name)) for f in found.frames])) for name in outputs}

    return Steering(
        up_to_date=up_to_date,
        frames=len(found.frames),
        skipped=found.skipped,
        seconds=seconds,
        mean=mean("{}"),
        mean_spread=mean("{}_spread"),
        two_ways=sum(max(frame.yaw_modes, frame.pitch_modes or 1) > 1 for frame in found.frames),
        passes=found.passes,
    )
