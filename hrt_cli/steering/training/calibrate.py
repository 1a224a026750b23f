"""Temperature scaling (Guo, Pleiss, Sun and Weinberger 2017, arXiv:1706.04599).

One temperature T per output divides its logits before the softmax, chosen by the negative log-likelihood of frames
that were held out. Which class is likeliest does not change, only how sure the network is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LOWEST, HIGHEST = 0.2, 5.0
"""Bounds of T: a handful of frames that all come out right would ask for certainty."""
_HALVINGS = 60

Truth = NDArray[np.int64] | NDArray[np.float64]


def fit_temperature(logits: NDArray[np.float64], labels: Truth) -> float:
    """Return the temperature that minimises the negative log-likelihood; 1 where none is better than 1.

    With b = 1 / T the likelihood is convex and its derivative, mean(E_softmax(b z)[z] - E_labels[z]), rises with b: its
    zero is found by bisection in log T.

    Parameters
    ----------
    logits : float64 [n, classes]
    labels : int64 [n] or float64 [n, classes]
        The true class of each, or the true distribution.

    Returns
    -------
    float
        In [`LOWEST`, `HIGHEST`].
    """
    low, high = math.log(LOWEST), math.log(HIGHEST)
    labels = _distributions(labels, logits.shape[1])
    of_truth = (labels * logits).sum(axis=1)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        expected = (softmax(logits / math.exp(middle)) * logits).sum(axis=1)
        # A positive derivative in b asks for a smaller b, which is a larger T.
        low, high = (middle, high) if float((expected - of_truth).mean()) > 0.0 else (low, middle)
    found = math.exp(0.5 * (low + high))
    better = negative_log_likelihood(logits / found, labels) < negative_log_likelihood(logits, labels)
    return found if better else 1.0


def softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distributions that logits are, float64 [n, classes]."""
    return np.asarray(np.exp(_log_softmax(logits)))


def negative_log_likelihood(logits: NDArray[np.float64], labels: Truth) -> float:
    """Return the mean of -sum_j p_j log softmax(z)_j, in nats, p being the labels' distributions."""
    return float(-(_distributions(labels, logits.shape[1]) * _log_softmax(logits)).sum(axis=1).mean())


def _distributions(labels: Truth, classes: int) -> NDArray[np.float64]:
    if labels.ndim == 2:
        return np.asarray(labels, np.float64)
    return np.asarray(labels[:, None] == np.arange(classes), np.float64)


def _log_softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    shifted = logits - logits.max(axis=1, keepdims=True)
    return np.asarray(shifted - np.log(np.exp(shifted).sum(axis=1, keepdims=True)))
