"""Small artifacts of every kind, to be changed in one place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.artifacts.carriers import publish_json, publish_npz
from hrt_cli.artifacts.drivelog import Header, Robot, publish_drive_log
from hrt_cli.artifacts.provenance import record
from hrt_cli.main import cli
from hrt_cli.planning.policy import default_policies
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.raster.windows import Window
from hrt_cli.texture.model import TextureModel
from hrt_cli.texture.settings import FeatureSettings

UTM33 = CRS.from_epsg(32633)
PLACE = Affine(1, 0, 400_000, 0, -1, 5_000_000)
NAMES = ["grass", "sand", "rock"]
FEATURES = FeatureSettings(
    features="site", rotation="invariant", wavelengths_m=(0.2, 0.4), orientations=4, texture_sigma_m=0.6,
    fit_sigma_m=1.0, colour_sigma_m=0.4, contrast_sigma_m=0.6, step_m=0.4, scale_invariant=False,
)  # fmt: skip


def compare(a: Path, b: Path, *options: object) -> Result:
    return CliRunner().invoke(cli, ["compare", str(a), str(b), *map(str, options)])


def figures(a: Path, b: Path, *options: object) -> dict[str, Any]:
    """What `hrt compare --json` says of the figures."""
    found: dict[str, Any] = json.loads(compare(a, b, "--json", *options).stdout)["figures"]
    return found


def differing(a: Path, b: Path, *options: object) -> set[str]:
    """The names of the figures that are beyond their tolerances; exit code and message agree with them."""
    done = compare(a, b, "--json", *options)
    found = json.loads(done.stdout)
    names = {name for name, each in found["figures"].items() if each["ok"] is False}
    assert getattr(done.exception, "exit_code", 0) == (3 if names else 0), done.output
    assert found["same"] is (not names)
    if names:
        assert str(done.exception).startswith(f"{b}: differs from {a} in ")
        assert next(name for name, each in found["figures"].items() if each["ok"] is False) in str(done.exception)
    return names


def ids(rows: int = 40, cols: int = 50) -> NDArray[np.uint8]:
    found = (np.arange(cols)[None, :] * 3 // cols + np.zeros((rows, 1))).astype(np.uint8)
    found[:3, :4] = 255
    return found


def put_classes(
    path: Path,
    values: NDArray[np.uint8] | None = None,
    *,
    names: list[str] | None = None,
    transform: Affine = PLACE,
    crs: CRS | None = UTM33,
    **creation: str,
) -> Path:
    values = ids() if values is None else values
    grid = Grid(*values.shape, transform, crs)
    made = record("segment", 1, {}, {})
    with publishing_classes(path, grid, names or NAMES, made, tags={}, creation=creation) as writer:
        writer.write(Window(0, 0, *values.shape), values)
    return path


def scores_map() -> NDArray[np.float32]:
    score = np.random.default_rng(4).random((20, 24)).astype(np.float32)
    score[5:9, 12] = np.nan
    return score


def put_scoremap(
    path: Path,
    score: NDArray[np.float32] | None = None,
    sd: NDArray[np.float32] | None = None,
    transform: Affine = PLACE,
    crs: CRS = UTM33,
) -> Path:
    score = scores_map() if score is None else score
    sd = np.where(np.isnan(score), np.nan, 0.1).astype(np.float32) if sd is None else sd
    grid = Grid(*score.shape, transform, crs)
    publish_scoremap(path, Scoremap(score, sd, grid, 1.0), record("scoremap", 1, {}, {}), tags={}, creation={})
    return path


def put_plan(path: Path, scoremap: Path, *, robots: int = 1, seed: int = 0) -> Path:
    starts = (parse_start("cell:3,4"),)
    request = PlanRequest(starts, parse_budget("25"), method="greedy", robots=robots, seed=seed)
    plan_file(scoremap, path, request)
    return path


def edit(source: Path, target: Path, change: Callable[[dict[str, Any]], object], *, signed: bool = False) -> Path:
    """Copy a JSON artifact with a change; its provenance stands as it was, or is made anew."""
    document = json.loads(source.read_text())
    change(document)
    if signed:
        document.pop("provenance", None)
        publish_json(target, document, record("test", 1, {}, {}))
    else:
        target.write_text(json.dumps(document))
    return target


SCORES = {
    "0": {"name": "grass", "alpha": 8.0, "beta": 2.0, "evidence_m": 8.0},
    "1": {"name": "sand", "alpha": 3.0, "beta": 3.0, "evidence_m": 4.0},
    "2": {"name": "rock", "mean": 0.1},
}


def put_scores(path: Path, **changes: dict[str, Any] | None) -> Path:
    """Write a score table; `_1={...}` changes members of class 1, None leaves it out."""
    table = {k: dict(v) for k, v in SCORES.items()}
    for key, change in changes.items():
        if change is None:
            del table[key[1:]]
        else:
            table[key[1:]] = table.get(key[1:], {}) | change
    path.write_text(json.dumps({"scores": table}))
    return path


def put_policy(path: Path, change: Callable[[dict[str, Any]], object] = lambda arrays: None) -> Path:
    arrays: dict[str, Any] = {name: array.copy() for name, array in default_policies()[0].to_arrays().items()}
    change(arrays)
    publish_npz(path, arrays, record("train-plan", 1, {}, {}))
    return path


def put_texture(path: Path, change: Callable[[dict[str, Any]], object] = lambda arrays: None) -> Path:
    rng = np.random.default_rng(0)
    channels = sum(FEATURES.block_sizes)
    model = TextureModel(
        FEATURES, (0.1, 0.1), rng.random(channels), rng.random((5, channels)), rng.random((3, 5)),
        np.array([0.5, 0.25, 0.25]), rng.random((3, 3)) * 255, rng.random(3), rng.random(3),
    )  # fmt: skip
    arrays: dict[str, Any] = dict(model.to_arrays())
    change(arrays)
    publish_npz(path, arrays, record("segment", 1, {}, {}))
    return path


def drive() -> list[dict[str, Any]]:
    return [
        {"t": 10.0 + 0.5 * k, "x": 400_005.0 + 0.4 * k, "y": 4_999_990.0, "speed_m_s": 0.8, "heading_deg": 90.0}
        for k in range(20)
    ]


def put_drive(path: Path, records: list[dict[str, Any]] | None = None, crs: str | None = "EPSG:32633") -> Path:
    header = Header(format="hrt-drive-log", crs=crs, robot=Robot(kind="ugv", radius_m=0.35), end="arrived")
    publish_drive_log(path, header, drive() if records is None else records, record("drive", 1, {}, {}))
    return path


def recoded(source: Path, target: Path, **profile: Any) -> Path:
    """The same raster stored otherwise, by plain rasterio; `transform` and `crs` may stand in for its own."""
    with rasterio.open(source) as dataset:
        options = {**dataset.profile, "driver": "GTiff", "compress": "lzw", "tiled": False, **profile}
        for key in ("blockxsize", "blockysize", "interleave"):
            options.pop(key, None)
        pixels, tags = dataset.read(), dataset.tags(ns="HRT")
        colours = dataset.colormap(1) if dataset.count == 1 else None
        descriptions = dataset.descriptions
    with rasterio.open(target, "w", **options) as dataset:
        dataset.descriptions = descriptions
        if colours is not None:
            dataset.write_colormap(1, colours)
        dataset.write(pixels)
        dataset.update_tags(ns="HRT", **tags)
    return target
