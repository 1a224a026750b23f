"""One step against plain PyTorch, the course of a training, and that it goes on from any state of it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import nn

from hrt_cli.errors import ArgumentError
from hrt_cli.steering.network import net as network
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.precision import Arithmetic, repeatable
from hrt_cli.steering.network.resnet import ResNet18
from hrt_cli.steering.training import train
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.batches import Frames, dropout_seed
from hrt_cli.steering.training.calibrate import HIGHEST
from hrt_cli.steering.training.state import Course, Epoch, packed, unpacked
from hrt_cli.steering.training.train import SteerSpec, Trainer, constant_steering, learning_rate_at

pytestmark = pytest.mark.usefixtures("tiny")
CPU = Arithmetic("cpu", False)
CONFIG = SteeringConfig(width=32, height=32, half_classes=3)


def posts(n: int, seed: int = 0, goal: bool = False, pitch: bool = False) -> Frames:
    """Frames in which a bright post stands where to steer."""
    rng = np.random.default_rng(seed)
    steering = rng.uniform(-1, 1, (n, 1 + pitch)).astype(np.float32)
    pictures = rng.integers(20, 60, (n, 32, 32, 3), np.uint8)
    for picture, angle in zip(pictures, steering[:, 0], strict=True):
        at = round((angle + 1) / 2 * 27)
        picture[:, at : at + 5] = 220
    told = (steering[:, :1] * 0.7).astype(np.float32) if goal else None
    return Frames(pictures, np.arange(n), steering, told)


def trainer(spec: SteerSpec, config: SteeringConfig = CONFIG, *, frames: int = 24) -> Trainer:
    torch.manual_seed(0)
    pitch = "pitch" in config.outputs
    return Trainer(
        SteeringNet(config),
        posts(frames, 1, config.goal, pitch),
        posts(9, 2, config.goal, pitch),
        spec,
        CPU,
    )


def test_it_learns_what_turns_cost_and_not_the_yaw_beside() -> None:
    costs = np.tile(np.array([3, 2.5, 2, 1.5, 1, 0, 0.5], np.float32), (24, 1, 1))
    own = replace(posts(24, 1), steering=np.full((24, 1), -0.9, np.float32), costs=costs)
    spec = SteerSpec(epochs=25, batch=8, learning_rate=0.02, augment=Augment.none(), cost_scale_s=0.25)
    yaws = []
    for each in (spec, replace(spec, cost_scale_s=0.0)):
        torch.manual_seed(0)
        learner = Trainer(SteeringNet(CONFIG), own, own, each, CPU)
        learner.run()
        yaws.append(int(learner._logits(own)["yaw"].mean(axis=0).argmax()))
    assert yaws == [5, 0]


def test_it_learns_from_every_goal_what_turns_cost_and_pitch_from_its_own() -> None:
    """Left is best where the goal is left, right where it is right; the frame's own goal is always left."""
    config = SteeringConfig(width=32, height=32, half_classes=3, goal=True, outputs=("yaw", "pitch"))
    goal = np.tile(np.array([-0.8, -0.8, 0.8], np.float32), (24, 1))
    left = np.array([0, 1, 2, 3, 4, 5, 6], np.float32)
    costs = np.tile(np.stack([left, left, left[::-1]]), (24, 1, 1))
    steering = np.tile(np.array([-1.0, 2 / 3], np.float32), (24, 1))
    own = replace(posts(24, 1), steering=steering, goal=goal, costs=costs)
    validation = replace(own, goal=goal[:, :1], costs=costs[:, :1])
    torch.manual_seed(0)
    spec = SteerSpec(epochs=25, batch=8, learning_rate=0.02, augment=Augment.none(), cost_scale_s=0.25)
    learner = Trainer(SteeringNet(config), own, validation, spec, CPU)
    learner.run()
    best = {}
    for name, bearing in (("left", -0.8), ("right", 0.8)):
        asked = replace(validation, goal=np.full((24, 1), bearing, np.float32))
        best[name] = {output: int(each.mean(axis=0).argmax()) for output, each in learner._logits(asked).items()}
    assert best["left"] == {"yaw": 0, "pitch": 5}
    assert best["right"]["yaw"] == 6
    # Errors told of the training are those towards the frame's own goal.
    assert learner.course.history[-1].train_mae < 0.25


