"""`hrt evaluate steer` on models whose answers are known, and as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import DifferenceError, InputError
from hrt_cli.evaluation import steering as module
from hrt_cli.evaluation.steering import evaluate_steer
from hrt_cli.main import cli
from hrt_cli.steering.network.metrics import measure, median_angles
from hrt_cli.steering.network.model import publish_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet

BOTH = SteeringConfig(outputs=("yaw", "pitch"), half_classes=1, width=32, height=32, goal=True)
SEVEN = {"mae", "rmse", "accuracy", "nll", "ece", "constant_baseline_mae", "frames"}


class Fixed:
    """Answers by the red of the first pixel: a row of the table for each."""

    def __init__(self, config: SteeringConfig, tables: dict[str, list[list[float]]]) -> None:
        self.config, self.tables = config, {name: np.array(table) for name, table in tables.items()}
        self.calls: list[tuple[int, Any]] = []

    def probabilities(self, pictures: np.ndarray, goal: np.ndarray | None = None) -> dict[str, np.ndarray]:
        self.calls.append((len(pictures), None if goal is None else goal.tolist()))
        return {name: table[pictures[:, 0, 0, 0]] for name, table in self.tables.items()}


def put_labels(folder: Path, header: str, rows: list[str]) -> Path:
    folder.mkdir(exist_ok=True)
    for k in range(len(rows)):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((32, 32, 3), k, np.uint8))
    (folder / "labels.csv").write_text("\n".join([header, *(f"{k}.png,{row}" for k, row in enumerate(rows))]) + "\n")
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    rows = ["0.5,0.25,a,90", "-0.5,0.5,a,0", "1.0,-1.0,b,-90"]
    return put_labels(tmp_path / "seen", "image,yaw,pitch,session,goal_deg", rows)


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> Fixed:
    fixed = Fixed(
        BOTH,
        {
            "yaw": [[0.0, 0.5, 0.5], [0.2, 0.8, 0.0], [0.1, 0.2, 0.7]],
            "pitch": [[0.1, 0.6, 0.3], [0.0, 0.1, 0.9], [0.9, 0.1, 0.0]],
        },
    )
    monkeypatch.setattr(module, "load_predictor", lambda path: fixed)
    return fixed


def test_figures_by_hand(recording: Path, answering: Fixed) -> None:
    found = evaluate_steer(Path("m"), [recording], batch=2)
    yaw, pitch = found.total.outputs["yaw"], found.total.outputs["pitch"]
    # Expected yaw 0.5, -0.2, 0.6; labels 0.5, -0.5, 1; their median 0.5. Expected pitch 0.2, 0.9, -0.9.
    assert yaw.mae == pytest.approx((0 + 0.3 + 0.4) / 3)
    assert pitch.mae == pytest.approx((0.05 + 0.4 + 0.1) / 3)
    assert found.total.mae == pytest.approx((yaw.mae + pitch.mae) / 2)
    assert found.constant == {"yaw": 0.5, "pitch": 0.25}
    assert yaw.constant_baseline_mae == pytest.approx((0 + 1 + 0.5) / 3)
    assert pitch.constant_baseline_mae == pytest.approx((0 + 0.25 + 1.25) / 3)
    assert found.expected.tolist() == [pytest.approx(row) for row in ([0.5, 0.2], [-0.2, 0.9], [0.6, -0.9])]
    assert found.spread[0, 0] == pytest.approx(0.5)
    # Asked in batches, each with the bearings of its frames in radians.
    assert [size for size, _ in answering.calls] == [2, 1]
    assert answering.calls[0][1] == pytest.approx([np.pi / 2, 0])
    assert (found.total.frames, found.skipped) == (3, 0)


def test_sessions_are_measured_apart_beside_one_constant(recording: Path, answering: Fixed) -> None:
    found = evaluate_steer(Path("m"), [recording])
    first, second = found.sessions.values()
    assert [each.frames for each in found.sessions.values()] == [2, 1]
    assert first.outputs["yaw"].mae == pytest.approx(0.15)
    assert second.outputs["yaw"].mae == pytest.approx(0.4)
    assert second.outputs["yaw"].constant_baseline_mae == pytest.approx(0.5)
    assert found.session.tolist() == [0, 0, 1]
    # Labels 0.5 and -0.5 lie between two classes and count as the outer ones.
    assert found.confusion["yaw"].tolist() == [[0, 1, 0], [0, 0, 0], [0, 1, 1]]
    assert found.reliability["yaw"].count.sum() == 3


def test_data_of_another_lens_are_refused(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (recording / "recording.json").write_text('{"format": "hrt-recording", "lens": {"hfov_deg": 100}}')
    narrow = BOTH.model_copy(update={"hfov_deg": 60.0})
    monkeypatch.setattr(module, "load_predictor", lambda path: Fixed(narrow, {}))
    with pytest.raises(InputError, match=r"is of a lens 100 degrees wide, and it must be one of 60"):
        evaluate_steer(Path("m"), [recording])


def test_a_model_of_yaw_is_measured_on_data_with_pitch(
    recording: Path, answering: Fixed, monkeypatch: pytest.MonkeyPatch
) -> None:
    only = SteeringConfig(outputs=("yaw",), half_classes=1, width=32, height=32)
    fixed = Fixed(only, {"yaw": [[0.0, 0.5, 0.5], [0.2, 0.8, 0.0], [0.1, 0.2, 0.7]]})
    monkeypatch.setattr(module, "load_predictor", lambda path: fixed)
    found = evaluate_steer(Path("m"), [recording])
    assert list(found.total.outputs) == ["yaw"]
    assert fixed.calls == [(3, None)]  # it is told no goal, and asks for none


@pytest.mark.parametrize(
    ("header", "row", "problem"),
    [
        ("image,yaw,session,goal_deg", "0.1,a,3", "no labels of pitch"),
        ("image,yaw,pitch,session", "0.1,0.2,a", "does not say where to go"),
    ],
)
def test_data_that_lack_what_the_model_needs_are_refused(
    tmp_path: Path, answering: Fixed, header: str, row: str, problem: str
) -> None:
    with pytest.raises(InputError, match=rf"poor: .*{problem}"):
        evaluate_steer(Path("m"), [put_labels(tmp_path / "poor", header, [row])])


def test_a_model_that_answers_nan_is_refused(recording: Path, answering: Fixed) -> None:
    answering.tables["pitch"][1, 2] = np.nan
    with pytest.raises(InputError, match=r"m\.onnx: predicts numbers that are not finite"):
        evaluate_steer(Path("m.onnx"), [recording])


def run(*args: object) -> Result:
    return CliRunner().invoke(cli, ["evaluate", "steer", *map(str, args)])


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    config = SteeringConfig(half_classes=2, width=32, height=32)
    path = tmp_path_factory.mktemp("model") / "steer.safetensors"
    publish_model(path, SteeringNet(config).eval(), config, record("test", 1, {}, {}))
    return path


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    rows = [f"{rng.uniform(-1, 1):.4f},{'ab'[k % 2]}" for k in range(20)]
    return put_labels(tmp_path_factory.mktemp("data") / "seen", "image,yaw,session", rows)


def test_json_keys(model: Path, seen: Path) -> None:
    done = run(model, seen, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert set(found) == SEVEN | {"skipped", "outputs", "sessions", "reliability", "confusion", "constant"}
    assert set(found["outputs"]["yaw"]) == SEVEN - {"frames"}
    assert len(found["sessions"]) == 2
    assert all(set(each) == SEVEN | {"outputs"} for each in found["sessions"].values())
    assert sum(each["frames"] for each in found["sessions"].values()) == found["frames"] == 20
    assert sum(each["count"] for each in found["reliability"]["yaw"]) == 20
    assert len(found["confusion"]["yaw"]) == 5
    labels = np.array([[float(line.split(",")[1])] for line in (seen / "labels.csv").read_text().splitlines()[1:]])
    assert found["constant"]["yaw"] == pytest.approx(np.median(labels))


def test_the_model_and_its_export_measure_alike(model: Path, seen: Path, tmp_path: Path) -> None:
    from hrt_cli.steering.onnx.export import export_onnx

    export_onnx(model, tmp_path / "steer.onnx")
    ours, theirs = (json.loads(run(path, seen, "--json").stdout) for path in (model, tmp_path / "steer.onnx"))
    for name in ("mae", "rmse", "nll", "constant_baseline_mae"):
        assert theirs[name] == pytest.approx(ours[name], abs=1e-4)


def test_requirements(model: Path, seen: Path, tmp_path: Path) -> None:
    mae = json.loads(run(model, seen, "--json").stdout)["mae"]
    assert run(model, seen, "--require", f"mae<={mae + 1e-6}").exit_code == 0
    assert run(model, seen, "--require", f"mae=={mae!r}", "--require", "outputs.yaw.mae<1").exit_code == 0
    assert run(model, seen, "--require", f"mae<{mae!r}").exception.exit_code == 3
    failed = run(model, seen, "--require", f"mae<={mae - 1e-6}")
    assert isinstance(failed.exception, DifferenceError)
    assert "MAE" in failed.stdout  # the result is told all the same
    # Nothing is better than a constant where the robot always steered alike.
    straight = put_labels(tmp_path / "straight", "image,yaw,session", ["0.25,a"] * 3)
    failed = run(model, straight, "--require-better-than-constant")
    assert isinstance(failed.exception, DifferenceError)
    assert "no less than that of a constant" in str(failed.exception)


@pytest.mark.parametrize(("expected", "code"), [(0.0, 3), (0.01, 0)])
def test_as_good_as_a_constant_is_not_better(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected: float, code: int
) -> None:
    data = put_labels(tmp_path / "seen", "image,yaw,session", ["0.0,a", "0.5,a", "-0.5,a"])
    config = SteeringConfig(half_classes=1, width=32, height=32)
    rows = [[0.0, 1.0, 0.0], [0.0, 1.0 - expected, expected], [0.0, 1.0, 0.0]]
    monkeypatch.setattr(module, "load_predictor", lambda path: Fixed(config, {"yaw": rows}))
    done = run("m", data, "--require-better-than-constant")
    assert getattr(done.exception, "exit_code", 0) == code


def test_the_line_puts_the_constant_beside_the_error(model: Path, seen: Path) -> None:
    line = run(model, seen).stdout
    found = json.loads(run(model, seen, "--json").stdout)
    assert f"MAE {found['mae']:.3f} (a constant: {found['constant_baseline_mae']:.3f})" in line
    assert "20 frames of 2 sessions" in line
    assert len(line.splitlines()) == 1


def test_the_figure_is_an_artifact(model: Path, seen: Path, tmp_path: Path) -> None:
    done = run(model, seen, "--figure", tmp_path / "f.png")
    assert done.exit_code == 0, done.output
    assert [each.role for each in png_provenance(tmp_path / "f.png").inputs] == ["model", "labels/0"]


def test_what_is_measured_is_what_the_library_measures(model: Path, seen: Path) -> None:
    found = evaluate_steer(model, [seen])
    assert found.total.constant_baseline_mae == pytest.approx(
        float(np.abs(found.steering - median_angles(found.steering)).mean())
    )
    uniform = measure({"yaw": np.full((20, 5), 0.2)}, found.steering, 2, median_angles(found.steering))
    assert uniform.constant_baseline_mae == pytest.approx(found.total.constant_baseline_mae)


def test_bad_frames_are_counted(model: Path, seen: Path, tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.2f},a" for k in range(6)]
    spoilt = put_labels(tmp_path / "spoilt", "image,yaw,session", rows)
    (spoilt / "3.png").write_bytes(b"<html>")
    refused = run(model, spoilt)
    assert isinstance(refused.exception, InputError)
    assert "3.png" in str(refused.exception)
    found = json.loads(run(model, spoilt, "--skip-bad", "--json").stdout)
    assert (found["frames"], found["skipped"]) == (5, 1)
    assert found["constant"]["yaw"] == pytest.approx(0.2)
