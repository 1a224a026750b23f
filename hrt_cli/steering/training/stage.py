"""The train-steer stage: folders of steering data become a steering model, from file to file."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import Field, ValidationError

from hrt_cli.artifacts.jsonio import Document, canonical, describe
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import check_target, publishing
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.model import model_provenance, publish_model, read_model, read_training
from hrt_cli.steering.network.net import Output, SteeringConfig, SteeringNet
from hrt_cli.steering.network.precision import Arithmetic, Precision, choose, repeatable
from hrt_cli.steering.network.resnet import IMAGENET_MEAN, IMAGENET_STD, load_published
from hrt_cli.steering.network.signals import undivided
from hrt_cli.steering.recordings.samples import check_lens
from hrt_cli.steering.training.checkpoint import Checkpoint
from hrt_cli.steering.training.gather import Gathered, gather
from hrt_cli.steering.training.state import Epoch
from hrt_cli.steering.training.train import SteerSpec, Trainer, constant_steering

STAGE = "train-steer"
STAGE_VERSION = 4


class Record(Document):
    """What a model file tells of its training.

    Attributes
    ----------
    history : tuple of Epoch
    best_epoch : int
        Whose weights the file holds, from 1.
    constant : tuple of float
        The best constant steering by the training frames, by output.
    constant_baseline_mae : float
        Its mean absolute error on the validation frames.
    train_frames, validation_frames, skipped : int
    sessions : int
    split : str
        How the validation frames were chosen.
    """

    history: tuple[Epoch, ...] = Field(min_length=1)
    best_epoch: int = Field(ge=1)
    constant: tuple[float, ...]
    constant_baseline_mae: float
    train_frames: int
    validation_frames: int
    skipped: int
    sessions: int
    split: str

    @property
    def best(self) -> Epoch:
        """The epoch whose weights the file holds."""
        return self.history[self.best_epoch - 1]


@dataclass(frozen=True)
class SteerTraining:
    """What the train-steer stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    resumed_at : int
        Steps that an earlier run had done before it was stopped; 0 where there was none.
    seconds : float
        Wall-clock time of this run's share of the training.
    images_per_second : float or None
        Training frames a second in this run; None where it saw none.
    arithmetic : Arithmetic
    outputs : tuple of str
    record : Record
        History, best epoch, numbers of frames.
    """

    up_to_date: bool
    resumed_at: int
    seconds: float
    images_per_second: float | None
    arithmetic: Arithmetic
    outputs: tuple[Output, ...]
    record: Record

    @property
    def no_better_than_constant(self) -> bool:
        """Whether steering always the same would err as little."""
        return self.record.best.mae >= self.record.constant_baseline_mae


def train_steer_file(
    folders: Sequence[Path],
    output: Path,
    spec: SteerSpec,
    config: SteeringConfig,
    *,
    validation: Sequence[Path] = (),
    weights: Path | None = None,
    init: Path | None = None,
    metrics: Path | None = None,
    precision: Precision = "auto",
    correction: float = 0.2,
    skip_bad: bool = False,
    existing: Existing = REFUSE,
    progress: Progress = silent,
    note: Note = unheard,
) -> SteerTraining:
    """Train a steering network on folders of steering data and write it to `output`.

    The weights kept are those of the best epoch (`Course.best_epoch`), with the temperatures fitted there. A
    training that is stopped, even by a power cut, leaves a `Checkpoint` beside `output`; the next run with the same
    data and settings on the same kind of machine goes on from there and writes the bytes that one run would have.

    The fingerprint covers device and precision as used, and on a CPU the threads: a model that another machine made
    with others is not up to date here. Say them (`precision`, `spec.threads`) where machines share files.

    Parameters
    ----------
    folders : sequence of Path
        See `samples.read_samples`.
    output : Path
        The model to write, safetensors.
    spec : SteerSpec
        Hyper-parameters.
    config : SteeringConfig
        The network; its outputs and whether it is told where to go follow the data.
    validation : sequence of Path
        Folders to hold out instead of a split.
    weights : Path, optional
        torchvision's `resnet18` to begin from (`resnet.load_published`); pictures are then normalised for it.
    init : Path, optional
        A steering model of the same configuration to begin from; its normalisation is taken over.
    metrics : Path, optional
        Gets the history, a JSON object an epoch (JSON Lines).
    precision : {"auto", "float32", "bf16"}
        See `precision.choose`.
    correction : float
        What is added to the steering of a left camera's picture.
    skip_bad : bool
        Leave bad rows and pictures out instead of refusing them.
    existing : Existing
        What to do where outputs exist.
    progress : Progress
        Called with (done, in all): first pictures read, then steps.
    note : Note
        Told what became of a checkpoint, and more.

    Raises
    ------
    InputError
        Data, weights or model cannot be used.
    ArgumentError
        The data cannot be split, or the training diverges.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    if weights is not None and init is not None:
        raise ArgumentError("--weights and --init are two beginnings; give one of them")
    begun_from = {role: path for role, path in (("weights", weights), ("init", init)) if path is not None}
    for target in filter(None, (output, metrics)):
        check_target(target, list(begun_from.values()))
    if metrics is not None and output.resolve() == metrics.resolve():
        raise OutputError(f"{metrics}: the metrics would overwrite the model; choose another name")
    data = gather(
        folders, validation, spec, config, correction=correction, skip_bad=skip_bad, progress=progress, note=note
    )
    for target in filter(None, (output, metrics)):
        check_target(target, list(data.inputs.values()))
    arithmetic = choose(precision, note)
    net = _beginning(data.config, spec, weights, init)
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=data.inputs | begun_from,
        parameters=_parameters(data, net.config, spec, arithmetic, correction),
        outputs={output: model_provenance},
        existing=existing,
    )
    checkpoint = Checkpoint(output, job.provenance, note)
    if job.up_to_date:
        checkpoint.remove_own()
        record = read_record(output)
        done = SteerTraining(True, 0, 0.0, None, arithmetic, data.config.outputs, record)
    else:
        _refuse_existing(metrics, existing)
        done = _train(output, net, data, spec, arithmetic, checkpoint, job.provenance, progress)
    _write_metrics(metrics, done.record, existing)
    return done


