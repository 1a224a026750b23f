"""Small networks and pictures for the tests of prediction, in memory and as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrt_cli.artifacts.provenance import record
from hrt_cli.steering.network.model import publish_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet

# For pictures this small, threads cost more than they bring.
torch.set_num_threads(1)
WIDTH, HEIGHT = 64, 48


def small_net(seed: int = 0, **config: Any) -> SteeringNet:
    """An untrained network, ready to predict, whose answers differ from picture to picture."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = SteeringNet(SteeringConfig(**{"width": WIDTH, "height": HEIGHT, **config})).eval()
        for head in net.heads.values():
            nn.init.normal_(head.weight, std=0.03)
    return net


def put_net(path: Path, net: SteeringNet) -> Path:
    publish_model(path, net, net.config, record("train-steer", 1, {}, {}))
    return path


class FixedTrunk(nn.Module):
    """Sees the same features whatever it is shown; what its last stage makes of them is three times as much."""

    def __init__(self, maps: Tensor) -> None:
        super().__init__()
        self.maps = maps

    def forward(self, x: Tensor, dropout: nn.Module | None = None) -> Tensor:
        return self.layer4(self.to_layer3(x))

    def to_layer3(self, x: Tensor) -> Tensor:
        return self.maps.expand(len(x), *self.maps.shape[1:]).clone()

    def layer4(self, x: Tensor) -> Tensor:
        return 3.0 * x


def noise(count: int, seed: int = 0, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (count, height, width, 3), np.uint8)


def put_pictures(folder: Path, count: int, seed: int = 0) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{index}.png" for index in range(count)]
    for path, picture in zip(paths, noise(count, seed), strict=True):
        path.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
    return paths


def put_recording(folder: Path, count: int, *, goal: bool = False, yaw: float = 0.25) -> Path:
    """Pictures with labels; the goal of each is 10 degrees further to the right."""
    put_pictures(folder / "frames", count)
    rows = ["image,yaw,session" + (",goal_deg" if goal else "")]
    rows += [f"frames/{k}.png,{yaw},a" + (f",{10 * k}" if goal else "") for k in range(count)]
    (folder / "labels.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def put_video(path: Path, count: int, fourcc: str = "MJPG", fps: float = 10.0) -> Path:
    """A video whose frame k is a grey of 10 k."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*fourcc), fps, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for index in range(count):
        writer.write(np.full((HEIGHT, WIDTH, 3), 10 * index, np.uint8))
    writer.release()
    return path