def test_temperatures_are_fitted_to_the_costs() -> None:
    own = replace(posts(24, 1), costs=np.zeros((24, 1, 7), np.float32))
    learner = Trainer(SteeringNet(CONFIG), own, own, SteerSpec(epochs=1, batch=8), CPU)
    learner.run()
    # Every turn costs the same: the flatter the better.
    assert learner.course.history[0].temperature["yaw"] == pytest.approx(HIGHEST, rel=1e-3)


def test_the_learning_rate_rises_and_falls() -> None:
    rates = [learning_rate_at(step, 40, 0.5) for step in range(40)]
    np.testing.assert_allclose(rates[:5], [0.125, 0.25, 0.375, 0.5, 0.5])
    assert rates[22] == pytest.approx(0.25)
    assert rates[39] == pytest.approx(0.25 * (1 + math.cos(math.pi * 35 / 36)))
    assert all(a > b for a, b in pairwise(rates[4:]))
    assert learning_rate_at(0, 1, 0.5) == 0.5


def test_a_step_is_the_step_of_plain_pytorch() -> None:
    """No augmentation, dropout masked by the seed that the trainer uses, all frames in one batch."""
    spec = SteerSpec(
        epochs=1, batch=8, augment=Augment.none(), weight_decay=0.3, length_scale=3.0, dropout_weight=2.0,
        entropy_weight=0.2, sigma=0.15, clip_norm=0.7, learning_rate=0.01,
    )  # fmt: skip
    found = trainer(spec, frames=8)
    before = {name: p.detach().clone() for name, p in found.net.named_parameters()}
    seen: list[tuple[torch.Tensor, torch.Tensor]] = []
    plain_step = found._step

    def noting(batch) -> None:
        seen.append((batch.pictures.clone(), batch.steering.clone()))
        plain_step(batch)

    found._step = noting
    found.run()
    ((pictures, steering),) = seen

    torch.manual_seed(0)
    net = SteeringNet(CONFIG)
    net.train()
    torch.manual_seed(dropout_seed(0, 0, 0))
    logits = net(pictures)["yaw"]
    angles = torch.tensor([-1, -2 / 3, -1 / 3, 0, 1 / 3, 2 / 3, 1])
    theta = torch.exp(-((angles - steering) ** 2) / (2 * 0.15**2))
    theta = theta / theta.sum(1, keepdim=True)
    f = torch.softmax(logits, 1)
    loss = (-(theta * f.log()).sum(1) + 0.2 * (f * f.log()).sum(1)).mean()
    p = torch.sigmoid(net.dropout.p_logit)
    weight = net.heads["yaw"].weight
    penalty = 9.0 / 16 * (weight**2).sum() / (1 - p) + 512 / 8 * (p * p.log() + (1 - p) * (1 - p).log())
    (loss + 2 * penalty).backward()
    named = dict(net.named_parameters())
    norm = math.sqrt(sum(float((each.grad**2).sum()) for each in named.values()))
    assert norm > 0.7
    for name, each in named.items():
        gradient = each.grad * (0.7 / (norm + 1e-6))
        decayed = name in ("trunk.conv1.weight", "trunk.layer4.weight")
        # AdamW's first step: the moments corrected for their bias are the gradient and its square.
        old = before[name] * (1 - 0.01 * 0.3) if decayed else before[name]
        expected = old - 0.01 * gradient / (gradient.abs() + 1e-8)
        sure = gradient.abs() > 1e-4 * gradient.abs().max()
        torch.testing.assert_close(found.net.get_parameter(name)[sure], expected[sure], rtol=1e-4, atol=1e-5)
    assert found.course.history[0].train_loss == pytest.approx(loss.item(), rel=1e-5)
    mae = ((f * angles).sum(1) - steering[:, 0]).abs().mean().item()
    assert found.course.history[0].train_mae == pytest.approx(mae, rel=1e-5)
    assert found.course.history[0].learning_rate == 0.01


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, math.inf])
def test_gradients_are_clipped_as_pytorch_clips_them(scale: float) -> None:
    """To the bit: to leave out a product with 1 changes nothing."""
    rng, nets = torch.Generator().manual_seed(3), []
    net = SteeringNet(CONFIG)
    gradients = {name: scale * torch.randn(each.shape, generator=rng) for name, each in net.named_parameters()}
    for clip in (train.clip_gradients, torch.nn.utils.clip_grad_norm_):
        for name, each in net.named_parameters():
            each.grad = None if name == "trunk.conv1.weight" else gradients[name].clone()
        norm = float(clip(net.parameters(), 0.7))
        nets.append([norm, *(each.grad.clone() for each in net.parameters() if each.grad is not None)])
    torch.testing.assert_close(*nets, rtol=0, atol=0, equal_nan=True)


