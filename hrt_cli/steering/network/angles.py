"""Discretised steering: 2M + 1 angles in [-1, 1], labels smoothed over them, and what a distribution over them says."""

from __future__ import annotations

import torch
from torch import Tensor


def class_angles(half_classes: int) -> Tensor:
    """Return the angles -1, ..., -1/M, 0, 1/M, ..., 1, float32 [2M + 1]."""
    return torch.arange(-half_classes, half_classes + 1, dtype=torch.float32) / half_classes


def nearest_class(angle: Tensor, half_classes: int) -> Tensor:
    """Return the class of each angle, int64: the nearest, of two equally near the one farther from straight ahead.

    Parameters
    ----------
    angle : float [...]
        In [-1, 1].
    """
    scaled = angle * half_classes
    return (torch.sign(scaled) * torch.floor(scaled.abs() + 0.5)).long() + half_classes


def smoothed_labels(angle: Tensor, half_classes: int, sigma: float) -> Tensor:
    """Spread each label over the classes by a Gaussian about its angle.

    theta_j is proportional to exp(-(a_j - y)^2 / (2 sigma^2)) and sums to 1.

    Parameters
    ----------
    angle : float [n]
        Labels y in [-1, 1].
    sigma : float
        Standard deviation, in the unit of the angles; 0 gives all to the nearest class.

    Returns
    -------
    float32 [n, 2M + 1]
    """
    if sigma == 0.0:
        return torch.nn.functional.one_hot(nearest_class(angle, half_classes), 2 * half_classes + 1).float()
    away = class_angles(half_classes) - angle.float()[:, None]
    return torch.softmax(-(away**2) / (2.0 * sigma**2), dim=1)


def expected_angle(probability: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean of the angles under distributions over the classes, and their standard deviation.

    Parameters
    ----------
    probability : float [..., 2M + 1]
    """
    angles = class_angles(probability.shape[-1] // 2).to(probability)
    mean = (probability * angles).sum(-1)
    variance = (probability * (angles - mean[..., None]) ** 2).sum(-1)
    return mean, variance.clamp_min(0.0).sqrt()
