"""How good predictions of steering are: how far off, how often the right class, and how well the model knows it.

Angles are in [-1, 1]. Errors are of the expected angle under the predicted distribution against the label itself, not
against its class, so that networks of different numbers of classes compare.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hrt_cli.steering.network.net import Output

BINS = 15
"""Of confidence, equally wide, as in the figures of Guo et al. 2017."""
LEAST_PROBABILITY = 1e-12
"""What a probability counts as at least in the log-likelihood: one that underflowed must not make the mean infinite."""


@dataclass(frozen=True)
class Figures:
    """The figures of one output.

    Attributes
    ----------
    mae, rmse : float
        Of the expected angle.
    accuracy : float
        Share of the frames whose likeliest class is the one nearest to the label.
    nll : float
        Mean of -log of the probability of that class, in nats.
    ece : float
        Expected calibration error (see `Reliability.ece`).
    constant_baseline_mae : float
        What always steering the one angle that was given would come to.
    """

    mae: float
    rmse: float
    accuracy: float
    nll: float
    ece: float
    constant_baseline_mae: float


_NAMES = tuple(each.name for each in fields(Figures))


@dataclass(frozen=True)
class Measure(Figures):
    """Figures over all outputs, each their mean over the outputs.

    Attributes
    ----------
    frames : int
    outputs : dict of str to Figures
        Each by itself.
    """

    frames: int
    outputs: dict[Output, Figures]


@dataclass(frozen=True)
class Reliability:
    """How often predictions of a confidence are right, by bins of confidence ((k - 1) / 15, k / 15].

    Attributes
    ----------
    count : int64 [15]
        Frames whose likeliest class has a probability in the bin.
    confidence, accuracy : float64 [15]
        Means over them of that probability, and of whether the class was right; NaN where there is none.
    """

    count: NDArray[np.int64]
    confidence: NDArray[np.float64]
    accuracy: NDArray[np.float64]

    @property
    def ece(self) -> float:
        """Expected calibration error: sum of |accuracy - confidence| weighted by count (Guo et al. 2017, eq. 3)."""
        filled = self.count > 0
        gap = np.abs(self.accuracy[filled] - self.confidence[filled])
        return float((self.count[filled] * gap).sum() / self.count.sum())

    def bins(self) -> list[dict[str, float | int | None]]:
        """Return the bins as JSON values, None where a mean is of nothing."""
        return [
            {"count": count, "confidence": confidence if count else None, "accuracy": accuracy if count else None}
            for count, confidence, accuracy in zip(
                self.count.tolist(), self.confidence.tolist(), self.accuracy.tolist(), strict=True
            )
        ]


def measure(
    probability: Mapping[Output, NDArray[np.float64]],
    steering: NDArray[np.float32],
    half_classes: int,
    baseline: NDArray[np.float32],
) -> Measure:
    """Measure predictions against labels.

    Parameters
    ----------
    probability : mapping of str to float64 [n, 2M + 1]
        By output, in the order of the columns of `steering`; rows sum to 1.
    steering : float32 [n, outputs]
        Labels in [-1, 1]; n is at least 1.
    half_classes : int
        M.
    baseline : float32 [outputs]
        The constant angles to compare with.

    Raises
    ------
    ValueError
        The shapes do not fit, there is no frame, or a probability is not finite.
    """
    if not len(steering):
        raise ValueError("there is no frame to measure")
    if steering.shape != (len(steering), len(probability)) or baseline.shape != (len(probability),):
        raise ValueError("labels, baseline and predictions are of different outputs")
    outputs = {
        name: _figures(each, steering[:, column], half_classes, float(baseline[column]))
        for column, (name, each) in enumerate(probability.items())
    }
    means = {name: float(np.mean([vars(each)[name] for each in outputs.values()])) for name in _NAMES}
    return Measure(**means, frames=len(steering), outputs=outputs)


def median_angles(steering: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the medians of labels, float32 [outputs]: of all constants, those of the least mean absolute error."""
    return np.asarray(np.median(steering, axis=0), np.float32)


def expected_angles(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the angles under each distribution [n, 2M + 1], float64 [n]."""
    half = probability.shape[1] // 2
    return np.asarray(probability @ (np.arange(-half, half + 1) / half))


def spreads(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation of the angle under each distribution [n, 2M + 1], float64 [n]."""
    half = probability.shape[1] // 2
    away = np.arange(-half, half + 1) / half - expected_angles(probability)[:, None]
    return np.asarray(np.sqrt((probability * away**2).sum(axis=1)))


def nearest_classes(steering: NDArray[np.float32], half_classes: int) -> NDArray[np.int64]:
    """Return the class of each label [n], int64 [n]; `angles.nearest_class` without PyTorch."""
    scaled = np.asarray(steering, np.float32) * np.float32(half_classes)
    steps = np.sign(scaled) * np.floor(np.abs(scaled) + np.float32(0.5))
    return np.asarray(steps.astype(np.int64) + half_classes)


def reliability(probability: NDArray[np.float64], steering: NDArray[np.float32], half_classes: int) -> Reliability:
    """Return how often predictions [n, 2M + 1] of each confidence are right on labels [n]."""
    confidence = probability.max(axis=1)
    right = probability.argmax(axis=1) == nearest_classes(steering, half_classes)
    at = np.searchsorted(np.arange(1, BINS) / BINS, confidence, side="left")
    count = np.bincount(at, minlength=BINS)
    with np.errstate(invalid="ignore"):
        mean_confidence = np.bincount(at, confidence, BINS) / count
        accuracy = np.bincount(at, right, BINS) / count
    return Reliability(count.astype(np.int64), mean_confidence, accuracy)


def confusion(probability: NDArray[np.float64], steering: NDArray[np.float32], half_classes: int) -> NDArray[np.int64]:
    """Count frames by the class of the label and the likeliest class, int64 [2M + 1 true, 2M + 1 predicted]."""
    classes = 2 * half_classes + 1
    pairs = nearest_classes(steering, half_classes) * classes + probability.argmax(axis=1)
    return np.bincount(pairs, minlength=classes**2).reshape(classes, classes).astype(np.int64)


def _figures(
    probability: NDArray[np.float64], steering: NDArray[np.float32], half_classes: int, constant: float
) -> Figures:
    if probability.shape != (len(steering), 2 * half_classes + 1):
        raise ValueError(f"{probability.shape} are no probabilities of {2 * half_classes + 1} classes")
    if not np.isfinite(probability).all():
        raise ValueError("a probability is not finite")
    label = steering.astype(np.float64)
    error = expected_angles(probability) - label
    nearest = nearest_classes(steering, half_classes)
    of_right = probability[np.arange(len(nearest)), nearest]
    return Figures(
        mae=float(np.abs(error).mean()),
        rmse=float(np.sqrt((error**2).mean())),
        accuracy=float((probability.argmax(axis=1) == nearest).mean()),
        nll=float(-np.log(np.maximum(of_right, LEAST_PROBABILITY)).mean()),
        ece=reliability(probability, steering, half_classes).ece,
        constant_baseline_mae=float(np.abs(label - constant).mean()),
    )