def read_record(path: Path) -> Record:
    """Read what a model file tells of its training.

    Raises
    ------
    InputError
        It does not, or not in this way.
    """
    found = read_training(path)
    if found is None:
        raise InputError(path, "does not say how it was trained")
    try:
        return Record.model_validate_json(json.dumps(found))
    except ValidationError as error:
        raise InputError(path, f"training.{describe(error)}") from error


def _train(
    output: Path,
    net: SteeringNet,
    data: Gathered,
    spec: SteerSpec,
    arithmetic: Arithmetic,
    checkpoint: Checkpoint,
    provenance: Provenance,
    progress: Progress,
) -> SteerTraining:
    with ExitStack() as stack:
        # Both load parts of PyTorch, and half a module that a signal leaves behind fails whoever asks for it next.
        with undivided():
            stack.enter_context(repeatable(arithmetic, spec.threads))
            trainer = Trainer(net, data.training, data.validation, spec, arithmetic)
        checkpoint.resume(trainer)
        resumed_at = trainer.step
        began = time.monotonic()
        try:
            trainer.run(progress, lambda: checkpoint.keep(trainer))
            seconds = time.monotonic() - began
            record = _record(trainer, data)
            best = SteeringNet(net.config)
            best.load_state_dict(trainer.course.best)
            config = net.config.model_copy(update={"temperature": record.best.temperature})
            publish_model(output, best, config, provenance, record.model_dump(mode="json"))
        except BaseException:  # a signal, too
            checkpoint.stopped(trainer)
            raise
    checkpoint.remove()
    speed = trainer.frames_seen / seconds if trainer.frames_seen and seconds > 0 else None
    return SteerTraining(False, resumed_at, seconds, speed, arithmetic, net.config.outputs, record)


def _record(trainer: Trainer, data: Gathered) -> Record:
    course = trainer.course
    constant = constant_steering(data.training)
    record = Record(
        history=tuple(course.history),
        best_epoch=course.best_epoch,
        constant=tuple(float(value) for value in constant),
        constant_baseline_mae=float(np.abs(data.validation.steering.astype(np.float64) - constant).mean()),
        train_frames=len(data.training),
        validation_frames=len(data.validation),
        skipped=data.skipped,
        sessions=data.sessions,
        split=data.how,
    )
    # As the file will give it back, so that what is written from it now is what is written from it then.
    return Record.model_validate_json(canonical(record.model_dump(mode="json")))


def _beginning(config: SteeringConfig, spec: SteerSpec, weights: Path | None, init: Path | None) -> SteeringNet:
    """Return the network to begin with, on the CPU."""
    if init is not None:
        net = read_model(init)
        check_lens(init, net.config.hfov_deg, config.hfov_deg)
        free = {"mean", "std", "temperature", "hfov_deg", "mirrored"}
        given, wanted = net.config.model_dump(exclude=free), config.model_dump(exclude=free)
        for name in given:
            if given[name] != wanted[name]:
                raise InputError(init, f"its {name} is {given[name]}, and that of this training {wanted[name]}")
        lens = net.config.hfov_deg if config.hfov_deg is None else config.hfov_deg
        net.config = net.config.model_copy(update={"temperature": {}, "hfov_deg": lens, "mirrored": config.mirrored})
        return net
    if weights is not None:
        config = config.model_copy(update={"mean": IMAGENET_MEAN, "std": IMAGENET_STD})
    with torch.random.fork_rng():
        torch.manual_seed(spec.seed)
        net = SteeringNet(config)
    if weights is not None:
        load_published(net.trunk, weights)
    return net


def _parameters(
    data: Gathered, config: SteeringConfig, spec: SteerSpec, arithmetic: Arithmetic, correction: float
) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(json.dumps(asdict(spec)))
    if arithmetic.device == "cuda":
        del told["threads"]
    return {
        **told,
        "config": json.loads(config.model_dump_json()),
        **data.digests,
        "device": arithmetic.device,
        "precision": arithmetic.precision,
        "correction": correction,
    }


def _refuse_existing(path: Path | None, existing: Existing) -> None:
    if path is not None and path.exists() and not (existing.overwrite or existing.force):
        raise OutputError(f"{path}: exists and was not made by this run; use --overwrite to replace it")


def _write_metrics(path: Path | None, record: Record, existing: Existing) -> None:
    if path is None:
        return
    text = "".join(json.dumps(each.model_dump(mode="json"), allow_nan=False) + "\n" for each in record.history)

    def check(draft: Path) -> None:
        if draft.read_text(encoding="utf-8") != text:
            raise OutputError(f"{path}: did not read back as it was written (is the disk full?)")

    if path.is_file() and path.read_bytes() == text.encode():
        return
    _refuse_existing(path, existing)
    with publishing(path, check) as draft:
        draft.write_text(text, encoding="utf-8")
