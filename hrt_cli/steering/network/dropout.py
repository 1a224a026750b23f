"""Concrete Dropout: dropout whose probability is learnt (Gal, Hron and Kendall 2017, arXiv:1705.07832).

The mask is a relaxed Bernoulli variable (a Concrete distribution), so that gradients reach p through it. With noise
u ~ U(0, 1), eq. 5 of the paper:

    z = sigmoid((logit p + logit u) / t),    out = x (1 - z) / (1 - p)

and for the layer that follows, with weights W and K inputs, the regulariser of eq. 3 and 4:

    wd |W|^2 / (1 - p)  +  dd K (p log p + (1 - p) log(1 - p))
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

DENSE_TEMPERATURE, SPATIAL_TEMPERATURE = 0.1, 2.0 / 3.0
EPSILON = 1e-7


class ConcreteDropout(nn.Module):
    """Drops inputs, or whole channels of a picture, with one learnt probability.

    In training, and where `sampling` is set, masks are drawn from torch's global generator; else inputs pass as they
    are. It is computed in float32 whatever autocast says.

    Parameters
    ----------
    features : int
        K: features of the input, or its channels.
    spatial : bool
        One mask per channel of [n, K, h, w] instead of one per feature of [n, K].
    p : float
        To begin with.
    """

    def __init__(self, features: int, *, spatial: bool = False, p: float = 0.1) -> None:
        super().__init__()
        self.features, self.spatial = features, spatial
        self.sampling = False
        self.p_logit = nn.Parameter(torch.tensor(math.log(p / (1.0 - p))))

    @property
    def p(self) -> Tensor:
        """The probability of dropping, a scalar."""
        return torch.sigmoid(self.p_logit)

    def forward(self, x: Tensor) -> Tensor:
        """Return `x` with some of it dropped, float32 in training and sampling."""
        if not (self.training or self.sampling):
            return x
        shape = (*x.shape[:2], 1, 1) if self.spatial else x.shape
        return dropped(x.float(), self.p, torch.rand(shape, device=x.device), self.temperature)

    @property
    def temperature(self) -> float:
        """Of the relaxation: the lower, the nearer the mask is to 0 or 1."""
        return SPATIAL_TEMPERATURE if self.spatial else DENSE_TEMPERATURE

    def penalty(self, weights: Sequence[Tensor], *, weight_decay: float, dropout_decay: float) -> Tensor:
        """Return the regulariser for the layers that this one feeds, a scalar.

        Parameters
        ----------
        weights : sequence of Tensor
            Of those layers. The optimiser must not decay them again.
        weight_decay, dropout_decay : float
            wd = l^2 / (2 N) and dd = 1 / N for a mean cross-entropy over N samples and a prior length scale l.
        """
        p = self.p
        square = torch.stack([(weight.float() ** 2).sum() for weight in weights]).sum()
        entropy = p * torch.log(p + EPSILON) + (1.0 - p) * torch.log(1.0 - p + EPSILON)
        return weight_decay * square / (1.0 - p) + dropout_decay * self.features * entropy


def dropped(x: Tensor, p: Tensor, noise: Tensor, temperature: float) -> Tensor:
    """Return `x` under the relaxed mask that `noise` in [0, 1) gives (eq. 5)."""
    logit_p = torch.log(p + EPSILON) - torch.log(1.0 - p + EPSILON)
    logit_u = torch.log(noise + EPSILON) - torch.log(1.0 - noise + EPSILON)
    drop = torch.sigmoid((logit_p + logit_u) / temperature)
    return x * (1.0 - drop) / (1.0 - p)
