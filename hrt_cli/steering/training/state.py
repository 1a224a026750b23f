"""Where a training is, as tensors and a JSON document: all that the rest of it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from pydantic import Field, ValidationError
from torch import Tensor

from hrt_cli.artifacts.jsonio import Document, describe
from hrt_cli.steering.network.net import Output, SteeringNet

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")
"""What AdamW keeps of each parameter."""


class Epoch(Document):
    """What an epoch came to, and what the network would be worth were it the last.

    Attributes
    ----------
    epoch : int
        From 1.
    train_loss, train_mae : float
        Means over its batches, as they were seen: augmented, with dropout, with the weights of the moment. The loss
        is that of `net.total_loss`, without the regulariser.
    validation_loss : float
        The same loss of the validation frames.
    mae, rmse, accuracy, nll, ece : float
        Of the validation frames at the temperatures below: see `metrics.measure`.
    outputs : dict
        The same by output.
    temperature : dict of str to float
        By output: see `calibrate.fit_temperature`.
    dropout, spatial_dropout : float
        Probabilities of Concrete Dropout; None where there is none.
    learning_rate : float
        Of its last batch.
    """

    epoch: int = Field(ge=1)
    train_loss: float
    train_mae: float
    validation_loss: float
    mae: float
    rmse: float
    accuracy: float
    nll: float
    ece: float
    outputs: dict[Output, dict[str, float]]
    temperature: dict[Output, float]
    dropout: float
    spatial_dropout: float | None
    learning_rate: float


@dataclass
class Course:
    """How far a training has come.

    Attributes
    ----------
    epoch, batch : int
        Epochs done, and batches done of the one under way.
    loss_sum, error_sum : float
        Of the batches done of the epoch under way, times their frames.
    history : list of Epoch
    best : dict of str to Tensor
        The network's state after the best epoch so far; empty before the first.
    """

    epoch: int = 0
    batch: int = 0
    loss_sum: float = 0.0
    error_sum: float = 0.0
    history: list[Epoch] = field(default_factory=list)
    best: dict[str, Tensor] = field(default_factory=dict)

    @property
    def best_epoch(self) -> int:
        """The epoch of the lowest validation loss, from 1, of equals the first; 0 before the first.

        By it, and not by the error alone, a network pays for being wrong and sure; and against smoothed labels it
        grows with the distance from the right angle, where that against hard classes jumps at their borders.
        """
        return min(self.history, key=lambda each: each.validation_loss).epoch if self.history else 0


class _Place(Document):
    epoch: int = Field(ge=0)
    batch: int = Field(ge=0)
    loss_sum: float
    error_sum: float
    history: list[Epoch]


def packed(
    net: SteeringNet, optimiser: torch.optim.Optimizer, course: Course
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return a training as tensors on the CPU and a JSON document, for `publish_tensors`."""
    tensors = {f"net/{name}": tensor for name, tensor in net.state_dict().items()}
    tensors |= {f"best/{name}": tensor for name, tensor in course.best.items()}
    for name, parameter in net.named_parameters():
        tensors |= {f"{key}/{name}": optimiser.state[parameter][key] for key in _MOMENTS}
    place = _Place(
        epoch=course.epoch,
        batch=course.batch,
        loss_sum=course.loss_sum,
        error_sum=course.error_sum,
        history=course.history,
    )
    whole = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    return whole, place.model_dump(mode="json")


def unpacked(
    tensors: dict[str, Tensor], document: dict[str, Any], net: SteeringNet, optimiser: torch.optim.Optimizer
) -> Course:
    """Put a network and its optimiser where `packed` found them; return how far the training had come.

    Raises
    ------
    ValueError
        It is no state of such a training. Then nothing was changed.
    """
    try:
        place = _Place.model_validate(document)
    except ValidationError as error:
        raise ValueError(describe(error)) from error
    if [each.epoch for each in place.history] != list(range(1, place.epoch + 1)):
        raise ValueError("its history is not one of its epochs")
    state, parameters = net.state_dict(), dict(net.named_parameters())
    wanted = {f"net/{name}": tensor.shape for name, tensor in state.items()}
    wanted |= {f"{key}/{name}": p.shape for key in _MOMENTS[1:] for name, p in parameters.items()}
    wanted |= {f"step/{name}": torch.Size(()) for name in parameters}
    if place.history:
        wanted |= {f"best/{name}": tensor.shape for name, tensor in state.items()}
    if {name: tensor.shape for name, tensor in tensors.items()} != wanted:
        raise ValueError("its tensors are not those of this training")
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise ValueError("its numbers are not all finite")
    net.load_state_dict({name: tensors[f"net/{name}"] for name in state})
    for name, parameter in parameters.items():
        # As the optimiser makes them: of the parameter's own memory layout, which its fused kernel takes for granted.
        optimiser.state[parameter] = {
            "step": tensors[f"step/{name}"].to(parameter.device),
            **{key: torch.empty_like(parameter).copy_(tensors[f"{key}/{name}"]).detach() for key in _MOMENTS[1:]},
        }
    best = {name: tensors[f"best/{name}"] for name in state} if place.history else {}
    return Course(place.epoch, place.batch, place.loss_sum, place.error_sum, list(place.history), best)
