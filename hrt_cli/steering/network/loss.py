"""The loss of Manderson, Manjanna and Dudek (2019): smoothed labels, and a price on over-confidence.

    L = mean over samples of l  +  lambda1 * L_reg
    l = - sum_j theta_j log f_j  -  lambda2 * H(f),    H(f) = - sum_j f_j log f_j

The paper prints the second term as -lambda2 sum_j f_j log f_j, which is +lambda2 H(f) and would reward confidence; its
text says that over-confident predictions are penalised. Here it is as the text says (the confidence penalty of
Pereyra et al. 2017, arXiv:1701.06548): of two predictions that are equally right, the one of lower entropy costs more.
L_reg is the regulariser of Concrete Dropout (`dropout`).
"""

from __future__ import annotations

from torch import Tensor


def steering_loss(logits: Tensor, labels: Tensor, entropy_weight: float) -> Tensor:
    """Return l of each sample, float32 [n].

    Parameters
    ----------
    logits : float [n, classes]
    labels : float [n, classes]
        theta: each row sums to 1.
    entropy_weight : float
        lambda2, at least 0.
    """
    log_f = logits.float().log_softmax(dim=-1)
    return entropy_weight * (log_f.exp() * log_f).sum(-1) - (labels * log_f).sum(-1)
