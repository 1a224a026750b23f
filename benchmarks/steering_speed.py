"""How fast steering networks learn and answer, beside PyTorch as one would write it first."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from steering_data import SHARE, load, made_up, opened, part
from tables import Skipped, Table

from hrt_cli.steering.network.angles import smoothed_labels
from hrt_cli.steering.network.gemm import Conv3x3
from hrt_cli.steering.network.metrics import expected_angles
from hrt_cli.steering.network.model import read_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet, total_loss
from hrt_cli.steering.network.pictures import prepare
from hrt_cli.steering.network.precision import Arithmetic, choose, repeatable
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.onnx.export import export_onnx
from hrt_cli.steering.onnx.model import OnnxPredictor
from hrt_cli.steering.training.augment import augment
from hrt_cli.steering.training.batches import Frames
from hrt_cli.steering.training.stage import train_steer_file
from hrt_cli.steering.training.train import SteerSpec, Trainer

_AT_ONCE = 32
_TURN, _UNCOUNTED, _REST_S = 10, 2, 0.25
"""Answers of one predictor at a time, how many of them are not counted, and for how long nobody computes before them:
threads of the one before still spin for a while."""

Answer = Callable[[NDArray[np.uint8]], NDArray[np.float64]]


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Parameters
    ----------
    width, height : int
        Of the pictures whose answers are timed.
    trainings : tuple of (int, int, int)
        Width, height and batch of the trainings.
    steps, rounds : int
        Steps of a training that are timed at a time, and how often each training has its turn.
    turns : int
        Turns of each predictor, of `_TURN` answers.
    epochs : int
        Of the model whose answers are timed.
    """

    width: int = 160
    height: int = 120
    trainings: tuple[tuple[int, int, int], ...] = ((160, 120, 32), (160, 120, 64), (64, 32, 24))
    steps: int = 8
    rounds: int = 7
    turns: int = 25
    epochs: int = 6


NORMAL = Size()
QUICK = Size(trainings=((160, 120, 32), (64, 32, 24)), steps=2, rounds=2, turns=4, epochs=1)


class PlainTraining:
    """The same network, loss and clipping in float32 and NCHW, with AdamW as it comes, one thing after the other."""

    def __init__(self, config: SteeringConfig, frames: Frames, spec: SteerSpec, device: str) -> None:
        torch.manual_seed(spec.seed)
        self.net = SteeringNet(config).to(device)
        for module in self.net.modules():
            if isinstance(module, Conv3x3):
                module.__class__ = torch.nn.Conv2d  # PyTorch's own forward
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=spec.learning_rate, weight_decay=spec.weight_decay, fused=False
        )
        self._frames, self._spec, self._device = frames, spec, device
        self._rng = np.random.default_rng(spec.seed)

    def step(self, rows: NDArray[np.int64]) -> float:
        """Learn from some frames; return the loss."""
        spec, net = self._spec, self.net
        pictures, steering, *_ = augment(*self._frames.cut(rows), spec.augment, self._rng)
        # `prepare` gives a transposed view; contiguous is NCHW.
        seen = torch.from_numpy(prepare(pictures, net.config)).contiguous().to(self._device)
        yaw = torch.from_numpy(steering[:, 0])
        labels = smoothed_labels(yaw, net.config.half_classes, spec.sigma).to(self._device)
        net.train()
        loss = total_loss(net(seen), {"yaw": labels}, spec.entropy_weight)
        n = len(self._frames)
        penalty = net.penalty(weight_decay=spec.length_scale**2 / (2.0 * n), dropout_decay=1.0 / n)
        self.optimiser.zero_grad()
        (loss + spec.dropout_weight * penalty).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), spec.clip_norm)
        self.optimiser.step()
        return loss.item()


def plain_seconds(training: PlainTraining, frames: int, steps: int) -> float:
    began = time.perf_counter()
    for rows in np.array_split(np.arange(frames), steps):
        training.step(rows)
    return time.perf_counter() - began


def our_seconds(net: SteeringNet, frames: Frames, spec: SteerSpec, arithmetic: Arithmetic) -> float:
    """Time an epoch of hrt's own training, its first batch included, to the end of its last step."""
    few = Frames(frames.pictures, frames.rows[:2], frames.steering[:2], None)
    ends: list[float] = []
    with repeatable(arithmetic, spec.threads):
        trainer = Trainer(net, frames, few, spec, arithmetic)
        began = time.perf_counter()
        trainer.run(keep=lambda: ends.append(time.perf_counter()))
    return ends[-1] - began


def speed(size: Size, threads: int) -> list[Table]:
    """Time both trainings in turns, on frames that are made up."""
    torch.set_num_threads(threads)
    arithmetic = choose("auto")
    rows = []
    for width, height, batch in size.trainings:
        config = SteeringConfig(width=width, height=height)
        spec = SteerSpec(batch=batch, epochs=1, patience=0, threads=threads)
        count = batch * size.steps
        pictures, steering = made_up(count, width, height)
        frames = Frames(pictures, np.arange(count), steering, None)
        net, plain = SteeringNet(config), PlainTraining(config, frames, spec, arithmetic.device)
        ours, theirs = [], []
        for turn in range(size.rounds + 1):
            seconds = our_seconds(net, frames, spec, arithmetic), plain_seconds(plain, count, size.steps)
            if turn > 0:  # the first one sets things up
                ours.append(seconds[0])
                theirs.append(seconds[1])
        ratio = np.array(theirs) / np.array(ours)
        rows.append({
            "size": f"{width}x{height}", "batch": batch, "hrt, images/s": count / float(np.median(ours)),
            "plain, images/s": count / float(np.median(theirs)), "hrt is faster by": float(np.median(ratio)),
            "least": float(ratio.min()), "most": float(ratio.max()),
        })  # fmt: skip
    notes = [
        f"{size.steps} steps at a time, {size.rounds} turns each; {arithmetic_told()}",
        f"hrt computes in {arithmetic.precision}, channels last, AdamW fused, batches made by a thread beside;",
        "plain: float32, NCHW, AdamW not fused, no thread beside; the same network, loss, clipping and augmentation",
    ]
    return [Table("speed: training", rows, notes)]


