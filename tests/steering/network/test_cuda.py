"""A GPU, where there is one, learns what a CPU learns; what it made is used without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from steer_files import put_recording

from hrt_cli.artifacts.stage import Existing
from hrt_cli.steering.network.model import model_provenance, read_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.precision import Arithmetic, choose, repeatable
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.training.gather import gather
from hrt_cli.steering.training.stage import train_steer_file
from hrt_cli.steering.training.train import SteerSpec, Trainer

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU that CUDA finds")
CONFIG = SteeringConfig(width=64, height=32, half_classes=3)
# Dropout draws from the device's own generator, so a network that drops nothing is compared.
SPEC = SteerSpec(epochs=2, batch=16, gap=0, threads=2, dropout_weight=0.0, learning_rate=1e-3)


def trained(data: Path, arithmetic: Arithmetic) -> Trainer:
    torch.manual_seed(0)
    net = SteeringNet(CONFIG)
    torch.nn.init.constant_(net.dropout.get_parameter("p_logit"), -30.0)
    gathered = gather([data], [], SPEC, CONFIG)
    with repeatable(arithmetic, SPEC.threads):
        trainer = Trainer(net, gathered.training, gathered.validation, SPEC, arithmetic)
        trainer.run()
    return trainer


def test_it_learns_what_the_cpu_learns(tmp_path: Path) -> None:
    data = put_recording(tmp_path / "a", 80, width=64)
    own, other = (trained(data, Arithmetic(device, False)) for device in ("cuda", "cpu"))
    for a, b in zip(own.course.history, other.course.history, strict=True):
        assert a.train_loss == pytest.approx(b.train_loss, rel=2e-3)
        assert a.train_mae == pytest.approx(b.train_mae, rel=2e-2)


def test_what_it_made_is_used_without_it_and_made_anew_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, output = put_recording(tmp_path / "a", 80, width=64), tmp_path / "m.safetensors"
    done = train_steer_file([data], output, SPEC, CONFIG)
    assert done.arithmetic == choose("auto")
    found = model_provenance(output)
    assert found is not None
    assert found.parameters["device"] == "cuda"
    before = output.read_bytes()
    train_steer_file([data], output, SPEC, CONFIG, existing=Existing(force=True))
    assert output.read_bytes() == before
    other = replace(SPEC, threads=1)
    assert train_steer_file([data], output, other, CONFIG).up_to_date
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    pictures = np.zeros((2, 32, 64, 3), np.uint8)
    share = TorchPredictor(read_model(output)).probabilities(pictures)["yaw"]
    assert share.shape == (2, 7)
    assert share.sum(axis=1) == pytest.approx(1.0)
