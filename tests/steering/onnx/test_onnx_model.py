"""An exported network as a predictor: what it answers, and what is refused instead of run."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from click.testing import CliRunner, Result
from onnx_samples import lively, put_model, put_recording, scenes

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import ArgumentError, HrtError, InputError
from hrt_cli.main import cli
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.onnx.export import export_onnx
from hrt_cli.steering.onnx.file import publish_onnx, read_onnx
from hrt_cli.steering.onnx.model import OnnxPredictor
from hrt_cli.steering.prediction.load import load_predictor

CONFIG = SteeringConfig(outputs=("yaw", "pitch"), half_classes=3, width=32, height=32, goal=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("model")


@pytest.fixture(scope="module")
def model(folder: Path) -> Path:
    return put_model(folder / "steer.safetensors", CONFIG)


@pytest.fixture(scope="module")
def exported(folder: Path, model: Path) -> Path:
    export_onnx(model, folder / "steer.onnx")
    return folder / "steer.onnx"


def rewritten(path: Path, target: Path, graph: bytes | None = None, **changes: Any) -> Path:
    """The same file with other members in its description, or another graph, and hashes that fit."""
    model, document, _ = read_onnx(path)
    document = {key: value for key, value in (document | changes).items() if value is not None}
    publish_onnx(target, graph or model, document, record("test", 1, {}, {}), bool)
    return target


def test_either_file_is_a_predictor(model: Path, exported: Path) -> None:
    torch_side, onnx_side = load_predictor(model), load_predictor(exported)
    assert isinstance(torch_side, TorchPredictor)
    assert isinstance(onnx_side, OnnxPredictor)
    assert onnx_side.config == torch_side.config == CONFIG
    pictures, goal = scenes(6, 32, 32), np.linspace(-2, 2, 6, dtype=np.float32)
    ours, theirs = (each.probabilities(pictures, goal) for each in (torch_side, onnx_side))
    assert list(ours) == list(theirs) == ["yaw", "pitch"]
    for name in ours:
        assert theirs[name].dtype == np.float64
        np.testing.assert_allclose(theirs[name], ours[name], atol=1e-5)
        np.testing.assert_allclose(theirs[name].sum(axis=1), 1, atol=1e-6)
    one = OnnxPredictor(exported, threads=1).probabilities(pictures, goal)
    np.testing.assert_allclose(one["yaw"], theirs["yaw"], atol=1e-6)
    with pytest.raises(ValueError, match="told where to go"):
        onnx_side.probabilities(pictures)


def test_pictures_that_are_not_contiguous_are_seen_right(exported: Path) -> None:
    predictor = OnnxPredictor(exported)
    pictures, goal = scenes(4, 32, 32), np.zeros(4, np.float32)
    mirrored = predictor.probabilities(pictures[:, :, ::-1], goal)
    again = predictor.probabilities(np.ascontiguousarray(pictures[:, :, ::-1]), goal.astype(np.float64))
    np.testing.assert_array_equal(mirrored["yaw"], again["yaw"])


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"version": 2}, r"is of version 2; this hrt reads versions up to 1 \(update hrt\)"),
        ({"version": "1"}, "version"),
        ({"format": "hrt-steering"}, "is not a steering model of hrt"),
        ({"format": None}, "is not a steering model of hrt"),
        ({"config": None}, "config"),
        ({"precision": "int4"}, "precision"),
        ({"more": 1}, "more"),
    ],
)
def test_a_description_that_is_not_ours_is_refused(exported: Path, folder: Path, changes: Any, problem: str) -> None:
    with pytest.raises(InputError, match=rf"odd\.onnx: .*{problem}"):
        OnnxPredictor(rewritten(exported, folder / "odd.onnx", **changes))


@pytest.mark.parametrize(
    "changes", [{"width": 64}, {"half_classes": 4}, {"outputs": ["yaw"]}, {"goal": False}, {"height": 40}]
)
def test_a_graph_of_another_network_is_refused(exported: Path, folder: Path, changes: dict[str, Any]) -> None:
    config = json.loads(CONFIG.model_dump_json()) | changes
    with pytest.raises(InputError, match=r"odd\.onnx: its graph has other inputs or outputs"):
        OnnxPredictor(rewritten(exported, folder / "odd.onnx", config=config))


def test_a_graph_that_cannot_be_run_is_refused_in_one_line(exported: Path, folder: Path) -> None:
    with pytest.raises(InputError, match=r"odd\.onnx: cannot be run by onnxruntime") as refused:
        OnnxPredictor(rewritten(exported, folder / "odd.onnx", graph=b"\x0a\x03abc"))
    assert "\n" not in str(refused.value)


def test_a_graph_cannot_have_other_files_read(exported: Path, folder: Path) -> None:
    """Weights that are said to lie in another file are not fetched from there."""
    (folder / "secret.bin").write_bytes(np.zeros(9, np.float32).tobytes())
    found = onnx.load_from_string(read_onnx(exported)[0])
    bias = next(each for each in found.graph.initializer if each.name == "yaw.logits.bias")
    bias.ClearField("raw_data")
    bias.data_location = onnx.TensorProto.EXTERNAL
    bias.external_data.add(key="location", value="secret.bin")
    with pytest.raises(InputError, match="cannot be run"):
        OnnxPredictor(rewritten(exported, folder / "odd.onnx", graph=found.SerializeToString()))


def test_a_flipped_bit_in_a_weight_is_refused(exported: Path, folder: Path) -> None:
    whole = bytearray(exported.read_bytes())
    whole[len(whole) // 2] ^= 1
    bad = folder / "flipped.onnx"
    bad.write_bytes(whole)
    with pytest.raises(InputError, match=r"flipped\.onnx: its content is not what its provenance recorded"):
        load_predictor(bad)


def test_without_onnxruntime_it_says_what_to_install(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ArgumentError, match=r"steer\.onnx: needs onnxruntime: pip install 'hrt\[onnx\]'"):
        load_predictor(exported)


def run(*args: object) -> Result:
    return CliRunner().invoke(cli, ["export-steer", *map(str, args)])


def test_the_command(tmp_path: Path) -> None:
    config = SteeringConfig(width=32, height=32)
    model = put_model(tmp_path / "m.safetensors", config)
    done = run(model, "-o", tmp_path / "m.onnx", "--json")
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""  # the libraries keep quiet
    found = json.loads(done.stdout)
    assert set(found) == {"output", "up_to_date", "precision", "size_bytes", "comparison"}
    assert found["precision"] == "float32"
    assert found["comparison"]["mae_before"] is None


@pytest.mark.slow
def test_the_command_in_int8(tmp_path: Path) -> None:
    model = put_model(tmp_path / "m.safetensors", SteeringConfig(width=32, height=32))
    seen = put_recording(tmp_path / "seen", scenes(33, 32, 32))
    shown = run(model, "-o", tmp_path / "i.onnx", "--int8", "--calibrate", seen)
    assert shown.stderr == ""
    assert "MAE" in shown.stdout
    assert "on 33 frames" in shown.stdout
    assert len(shown.stdout.splitlines()) == 1
    assert "up to date" in run(model, "-o", tmp_path / "i.onnx", "--int8", "--calibrate", seen).stdout
    ours, theirs = load_predictor(model), load_predictor(tmp_path / "i.onnx")
    pictures = scenes(4, 32, 32, seed=5)
    np.testing.assert_allclose(
        theirs.probabilities(pictures)["yaw"], ours.probabilities(pictures)["yaw"], atol=0.15
    )  # fmt: skip


def test_the_command_refuses_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "m.safetensors").write_bytes(b"\x80\x04cposix\nsystem\n")
    refused = run(tmp_path / "m.safetensors", "-o", tmp_path / "m.onnx")
    assert isinstance(refused.exception, HrtError)
    assert "no safetensors file" in str(refused.exception)
    assert not (tmp_path / "m.onnx").exists()


def test_lively_networks_are_repeatable() -> None:
    pictures, goal = scenes(2, 32, 32), np.zeros(2, np.float32)
    one, two = (TorchPredictor(lively(CONFIG)).probabilities(pictures, goal)["yaw"] for _ in range(2))
    np.testing.assert_array_equal(one, two)
