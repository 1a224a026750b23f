"""One face for what predicts: a model in PyTorch, or the same exported to ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from hrt_cli.steering.model import read_model
from hrt_cli.steering.network import Output, SteeringConfig, SteeringNet
from hrt_cli.steering.pictures import prepare

Distributions = dict[Output, NDArray[np.float64]]
"""By output, probabilities of the classes."""


class Predictor(Protocol):
    """Predicts steering."""

    @property
    def config(self) -> SteeringConfig:
        """What it wants to see."""

    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None = None) -> Distributions:
        """Return the distribution of each output, float64 [n, 2M + 1], temperature applied.

        Parameters
        ----------
        pictures : uint8 [n, height, width, 3]
            Fitted (`pictures.fitted`).
        goal : float32 [n], optional
            Bearings in radians; needed where the configuration says so.
        """


class TorchPredictor:
    """A network on the CPU; see `Predictor`."""

    def __init__(self, net: SteeringNet) -> None:
        self._net = net.eval()

    @property
    def config(self) -> SteeringConfig:
        """See `Predictor`."""
        return self._net.config

    @torch.inference_mode()
    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None = None) -> Distributions:
        """See `Predictor`."""
        seen = torch.from_numpy(prepare(pictures, self.config)).contiguous(memory_format=torch.channels_last)
        logits = self._net(seen, None if goal is None else torch.from_numpy(goal))
        return {
            name: torch.softmax(values.double() / self.config.temperature.get(name, 1.0), dim=-1).numpy()
            for name, values in logits.items()
        }


def load_predictor(path: Path) -> Predictor:
    """Return what predicts by a model file (`model.read_model`)."""
    return TorchPredictor(read_model(path))
