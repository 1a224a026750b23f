"""What predicts steering: one face for all, and a network in PyTorch behind it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrt_cli.steering.network.net import Output, SteeringConfig, SteeringNet
from hrt_cli.steering.network.pictures import prepare
from hrt_cli.steering.network.precision import on_threads
from hrt_cli.steering.network.saliency import Layer, angle_maps

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
    """A network on the CPU; see `Predictor`.

    Parameters
    ----------
    net : SteeringNet
    threads : int
        0 for as many as PyTorch takes. A single small picture is best left to one: more of them mostly wait for each
        other.
    """

    def __init__(self, net: SteeringNet, *, threads: int = 0) -> None:
        self._threads = threads
        # Weights laid out as the pictures are: else each is turned round again for every picture.
        self._net: SteeringNet = net.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def config(self) -> SteeringConfig:
        """See `Predictor`."""
        return self._net.config

    @torch.inference_mode()
    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None = None) -> Distributions:
        """See `Predictor`."""
        seen = torch.from_numpy(prepare(pictures, self.config)).contiguous(memory_format=torch.channels_last)
        with on_threads(self._threads):
            logits = self._net(seen, None if goal is None else torch.from_numpy(goal))
        return {name: values.numpy() for name, values in self._probability(logits).items()}

    @torch.inference_mode()
    def sampled(
        self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None, passes: int, seed: int
    ) -> Distributions:
        """Return the distributions of networks drawn by dropout, float64 [passes, n, 2M + 1].

        Monte-Carlo dropout (Gal and Ghahramani 2016, arXiv:1506.02142). Every picture is shown to the same `passes`
        networks, so that its answers do not depend on what else is in the batch. Only what dropout changes is computed
        anew in each pass. torch's own generator is left as it was.

        Parameters
        ----------
        pictures, goal
            As in `Predictor.probabilities`.
        passes : int
            Networks to draw, at least 1.
        seed : int
            Of the masks.
        """
        net = self._net
        seen = torch.from_numpy(prepare(pictures, self.config)).contiguous(memory_format=torch.channels_last)
        goals = None if goal is None else torch.from_numpy(goal)
        fixed = net.features(seen, goals) if net.spatial is None else net.trunk.layer4[0](net.trunk.to_layer3(seen))
        drawn = []
        with torch.random.fork_rng(devices=[]), net.sampling():
            for index in range(len(fixed)):
                torch.manual_seed(seed)
                features = fixed[index].expand(passes, *fixed.shape[1:])
                if net.spatial is not None:
                    told = None if goals is None else goals[index].expand(passes)
                    features = net.gathered(net.trunk.end(features, net.spatial), told)
                drawn.append(self._probability(net.logits(features)))
        return {name: torch.stack([each[name] for each in drawn], dim=1).numpy() for name in self.config.outputs}

    def saliency(
        self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None, output: Output, layer: Layer
    ) -> NDArray[np.float32]:
        """Return what in the pictures turned the expected angle of one output; see `saliency.angle_maps`."""
        seen = torch.from_numpy(prepare(pictures, self.config))
        return angle_maps(self._net, seen, None if goal is None else torch.from_numpy(goal), output, layer=layer)

    def _probability(self, logits: dict[Output, Tensor]) -> dict[Output, Tensor]:
        temperature = self.config.temperature
        return {name: torch.softmax(each.double() / temperature.get(name, 1.0), -1) for name, each in logits.items()}
