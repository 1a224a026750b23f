"""Predictions in one pass and in many: whose masks, from which generator, and what they leave alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from predict_files import noise, put_net, small_net

from hrt_cli.steering.network.net import SteeringNet
from hrt_cli.steering.network.pictures import prepare
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.prediction.load import load_predictor


@pytest.fixture(scope="module")
def net() -> SteeringNet:
    return small_net(temperature={"yaw": 2.0})


@pytest.fixture(scope="module")
def full() -> SteeringNet:
    return small_net(outputs=("yaw", "pitch"), half_classes=3, goal=True, columns=2, spatial_dropout=True)


def test_probabilities_are_the_softmax_of_the_cooled_logits(net: SteeringNet, tmp_path: Path) -> None:
    pictures = noise(2)
    with torch.no_grad():
        logits = net(torch.from_numpy(prepare(pictures, net.config)))["yaw"].double().numpy() / 2.0
    wanted = np.exp(logits) / np.exp(logits).sum(1, keepdims=True)
    found = load_predictor(put_net(tmp_path / "m.safetensors", net)).probabilities(pictures)["yaw"]
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    np.testing.assert_allclose(found.sum(1), 1.0, atol=1e-12)


@pytest.mark.parametrize(("asked", "used"), [(0, 3), (1, 1), (2, 2)])
def test_it_computes_on_as_many_threads_as_it_was_told(net: SteeringNet, asked: int, used: int) -> None:
    before, seen = torch.get_num_threads(), []
    handle = net.register_forward_pre_hook(lambda *_: seen.append(torch.get_num_threads()))
    torch.set_num_threads(3)
    try:
        TorchPredictor(net, threads=asked).probabilities(noise(1))
        assert (seen, torch.get_num_threads()) == ([used], 3)
    finally:
        handle.remove()
        torch.set_num_threads(before)


def test_passes_are_masks_on_the_features(net: SteeringNet) -> None:
    pictures = noise(2)
    found = TorchPredictor(net).sampled(pictures, None, 4, seed=9)["yaw"]
    assert found.shape == (4, 2, 15)
    with torch.no_grad():
        features = net.features(torch.from_numpy(prepare(pictures, net.config))).double().numpy()
    torch.manual_seed(9)
    u = torch.rand(4, 512).double().numpy()
    kept = 1.0 - 1.0 / (1.0 + np.exp(-(math.log(0.1 / 0.9) + np.log(u / (1 - u))) / 0.1))
    weight, bias = (each.detach().double().numpy() for each in net.heads["yaw"].parameters())
    for picture in range(2):
        logits = (features[picture] * kept / 0.9) @ weight.T + bias
        wanted = np.exp(logits / 2.0)
        np.testing.assert_allclose(found[:, picture], wanted / wanted.sum(1, keepdims=True), atol=1e-4)


def test_spatial_passes_are_whole_passes(full: SteeringNet) -> None:
    pictures, goal = noise(2), np.array([0.3, -0.7], np.float32)
    found = TorchPredictor(full).sampled(pictures, goal, 3, seed=5)
    for picture in range(2):
        seen = torch.from_numpy(prepare(pictures[picture : picture + 1], full.config)).expand(3, 3, 48, 64)
        with torch.no_grad(), torch.random.fork_rng(), full.sampling():
            torch.manual_seed(5)
            logits = full(seen, torch.full((3,), float(goal[picture])))
        for name, each in logits.items():
            np.testing.assert_allclose(found[name][:, picture], torch.softmax(each.double(), -1), atol=1e-4)


def test_masks_follow_the_seed_and_not_the_company(full: SteeringNet) -> None:
    predictor = TorchPredictor(full)
    pictures, goal = noise(3), np.zeros(3, np.float32)
    first = predictor.sampled(pictures, goal, 5, seed=1)["yaw"]
    assert np.array_equal(first, predictor.sampled(pictures, goal, 5, seed=1)["yaw"])
    alone = predictor.sampled(pictures[2:], goal[2:], 5, seed=1)["yaw"]
    np.testing.assert_allclose(first[:, 2:], alone, atol=1e-4)
    assert not np.allclose(first, predictor.sampled(pictures, goal, 5, seed=2)["yaw"], atol=1e-4)
    assert len({each.tobytes() for each in first[:, 0]}) == 5


def test_the_generator_and_the_network_are_left_as_they_were(net: SteeringNet) -> None:
    predictor, pictures = TorchPredictor(net), noise(1)
    before, plain = torch.random.get_rng_state(), predictor.probabilities(pictures)["yaw"]
    predictor.sampled(pictures, None, 3, seed=0)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert np.array_equal(predictor.probabilities(pictures)["yaw"], plain)


def test_without_dropout_all_passes_are_the_prediction() -> None:
    net = small_net()
    torch.nn.init.constant_(net.dropout.p_logit, -30.0)
    predictor = TorchPredictor(net)
    found = predictor.sampled(noise(1), None, 6, seed=0)["yaw"]
    np.testing.assert_allclose(found, np.broadcast_to(predictor.probabilities(noise(1))["yaw"], (6, 1, 15)), atol=1e-3)
