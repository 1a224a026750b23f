"""Where in a picture the network looked: gradients of its answer times what it saw there.

Grad-CAM (Selvaraju et al. 2017, arXiv:1610.02391) weighs the maps A_k of a convolution by the mean over the picture of
the gradient of the answer y (eq. 1) and sums (eq. 2):

    a_k = mean over i, j of dy/dA_kij,    L_ij = sum_k a_k A_kij

The mean forgets where a map counted: a network that averages its features by columns and listens to the left ones only
would be shown looking to the right as well. So the gradient stays where it is (HiResCAM: Draelos and Carin 2020,
arXiv:2011.08891):

    L_ij = sum_k dy/dA_kij A_kij

which on the last convolution of a network with one column and no goal is the same map, and otherwise is the one that
adds up to how y changes when all features grow by a share.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrt_cli.steering.network.angles import expected_angle
from hrt_cli.steering.network.net import Output, SteeringNet

Layer = Literal["layer3", "layer4"]
"""Which stage's features: the last one's, a cell for 32 x 32 pixels, or the finer before it, one for 16 x 16."""


def angle_maps(
    net: SteeringNet, pictures: Tensor, goal: Tensor | None, output: Output, *, layer: Layer = "layer4"
) -> NDArray[np.float32]:
    """Return what turned the expected angle of one output: above 0 to the right (up), below 0 to the left (down).

    Both signs are kept. The paper's ReLU leaves out what speaks against a class; an angle has no "against", but two
    sides.

    Parameters
    ----------
    net : SteeringNet
        In evaluation mode.
    pictures, goal
        As `SteeringNet.forward` takes them.

    Returns
    -------
    float32 [n, height, width]
        L, interpolated to the size of the pictures.
    """
    temperature = net.config.temperature.get(output, 1.0)

    def answer(logits: Tensor) -> Tensor:
        return expected_angle(torch.softmax(logits / temperature, dim=-1))[0]

    return _scaled(_maps(net, pictures, goal, output, answer, layer), pictures)


def class_maps(
    net: SteeringNet, pictures: Tensor, goal: Tensor | None, output: Output, chosen: Tensor, *, layer: Layer = "layer4"
) -> NDArray[np.float32]:
    """Return what speaks for one class of each picture, by its logit: ReLU(L), as in the paper.

    Parameters
    ----------
    net, pictures, goal
        As in `angle_maps`.
    chosen : int64 [n]
        The class of each picture.

    Returns
    -------
    float32 [n, height, width]
        At least 0.
    """

    def answer(logits: Tensor) -> Tensor:
        return logits.gather(1, chosen[:, None])[:, 0]

    return _scaled(_maps(net, pictures, goal, output, answer, layer).relu(), pictures)


def _maps(
    net: SteeringNet,
    pictures: Tensor,
    goal: Tensor | None,
    output: Output,
    answer: Callable[[Tensor], Tensor],
    layer: Layer,
) -> Tensor:
    """Return L of what `answer` makes of the logits, float32 [n, rows, cols]."""
    with torch.no_grad():
        seen = net.trunk.to_layer3(pictures) if layer == "layer3" else net.trunk(pictures)
    seen.requires_grad_()
    with torch.enable_grad():
        last = net.trunk.layer4(seen) if layer == "layer3" else seen
        # Pictures do not touch one another in evaluation mode, so the gradient of the sum is that of each.
        total = answer(net.logits(net.gathered(last, goal))[output]).sum()
        (gradient,) = torch.autograd.grad(total, seen)
    return (gradient * seen.detach()).sum(1)


def _scaled(maps: Tensor, pictures: Tensor) -> NDArray[np.float32]:
    size = pictures.shape[-2:]
    return torch.nn.functional.interpolate(maps[:, None], size, mode="bilinear", align_corners=False)[:, 0].numpy()
