"""The train-steer stage: what it writes, when it is up to date, and what it refuses."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from steer_files import put_recording

from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.steering.network import net as network
from hrt_cli.steering.network import precision
from hrt_cli.steering.network.model import model_provenance, read_model, read_tensors
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.network.resnet import ResNet18
from hrt_cli.steering.training import stage as training
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.gather import gather
from hrt_cli.steering.training.stage import SteerTraining, read_record, train_steer_file
from hrt_cli.steering.training.train import SteerSpec

pytestmark = pytest.mark.usefixtures("tiny")
SPEC = SteerSpec(epochs=3, batch=8, gap=0, threads=1)
CONFIG = SteeringConfig(width=32, height=32, half_classes=3)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_recording(tmp_path_factory.mktemp("data") / "a", 30)


def run(data: Path | list[Path], output: Path, spec: SteerSpec = SPEC, config: SteeringConfig = CONFIG, **options):
    folders = data if isinstance(data, list) else [data]
    return train_steer_file(folders, output, spec, config, **options)


@pytest.fixture
def made(data: Path, tmp_path: Path) -> tuple[Path, SteerTraining]:
    output = tmp_path / "m.safetensors"
    return output, run(data, output)


def test_the_model_is_the_best_epoch_with_its_temperature(made: tuple[Path, SteerTraining]) -> None:
    output, done = made
    assert (done.up_to_date, done.resumed_at) == (False, 0)
    assert [path.name for path in output.parent.iterdir()] == [output.name]
    (output.parent / "plain").touch()
    assert output.stat().st_mode == (output.parent / "plain").stat().st_mode
    record = done.record
    assert len(record.history) == 3
    assert record.best.validation_loss == min(each.validation_loss for each in record.history)
    assert (record.train_frames, record.validation_frames, record.skipped, record.sessions) == (24, 6, 0, 2)
    assert record.split == "by block: 20% of the frames held out, 0 frames beside them dropped (gap 0)"
    net = read_model(output)
    assert net.config.temperature == record.best.temperature
    assert record == read_record(output)
    assert done.seconds > 0
    assert done.images_per_second == pytest.approx(3 * 24 / done.seconds)


def test_the_figures_are_those_of_the_model_on_the_frames_held_out(
    data: Path, tmp_path: Path, made: tuple[Path, SteerTraining]
) -> None:
    apart, output = put_recording(tmp_path / "apart", 7, seed=3), tmp_path / "n.safetensors"
    record = run(data, output, validation=[apart]).record
    assert (record.train_frames, record.validation_frames, record.sessions) == (30, 7, 4)
    assert record.split == "folders of their own"
    predictor = TorchPredictor(read_model(output))
    rows = [line.split(",") for line in (apart / "labels.csv").read_text().splitlines()[1:]]
    pictures = np.stack([cv2.imread(str(apart / row[0]))[..., ::-1] for row in rows])
    angle = predictor.probabilities(pictures)["yaw"] @ np.linspace(-1, 1, 7)
    truth = np.array([float(row[1]) for row in rows])
    assert record.best.mae == pytest.approx(np.abs(angle - truth).mean(), rel=1e-4)
    labels = [float(line.split(",")[1]) for line in (data / "labels.csv").read_text().splitlines()[1:]]
    assert record.constant_baseline_mae == pytest.approx(np.abs(truth - np.median(labels)).mean(), rel=1e-5)
    assert record.best.outputs["yaw"]["constant_baseline_mae"] == pytest.approx(record.constant_baseline_mae, rel=1e-5)


def test_the_same_again_is_up_to_date_and_anew_it_is_the_same_bytes(
    data: Path, made: tuple[Path, SteerTraining]
) -> None:
    output, first = made
    before = output.read_bytes()
    again = run(data, output)
    assert again.up_to_date
    assert again.record == first.record
    assert again.images_per_second is None
    anew = run(data, output, existing=Existing(force=True))
    assert not anew.up_to_date
    assert output.read_bytes() == before


def test_the_folder_and_its_name_do_not_matter(data: Path, tmp_path: Path, made: tuple[Path, SteerTraining]) -> None:
    other = tmp_path / "elsewhere" / "a"
    other.parent.mkdir()
    other.symlink_to(data)
    output = tmp_path / "elsewhere" / "other.safetensors"
    run(other, output)
    assert output.read_bytes() == made[0].read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        {"spec": replace(SPEC, epochs=2)},
        {"spec": replace(SPEC, threads=2)},
        {"spec": replace(SPEC, gap=1)},
        {"spec": replace(SPEC, augment=Augment.none())},
        {"config": CONFIG.model_copy(update={"columns": 2})},
        {"precision": "float32" if precision.cpu_computes_bf16() else "bf16"},
        {"correction": 0.1},
    ],
)
@pytest.mark.usefixtures("cpu")
def test_another_recipe_is_another_model(data: Path, made: tuple[Path, SteerTraining], change: dict) -> None:
    output, _ = made
    with pytest.raises(OutputError, match="exists and was not made by this run; use --overwrite"):
        run(data, output, **change)
    assert run(data, output).up_to_date


def test_other_pictures_under_the_same_labels_are_another_model(tmp_path: Path) -> None:
    data, output = put_recording(tmp_path / "a", 30), tmp_path / "m.safetensors"
    run(data, output)
    cv2.imwrite(str(data / "frames" / "003.png"), np.zeros((32, 32, 3), np.uint8))
    with pytest.raises(OutputError):
        run(data, output)


@pytest.mark.usefixtures("cpu")
def test_what_computed_is_part_of_the_provenance_and_on_a_gpu_threads_are_not(
    data: Path, made: tuple[Path, SteerTraining], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = model_provenance(made[0])
    assert found is not None
    assert (found.stage, found.parameters["device"], found.parameters["threads"]) == ("train-steer", "cpu", 1)
    assert found.parameters["precision"] == ("bf16" if precision.cpu_computes_bf16() else "float32")
    assert [(each.role, each.name) for each in found.inputs] == [("labels/0", "labels.csv")]
    gathered = training.gather([data], [], SPEC, CONFIG)
    told = training._parameters(gathered, CONFIG, SPEC, precision.Arithmetic("cuda", True), 0.2)
    assert (told["device"], told["precision"]) == ("cuda", "bf16")
    assert "threads" not in told


def test_the_model_tells_whether_it_learnt_from_mirrored_pictures(
    data: Path, tmp_path: Path, made: tuple[Path, SteerTraining]
) -> None:
    assert read_model(made[0]).config.mirrored
    plain, again = tmp_path / "plain.safetensors", tmp_path / "again.safetensors"
    run(data, plain, replace(SPEC, augment=Augment(flip=0.0)), init=made[0])
    assert not read_model(plain).config.mirrored
    run(data, again, init=plain)
    assert read_model(again).config.mirrored


def test_the_metrics_are_a_line_an_epoch(data: Path, tmp_path: Path) -> None:
    output, metrics = tmp_path / "m.safetensors", tmp_path / "m.jsonl"
    done = run(data, output, metrics=metrics)
    lines = [json.loads(line) for line in metrics.read_text().splitlines()]
    assert lines == [each.model_dump(mode="json") for each in done.record.history]
    assert [line["epoch"] for line in lines] == [1, 2, 3]
    before = metrics.read_bytes()
    assert run(data, output, metrics=metrics).up_to_date
    metrics.unlink()
    assert run(data, output, metrics=metrics).up_to_date
    assert metrics.read_bytes() == before
    # What else stands there is left alone, before the training.
    other = tmp_path / "n.safetensors"
    metrics.write_text("mine")
    with pytest.raises(OutputError, match=r"m\.jsonl: exists and was not made by this run"):
        run(data, other, metrics=metrics)
    assert not other.exists()
    with pytest.raises(OutputError, match=r"m\.jsonl: exists"):
        run(data, output, metrics=metrics)
    assert metrics.read_text() == "mine"
    run(data, output, metrics=metrics, existing=Existing(overwrite=True))
    assert metrics.read_bytes() == before


def test_no_output_replaces_an_input_or_another_output(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "m.safetensors"
    with pytest.raises(OutputError, match="would overwrite the model"):
        run(data, output, metrics=output)
    for where in ({"metrics": data / "labels.csv"}, {}):
        with pytest.raises(OutputError, match="the output is also an input"):
            run(data, output if where else data / "labels.csv", existing=Existing(overwrite=True), **where)


def test_outputs_and_goal_follow_the_data(tmp_path: Path) -> None:
    data = put_recording(tmp_path / "auv", 30, pitch=True, goal=True)
    output, blind = tmp_path / "m.safetensors", tmp_path / "n.safetensors"
    done = run(data, output)
    config = read_model(output).config
    assert (config.outputs, config.goal) == (("yaw", "pitch"), True)
    assert set(done.record.best.outputs) == set(done.record.best.temperature) == {"yaw", "pitch"}
    assert run(data, output, metrics=tmp_path / "m.jsonl").up_to_date
    assert run(data, output, metrics=tmp_path / "m.jsonl").up_to_date
    run(data, blind, replace(SPEC, epochs=1, goal=False))
    assert not read_model(blind).config.goal


def test_what_is_held_out_must_be_alike_and_apart(data: Path, tmp_path: Path) -> None:
    auv = put_recording(tmp_path / "auv", 30, pitch=True, goal=True)
    blind = put_recording(tmp_path / "blind", 30, pitch=True)
    output = tmp_path / "m.safetensors"
    with pytest.raises(InputError, match=r"auv/labels\.csv: has yaw, pitch; the training data have yaw$"):
        run(data, output, validation=[auv])
    with pytest.raises(InputError, match=r"blind/labels\.csv: does not say where to go.*--no-goal"):
        run(auv, output, validation=[blind])
    rows = (auv / "labels.csv").read_text().splitlines()
    shutil.copytree(auv, tmp_path / "costs")
    with_costs = "\n".join([f"{rows[0]},turn_costs_s", *(f"{row},0 1 2" for row in rows[1:])])
    (tmp_path / "costs" / "labels.csv").write_text(f"{with_costs}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"costs/labels\.csv: has 3 turn_costs_s a row, and the training data 0"):
        run(auv, output, validation=[tmp_path / "costs"])
    with pytest.raises(InputError, match=r"labels\.csv: is both trained on and held out"):
        run(data, output, validation=[data])
    assert not output.exists()


def test_it_goes_on_from_another_model(data: Path, tmp_path: Path, made: tuple[Path, SteerTraining]) -> None:
    first, output = made[0], tmp_path / "next.safetensors"
    # With no step to speak of, what is written is what it began from.
    still = replace(SPEC, epochs=1, learning_rate=1e-12, weight_decay=0.0)
    run(data, output, still, init=first)
    before, after = read_tensors(first)[0], read_tensors(output)[0]
    torch.testing.assert_close(after["heads.yaw.weight"], before["heads.yaw.weight"])
    found = model_provenance(output)
    assert found is not None
    assert [each.role for each in found.inputs] == ["labels/0", "init"]
    with pytest.raises(InputError, match=r"m\.safetensors: its half_classes is 3, and that of this training 5"):
        run(data, tmp_path / "n.safetensors", config=SteeringConfig(width=32, height=32, half_classes=5), init=first)
    with pytest.raises(ArgumentError, match="give one of them"):
        run(data, tmp_path / "n.safetensors", init=first, weights=first)
    with pytest.raises(OutputError, match="the output is also an input"):
        run(data, first, init=first, existing=Existing(overwrite=True))


def test_other_goals_are_learnt_from_and_not_measured_by(data: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(data, tmp_path / "goals")
    rows = (data / "labels.csv").read_text().splitlines()
    head = f"{rows[0]},goal_deg,turn_costs_s,other_goals_deg,other_costs_s"
    told = [f"{row},5,0 1 2,{k} {-k},1 0 1 2 0 {k}" for k, row in enumerate(rows[1:])]
    (folder / "labels.csv").write_text("\n".join([head, *told]) + "\n", encoding="utf-8")
    found = gather([folder], [], SPEC, CONFIG)
    assert found.training.goal is not None
    assert found.training.costs is not None
    np.testing.assert_allclose(np.degrees(found.training.goal[:, 0]), 5, rtol=1e-6)
    which = np.rint(np.degrees(found.training.goal[:, 1]))
    np.testing.assert_allclose(np.degrees(found.training.goal[:, 2]), -which, atol=1e-4)
    assert found.training.costs[:, :2].tolist() == [[[0, 1, 2], [1, 0, 1]]] * len(found.training)
    np.testing.assert_array_equal(found.training.costs[:, 2, 2], which)
    assert found.validation.goal is not None
    assert found.validation.costs is not None
    assert (found.validation.goal.shape[1], found.validation.costs.shape[1:]) == (1, (1, 3))
    for spec in (replace(SPEC, cost_scale_s=0.0), replace(SPEC, goal=False)):
        plain = gather([folder], [], spec, CONFIG).training
        assert plain.goal is None or plain.goal.shape[1] == 1


def test_a_model_tells_its_lens_and_goes_on_with_no_other(data: Path, tmp_path: Path) -> None:
    short, folders = replace(SPEC, epochs=1), {}
    for hfov in (100, 75):
        folders[hfov] = shutil.copytree(data, tmp_path / f"{hfov}")
        (folders[hfov] / "recording.json").write_text(f'{{"format": "hrt-recording", "lens": {{"hfov_deg": {hfov}}}}}')
    run(folders[100], tmp_path / "m.safetensors", short)
    assert read_model(tmp_path / "m.safetensors").config.hfov_deg == 100.0
    run(data, tmp_path / "n.safetensors", short, init=tmp_path / "m.safetensors")
    assert read_model(tmp_path / "n.safetensors").config.hfov_deg == 100.0
    with pytest.raises(InputError, match=r"m\.safetensors: is of a lens 100 degrees wide, and it must be one of 75"):
        run(folders[75], tmp_path / "o.safetensors", short, init=tmp_path / "m.safetensors")
    with pytest.raises(InputError, match=r"75/labels\.csv: is of a lens 75 degrees wide, and it must be one of 100"):
        run(folders[100], tmp_path / "o.safetensors", short, validation=[folders[75]])


@pytest.mark.slow
def test_it_begins_from_published_weights(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "ResNet18", ResNet18)
    torch.manual_seed(5)
    trunk = SteeringNet(CONFIG).trunk.state_dict()
    weights, output = tmp_path / "resnet18.pth", tmp_path / "m.safetensors"
    torch.save(trunk | {"fc.weight": torch.zeros(1000, 512), "fc.bias": torch.zeros(1000)}, weights)
    run(data, output, replace(SPEC, epochs=1, batch=24, learning_rate=1e-12), weights=weights)
    net = read_model(output)
    torch.testing.assert_close(net.trunk.conv1.weight, trunk["conv1.weight"])
    assert net.config.mean == (0.485, 0.456, 0.406)
    weights.write_bytes(b"no weights")
    with pytest.raises(InputError, match=r"resnet18\.pth: "):
        run(data, tmp_path / "n.safetensors", weights=weights)


def test_a_model_no_better_than_a_constant_is_told(data: Path, tmp_path: Path) -> None:
    """Blank pictures: there is nothing to see."""
    blank = put_recording(tmp_path / "blank", 30)
    for path in (blank / "frames").iterdir():
        cv2.imwrite(str(path), np.full((32, 32, 3), 90, np.uint8))
    spec = replace(SPEC, epochs=1, learning_rate=1e-9)
    done = run(blank, tmp_path / "m.safetensors", spec, validation=[put_recording(tmp_path / "v", 5, seed=8)])
    assert done.no_better_than_constant == (done.record.best.mae >= done.record.constant_baseline_mae)
    lied = done.record.model_copy(update={"constant_baseline_mae": done.record.best.mae})
    assert SteerTraining(False, 0, 1.0, 1.0, done.arithmetic, ("yaw",), lied).no_better_than_constant
    lied = done.record.model_copy(update={"constant_baseline_mae": done.record.best.mae + 1e-6})
    assert not SteerTraining(False, 0, 1.0, 1.0, done.arithmetic, ("yaw",), lied).no_better_than_constant


def test_random_frames_held_out_are_warned_of(data: Path, tmp_path: Path) -> None:
    notes: list[str] = []
    spec = replace(SPEC, epochs=1, split="random")
    run(data, tmp_path / "m.safetensors", spec, note=notes.append)
    assert [note for note in notes if note.startswith("Warning: random frame splits halve the apparent error")]


def test_one_angle_teaches_nothing(tmp_path: Path) -> None:
    data = put_recording(tmp_path / "a", 12)
    lines = (data / "labels.csv").read_text().splitlines()
    straight = [lines[0], *(",".join([line.split(",")[0], "0.0", line.split(",")[2]]) for line in lines[1:])]
    (data / "labels.csv").write_text("\n".join(straight) + "\n")
    with pytest.raises(InputError, match="one class"):
        run(data, tmp_path / "m.safetensors")


def test_an_output_that_cannot_be_written_is_told_before_the_data_are_read(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist; make it first"):
        run(tmp_path / "nowhere", tmp_path / "absent" / "m.safetensors", existing=REFUSE)


def test_a_model_that_does_not_say_how_it_was_trained_has_no_record(
    tmp_path: Path, made: tuple[Path, SteerTraining]
) -> None:
    from hrt_cli.artifacts.provenance import record
    from hrt_cli.steering.network.model import publish_model

    path = tmp_path / "bare.safetensors"
    publish_model(path, read_model(made[0]), CONFIG, record("test", 1, {}, {}))
    with pytest.raises(InputError, match="does not say how it was trained"):
        read_record(path)
    publish_model(path, read_model(made[0]), CONFIG, record("test", 1, {}, {}), {"history": []})
    with pytest.raises(InputError, match=r"training\.history"):
        read_record(path)
