"""Small steering networks that answer something, and recordings for them to see."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from hrt_cli.artifacts.provenance import record
from hrt_cli.steering.network.model import publish_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.pictures import prepare

torch.set_num_threads(1)


def lively(config: SteeringConfig, seed: int = 0) -> SteeringNet:
    """A network with statistics of its own in every batch norm, and answers that are not all alike."""
    torch.manual_seed(seed)
    net = SteeringNet(config)
    seen = torch.from_numpy(prepare(scenes(32, config.height, config.width, seed=77), config))
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.weight.uniform_(0.5, 1.2)
                module.bias.normal_(0, 0.1)
                module.momentum = None  # the statistics of what it sees
        net.train()
        net.trunk(seen)
        net.eval()
        features = net.features(seen, torch.linspace(-3, 3, len(seen)) if config.goal else None)
        for head in net.heads.values():
            head.weight.normal_().mul_(0.4 / (features.std(0) + 0.1) / features.shape[1] ** 0.5)
            head.bias.copy_(-head.weight @ features.mean(0))
    return net


def put_model(path: Path, config: SteeringConfig, seed: int = 0, parameters: dict[str, object] | None = None) -> Path:
    publish_model(path, lively(config, seed), config, record("test", 1, parameters or {"seed": seed}, {}))
    return path


def scenes(count: int, rows: int, cols: int, seed: int = 0) -> np.ndarray:
    """Pictures that differ in colour, in what is where, and in fine structure, uint8 [count, rows, cols, 3]."""
    rng = np.random.default_rng(seed)
    colour = rng.integers(0, 120, (count, 1, 1, 3))
    coarse = rng.integers(0, 100, (count, -(-rows // 8), -(-cols // 8), 3)).repeat(8, 1).repeat(8, 2)[:, :rows, :cols]
    return (colour + coarse + rng.integers(0, 36, coarse.shape)).astype(np.uint8)


def put_recording(
    folder: Path, pictures: np.ndarray, *, sessions: int = 1, goal: bool = False, pitch: bool = False, seed: int = 0
) -> Path:
    """A folder with `labels.csv` and PNGs."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    lines = ["image,yaw,session" + ",pitch" * pitch + ",goal_deg" * goal]
    for k, rgb in enumerate(pictures):
        cv2.imwrite(str(folder / f"{k}.png"), rgb[..., ::-1])
        more = f",{rng.uniform(-1, 1):.4f}" * pitch + f",{rng.uniform(-90, 90):.2f}" * goal
        lines.append(f"{k}.png,{rng.uniform(-1, 1):.4f},s{k * sessions // len(pictures)}{more}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n")
    return folder
