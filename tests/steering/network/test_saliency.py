"""Where the network looked: by hand on features that are given, by finite differences, and half a picture alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from predict_files import FixedTrunk, noise, small_net
from torch import Tensor, nn

from hrt_cli.steering.network.net import SteeringNet
from hrt_cli.steering.network.pictures import prepare
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.network.saliency import Layer, angle_maps, class_maps


def told(maps: Tensor, yaw: dict[tuple[int, int], float], columns: int = 1) -> SteeringNet:
    """A network of 3 classes that sees `maps`, and whose weights are `yaw` by (class, feature) and 0 elsewhere."""
    net = small_net(half_classes=1, columns=columns)
    net.trunk = FixedTrunk(maps)  # type: ignore[assignment]
    head = net.heads["yaw"]
    nn.init.zeros_(head.weight)
    nn.init.zeros_(head.bias)
    with torch.no_grad():
        for at, weight in yaw.items():
            head.weight[at] = weight
    return net


def at_corners(found: np.ndarray) -> np.ndarray:
    """The values of a 2 x 2 map where it is not interpolated: at the corners."""
    return found[[0, 0, -1, -1], [0, -1, 0, -1]].reshape(2, 2)


X = torch.zeros(1, 3, 48, 64)


def test_a_class_by_hand() -> None:
    maps = torch.zeros(1, 512, 2, 2)
    maps[0, 0] = torch.tensor([[1.0, 2.0], [0.0, 1.0]])
    maps[0, 1] = torch.tensor([[0.0, 4.0], [1.0, 0.0]])
    net = told(maps, {(2, 0): 2.0, (2, 1): -1.0})
    # The last stage gives 3 A. d logit_2 / d(3 A) = w / 4 everywhere, so L = 3 (2 A_0 - A_1) / 4.
    found = at_corners(class_maps(net, X, None, "yaw", torch.tensor([2]))[0])
    np.testing.assert_allclose(found, [[1.5, 0.0], [0.0, 1.5]], atol=1e-6)
    # One stage earlier features are a third and their gradient threefold.
    earlier = at_corners(class_maps(net, X, None, "yaw", torch.tensor([2]), layer="layer3")[0])
    np.testing.assert_allclose(earlier, found, atol=1e-6)
    assert not class_maps(net, X, None, "yaw", torch.tensor([0])).any()


def test_an_angle_by_hand() -> None:
    maps = torch.zeros(1, 512, 2, 2)
    maps[0, 0] = torch.tensor([[4.0, 0.0], [0.0, 0.0]])
    maps[0, 1] = torch.tensor([[0.0, 4.0], [0.0, 0.0]])
    # Means over the picture are 3 and 3: the logits of left and right are 0.3 each.
    net = told(maps, {(0, 0): 0.1, (2, 1): 0.1})
    outer = np.exp(0.3) / (2 * np.exp(0.3) + 1)
    # d mean / d logit_j = p_j (a_j - mean) with mean 0; times w / 4, times 3 A = 12.
    found = at_corners(angle_maps(net, X, None, "yaw")[0])
    np.testing.assert_allclose(found, [[-outer * 0.1 * 3, outer * 0.1 * 3], [0, 0]], atol=1e-6)


def test_temperature_counts() -> None:
    maps = torch.zeros(1, 512, 1, 1)
    maps[0, 0] = 1.0
    net = told(maps, {(2, 0): 0.1})
    config = net.config.model_copy(update={"temperature": {"yaw": 2.0}})
    net.config = config
    left, right = np.array([1.0, np.exp(0.15)]) / (2 + np.exp(0.15))
    wanted = right * (1.0 - (right - left)) * 0.15
    np.testing.assert_allclose(angle_maps(net, X, None, "yaw")[0, 0, 0], wanted, rtol=1e-5)


def test_on_the_last_stage_of_one_column_it_is_grad_cam() -> None:
    net = small_net()
    x = torch.from_numpy(prepare(noise(2), net.config))
    chosen = torch.tensor([3, 11])
    maps = net.trunk(x).detach().requires_grad_()
    score = net.logits(net.gathered(maps))["yaw"].gather(1, chosen[:, None]).sum()
    (gradient,) = torch.autograd.grad(score, maps)
    alpha = gradient.mean((2, 3), keepdim=True)  # eq. 1
    cam = torch.relu((alpha * maps).sum(1)).detach().numpy()  # eq. 2
    wanted = np.stack([cv2.resize(each, (64, 48), interpolation=cv2.INTER_LINEAR) for each in cam])
    np.testing.assert_allclose(class_maps(net, x, None, "yaw", chosen), wanted, atol=1e-5)


@pytest.mark.parametrize("layer", ["layer3", "layer4"])
def test_the_left_half_alone_is_shown_where_it_alone_counts(layer: Layer) -> None:
    net = small_net(columns=2, width=128, height=64)
    with torch.no_grad():
        net.heads["yaw"].weight[:, 1::2] = 0.0  # features are channel by channel, left before right
    x = torch.from_numpy(prepare(noise(1, width=128, height=64), net.config))
    found = np.abs(angle_maps(net, x, None, "yaw", layer=layer)[0])
    if layer == "layer4":
        assert not found[:, 96:].any()  # beyond what is interpolated
    assert found[:, :48].mean() > 5 * found[:, 112:].mean()
    assert found[:, :48].max() > 0


@pytest.mark.parametrize("layer", ["layer3", "layer4"])
def test_maps_add_up_to_what_growing_features_do(layer: Layer) -> None:
    maps = torch.rand(1, 512, 1, 1)
    net = small_net(goal=True, outputs=("yaw", "pitch"))
    net.trunk = FixedTrunk(maps)  # type: ignore[assignment]
    goal = torch.tensor([0.4])

    def angle(grown: float) -> float:
        net.trunk.maps = maps * grown  # type: ignore[assignment]
        seen = noise(1)
        p = TorchPredictor(net).probabilities(seen, goal.numpy())["pitch"][0]
        return float(p @ (np.arange(-7, 8) / 7))

    slope = (angle(1.001) - angle(0.999)) / 0.002
    net.trunk.maps = maps  # type: ignore[assignment]
    found = angle_maps(net, X, goal, "pitch", layer=layer)[0]
    assert found[0, 0] == pytest.approx(slope, rel=2e-2, abs=1e-4)


def test_pictures_do_not_touch_one_another_and_nothing_is_left_behind() -> None:
    net = small_net()
    predictor, pictures = TorchPredictor(net), noise(3)
    found = predictor.saliency(pictures, None, "yaw", "layer3")
    assert found.shape == (3, 48, 64)
    np.testing.assert_allclose(found[1:2], predictor.saliency(pictures[1:2], None, "yaw", "layer3"), atol=1e-5)
    assert all(parameter.grad is None for parameter in net.parameters())
