"""`hrt train-steer` on the command line."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import click
import cv2
import pytest
from click.testing import CliRunner, Result
from steer_files import put_recording

from hrt_cli import main as shell
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.errors import HrtError, OutputError
from hrt_cli.steering.network.model import model_provenance, read_model
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.training import stage as training
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.train import SteerSpec

pytestmark = pytest.mark.usefixtures("tiny")
COMMAND = shell.cli.get_command(click.Context(shell.cli), "train-steer")
SMALL = ["--size", "32x32", "--epochs", "2", "--batch", "8", "--gap", "0", "--threads", "1"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_recording(tmp_path_factory.mktemp("data") / "a", 30)


def train(*arguments: object) -> Result:
    found = CliRunner().invoke(COMMAND, [*SMALL, *map(str, arguments)])
    if isinstance(found.exception, HrtError):
        raise found.exception
    return found


def test_the_result_has_the_keys_that_other_tools_rely_on(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "m.safetensors"
    found = json.loads(train(data, "-o", output, "--json").stdout)
    keys = "mae rmse accuracy nll ece constant_baseline_mae frames skipped output up_to_date epochs best_epoch seconds"
    keys += " images_per_second device precision train_frames validation_frames split"
    assert set(keys.split()) <= set(found)
    assert (found["epochs"], found["frames"], found["train_frames"], found["validation_frames"]) == (2, 30, 24, 6)
    assert found["output"] == str(output)
    again = json.loads(train(data, "-o", output, "--json").stdout)
    assert again["up_to_date"]
    fixed = set(found) - {"up_to_date", "seconds", "images_per_second"}
    assert {key: found[key] for key in fixed} == {key: again[key] for key in fixed}


def test_the_line_puts_the_constant_beside_the_error(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "m.safetensors"
    record = json.loads(train(data, "-o", output, "--json").stdout)
    line = train(data, "-o", output).stdout
    assert line.startswith(f"{output}: MAE {record['mae']:.3f}, ")
    assert f" {record['constant_baseline_mae']:.3f} of one constant angle; " in line
    assert "(up to date)" in line


def test_a_model_no_better_than_a_constant_is_warned_of(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for worse in (True, False):
        monkeypatch.setattr(training.SteerTraining, "no_better_than_constant", worse)
        found = train(data, "-o", tmp_path / "m.safetensors")
        assert ("NO BETTER than" in found.stdout) is worse
        assert ("Warning: the model steers no better than one constant angle" in found.stderr) is worse


def test_it_draws_and_writes_the_course_of_the_training(data: Path, tmp_path: Path) -> None:
    output, curve, metrics = (tmp_path / name for name in ("m.safetensors", "c.png", "m.jsonl"))
    train(data, "-o", output, "--curve", curve, "--metrics", metrics)
    assert len(metrics.read_text().splitlines()) == 2
    found = png_provenance(curve)
    assert found is not None
    assert [each.name for each in found.inputs] == ["m.safetensors"]
    before = curve.read_bytes()
    curve.unlink()
    train(data, "-o", output, "--figure", curve)
    assert curve.read_bytes() == before
    for wrong in (tmp_path / "c.svg", output):
        with pytest.raises(OutputError):
            train(data, "-o", output, "--curve", wrong)


@pytest.mark.usefixtures("cpu")
def test_options_reach_the_network_and_the_recipe(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "m.safetensors"
    options = "--half-classes 4 --columns 3 --crop-top .25 --no-augment --sigma 0 --entropy .1"
    options += " --learning-rate 1e-2 --weight-decay 0 --patience 3 --balance .5 --share .3 --gap 1 --seed 9 --no-goal"
    options += " --correction .1 --precision float32 --split block"
    train(data, "-o", output, *options.split())
    config = read_model(output).config
    assert (config.half_classes, config.columns, config.crop_top) == (4, 3, 0.25)
    assert not config.mirrored
    assert (config.width, config.height) == (32, 32)
    found = model_provenance(output)
    assert found is not None
    told = found.parameters
    names = "sigma entropy_weight learning_rate weight_decay patience balance share gap seed goal correction split"
    values = [0, 0.1, 0.01, 0, 3, 0.5, 0.3, 1, 9, False, 0.1, "block"]
    assert [told[name] for name in names.split()] == values
    assert (told["epochs"], told["batch"], told["threads"]) == (2, 8, 1)
    assert told["augment"] == {each.name: getattr(Augment.none(), each.name) for each in fields(Augment)}


@pytest.mark.parametrize("given", [True, False])
def test_spatial_dropout_is_asked_for(data: Path, tmp_path: Path, given: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As far as the stage: the regulariser names a layer of ResNet-18 that the tiny trunk has not."""
    asked: list[SteeringConfig] = []

    def stage(folders: object, output: object, spec: object, config: SteeringConfig, **options: object) -> None:
        asked.append(config)
        raise OutputError("enough")

    monkeypatch.setattr(training, "train_steer_file", stage)
    with pytest.raises(OutputError):
        train(data, "-o", tmp_path / "m.safetensors", *(["--spatial-dropout"] if given else []))
    assert asked[0].spatial_dropout is given


def test_the_command_has_the_defaults_of_the_library() -> None:
    spec, config = SteerSpec(), SteeringConfig()
    shown = {each.name: each for each in COMMAND.params}
    other = {"dropout_weight", "length_scale", "clip_norm", "augment"}
    for each in fields(SteerSpec):
        if each.name not in other:
            assert shown[each.name].default == getattr(spec, each.name), each.name
    assert shown["augment"].default is True
    for name in ("half_classes", "columns", "crop_top"):
        assert shown[name].default == getattr(config, name)
    assert shown["size"].default == f"{config.width}x{config.height}"


@pytest.mark.parametrize("size", ["160", "160x", "31x64", "64x3000", "64X48", "-64x48", "1e2x50", "064x048"])
def test_a_size_is_two_numbers(data: Path, tmp_path: Path, size: str) -> None:
    found = train(data, "-o", tmp_path / "m.safetensors", "--size", size)
    assert found.exit_code == 2
    assert repr(size) in found.stderr


def test_data_that_cannot_be_used_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = put_recording(tmp_path / "a", 12)
    (data / "frames" / "003.png").write_bytes(b"<html>")
    assert shell._run(["train-steer", str(data), "-o", str(tmp_path / "m.safetensors")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("Error: ")
    assert "003.png" in line
    assert cv2.imread(str(data / "frames" / "002.png")) is not None