def test_it_learns_what_the_picture_shows() -> None:
    config = CONFIG.model_copy(update={"columns": 8})
    found = trainer(SteerSpec(epochs=16, batch=16, learning_rate=0.02, augment=Augment.none()), config, frames=64)
    with repeatable(CPU, 1):
        found.run()
    best = found.course.history[found.course.best_epoch - 1]
    still = np.abs(posts(9, 2).steering - constant_steering(posts(64, 1))).mean()
    assert best.mae < 0.5 * still
    assert best.train_loss < found.course.history[0].train_loss


def test_the_figures_of_an_epoch_are_those_of_the_network_as_it_will_predict() -> None:
    found = trainer(SteerSpec(epochs=2, batch=8, sigma=0.08))
    found.run()
    net, frames, last = found.net.eval(), posts(9, 2), found.course.history[-1]
    seen = torch.from_numpy((frames.pictures / 255.0 - 0.5).astype(np.float32) / 0.25).permute(0, 3, 1, 2)
    with torch.no_grad():
        logits = net(seen)["yaw"].double()
    f = torch.softmax(logits / last.temperature["yaw"], 1)
    angles = torch.linspace(-1, 1, 7, dtype=torch.float64)
    y = torch.from_numpy(frames.steering[:, 0]).double()
    assert last.mae == pytest.approx(float(((f * angles).sum(1) - y).abs().mean()), rel=1e-5)
    truth = torch.argmin((angles - y[:, None]).abs(), 1)
    nll = [float(torch.nn.functional.cross_entropy(logits / t, truth)) for t in (last.temperature["yaw"], 1.0)]
    assert last.nll == pytest.approx(nll[0], rel=1e-5)
    assert nll[0] <= nll[1]
    theta = torch.softmax(-((angles - y[:, None]) ** 2) / (2 * 0.08**2), 1)
    plain = torch.softmax(logits, 1)
    loss = (-(theta * plain.log()).sum(1) + 0.05 * (plain * plain.log()).sum(1)).mean()
    assert last.validation_loss == pytest.approx(float(loss), rel=1e-5)


def epoch(number: int, loss: float) -> Epoch:
    return Epoch(
        epoch=number, train_loss=1, train_mae=1, validation_loss=loss, mae=1, rmse=1, accuracy=0, nll=1, ece=0,
        outputs={}, temperature={}, dropout=0.1, spatial_dropout=None, learning_rate=0.1,
    )  # fmt: skip


def test_the_best_epoch_is_the_first_of_the_lowest_loss() -> None:
    assert Course().best_epoch == 0
    assert Course(history=[epoch(i + 1, loss) for i, loss in enumerate([3, 2, 4, 2])]).best_epoch == 2


def test_it_ends_when_nothing_gets_better_and_keeps_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    losses = iter([3.0, 2.0, 2.5, 2.0, 2.2, 1.0])
    found = trainer(SteerSpec(epochs=9, batch=12, patience=3))
    heads: list[torch.Tensor] = []

    def measured() -> Epoch:
        heads.append(found.net.heads["yaw"].weight.detach().clone())
        return epoch(found.course.epoch + 1, next(losses))

    monkeypatch.setattr(found, "_measure", measured)
    found.run()
    assert (found.course.epoch, found.course.best_epoch) == (5, 2)
    torch.testing.assert_close(found.course.best["heads.yaw.weight"], heads[1], rtol=0, atol=0)
    assert not torch.equal(heads[1], heads[4])


def test_without_patience_it_goes_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    found = trainer(SteerSpec(epochs=4, batch=24, patience=0))
    monkeypatch.setattr(found, "_measure", lambda: epoch(found.course.epoch + 1, found.course.epoch + 1.0))
    found.run()
    assert (found.course.epoch, found.course.best_epoch) == (4, 1)


