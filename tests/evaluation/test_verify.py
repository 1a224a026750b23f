from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from affine import Affine
from rasterio.crs import CRS
from safetensors.torch import save_file

from hrt_cli.artifacts.carriers import publish_json, publish_npz
from hrt_cli.artifacts.png import publish_png
from hrt_cli.artifacts.provenance import Provenance, record
from hrt_cli.errors import InputError
from hrt_cli.evaluation.verify import verify_file
from hrt_cli.raster.cog import Layout, publishing_cog
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window
from hrt_cli.steering.network.model import publish_tensors

GRID = Grid(40, 50, Affine(0.1, 0, 500_000, 0, -0.1, 5_400_000), CRS.from_epsg(32633))


def publish_steering(target: Path, provenance: Provenance) -> None:
    tensors = {"heads.yaw.weight": torch.arange(40.0), "heads.yaw.bias": torch.zeros(3)}
    publish_tensors(target, tensors, {"format": "hrt-steering", "version": 1}, provenance)


def publish_tif(target: Path, provenance: Provenance) -> None:
    pixels = np.random.default_rng(0).integers(0, 5, GRID.shape, np.uint8)
    with publishing_cog(target, GRID, Layout(("class",), "uint8", nodata=255), provenance) as writer:
        writer.write(Window(0, 0, *GRID.shape), pixels)


PUBLISHERS: dict[str, Callable[[Path, Provenance], None]] = {
    "out.json": lambda target, provenance: publish_json(target, {"score": 1.5, "cells": [[0, 1]] * 40}, provenance),
    "out.geojson": lambda target, provenance: publish_json(target, {"features": []}, provenance),
    "out.npz": lambda target, provenance: publish_npz(target, {"weights": np.arange(40.0)}, provenance),
    "out.png": lambda target, provenance: publish_png(
        target, bytes(cv2.imencode(".png", np.eye(20, dtype=np.uint8))[1]), provenance
    ),
    "out.tif": publish_tif,
    "out.safetensors": publish_steering,
}


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Path]:
    paths = {"ortho": tmp_path / "ortho.bin", "scores": tmp_path / "scores.bin"}
    for role, path in paths.items():
        path.write_text(role)
    return paths


@pytest.fixture(params=PUBLISHERS)
def artifact(request: pytest.FixtureRequest, tmp_path: Path, inputs: dict[str, Path]) -> Path:
    target: Path = tmp_path / request.param
    PUBLISHERS[request.param](target, record("segment", 1, {"classes": 5}, inputs))
    return target


def test_an_artifact_as_it_was_written_is_ok(artifact: Path) -> None:
    found = verify_file(artifact)
    assert (found.verdict, found.inputs_checked, found.inputs_absent) == ("ok", 2, 0)
    assert "segment" in found.detail


def test_a_changed_input_is_found(artifact: Path, inputs: dict[str, Path]) -> None:
    inputs["scores"].write_text("other")
    found = verify_file(artifact)
    assert found.verdict == "changed"
    assert found.detail == "its input scores.bin has changed since"


def test_inputs_are_looked_for_in_the_folders_given(artifact: Path, inputs: dict[str, Path]) -> None:
    elsewhere = artifact.parent / "elsewhere"
    elsewhere.mkdir()
    for path in inputs.values():
        path.rename(elsewhere / path.name)
    absent = verify_file(artifact)
    assert (absent.verdict, absent.inputs_checked, absent.inputs_absent) == ("ok", 0, 2)
    found = verify_file(artifact, (artifact.parent / "nowhere", elsewhere))
    assert (found.verdict, found.inputs_checked, found.inputs_absent) == ("ok", 2, 0)
    (elsewhere / "ortho.bin").write_text("other")
    assert verify_file(artifact, (elsewhere,)).verdict == "changed"
    # Another file of that name beside it is no contradiction while one of them is the input.
    (artifact.parent / "ortho.bin").write_text("ortho")
    assert verify_file(artifact, (elsewhere,)).verdict == "ok"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_a_cut_artifact_is_damaged(artifact: Path, share: float) -> None:
    content = artifact.read_bytes()
    artifact.write_bytes(content[: int(share * len(content))])
    found = verify_file(artifact)
    # A GeoTIFF cut in its header opens without its tags.
    assert found.verdict == "damaged" or (artifact.suffix == ".tif" and share == 0.3 and found.verdict == "unsigned")
    assert str(artifact) not in found.detail


def test_an_artifact_with_a_flipped_bit_in_its_content_is_damaged(artifact: Path) -> None:
    content = bytearray(artifact.read_bytes())
    marks = {".json": b"1.5", ".geojson": b"features", ".npz": b"weights", ".png": b"IDAT"}
    if artifact.suffix in marks:
        mark = marks[artifact.suffix]
        position = content.index(mark) + len(mark) - 1
    else:
        # The pixels of a small Cloud Optimised GeoTIFF are nearly the last thing in it, and tensors the very last.
        position = len(content) - (200 if artifact.suffix == ".tif" else 20)
    content[position] ^= 1
    artifact.write_bytes(content)
    assert verify_file(artifact).verdict == "damaged"


@pytest.mark.parametrize("what", ["a setting", "a tensor's name"])
def test_a_steering_model_whose_header_was_changed_is_damaged(tmp_path: Path, what: str) -> None:
    target = tmp_path / "m.safetensors"
    publish_steering(target, record("train-steer", 1, {"epochs": 60}, {}))
    assert verify_file(target).verdict == "ok"
    old, new = (b"hrt-steering", b"hrt-steerinG") if what == "a setting" else (b"yaw.bias", b"yaw.bIas")
    content = target.read_bytes()
    assert content.count(old) == 1
    target.write_bytes(content.replace(old, new))
    found = verify_file(target)
    assert found.verdict == "damaged"
    assert found.detail.startswith("its content is not what its provenance recorded")


def test_weights_of_another_tool_are_no_artifact_of_hrt(tmp_path: Path) -> None:
    save_file({"weight": torch.zeros(3)}, tmp_path / "other.safetensors")
    assert verify_file(tmp_path / "other.safetensors").verdict == "unsigned"
    torch.save({"weight": torch.zeros(3)}, tmp_path / "pickle.safetensors")
    found = verify_file(tmp_path / "pickle.safetensors")
    assert (found.verdict, found.detail) == ("damaged", "is no safetensors file, or a damaged one")


def test_a_model_without_provenance_is_unsigned(tmp_path: Path) -> None:
    save_file({"weight": torch.zeros(3)}, tmp_path / "m.safetensors", metadata={"hrt": '{"format": "hrt-steering"}'})
    assert verify_file(tmp_path / "m.safetensors").verdict == "unsigned"


@pytest.mark.parametrize(("name", "content"), [("a.json", b"{}"), ("a.geojson", b'{"type": "Feature"}')])
def test_a_file_without_provenance_is_unsigned(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    found = verify_file(tmp_path / name)
    assert (found.verdict, found.detail) == ("unsigned", "carries no provenance")


def test_the_suffix_may_be_written_large(tmp_path: Path) -> None:
    PUBLISHERS["out.json"](tmp_path / "OUT.JSON", record("plan", 1, {}, {}))
    assert verify_file(tmp_path / "OUT.JSON").verdict == "ok"


@pytest.mark.parametrize("name", ["absent.json", ".", "a.txt", "noext"])
def test_what_is_no_artifact_is_refused(tmp_path: Path, name: str) -> None:
    for other in ("a.txt", "noext"):
        (tmp_path / other).touch()
    with pytest.raises(InputError, match=r"no such file|is no artifact"):
        verify_file(tmp_path / name)
