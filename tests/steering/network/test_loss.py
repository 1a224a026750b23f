"""The loss, by hand, against PyTorch's own cross-entropy, and which way its second term pulls."""

from __future__ import annotations

import math

import pytest
import torch
from torch.nn import functional

from hrt_cli.steering.network.loss import steering_loss
from hrt_cli.steering.network.net import total_loss


def test_by_hand() -> None:
    logits = torch.tensor([[0.0, math.log(3.0)]])  # f = 1/4, 3/4
    labels = torch.tensor([[0.5, 0.5]])
    cross = -0.5 * math.log(0.25) - 0.5 * math.log(0.75)
    entropy = -0.25 * math.log(0.25) - 0.75 * math.log(0.75)
    assert float(steering_loss(logits, labels, 0.2)) == pytest.approx(cross - 0.2 * entropy, rel=1e-5)


def test_without_the_second_term_it_is_cross_entropy() -> None:
    torch.manual_seed(0)
    logits, labels = torch.randn(8, 15) * 3, torch.softmax(torch.randn(8, 15), -1)
    found = steering_loss(logits, labels, 0.0)
    torch.testing.assert_close(found, functional.cross_entropy(logits, labels, reduction="none"))
    hard = torch.randint(0, 15, (8,))
    found = steering_loss(logits, functional.one_hot(hard, 15).float(), 0.0)
    torch.testing.assert_close(found, functional.cross_entropy(logits, hard, reduction="none"))


def test_of_two_equally_right_the_surer_one_costs_more() -> None:
    # The same probability of the true class; the rest on one class, or spread.
    spread = torch.log(torch.tensor([[0.4, 0.3, 0.3]]))
    sure = torch.log(torch.tensor([[0.4, 0.6 - 1e-6, 1e-6]]))
    true = torch.tensor([[1.0, 0.0, 0.0]])
    torch.testing.assert_close(steering_loss(spread, true, 0.0), steering_loss(sure, true, 0.0))
    assert float(steering_loss(sure, true, 0.1)) > float(steering_loss(spread, true, 0.1))


def test_gradients_are_those_of_finite_differences() -> None:
    torch.manual_seed(0)
    labels = torch.softmax(torch.randn(3, 5), -1)
    logits = torch.randn(3, 5, requires_grad=True)
    steering_loss(logits, labels, 0.3).sum().backward()
    assert logits.grad is not None
    for row, at in ((0, 0), (1, 3), (2, 4)):
        step = torch.zeros(3, 5)
        step[row, at] = 1e-2
        up, down = (steering_loss(logits.detach() + sign * step, labels, 0.3).sum() for sign in (1, -1))
        assert float((up - down) / 2e-2) == pytest.approx(float(logits.grad[row, at]), abs=2e-3)


def test_sure_logits_stay_finite() -> None:
    found = steering_loss(torch.tensor([[1e4, -1e4, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), 0.1)
    assert float(found) == pytest.approx(0.0, abs=1e-6)


def test_outputs_add_up_and_each_is_averaged_over_its_samples() -> None:
    torch.manual_seed(1)
    logits = {"yaw": torch.randn(3, 5), "pitch": torch.randn(3, 5)}
    labels = {name: torch.softmax(torch.randn(3, 5), -1) for name in logits}
    each = steering_loss(logits["yaw"], labels["yaw"], 0.1) + steering_loss(logits["pitch"], labels["pitch"], 0.1)
    torch.testing.assert_close(total_loss(logits, labels, 0.1), each.mean())
    few = {"yaw": (logits["yaw"], labels["yaw"]), "pitch": (logits["pitch"][:1], labels["pitch"][:1])}
    apart = [steering_loss(ours, wanted, 0.1).mean() for ours, wanted in few.values()]
    found = total_loss(
        {name: each[0] for name, each in few.items()}, {name: each[1] for name, each in few.items()}, 0.1
    )
    torch.testing.assert_close(found, apart[0] + apart[1])
