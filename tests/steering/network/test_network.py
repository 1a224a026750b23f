"""The network: what it is told, what it answers, what of it is penalised and what decays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from predict_files import FixedTrunk, small_net
from pydantic import ValidationError

from hrt_cli.steering.network.net import SteeringConfig, SteeringNet, directions, told


@pytest.fixture(scope="module")
def net() -> SteeringNet:
    return small_net()


@pytest.fixture(scope="module")
def full() -> SteeringNet:
    return small_net(outputs=("yaw", "pitch"), half_classes=3, goal=True, columns=2, spatial_dropout=True)


def test_logits_of_each_output(net: SteeringNet, full: SteeringNet) -> None:
    x = torch.randn(2, 3, 48, 64)
    assert {name: tuple(each.shape) for name, each in net(x).items()} == {"yaw": (2, 15)}
    found = full(x, torch.zeros(2))
    assert {name: tuple(each.shape) for name, each in found.items()} == {"yaw": (2, 7), "pitch": (2, 7)}


def test_one_column_is_the_mean_over_the_picture(net: SteeringNet) -> None:
    x = torch.randn(2, 3, 48, 64)
    with torch.no_grad():
        torch.testing.assert_close(net.features(x), net.trunk(x).mean((2, 3)))
        torch.testing.assert_close(net(x)["yaw"], net.heads["yaw"](net.trunk(x).mean((2, 3))))


def test_columns_keep_left_and_right_apart() -> None:
    net = small_net(columns=2)
    maps = torch.rand(1, 512, 2, 4)
    net.trunk = FixedTrunk(maps)  # type: ignore[assignment]
    found = net.features(torch.zeros(1, 3, 48, 64)).view(512, 2)
    torch.testing.assert_close(
        found, 3 * torch.stack([maps[0, :, :, :2].mean((1, 2)), maps[0, :, :, 2:].mean((1, 2))], 1)
    )


def test_to_ask_for_several_goals_is_to_ask_for_each(full: SteeringNet) -> None:
    x, goals = torch.randn(3, 3, 48, 64), torch.tensor([[0.0, 0.8], [-0.5, 2.0], [1.0, -3.0]])
    with torch.no_grad():
        found = full(x, goals)
        for name, values in found.items():
            assert values.shape == (6, 7)
            for column in range(2):
                torch.testing.assert_close(values.view(3, 2, 7)[:, column], full(x, goals[:, column])[name])


def test_a_goal_must_be_given_and_counts_by_its_direction(full: SteeringNet) -> None:
    x = torch.randn(1, 3, 48, 64)
    with pytest.raises(ValueError, match="where to go"):
        full(x)
    with torch.no_grad():
        ahead, around, right = (full(x, torch.tensor([angle]))["yaw"] for angle in (0.0, 2 * math.pi, 0.8))
    torch.testing.assert_close(ahead, around, atol=1e-4, rtol=1e-4)
    assert not torch.allclose(ahead, right, atol=1e-4)


STEP = math.pi / 12
"""Between two of the 24 directions by which a bearing is told."""


def tell(*bearings_rad: float) -> np.ndarray:
    return told(torch.tensor(bearings_rad, dtype=torch.float64)).numpy()


def test_a_bearing_is_told_by_the_directions_near_it() -> None:
    np.testing.assert_allclose(directions().numpy(), np.arange(24) * math.radians(15.0), rtol=1e-6)
    at, midway, behind = tell(3 * STEP, 3.5 * STEP, -math.pi)
    assert at.shape == (24,)
    assert at[3] == pytest.approx(8.0)
    assert at.argmax() == 3
    assert midway[[3, 4]] == pytest.approx(4.0)
    assert (np.delete(midway, [3, 4]) < 0.16).all()
    assert behind[12] == pytest.approx(8.0)
    # Where it is asked, it is 8 times 2 to the power of (cos x - 1) / (1 - cos 7.5 degrees).
    power = (math.cos(math.radians(30.0)) - 1.0) / (1.0 - math.cos(math.radians(7.5)))
    assert at[5] == pytest.approx(8.0 * 2.0**power, rel=1e-4)
    assert told(torch.zeros(2)).dtype == torch.float32


@given(st.floats(-math.pi, math.pi), st.integers(-3, 3))
def test_a_bearing_is_told_alike_all_round(bearing_rad: float, turns: int) -> None:
    found, again, next_on = tell(bearing_rad, bearing_rad + 2 * math.pi * turns, bearing_rad + STEP)
    np.testing.assert_allclose(again, found, atol=1e-4)
    np.testing.assert_allclose(next_on, np.roll(found, 1), atol=1e-4)
    mirrored = tell(-bearing_rad)[0]
    np.testing.assert_allclose(mirrored, np.roll(found[::-1], 1), atol=1e-4)


def test_the_head_is_told_the_bearing_too(full: SteeringNet) -> None:
    x, goal = torch.randn(1, 3, 48, 64), torch.tensor([0.8])
    with torch.no_grad():
        found = full.features(x, goal)
    assert found.shape == (1, 128 + 24)
    torch.testing.assert_close(found[:, 128:], told(goal))
    # The units in between know it, too.
    with torch.no_grad():
        assert not torch.allclose(full.features(x, -goal)[:, :128], found[:, :128], atol=1e-4)


def test_the_penalty_is_the_sum_over_the_layers(net: SteeringNet, full: SteeringNet) -> None:
    def by_hand(weights: list[torch.Tensor], features: int, p: float) -> float:
        square = sum(float((each.double() ** 2).sum()) for each in weights)
        return 1e-3 * square / (1 - p) + 1e-2 * features * (p * math.log(p) + (1 - p) * math.log(1 - p))

    decays = {"weight_decay": 1e-3, "dropout_decay": 1e-2}
    heads = [net.heads["yaw"].weight]
    assert float(net.penalty(**decays).detach()) == pytest.approx(by_hand(heads, 512, 0.1), rel=1e-4)
    heads = [full.heads["yaw"].weight, full.heads["pitch"].weight]
    fed = by_hand([full.trunk.layer4[1].conv2.weight], 512, 0.1)
    assert float(full.penalty(**decays).detach()) == pytest.approx(by_hand(heads, 128 + 24, 0.1) + fed, rel=1e-4)


def test_what_the_regulariser_holds_is_not_decayed_again(full: SteeringNet) -> None:
    kept = full.undecayed()
    assert {"heads.yaw.weight", "heads.pitch.weight", "trunk.layer4.1.conv2.weight"} <= kept
    assert {"dropout.p_logit", "spatial.p_logit", "trunk.bn1.weight", "heads.yaw.bias", "merge.0.bias"} <= kept
    assert not {"trunk.conv1.weight", "merge.0.weight", "trunk.layer4.0.conv2.weight"} & kept
    assert kept <= dict(full.named_parameters()).keys()


def test_sampling_ends_however_it_ends(full: SteeringNet) -> None:
    x, goal = torch.randn(1, 3, 48, 64), torch.zeros(1)
    with torch.no_grad():
        before = full(x, goal)["yaw"]
        with full.sampling():
            assert not torch.equal(full(x, goal)["yaw"], full(x, goal)["yaw"])
        with pytest.raises(RuntimeError, match="stop"), full.sampling():
            raise RuntimeError("stop")
        assert torch.equal(full(x, goal)["yaw"], before)


@pytest.mark.parametrize(
    "wrong",
    [
        {"outputs": ("pitch",)},
        {"outputs": ("pitch", "yaw")},
        {"outputs": ()},
        {"half_classes": 0},
        {"half_classes": 128},
        {"width": 31},
        {"std": (0.0, 0.1, 0.1)},
        {"mean": (math.nan, 0.0, 0.0)},
        {"temperature": {"pitch": 1.0}},
        {"temperature": {"yaw": 0.0}},
        {"columns": 0},
        {"crop_top": 0.95},
        {"layers": 18},
    ],
)
def test_configurations_that_make_no_sense(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        SteeringConfig(**wrong)