def test_a_training_that_diverges_says_so_and_is_not_whole() -> None:
    found = trainer(SteerSpec(epochs=9, batch=8, learning_rate=1e30, augment=Augment.none()))
    with pytest.raises(
        ArgumentError, match=r"diverged \(epoch \d, learning rate 1e\+30\).*use a lower --learning-rate"
    ):
        found.run()
    assert not found.whole


CONFIGS = [
    CONFIG,
    CONFIG.model_copy(update={"outputs": ("yaw", "pitch"), "goal": True, "columns": 2}),
]


@pytest.mark.parametrize("config", CONFIGS, ids=["yaw", "pitch and goal"])
def test_a_training_goes_on_from_any_state_of_it(config: SteeringConfig) -> None:
    spec = SteerSpec(epochs=3, batch=8, balance=0.5)
    whole = trainer(spec, config)
    kept = []
    with repeatable(CPU, 1):
        whole.run(keep=lambda: kept.append(packed(whole.net, whole.optimiser, whole.course)))
    assert [(each["epoch"], each["batch"]) for _, each in kept] == [(e, b) for e in range(3) for b in (1, 2, 3)]
    for tensors, document in kept:
        again = trainer(spec, config)
        nn.init.zeros_(again.net.heads["yaw"].weight)
        again.course = unpacked(tensors, document, again.net, again.optimiser)
        torch.manual_seed(99)
        with repeatable(CPU, 1):
            again.run()
        assert again.course.history == whole.course.history
        for states in ((again.net.state_dict(), whole.net.state_dict()), (again.course.best, whole.course.best)):
            for name, tensor in states[1].items():
                torch.testing.assert_close(states[0][name], tensor, rtol=0, atol=0)


@pytest.mark.slow
def test_the_real_network_goes_on_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """With weights in channels-last order, which its moments must share."""
    monkeypatch.setattr(network, "ResNet18", ResNet18)
    spec = SteerSpec(epochs=2, batch=4, augment=Augment.none())
    config = CONFIG.model_copy(update={"spatial_dropout": True})
    whole = trainer(spec, config, frames=8)
    kept = []
    with repeatable(CPU, 1):
        whole.run(keep=lambda: kept.append(packed(whole.net, whole.optimiser, whole.course)))
        again = trainer(spec, config, frames=8)
        again.course = unpacked(*kept[0], again.net, again.optimiser)
        again.run()
    assert again.course.history == whole.course.history
    for name, tensor in whole.net.state_dict().items():
        torch.testing.assert_close(again.net.state_dict()[name], tensor, rtol=0, atol=0)


def test_bf16_trains_too_and_is_another_arithmetic() -> None:
    spec = SteerSpec(epochs=1, batch=8)
    plain, short = trainer(spec), trainer(spec)
    short._arithmetic = Arithmetic("cpu", True)
    plain.run()
    short.run()
    one, other = plain.course.history[0], short.course.history[0]
    assert other.train_loss == pytest.approx(one.train_loss, rel=0.05)
    assert other.train_loss != one.train_loss
    assert {tensor.dtype for tensor in short.net.state_dict().values()} == {torch.float32, torch.int64}


@pytest.mark.parametrize("what", ["missing", "shape", "nan", "history", "document"])
def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(what: str) -> None:
    found = trainer(SteerSpec(epochs=1, batch=12))
    found.run()
    tensors, document = packed(found.net, found.optimiser, found.course)
    if what == "missing":
        del tensors["exp_avg/trunk.conv1.weight"]
    elif what == "shape":
        tensors["net/trunk.conv1.weight"] = torch.zeros(3)
    elif what == "nan":
        tensors["exp_avg_sq/trunk.conv1.weight"][0] = math.nan
    elif what == "history":
        document["epoch"] = 2
    else:
        document["more"] = 1
    fresh = trainer(SteerSpec(epochs=1, batch=12))
    before = fresh.net.heads["yaw"].weight.detach().clone()
    with pytest.raises(ValueError, match=r"its |more"):
        unpacked(tensors, document, fresh.net, fresh.optimiser)
    torch.testing.assert_close(fresh.net.heads["yaw"].weight, before)
    assert not fresh.optimiser.state