def arithmetic_told() -> str:
    """Say what `--precision auto` computes in here, and why."""
    found = choose("auto")
    native = "computes bfloat16 natively" if found.bf16 else "only emulates bfloat16"
    return f"this {found.device} {native}"


def latency(size: Size, threads: int, data: Path, gap: int, seed: int) -> list[Table]:
    """Time answers to one picture at a time, and measure what each predictor is worth on held-out frames."""
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise Skipped("onnx and onnxruntime are not installed: pip install 'hrt[onnx]'") from error
    del onnx, onnxruntime
    torch.set_num_threads(threads)
    config = SteeringConfig(width=size.width, height=size.height)
    with opened(data) as folder, tempfile.TemporaryDirectory() as name:
        recorded = load(folder, config)
        parts = part(recorded.samples, gap, seed)
        spec = SteerSpec(split="block", share=SHARE, gap=gap, seed=seed, epochs=size.epochs, threads=threads)
        model = Path(name) / "model.safetensors"
        done = train_steer_file([folder], model, spec, config)
        torch.set_num_threads(threads)
        learnt = [recorded.samples.paths[row] for row in parts.train]
        answers = predictors(model, learnt, threads)
        held_out = recorded.frames(parts.validation)
        pictures = held_out.pictures[held_out.rows]
        spent = timed(answers, pictures, size.turns)
        mae = {name: mean_error(answer, pictures, held_out.steering[:, 0]) for name, answer in answers.items()}
    base = float(np.median(spent["PyTorch, eager"]))
    rows = [
        {
            "predictor": name, "ms a picture": float(np.median(spent[name])) * 1e3,
            "95 of 100 below": float(np.percentile(spent[name], 95)) * 1e3,
            "faster than eager by": base / float(np.median(spent[name])), "MAE": mae[name],
        }
        for name in answers
    ]  # fmt: skip
    loss = mae["ONNX, int8"] / mae["ONNX, float32"] - 1.0
    notes = [
        f"{size.width} x {size.height}, one picture at a time, from bytes to probabilities; {threads} threads;",
        f"{len(spent['PyTorch, eager'])} answers each, {_TURN} in turn, of which the first {_UNCOUNTED} do not count",
        f"MAE on {len(pictures)} frames held out ({parts.how}), after {len(done.record.history)} epochs; "
        f"a constant: {done.record.constant_baseline_mae:.3f}",
        f"int8, calibrated on training frames only, loses {loss:+.2%} of the MAE of float32",
    ]
    return [Table("latency", rows, notes)]


def predictors(model: Path, calibration: list[Path], threads: int) -> dict[str, Answer]:
    """Return what answers by a model: pictures uint8 [n, height, width, 3] to probabilities [n, classes]."""
    eager = read_model(model)

    def plain(pictures: NDArray[np.uint8]) -> NDArray[np.float64]:
        with torch.no_grad():
            seen = torch.from_numpy(prepare(pictures, eager.config)).contiguous()
            logits = eager(seen)["yaw"] / eager.config.temperature.get("yaw", 1.0)
            return np.asarray(torch.softmax(logits, -1).double().numpy())

    found: dict[str, Answer] = {"PyTorch, eager": plain}
    ours = TorchPredictor(read_model(model))
    found["hrt, PyTorch"] = lambda pictures: ours.probabilities(pictures)["yaw"]
    for precision in ("float32", "int8"):
        path = model.with_name(f"{precision}.onnx")
        export_onnx(model, path, int8=precision == "int8", calibration=calibration if precision == "int8" else ())
        found[f"ONNX, {precision}"] = _onnx(OnnxPredictor(path, threads=threads))
    return found


def _onnx(predictor: OnnxPredictor) -> Answer:
    return lambda pictures: predictor.probabilities(pictures)["yaw"]


def timed(answers: Mapping[str, Answer], pictures: NDArray[np.uint8], turns: int) -> dict[str, list[float]]:
    """Return the seconds of each answer to one picture that counts, the predictors taking turns."""
    spent: dict[str, list[float]] = {name: [] for name in answers}
    for turn in range(turns):
        for name, answer in answers.items():
            time.sleep(_REST_S)
            for number in range(_TURN):
                at = (turn * _TURN + number) % len(pictures)
                began = time.perf_counter()
                answer(pictures[at : at + 1])
                if number >= _UNCOUNTED:
                    spent[name].append(time.perf_counter() - began)
    return spent


def mean_error(answer: Answer, pictures: NDArray[np.uint8], yaw: NDArray[np.float32]) -> float:
    """Return the mean absolute error of the expected angles."""
    parts = [answer(pictures[first : first + _AT_ONCE]) for first in range(0, len(pictures), _AT_ONCE)]
    return float(np.abs(expected_angles(np.concatenate(parts)) - yaw).mean())
