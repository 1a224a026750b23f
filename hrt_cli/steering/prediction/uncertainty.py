"""How sure a prediction is: of one distribution over the angles, and of the same by networks drawn by dropout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_LEAST_HEIGHT = 0.25
"""Of a mode, as a share of the highest."""
_HIGHEST_SADDLE = 0.5
"""Between a mode and a higher one, as a share of the lower."""


@dataclass(frozen=True)
class Uncertainty:
    """How sure each of n predictions of one output is; every field is float64 [n].

    The variance of the mean distribution is the mean variance of the distributions plus the variance of their means
    (the law of total variance), and likewise its entropy is their mean entropy plus the mutual information (Houlsby et
    al. 2011, arXiv:1112.5745): what the picture leaves open, and what the network has not learnt.

    Attributes
    ----------
    spread : at least 0
        Standard deviation of the angle under the mean distribution: spread^2 = aleatoric^2 + epistemic^2.
    aleatoric : at least 0
        Root of the mean variance within a pass.
    epistemic : at least 0
        Standard deviation of the expected angle over the passes.
    entropy_nats : at least 0
        Of the mean distribution.
    mutual_information_nats : at least 0
        Between the class and the pass.
    """

    spread: NDArray[np.float64]
    aleatoric: NDArray[np.float64]
    epistemic: NDArray[np.float64]
    entropy_nats: NDArray[np.float64]
    mutual_information_nats: NDArray[np.float64]


def uncertainty(sampled: NDArray[np.float64]) -> Uncertainty:
    """Take the uncertainty of predictions apart.

    Parameters
    ----------
    sampled : float64 [passes, n, 2M + 1]
        Distributions of the same pictures by several passes.
    """
    mean, variance = moments(sampled)
    together = sampled.mean(axis=0)
    entropy = _entropy(together)
    return Uncertainty(
        spread=np.sqrt(moments(together)[1]),
        aleatoric=np.sqrt(variance.mean(axis=0)),
        epistemic=mean.std(axis=0),
        entropy_nats=entropy,
        mutual_information_nats=np.maximum(entropy - _entropy(sampled).mean(axis=0), 0.0),
    )


def moments(probability: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and variance of the angle under distributions, float64 [...] each.

    Parameters
    ----------
    probability : float64 [..., 2M + 1]
    """
    half = probability.shape[-1] // 2
    angles = np.arange(-half, half + 1) / half
    mean = probability @ angles
    return mean, (probability * (angles - mean[..., None]) ** 2).sum(axis=-1)


def count_modes(probability: NDArray[np.float64]) -> int:
    """Count the ways that a distribution sees: its peaks that stand apart.

    A peak counts if it is at least a quarter as high as the highest, and if on the way to any higher one the
    probability falls to half of the peak's or less. Of a distribution with two of them (left or right round an
    obstacle) the mean lies between, where nobody would steer.

    Parameters
    ----------
    probability : float64 [2M + 1]
    """
    before, after = np.append(-1.0, probability[:-1]), np.append(probability[1:], -1.0)
    peaks = np.flatnonzero((probability > before) & (probability >= after))
    peaks = peaks[np.argsort(-probability[peaks], kind="stable")]
    counted = 0
    for rank, at in enumerate(peaks):
        height = probability[at]
        saddles = [probability[min(at, other) : max(at, other) + 1].min() for other in peaks[:rank]]
        apart = all(saddle <= _HIGHEST_SADDLE * height for saddle in saddles)
        counted += apart and height >= _LEAST_HEIGHT * probability[peaks[0]]
    return int(counted)


def _entropy(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    logarithm = np.log(probability, out=np.zeros_like(probability), where=probability > 0.0)
    return np.asarray(-(probability * logarithm).sum(axis=-1), np.float64)
