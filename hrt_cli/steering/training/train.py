"""Training a steering network: AdamW, a learning rate that rises and falls, and an end once nothing gets better."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Progress, silent
from hrt_cli.steering.network.angles import expected_angle
from hrt_cli.steering.network.metrics import measure
from hrt_cli.steering.network.net import Output, SteeringNet, total_loss
from hrt_cli.steering.network.precision import Arithmetic
from hrt_cli.steering.network.signals import undivided
from hrt_cli.steering.recordings.split import By
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.batches import Batch, Frames, batch_count, dropout_seed, epoch_batches, ready
from hrt_cli.steering.training.calibrate import fit_temperature, softmax
from hrt_cli.steering.training.state import Course, Epoch
from hrt_cli.steering.training.targets import targets

_AT_ONCE = 128
"""Frames in a forward pass that only measures."""
_FIGURES = ("mae", "rmse", "accuracy", "nll", "ece")


@dataclass(frozen=True)
class SteerSpec:
    """Hyper-parameters of a training.

    Attributes
    ----------
    sigma : float
        Of the smoothed labels, in the unit of the angles; 0 is one class each.
    cost_scale_s : float
        Where the frames know what turning costs, of the labels made of that (`targets.cost_labels`); 0 makes none.
    entropy_weight, dropout_weight : float
        lambda2 and lambda1 of the loss.
    length_scale : float
        l of Concrete Dropout's prior: wd = l^2 / (2 N), dd = 1 / N for N training frames.
    epochs : int
        At most.
    batch : int
        Frames of a step, at least 2.
    learning_rate : float
        The highest: it rises to it over the first tenth of the steps and falls to 0 along a cosine.
    weight_decay : float
        Of AdamW (decoupled), for the weights that the regulariser does not hold.
    clip_norm : float
        Longest gradient.
    patience : int
        Epochs without a lower validation loss after which the training ends; 0: it never ends early.
    balance : float
        From 0, frames as they are, to 1, every class alike: see `balance.class_weights`.
    augment : Augment
    goal : bool
        Tell the network where to go, where the frames say it.
    split : {"auto", "session", "block", "random"}
    share : float
        Of the frames that is held out.
    gap : int
        Frames left out beside those: see `split.split`.
    seed : int
    threads : int
        Of PyTorch on the CPU; the result depends on it in its last digits.
    """

    sigma: float = 0.12
    cost_scale_s: float = 0.12
    entropy_weight: float = 0.05
    dropout_weight: float = 1.0
    length_scale: float = 1e-2
    epochs: int = 60
    batch: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    clip_norm: float = 5.0
    patience: int = 15
    balance: float = 0.0
    augment: Augment = field(default_factory=Augment)
    goal: bool = True
    split: By = "auto"
    share: float = 0.2
    gap: int = 10
    seed: int = 0
    threads: int = 2


_WARM_UP = 0.1


def learning_rate_at(step: int, steps: int, peak: float) -> float:
    """Return the learning rate of a step, from 0 of `steps`: a straight rise to `peak`, then half a cosine to 0."""
    rise = max(1, round(_WARM_UP * steps))
    if step < rise:
        return peak * (step + 1) / rise
    return 0.5 * peak * (1.0 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))


def constant_steering(training: Frames) -> NDArray[np.float32]:
    """Return the constant that errs least on the training frames, float32 [outputs]: their median."""
    return np.asarray(np.median(training.steering, axis=0), np.float32)


class Trainer:
    """A training under way.

    Parameters
    ----------
    net : SteeringNet
        It is trained in place and moved to the device.
    training, validation : Frames
    spec : SteerSpec
    arithmetic : Arithmetic
        The caller computes in `precision.repeatable`.

    Attributes
    ----------
    course : Course
        How far it has come.
    whole : bool
        Whether network, optimiser and course agree; not so after an error in a step.
    """

    def __init__(
        self, net: SteeringNet, training: Frames, validation: Frames, spec: SteerSpec, arithmetic: Arithmetic
    ) -> None:
        self.net = net.to(arithmetic.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = _optimiser(self.net, spec)
        self.course = Course()
        self.whole = True
        self.frames_seen = 0
        self._training, self._validation = training, validation
        self._spec, self._arithmetic = spec, arithmetic
        self._baseline = constant_steering(training)
        self.batches = batch_count(len(training), spec.batch)
        self.steps = spec.epochs * self.batches

    @property
    def step(self) -> int:
        """Steps done."""
        return self.course.epoch * self.batches + self.course.batch

    @property
    def ended(self) -> bool:
        """Whether all epochs are done, or the last so many were of no use."""
        course, patience = self.course, self._spec.patience
        return course.epoch >= self._spec.epochs or 0 < patience <= course.epoch - course.best_epoch

    def run(self, progress: Progress = silent, keep: Callable[[], None] = lambda: None) -> None:
        """Train to the end, from wherever `course` is.

        Parameters
        ----------
        progress : Progress
            Called with (steps done, steps).
        keep : callable
            Called after each step: the moment to save the training.

        Raises
        ------
        ArgumentError
            The loss is no number any more.
        """
        while not self.ended:
            batches = epoch_batches(
                self._training,
                self.net.config,
                batch=self._spec.batch,
                balance_strength=self._spec.balance,
                strengths=self._spec.augment,
                seed=self._spec.seed,
                epoch=self.course.epoch,
                first=self.course.batch,
            )
            with closing(batches):
                for batch in batches:
                    with undivided():
                        self.whole = False
                        self._step(batch)
                        self.whole = True
                    progress(self.step, self.steps)
                    keep()
            measured = self._measure()
            with undivided():
                self._close_epoch(measured)

    def _step(self, batch: Batch) -> None:
        spec, course, net = self._spec, self.course, self.net
        device = self._arithmetic.device
        rate = learning_rate_at(self.step, self.steps, spec.learning_rate)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        torch.manual_seed(dropout_seed(spec.seed, course.epoch, course.batch))
        half = net.config.half_classes
        costs = None if batch.costs is None else batch.costs.flatten(0, 1)
        wanted = targets(net.config.outputs, batch.steering, costs, half, spec.sigma, spec.cost_scale_s)
        labels = {name: each.to(device) for name, each in wanted.items()}
        net.train()
        with torch.autocast(device, torch.bfloat16, enabled=self._arithmetic.bf16):
            logits = net(batch.pictures.to(device), None if batch.goal is None else batch.goal.to(device))
        count = batch.steering.shape[0]
        own = {name: values.unflatten(0, (count, -1))[:, 0] for name, values in logits.items()}
        # What the steering of the frame teaches, it teaches about its own goal; costs are known for all.
        asked = {name: logits[name] if len(labels[name]) > count else own[name] for name in logits}
        loss = total_loss(asked, labels, spec.entropy_weight)
        n = len(self._training)
        penalty = net.penalty(weight_decay=spec.length_scale**2 / (2.0 * n), dropout_decay=1.0 / n)
        self.optimiser.zero_grad(set_to_none=True)
        (loss + spec.dropout_weight * penalty).backward()
        norm = clip_gradients(net.parameters(), spec.clip_norm)
        value = loss.item()
        if not (math.isfinite(value) and math.isfinite(norm)):
            raise self._diverged()
        self.optimiser.step()
        course.batch += 1
        course.loss_sum += value * count
        course.error_sum += _absolute_error(own, batch.steering) * count
        self.frames_seen += count

    def _measure(self) -> Epoch:
        """Return what the epoch whose batches are done came to."""
        net, spec, course = self.net, self._spec, self.course
        logits = self._logits(self._validation)
        steering = torch.from_numpy(self._validation.steering)
        half = net.config.half_classes
        temperature: dict[Output, float] = {}
        probability: dict[Output, NDArray[np.float64]] = {}
        costs = None if self._validation.costs is None else torch.from_numpy(self._validation.costs[:, 0])
        labels = targets(net.config.outputs, steering, costs, half, spec.sigma, spec.cost_scale_s)
        certain = targets(net.config.outputs, steering, costs, half, 0.0, spec.cost_scale_s)
        for name, values in logits.items():
            if not np.isfinite(values).all():
                raise self._diverged()
            temperature[name] = fit_temperature(values, certain[name].double().numpy())
            probability[name] = softmax(values / temperature[name])
        loss = total_loss(
            {name: torch.from_numpy(values) for name, values in logits.items()}, labels, spec.entropy_weight
        )
        found = measure(probability, self._validation.steering, half, self._baseline)
        frames = len(self._training)
        return Epoch(
            epoch=course.epoch + 1,
            train_loss=course.loss_sum / frames,
            train_mae=course.error_sum / frames,
            validation_loss=loss.item(),
            **{key: float(getattr(found, key)) for key in _FIGURES},
            outputs={
                name: {key: float(getattr(each, key)) for key in (*_FIGURES, "constant_baseline_mae")}
                for name, each in found.outputs.items()
            },
            temperature=temperature,
            dropout=net.dropout.p.item(),
            spatial_dropout=None if net.spatial is None else net.spatial.p.item(),
            learning_rate=learning_rate_at(self.step - 1, self.steps, spec.learning_rate),
        )

    def _close_epoch(self, measured: Epoch) -> None:
        course = self.course
        course.history.append(measured)
        course.epoch, course.batch, course.loss_sum, course.error_sum = course.epoch + 1, 0, 0.0, 0.0
        if course.best_epoch == course.epoch:
            course.best = {name: tensor.detach().cpu().clone() for name, tensor in self.net.state_dict().items()}

    @torch.inference_mode()
    def _logits(self, frames: Frames) -> dict[Output, NDArray[np.float64]]:
        """Return logits in float32 arithmetic, in which predictions are made, as float64 [n, classes]."""
        net, device = self.net.eval(), self._arithmetic.device
        found: dict[Output, list[Tensor]] = {name: [] for name in net.config.outputs}
        for start in range(0, len(frames), _AT_ONCE):
            batch = ready(frames.cut(np.arange(start, min(start + _AT_ONCE, len(frames)))), net.config)
            logits = net(batch.pictures.to(device), None if batch.goal is None else batch.goal.to(device))
            for name, values in logits.items():
                found[name].append(values.double().cpu())
        return {name: torch.cat(parts).numpy() for name, parts in found.items()}

    def _diverged(self) -> ArgumentError:
        self.whole = False
        where = f"epoch {self.course.epoch + 1}, learning rate {self._spec.learning_rate:g}"
        return ArgumentError(f"the training diverged ({where}): its loss is no number; use a lower --learning-rate")


def clip_gradients(parameters: Iterable[torch.nn.Parameter], clip_norm: float) -> float:
    """Make the gradients together no longer than a norm, as `clip_grad_norm_` does; return what it was.

    PyTorch's multiplies all of them even where that is by 1; that is a pass over all the memory that they take.
    """
    held = list(parameters)
    norm = torch.nn.utils.get_total_norm([each.grad for each in held if each.grad is not None])
    if not norm.item() + 1e-6 <= clip_norm:
        torch.nn.utils.clip_grads_with_norm_(held, clip_norm, norm)
    return norm.item()


def _optimiser(net: SteeringNet, spec: SteerSpec) -> torch.optim.AdamW:
    held = net.undecayed()
    named = list(net.named_parameters())
    groups = [
        {"params": [p for name, p in named if name not in held], "weight_decay": spec.weight_decay},
        {"params": [p for name, p in named if name in held], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=spec.learning_rate, fused=True)


def _absolute_error(logits: dict[Output, Tensor], steering: Tensor) -> float:
    """Return the mean absolute error of the expected angles."""
    with torch.no_grad():
        angles = [expected_angle(values.float().softmax(-1))[0] for values in logits.values()]
        return float((torch.stack(angles, dim=1).cpu() - steering).abs().mean())
