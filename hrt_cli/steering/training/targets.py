"""What a network should say: the distributions over the angles that the loss compares it with."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from hrt_cli.steering.network.angles import smoothed_labels
from hrt_cli.steering.network.net import Output


def targets(
    outputs: Sequence[Output], steering: Tensor, costs: Tensor | None, half_classes: int, sigma: float, scale_s: float
) -> dict[Output, Tensor]:
    """Return the target distribution of each output, float32 [n, 2M + 1].

    Yaw's is `cost_labels` where the frames know what turning costs; all others are `angles.smoothed_labels`.

    Parameters
    ----------
    outputs : sequence of str
    steering : float32 [n, outputs]
        In [-1, 1].
    costs : float32 [n, turns] or None
    half_classes : int
        M.
    sigma : float
        Of the smoothed labels.
    scale_s : float
        Of `cost_labels`; 0 leaves the costs aside.
    """
    found = {name: smoothed_labels(steering[:, i], half_classes, sigma) for i, name in enumerate(outputs)}
    if costs is not None and scale_s > 0.0:
        found["yaw"] = cost_labels(costs, half_classes, scale_s)
    return found


def cost_labels(costs: Tensor, half_classes: int, scale_s: float) -> Tensor:
    """Return exp(-cost / scale), normalised, at each of the 2M + 1 angles, float32 [n, 2M + 1].

    The distribution of least free energy at that temperature, as in maximum-entropy control (Ziebart 2010): an angle
    that costs `scale_s` more than another gets 1/e of its share.

    Parameters
    ----------
    costs : float [n, turns]
        At evenly spaced angles from -1 to 1; between them it is interpolated.
    """
    at = torch.nn.functional.interpolate(
        costs.float()[:, None], size=2 * half_classes + 1, mode="linear", align_corners=True
    )[:, 0]
    return torch.softmax(-at / scale_s, dim=1)
