"""How good steering networks are on frames held out of a recorded drive, beside Donkeycar's pilots."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import steering_donkeycar as donkeycar
import torch
from numpy.typing import NDArray
from steering_data import SHARE, Recorded, load, opened, part, throttles
from tables import Skipped, Table

from hrt_cli.steering.network.metrics import measure, median_angles, nearest_classes
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.precision import choose, repeatable
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.recordings.split import Split
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.batches import Frames
from hrt_cli.steering.training.calibrate import fit_temperature, softmax
from hrt_cli.steering.training.train import SteerSpec, Trainer

HALF = SteeringConfig().half_classes
OURS = {"hrt, Gaussian labels": None, "hrt, hard labels": 0.0}
"""Methods of hrt, with their sigma; None is that of the study."""
METHODS = (*OURS, "linear", "linear, augmented", "categorical", "constant")
COLUMNS = ("MAE", "RMSE", "accuracy", "NLL", "ECE", "MAE, T", "RMSE, T", "NLL, T", "ECE, T")
RATIOS = {
    "MAE, Gaussian / linear": ("MAE", "hrt, Gaussian labels", "linear"),
    "MAE, Gaussian / linear, augmented": ("MAE", "hrt, Gaussian labels", "linear, augmented"),
    "MAE, Gaussian / hard": ("MAE", "hrt, Gaussian labels", "hrt, hard labels"),
    "NLL, Gaussian / hard": ("NLL", "hrt, Gaussian labels", "hrt, hard labels"),
    "ECE, Gaussian / hard": ("ECE", "hrt, Gaussian labels", "hrt, hard labels"),
    "NLL, Gaussian / hard, last epochs": ("NLL", "hrt, Gaussian labels, last", "hrt, hard labels, last"),
    "ECE, Gaussian / hard, last epochs": ("ECE", "hrt, Gaussian labels, last", "hrt, hard labels, last"),
}
_AT_ONCE = 32
_LEAST = 1e-300

Row = dict[str, Any]


@dataclass(frozen=True)
class Study:
    """What is compared.

    Parameters
    ----------
    size : (int, int)
        Width and height of what hrt's network sees; Donkeycar's see 160 x 120.
    seeds : tuple of int
        Of the split, the networks and the batches: each holds other blocks out, the same for all methods.
    gap : int
        Frames dropped beside a block that is held out. Donkeycar records 20 frames a second, so 20 are a second.
    sigma : float
        Of the Gaussian labels.
    epochs, peer_epochs, patience : int
        At most, and Donkeycar's patience.
    """

    size: tuple[int, int] = (160, 120)
    seeds: tuple[int, ...] = (0, 1, 2)
    gap: int = 20
    sigma: float = SteerSpec().sigma
    epochs: int = SteerSpec().epochs
    peer_epochs: int = donkeycar.Recipe().epochs
    patience: int = donkeycar.Recipe().patience
    threads: int = 2

    def spec(self, seed: int, sigma: float | None) -> SteerSpec:
        spread = self.sigma if sigma is None else sigma
        return SteerSpec(
            sigma=spread, split="block", share=SHARE, gap=self.gap, seed=seed, epochs=self.epochs, patience=0,
            threads=self.threads,
        )  # fmt: skip

    def recipe(self) -> donkeycar.Recipe:
        return donkeycar.Recipe(epochs=self.peer_epochs, patience=self.patience)


class Results:
    """Figures by method and seed, in a file as soon as they are there, if there is one.

    Parameters
    ----------
    path : Path, optional
    settings : dict
        What all figures in one file have in common; a file of other settings is refused.
    """

    def __init__(self, path: Path | None, settings: Row) -> None:
        self._path = path
        self._document: Row = {"settings": settings, "results": {}}
        if path is not None and path.exists():
            found = json.loads(path.read_text(encoding="utf-8"))
            differing = [name for name in settings if found["settings"].get(name) != settings[name]]
            if differing:
                raise SystemExit(
                    f"{path}: was measured with other settings ({', '.join(differing)}); name another file"
                )
            self._document = found

    def get(self, key: str, work: Callable[[], Row]) -> Row:
        results = self._document["results"]
        if key not in results:
            began = time.monotonic()
            results[key] = {**work(), "seconds": time.monotonic() - began}
            self._write()
            print(f"  {key}: {results[key]['seconds']:.0f} s", flush=True)
        found: Row = results[key]
        return found

    def _write(self) -> None:
        if self._path is not None:
            draft = self._path.with_name(f".{self._path.name}.draft")
            draft.write_text(json.dumps(self._document, indent=2) + "\n", encoding="utf-8")
            os.replace(draft, self._path)


def accuracy(study: Study, data: Path, out: Path | None, machine: Row) -> list[Table]:
    """Train and measure each method for each seed; those that `out` has already are not trained again."""
    width, height = study.size
    arithmetic = choose("auto")
    with opened(data) as folder:
        own = load(folder, SteeringConfig(width=width, height=height))
        if own.samples.outputs != ("yaw",):
            raise Skipped(f"{data} has {', '.join(own.samples.outputs)}; this is about yaw alone")
        theirs = load(folder, SteeringConfig(width=donkeycar.WIDTH, height=donkeycar.HEIGHT))
        throttle = throttles(theirs.samples)
    settings = {
        "data": own.digest, "gap": study.gap, "share": SHARE, "recipe": asdict(study.recipe()),
        "spec": {**asdict(study.spec(0, None)), "seed": "each"}, "precision": arithmetic.precision,
        "device": arithmetic.device, "machine": machine,
    }  # fmt: skip
    results = Results(out, json.loads(json.dumps(settings)))
    rows: list[Row] = []
    for seed in study.seeds:
        parts = part(own.samples, study.gap, seed)
        for method in METHODS:
            seen = f"{width}x{height}" if method in OURS else f"{donkeycar.WIDTH}x{donkeycar.HEIGHT}"
            work = _work(method, study, seed, own, theirs, throttle, parts)
            found = results.get(f"{method}, {seen}, seed {seed}", work)
            rows += [{"seed": seed, **row, "epochs": found["epochs"]} for row in found["rows"]]
    notes = [
        f"{len(own.samples.paths)} frames, 50 ms apart (Donkeycar's 20 Hz); held out by blocks of a tenth, with "
        f"{study.gap} frames dropped on either side; other blocks for each seed, the same for all methods",
        f"e.g. seed {study.seeds[0]}: {parts_told(own, study.gap, study.seeds[0])}",
        f"hrt sees {width} x {height}, Donkeycar's pilots 160 x 120; each keeps the epoch of its lowest validation "
        "loss on these very frames, which flatters all alike",
        "errors against the exact labels, of the expected angle; linear: its output clipped to [-1, 1]; categorical, "
        "likeliest: as Donkeycar decodes it",
        "NLL and ECE over the same 15 angles; T: after temperature, fitted on one half of the held-out frames and "
        "measured on the other, in turn",
        "constant: the median of the training labels; epochs: in all, of which the best is kept; last: that of the "
        "last epoch, at which the learning rate has come down to 0",
        "linear, augmented: Donkeycar's network with hrt's augmentation; Donkeycar's own default is none",
    ]
    return [Table("accuracy", rows, notes), *summaries(rows, study.seeds)]


def parts_told(recorded: Recorded, gap: int, seed: int) -> str:
    parts = part(recorded.samples, gap, seed)
    return f"{parts.train.size} frames to learn from, {parts.validation.size} to measure by ({parts.how})"


def summaries(rows: Sequence[Row], seeds: Sequence[int]) -> list[Table]:
    """Return mean and standard deviation over the seeds, and ratios by seed."""
    names = list(dict.fromkeys(row["method"] for row in rows))
    means = [
        {"method": name, **{column: told([row[column] for row in rows if row["method"] == name]) for column in COLUMNS}}
        for name in names
    ]
    by = {(row["seed"], row["method"]): row for row in rows}
    ratios = []
    for title, (column, above, below) in RATIOS.items():
        each = [by[seed, above][column] / by[seed, below][column] for seed in seeds]
        ratios.append({
            "ratio": title, **{f"seed {seed}": one for seed, one in zip(seeds, each, strict=True)}, "all": told(each)
        })  # fmt: skip
    return [
        Table("accuracy: mean and standard deviation over the seeds", means),
        Table("accuracy: ratios (of NLL and ECE before temperature)", ratios),
    ]


def told(values: Sequence[float | None]) -> str | None:
    """Return mean and standard deviation (of one value none) in words; None where there are no values."""
    there = [value for value in values if value is not None]
    if not there:
        return None
    spread = f" ± {np.std(there, ddof=1):.3f}" if len(there) > 1 else ""
    return f"{np.mean(there):.3f}{spread}"


def _work(method: str, study: Study, seed: int, own: Recorded, theirs: Recorded, throttle: NDArray[np.float32],
          parts: Split) -> Callable[[], Row]:  # fmt: skip
    label = own.samples.steering[parts.validation, 0]
    if method in OURS:
        spec = study.spec(seed, OURS[method])
        training, validation = own.frames(parts.train), own.frames(parts.validation)
        width, height = study.size
        return lambda: train_ours(method, SteeringConfig(width=width, height=height), spec, training, validation)
    if method == "constant":
        middle = float(median_angles(own.samples.steering[parts.train])[0])
        return lambda: {"rows": [angle_row(method, np.full(len(label), middle), label)], "epochs": 0}
    kind, strengths = method.split(",")[0], Augment() if "augmented" in method else Augment.none()
    cut = [
        donkeycar.Driven(theirs.pictures[rows], theirs.samples.steering[rows, 0], throttle[rows])
        for rows in (parts.train, parts.validation)
    ]
    return lambda: train_theirs(method, kind, cut[0], cut[1], seed, study, strengths)


def train_ours(method: str, config: SteeringConfig, spec: SteerSpec, training: Frames, validation: Frames) -> Row:
    """Train as `hrt train-steer` does; measure the best epoch and the last one, at temperature 1 and after."""
    arithmetic = choose("auto")
    with repeatable(arithmetic, spec.threads):
        torch.manual_seed(spec.seed)
        trainer = Trainer(SteeringNet(config), training, validation, spec, arithmetic)
        trainer.run()
        course, rows = trainer.course, []
        pictures, label = validation.pictures[validation.rows], validation.steering[:, 0]
        for name, weights in ((method, course.best), (f"{method}, last", trainer.net.state_dict())):
            net = SteeringNet(config)
            net.load_state_dict(weights)
            predictor = TorchPredictor(net)
            probability = np.concatenate([
                predictor.probabilities(pictures[first : first + _AT_ONCE])["yaw"]
                for first in range(0, len(pictures), _AT_ONCE)
            ])  # fmt: skip
            rows.append(distribution_row(name, probability, label))
    return {"rows": rows, "epochs": course.epoch, "best_epoch": course.best_epoch}


def train_theirs(method: str, kind: str, training: donkeycar.Driven, validation: donkeycar.Driven, seed: int,
                 study: Study, strengths: Augment) -> Row:  # fmt: skip
    """Train a pilot of Donkeycar's and measure it."""
    torch.set_num_threads(study.threads)
    found = donkeycar.train_pilot(kind, training, validation, seed, study.recipe(), strengths, choose("auto").device)
    angle = donkeycar.predict(found.net, validation.pictures)[0].double()
    label = validation.angle
    if kind == "linear":
        rows = [angle_row(method, angle[:, 0].clamp(-1.0, 1.0).numpy(), label)]
    else:
        probability = torch.softmax(angle, -1).numpy()
        rows = [
            angle_row(f"{method}, likeliest", donkeycar.linear_unbin(probability), label),
            distribution_row(f"{method}, mean", probability, label),
        ]
    return {"rows": rows, "epochs": found.epochs, "best_epoch": found.best_epoch}


