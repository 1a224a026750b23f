"""Small recordings of each kind, for tests."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def picture(seed: int = 0, rows: int = 24, cols: int = 32) -> NDArray[np.uint8]:
    """A smooth picture (a JPEG keeps it nearly), different for each seed."""
    coarse = np.random.default_rng(seed).integers(0, 256, (3, 4, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_LINEAR), np.uint8)


def put_picture(path: Path, rgb: NDArray[Any] | None = None, *, seed: int = 0) -> Path:
    """Write a picture, RGB, in the format that its name says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rgb = picture(seed) if rgb is None else rgb
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 and rgb.shape[2] == 3 else rgb)
    return path


def put_labels(
    folder: Path,
    yaws: Sequence[float | str],
    *,
    pitches: Sequence[float] | None = None,
    sessions: Sequence[str] | None = None,
    goals_deg: Sequence[float] | None = None,
    costs_s: Sequence[str] | None = None,
    other_goals_deg: Sequence[str] | None = None,
    other_costs_s: Sequence[str] | None = None,
) -> Path:
    """A recording of hrt."""
    columns = {"image": [f"frames/{n:06d}.jpg" for n in range(len(yaws))], "yaw": yaws}
    columns |= {"pitch": pitches} if pitches is not None else {}
    columns |= {"session": sessions} if sessions is not None else {}
    columns |= {"goal_deg": goals_deg} if goals_deg is not None else {}
    columns |= {"turn_costs_s": costs_s} if costs_s is not None else {}
    columns |= {"other_goals_deg": other_goals_deg} if other_goals_deg is not None else {}
    columns |= {"other_costs_s": other_costs_s} if other_costs_s is not None else {}
    for number, name in enumerate(columns["image"]):
        put_picture(folder / str(name), seed=number)
    rows = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    return put_text(folder / "labels.csv", "\n".join(rows) + "\n")


def put_text(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())
    return path


def put_tub(
    folder: Path, records: Sequence[Sequence[dict[str, Any] | str]], *, deleted: Sequence[int] = (), **state: Any
) -> Path:
    """A Donkeycar tub of some catalogs; a record that is text is written as it is."""
    paths = [f"catalog_{n}.catalog" for n in range(len(records))]
    for name, catalog in zip(paths, records, strict=True):
        lines = [each if isinstance(each, str) else json.dumps(each) for each in catalog]
        put_text(folder / name, "".join(line + "\n" for line in lines))
    (folder / "images").mkdir(exist_ok=True)
    last = {"paths": paths, "current_index": sum(map(len, records)), "max_len": 1000, "deleted_indexes": list(deleted)}
    head = [["cam/image_array", "user/angle"], ["image_array", "float"], {}, {"created_at": 0.0}]
    text = "".join(json.dumps(each) + "\n" for each in [*head, last | state])
    return put_text(folder / "manifest.json", text)


def tub_record(index: int, angle: float, **more: Any) -> dict[str, Any]:
    return {"_index": index, "cam/image_array": f"{index}_cam_image_array_.jpg", "user/angle": angle, **more}
