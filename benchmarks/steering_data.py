"""Frames for the steering benchmarks: a recorded tub, parted by blocks, and pictures that are made up."""

from __future__ import annotations

import json
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tables import DATA, Skipped

from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import Samples, read_samples
from hrt_cli.steering.recordings.split import Split, split
from hrt_cli.steering.training.batches import Frames

TUB = DATA / "donkeycar_tub" / "tub.tar.gz"
SHARE = 0.2


@dataclass(frozen=True)
class Recorded:
    """Frames of a recording at one size; `digest` is of their files and labels, whatever the size."""

    samples: Samples
    pictures: NDArray[np.uint8]
    digest: str

    def frames(self, rows: NDArray[np.int64]) -> Frames:
        return Frames(self.pictures, rows, self.samples.steering[rows], None)


@contextmanager
def opened(data: Path) -> Iterator[Path]:
    """Give a folder with steering data: a folder itself, or a packed one unpacked for the time being."""
    if not data.exists():
        raise Skipped(f"{data} is absent: give a Donkeycar tub v2 with --data")
    if data.is_dir():
        yield data
        return
    with tempfile.TemporaryDirectory() as name:
        with tarfile.open(data) as packed:
            packed.extractall(name, filter="data")
        yield Path(name)


def load(folder: Path, config: SteeringConfig) -> Recorded:
    samples, pictures, digest = load_pictures(read_samples([folder]), config)
    return Recorded(samples, pictures, digest)


def part(samples: Samples, gap: int, seed: int) -> Split:
    """Hold whole blocks out, and drop `gap` frames on either side: `hrt train-steer --split block` does the same."""
    return split(samples, by="block", share=SHARE, gap=gap, seed=seed)


def throttles(samples: Samples) -> NDArray[np.float32]:
    """Return Donkeycar's `user/throttle` of each frame, from the catalogs of its tub."""
    found: dict[str, float] = {}
    for catalog in samples.files[1:]:
        for line in catalog.read_text(encoding="utf-8").splitlines():
            record = json.loads(line)
            if "user/throttle" not in record:
                raise Skipped(f"{catalog} has no user/throttle, which Donkeycar's pilots learn, too")
            found[record["cam/image_array"]] = float(record["user/throttle"])
    missing = [path.name for path in samples.paths if path.name not in found]
    if missing:
        raise Skipped(f"{samples.files[0]} is no Donkeycar tub: nothing tells the throttle of {missing[0]}")
    return np.array([found[path.name] for path in samples.paths], np.float32)


def made_up(count: int, width: int, height: int, seed: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return pictures [n, height, width, 3] of noise with a bright bar that moves with the steering [n, 1]."""
    rng = np.random.default_rng(seed)
    steering = rng.uniform(-1, 1, (count, 1)).astype(np.float32)
    pictures = rng.integers(0, 128, (count, height, width, 3), dtype=np.uint8)
    for picture, (yaw,) in zip(pictures, steering, strict=True):
        middle = round((0.5 + 0.4 * float(yaw)) * width)
        picture[height // 3 :, max(0, middle - width // 16) : middle + width // 16] = 255
    return pictures, steering


def write_recording(folder: Path, pictures: NDArray[np.uint8], steering: NDArray[np.float32]) -> Path:
    """Write frames as a recording of hrt."""
    folder.mkdir(parents=True)
    rows = ["image,yaw"]
    for number, (picture, (yaw,)) in enumerate(zip(pictures, steering, strict=True)):
        name = f"{number:05d}.png"
        if not cv2.imwrite(str(folder / name), picture[..., ::-1]):
            raise RuntimeError(f"{folder / name}: cannot be written")
        rows.append(f"{name},{float(yaw):.4f}")
    (folder / "labels.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder
