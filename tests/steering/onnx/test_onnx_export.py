"""Exported networks: the same answers as PyTorch's, refused where they are not, the same bytes again."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx_samples import lively, put_model, put_recording, scenes

from hrt_cli.artifacts.provenance import file_sha256
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.onnx import export as onnx_export
from hrt_cli.steering.onnx import frames as onnx_frames
from hrt_cli.steering.onnx.export import SteerExport, compare, describe_use, export_onnx
from hrt_cli.steering.onnx.file import read_onnx
from hrt_cli.steering.onnx.frames import made_up_frames, read_frames
from hrt_cli.steering.onnx.graph import float_graph
from hrt_cli.steering.onnx.model import OnnxPredictor

SMALL = SteeringConfig(width=48, height=32, columns=2)
FULL = SteeringConfig(
    outputs=("yaw", "pitch"),
    half_classes=4,
    width=72,
    height=40,
    crop_top=0.25,
    mean=(0.485, 0.456, 0.406),
    std=(0.229, 0.224, 0.225),
    columns=2,
    goal=True,
    spatial_dropout=True,
    temperature={"pitch": 2.5},
)
FORCE = Existing(force=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("export")


@pytest.fixture(scope="module")
def model(folder: Path) -> Path:
    return put_model(folder / "steer.safetensors", SMALL)


@pytest.fixture(scope="module")
def exported(folder: Path, model: Path) -> Path:
    export_onnx(model, folder / "steer.onnx")
    return folder / "steer.onnx"


@pytest.fixture(scope="module")
def recording(folder: Path) -> Path:
    return put_recording(folder / "seen", scenes(40, 32, 48))


@pytest.fixture(scope="module")
def int8(folder: Path, model: Path, recording: Path) -> tuple[Path, SteerExport]:
    output = folder / "int8.onnx"
    return output, export_onnx(model, output, int8=True, calibration=[recording])


@pytest.mark.parametrize("config", [SMALL, FULL], ids=["small", "full"])
def test_it_answers_as_pytorch_does(config: SteeringConfig) -> None:
    net = lively(config, seed=3)
    session = onnxruntime.InferenceSession(float_graph(net, "").SerializeToString())
    pictures = scenes(5, config.height, config.width)
    goal = np.linspace(-3, 3, 5, dtype=np.float32)
    inputs = {"image": pictures} | ({"goal": goal} if config.goal else {})
    expected = TorchPredictor(net).probabilities(pictures, goal if config.goal else None)
    assert [each.name for each in session.get_outputs()] == list(config.outputs)
    for name, found in zip(config.outputs, session.run(None, inputs), strict=True):
        assert expected[name].std(axis=0).max() > 0.005  # the answers differ from picture to picture
        np.testing.assert_allclose(found, expected[name], atol=1e-5)
        for k in range(5):  # and one by one
            alone = session.run([name], {key: value[k : k + 1] for key, value in inputs.items()})[0]
            np.testing.assert_allclose(alone[0], expected[name][k], atol=1e-5)


def test_the_goal_counts_as_it_does_in_pytorch() -> None:
    """Every bearing, with more columns than the features have, which is how those of a small picture overlap."""
    config = SteeringConfig(width=64, height=32, columns=3, goal=True, half_classes=5, temperature={"yaw": 0.7})
    net = lively(config, seed=8)
    session = onnxruntime.InferenceSession(float_graph(net, "").SerializeToString())
    goal = np.radians(np.arange(-360.0, 361.0, 22.5)).astype(np.float32)
    pictures = np.broadcast_to(scenes(1, 32, 64), (len(goal), 32, 64, 3)).copy()
    (found,) = session.run(None, {"image": pictures, "goal": goal})
    wanted = TorchPredictor(net).probabilities(pictures, goal)["yaw"]
    assert np.abs(found - wanted).max() <= 1e-5
    assert wanted.std(axis=0).max() > 0.01  # the answers differ from bearing to bearing
    np.testing.assert_allclose(found[:16], found[16:32], atol=1e-5)  # a whole turn on


@pytest.mark.parametrize(("width", "columns"), [(160, 3), (97, 4), (32, 1), (70, 5)])
def test_columns_are_averaged_as_the_network_does(width: int, columns: int) -> None:
    from hrt_cli.steering.onnx.graph import _column_shares

    seen = torch.randn(2, 6, 3, -(-width // 32))
    share = torch.from_numpy(_column_shares(SteeringConfig(width=width, columns=columns)))
    wanted = torch.nn.functional.adaptive_avg_pool2d(seen, (1, columns))[:, :, 0]
    np.testing.assert_allclose((seen.mean(2) @ share).numpy(), wanted.numpy(), atol=1e-6)


def test_the_file_is_an_onnx_model_that_says_how_to_feed_it(exported: Path, model: Path) -> None:
    found = onnx.load(exported)
    onnx.checker.check_model(found, full_check=True)
    said = json.loads({entry.key: entry.value for entry in found.metadata_props}["hrt"])
    assert said["config"] == json.loads(SMALL.model_dump_json())
    assert said["precision"] == "float32"
    assert said["preprocessing"] == found.doc_string == describe_use(SMALL)
    assert said["provenance"]["inputs"][0]["sha256"] == file_sha256(model)
    assert not any(node.metadata_props or node.doc_string for node in found.graph.node)
    assert str(Path(sys.prefix)).encode() not in exported.read_bytes()


def test_the_description_names_all_that_matters() -> None:
    text = describe_use(FULL)
    for part in ("[n, 40, 72, 3]", "red, green, blue", "round(0.25 * rows)", "goal", "radians", "-1, -3/4, ..., 1",
                 "full right", "full up", "72 x 40"):  # fmt: skip
        assert part in text
    assert "cut off" not in describe_use(SMALL)
    assert "goal" not in describe_use(SMALL)


def test_same_model_same_bytes_and_nothing_done_twice(exported: Path, model: Path) -> None:
    before = exported.read_bytes()
    done = export_onnx(model, exported)
    assert (done.up_to_date, done.comparison, done.size_bytes) == (True, None, len(before))
    assert not export_onnx(model, exported, existing=FORCE).up_to_date
    assert exported.read_bytes() == before


def test_another_model_is_not_overwritten_unasked(exported: Path, folder: Path) -> None:
    other = put_model(folder / "other.safetensors", SMALL, seed=1)
    before = exported.read_bytes()
    with pytest.raises(OutputError, match="--overwrite"):
        export_onnx(other, exported)
    assert exported.read_bytes() == before


def test_int8_is_a_quarter_of_the_size_and_answers_nearly_the_same(
    int8: tuple[Path, SteerExport], exported: Path
) -> None:
    output, done = int8
    assert done.size_bytes < 0.3 * exported.stat().st_size
    assert OnnxPredictor(output).precision == "int8"
    held_out = scenes(16, 32, 48, seed=9)
    ours = TorchPredictor(lively(SMALL)).probabilities(held_out)["yaw"]
    theirs = OnnxPredictor(output).probabilities(held_out)["yaw"]
    angles = np.arange(-7, 8) / 7
    assert np.abs(ours @ angles - theirs @ angles).mean() < 0.02
    assert np.corrcoef(ours @ angles, theirs @ angles)[0, 1] > 0.95
    assert done.comparison.frames == 40
    assert 0 < done.comparison.angle_difference < 0.02
    assert done.comparison.mae_before == pytest.approx(done.comparison.mae_after, abs=0.02)


@pytest.mark.slow
def test_int8_is_the_same_bytes_again(int8: tuple[Path, SteerExport], model: Path, recording: Path) -> None:
    before = int8[0].read_bytes()
    assert export_onnx(model, int8[0], int8=True, calibration=[recording]).up_to_date
    export_onnx(model, int8[0], int8=True, calibration=[recording], existing=FORCE)
    assert int8[0].read_bytes() == before


def test_no_processor_can_saturate(int8: tuple[Path, SteerExport]) -> None:
    """Unsigned activations, weights of 7 bits, and everything from the first to the last convolution in integers."""
    graph = onnx.load(int8[0]).graph
    weights = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    made = {node.output[0]: node for node in graph.node}
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    assert len(convolutions) == 20
    for node in convolutions:
        seen, weight = (made[name] for name in node.input[:2])
        assert seen.op_type == weight.op_type == "DequantizeLinear"
        assert weights[seen.input[2]].dtype == np.uint8
        quantised = weights[weight.input[0]]
        assert quantised.dtype == np.int8
        assert np.abs(quantised.astype(int)).max() <= 64
        assert weights[weight.input[1]].shape == (quantised.shape[0],)  # a scale per channel
    for node in graph.node:
        if node.op_type in ("Gemm", "MatMul"):  # the head is left as it is
            assert not any(made[name].op_type == "DequantizeLinear" for name in node.input if name in made)


def test_calibration_is_refused_where_it_says_too_little(folder: Path, model: Path, recording: Path) -> None:
    with pytest.raises(ArgumentError, match="--calibrate"):
        export_onnx(model, folder / "no.onnx", int8=True)
    few = put_recording(folder / "few", scenes(31, 32, 48))
    with pytest.raises(InputError, match=r"few: has 31 frames to calibrate on; give 32"):
        export_onnx(model, folder / "no.onnx", int8=True, calibration=[few])
    with pytest.raises(InputError, match=r"labels\.csv: is neither JPEG nor PNG"):
        export_onnx(model, folder / "no.onnx", int8=True, calibration=[recording / "labels.csv"])
    with pytest.raises(InputError, match="either folders of data or pictures"):
        export_onnx(model, folder / "no.onnx", int8=True, calibration=[recording, recording / "1.png"])
    assert not (folder / "no.onnx").exists()


def test_frames_are_taken_evenly(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(paths: list[Path], config: SteeringConfig = SMALL) -> onnx_frames.Frames:
        return read_frames(paths, config, skip_bad=False, correction=0.2, note=print)

    pictures = scenes(40, 32, 48)
    whole = read([recording])
    np.testing.assert_array_equal(whole.pictures, pictures)
    assert whole.steering.shape == (40, 1)
    assert whole.files == (recording / "labels.csv",)
    files = read([recording / f"{k}.png" for k in range(40)])
    np.testing.assert_array_equal(files.pictures, pictures)
    assert files.steering is files.goal is None
    monkeypatch.setattr(onnx_frames, "MOST", 4)
    some = read([recording])
    np.testing.assert_array_equal(some.pictures, pictures[[0, 13, 26, 39]])
    assert some.steering.tolist() == whole.steering[[0, 13, 26, 39]].tolist()
    assert some.digest != whole.digest
    # No labels of pitch: nothing to say of errors, but good to calibrate on.
    both = SteeringConfig(width=48, height=32, outputs=("yaw", "pitch"))
    assert read([recording], both).steering is None


@pytest.mark.slow
def test_a_network_that_is_told_where_to_go_is_calibrated_with_goals(folder: Path, recording: Path) -> None:
    config = SteeringConfig(width=48, height=32, goal=True)
    model = put_model(folder / "goal.safetensors", config, seed=4)
    for data in (recording, recording / "1.png"):
        with pytest.raises(InputError, match="does not say where to go"):
            export_onnx(model, folder / "goal.onnx", int8=True, calibration=[data])
    told = put_recording(folder / "told", scenes(33, 32, 48), goal=True)
    done = export_onnx(model, folder / "goal.onnx", int8=True, calibration=[told])
    assert done.comparison.frames == 33
    assert done.comparison.angle_difference < 0.02


def test_made_up_pictures_reach_the_extremes() -> None:
    frames = made_up_frames(FULL)
    assert frames.pictures.shape == (10, 40, 72, 3)
    assert frames.pictures.dtype == np.uint8
    assert {0, 255} <= {int(each.max()) for each in frames.pictures if each.std() == 0}
    assert frames.goal.dtype == np.float32
    assert made_up_frames(SMALL).goal is None


def test_a_graph_that_answers_otherwise_is_not_published(
    folder: Path, model: Path, recording: Path, int8: tuple[Path, SteerExport], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = onnx_export._graph_bytes

    def skewed(net, *args):
        with torch.no_grad():
            net.heads["yaw"].bias[0] += 0.5
        made = real(net, *args)
        with torch.no_grad():
            net.heads["yaw"].bias[0] -= 0.5
        return made

    monkeypatch.setattr(onnx_export, "_graph_bytes", skewed)
    with pytest.raises(OutputError, match=r"wrong\.onnx: a probability would be .* nothing was written"):
        export_onnx(model, folder / "wrong.onnx")
    quantised = read_onnx(int8[0])[0]
    monkeypatch.setattr(onnx_export, "_graph_bytes", lambda *args: quantised)
    monkeypatch.setattr(onnx_export, "MOST_ANGLE_DIFFERENCE", 1e-6)
    with pytest.raises(InputError, match=r"in int8 it steers by .* otherwise on average"):
        export_onnx(model, folder / "wrong.onnx", int8=True, calibration=[recording])
    assert not (folder / "wrong.onnx").exists()


def test_differences_by_hand() -> None:
    class Fixed:
        config = SteeringConfig(half_classes=1, width=32, height=32)

        def __init__(self, *rows: list[float]) -> None:
            self.rows = np.array(rows)

        def probabilities(self, pictures, goal=None):
            return {"yaw": self.rows[pictures[:, 0, 0, 0]]}

    pictures = np.zeros((2, 32, 32, 3), np.uint8)
    pictures[1] = 1
    labels = np.array([[0.5], [0.25]], np.float32)
    before, after = Fixed([0.0, 1.0, 0.0], [0.0, 0.5, 0.5]), Fixed([0.0, 0.75, 0.25], [0.0, 0.5, 0.5])
    found = compare(before, after, onnx_frames.Frames(pictures, None, labels, (), ""))
    assert (found.frames, found.max_difference, found.angle_difference) == (2, 0.25, 0.125)
    assert (found.mae_before, found.mae_after) == (0.375, 0.25)
    broken = compare(before, Fixed([np.nan] * 3, [1.0, 0, 0]), onnx_frames.Frames(pictures, None, None, (), ""))
    assert np.isnan(broken.max_difference)
    assert broken.mae_before is None
    with pytest.raises(OutputError):
        onnx_export._require_alike(Path("m"), Path("o"), broken, False)
    with pytest.raises(InputError):
        onnx_export._require_alike(Path("m"), Path("o"), broken, True)


def test_the_name_must_say_what_it_is(folder: Path, model: Path) -> None:
    with pytest.raises(OutputError, match=r"steer\.bin: an exported model is a \.onnx"):
        export_onnx(model, folder / "steer.bin")


@pytest.mark.parametrize("missing", ["onnx", "onnxruntime"])
def test_without_the_packages_it_says_what_to_install(
    folder: Path, model: Path, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ArgumentError, match=r"pip install 'hrt\[onnx\]'"):
        export_onnx(model, folder / "none.onnx")