def angle_row(method: str, angle: NDArray[np.float64], label: NDArray[np.float32]) -> Row:
    """Return the figures of angles alone; a distribution's are None."""
    error = angle - label.astype(np.float64)
    right = nearest_classes(angle.astype(np.float32), HALF) == nearest_classes(label, HALF)
    row: Row = {"method": method, **dict.fromkeys(COLUMNS)}
    mae, rmse = float(np.abs(error).mean()), float(np.sqrt((error**2).mean()))
    return row | {"MAE": mae, "RMSE": rmse, "accuracy": float(right.mean())}


def distribution_row(method: str, probability: NDArray[np.float64], label: NDArray[np.float32]) -> Row:
    """Return the figures of distributions [n, 15] at temperature 1, and after temperature."""
    row: Row = {"method": method}
    steering = label[:, None]
    for suffix, each in (("", probability), (", T", tempered(probability, label))):
        found = measure({"yaw": each}, steering, HALF, median_angles(steering))
        row |= {f"MAE{suffix}": found.mae, f"RMSE{suffix}": found.rmse}
        row |= {} if suffix else {"accuracy": found.accuracy}
        row |= {f"NLL{suffix}": found.nll, f"ECE{suffix}": found.ece}
    return row


def tempered(probability: NDArray[np.float64], label: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return distributions after temperature scaling: that of each half of the frames fitted on the other half.

    Parameters
    ----------
    probability : float64 [n, 15]
        In the order in which the frames were taken, so that the halves are blocks.
    """
    logits = np.log(np.maximum(probability, _LEAST))
    classes = nearest_classes(label, HALF)
    first = np.arange(len(label)) < len(label) // 2
    out = np.empty_like(probability)
    for half in (first, ~first):
        out[half] = softmax(logits[half] / fit_temperature(logits[~half], classes[~half]))
    return out
