"""Small recordings whose steering can be read off the picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np


def put_recording(
    folder: Path,
    frames: int = 24,
    *,
    sessions: int = 2,
    width: int = 32,
    height: int = 32,
    pitch: bool = False,
    goal: bool = False,
    seed: int = 0,
) -> Path:
    """Write a recording in which a bright post stands where the robot should steer, and a bar where it should pitch."""
    rng = np.random.default_rng(seed)
    (folder / "frames").mkdir(parents=True)
    names = ["image", "yaw", *(["pitch"] if pitch else []), "session", *(["goal_deg"] if goal else [])]
    lines = [",".join(names)]
    for number in range(frames):
        yaw, climb = rng.uniform(-1, 1, 2)
        picture = rng.integers(20, 60, (height, width, 3), np.uint8)
        at = round((yaw + 1) / 2 * (width - 5))
        picture[:, at : at + 5] = (230, 210, 190)
        if pitch:
            at = round((1 - climb) / 2 * (height - 4))
            picture[at : at + 4] = (60, 220, 60)
        name = f"frames/{number:03d}.png"
        cv2.imwrite(str(folder / name), picture)
        row = [name, f"{yaw:.4f}", *([f"{climb:.4f}"] if pitch else []), f"s{number * sessions // frames}"]
        lines.append(",".join([*row, *([f"{yaw * 40:.2f}"] if goal else [])]))
    (folder / "labels.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
