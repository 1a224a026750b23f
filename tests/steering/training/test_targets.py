"""What a network should say."""

from __future__ import annotations

import math

import pytest
import torch

from hrt_cli.steering.network.angles import smoothed_labels
from hrt_cli.steering.training.targets import cost_labels, targets


def test_a_cost_of_one_scale_more_is_one_e_th() -> None:
    found = cost_labels(torch.tensor([[0.5, 0.3, 0.9]]), 1, 0.2)[0]
    assert float(found.sum()) == pytest.approx(1.0)
    assert float(found[0] / found[1]) == pytest.approx(math.exp(-1.0))
    assert float(found[2] / found[1]) == pytest.approx(math.exp(-3.0), rel=1e-5)


def test_between_known_angles_costs_are_interpolated() -> None:
    found = cost_labels(torch.tensor([[0.0, 1.0, 4.0]]), 2, 1.0)[0]
    wanted = torch.softmax(-torch.tensor([0.0, 0.5, 1.0, 2.5, 4.0]), 0)
    torch.testing.assert_close(found, wanted)
    torch.testing.assert_close(cost_labels(torch.tensor([[0.0, 0.5, 1.0, 2.5, 4.0]]), 1, 1.0)[0, 1], torch.softmax(
        -torch.tensor([0.0, 1.0, 4.0]), 0)[1])  # fmt: skip


def test_costs_are_yaws_alone_and_can_be_left_aside() -> None:
    steering, costs = torch.tensor([[0.4, -0.2]]), torch.tensor([[3.0, 0.0, 3.0]])
    found = targets(("yaw", "pitch"), steering, costs, 1, 0.3, 0.5)
    torch.testing.assert_close(found["yaw"], cost_labels(costs, 1, 0.5))
    torch.testing.assert_close(found["pitch"], smoothed_labels(steering[:, 1], 1, 0.3))
    for plain in (
        targets(("yaw", "pitch"), steering, costs, 1, 0.3, 0.0),
        targets(("yaw", "pitch"), steering, None, 1, 0.3, 0.5),
    ):
        torch.testing.assert_close(plain["yaw"], smoothed_labels(steering[:, 0], 1, 0.3))
