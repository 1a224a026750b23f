"""The steering benchmark: Donkeycar's side is Donkeycar's, the measure is the same for all, and it still runs."""

from __future__ import annotations

import importlib
import json
import math
import signal
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from recording_files import put_picture, put_tub, tub_record

from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.precision import Arithmetic, repeatable
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.batches import Frames
from hrt_cli.steering.training.calibrate import fit_temperature, softmax
from hrt_cli.steering.training.gather import gather
from hrt_cli.steering.training.train import SteerSpec, Trainer

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
donkeycar = importlib.import_module("steering_donkeycar")
accuracy = importlib.import_module("steering_accuracy")
data = importlib.import_module("steering_data")
resume = importlib.import_module("steering_resume")
speed = importlib.import_module("steering_speed")
bench = importlib.import_module("steering")
sys.path.remove(str(BENCHMARKS))


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def tub(folder: Path, frames: int, rows: int = 24, cols: int = 32) -> Path:
    """A tub whose records stand in two catalogs; frame n has a throttle of n / 1000."""
    records = [
        {**tub_record(n, round(math.sin(n / 9), 3)), "user/throttle": n / 1000, "user/mode": "user"}
        for n in range(frames)
    ]
    put_tub(folder, [records[: frames // 2], records[frames // 2 :]])
    pictures, _ = data.made_up(frames, cols, rows)
    for n in range(frames):
        put_picture(folder / "images" / f"{n}_cam_image_array_.jpg", pictures[n])
    return folder


# Donkeycar's numbers


@given(st.floats(-1.2, 1.2), st.floats(-0.2, 1.2))
def test_bins_are_those_of_python_s_round(angle: float, throttle: float) -> None:
    a = min(14, max(0, round((angle + 1) / (2.0 / (15 - 1)))))
    t = min(19, max(0, round(throttle / (0.8 / 20))))
    assert donkeycar.linear_bin(np.array([angle]), 15, 1.0, 2.0)[0] == a
    assert donkeycar.linear_bin(np.array([throttle]), 20, 0.0, 0.8)[0] == t


def test_bins_are_hrt_s_classes() -> None:
    angles = donkeycar.linear_unbin(np.eye(15))
    assert np.allclose(angles, np.arange(-7, 8) / 7)
    assert (donkeycar.linear_bin(angles, 15, 1.0, 2.0) == np.arange(15)).all()
    mixed = np.full((1, 15), 0.05) + 0.25 * np.eye(15)[[3]]
    assert donkeycar.linear_unbin(mixed)[0] == pytest.approx(-4 / 7)


def test_networks_have_as_many_parameters_as_donkeycar_s() -> None:
    convolutions = (5 * 5 * 3 + 1) * 24 + (5 * 5 * 24 + 1) * 32 + (5 * 5 * 32 + 1) * 64 + 2 * (3 * 3 * 64 + 1) * 64
    # Keras' own summary of `linear` says 817,028.
    linear = convolutions + (64 * 8 * 13 + 1) * 100 + 101 * 50 + 2 * 51
    categorical = convolutions + (64 * 3 * 6 + 1) * 100 + 101 * 50 + 51 * (15 + 20)
    assert (linear, categorical) == (817_028, 268_311)
    for kind, count, sizes in (("linear", linear, (1, 1)), ("categorical", categorical, (15, 20))):
        net = donkeycar.Pilot(kind)
        assert sum(each.numel() for each in net.parameters()) == count
        found = net.eval()(torch.rand(2, 3, 120, 160))
        assert [tuple(each.shape) for each in found] == [(2, size) for size in sizes]
        assert sum(isinstance(each, torch.nn.Dropout) and each.p == 0.2 for each in net.modules()) == 7


def test_weights_begin_as_keras_begins() -> None:
    torch.manual_seed(0)
    net = donkeycar.Pilot("linear")
    for name, each in net.named_parameters():
        if name.endswith("bias"):
            assert not each.any()
            continue
        area = math.prod(each.shape[2:])
        bound = math.sqrt(6.0 / (area * (each.shape[0] + each.shape[1])))
        assert each.abs().max() <= bound
        assert each.std().item() == pytest.approx(bound / math.sqrt(3.0), rel=0.15)


def test_losses_by_hand() -> None:
    angle, throttle = np.array([0.5, -1.0], np.float32), np.array([0.4, 0.2], np.float32)
    recipe = donkeycar.Recipe()
    values = (torch.tensor([[0.0], [1.0]]), torch.tensor([[0.4], [0.0]]))
    found = donkeycar.loss_of("linear", values, angle, throttle, recipe)
    assert found.item() == pytest.approx((0.25 + 4.0) / 2 + 0.04 / 2)
    logits = [torch.zeros(2, 15), torch.zeros(2, 20)]
    # Angle .5 is bin round(10.5) = 10, throttle .4 of .8 bin 10, and .2 bin 5.
    logits[0][0, 10] = logits[0][1, 0] = math.log(15.0)
    logits[1][0, 10] = logits[1][1, 5] = math.log(20.0)
    found = donkeycar.loss_of("categorical", logits, angle, throttle, recipe)
    assert found.item() == pytest.approx(0.5 * math.log(29 / 15) + 0.5 * math.log(39 / 20), rel=1e-5)


@pytest.mark.parametrize(
    ("losses", "epochs", "best"),
    [
        ([1.0, 0.9998, 0.9997, 0.1], 3, 3),  # too little better to go on, and kept all the same
        ([1.0, 0.9, 0.95, 0.9, 0.1], 4, 2),
        ([1.0, 0.9, 0.95, 0.8, 0.7, 0.9, 0.6], 7, 7),
    ],
)
def test_training_ends_as_keras_ends_it(losses: list[float], epochs: int, best: int) -> None:
    stopping = donkeycar._Stopping(donkeycar.Recipe(epochs=7, patience=2, min_delta=5e-4))
    for loss in losses:
        if stopping.ended:
            break
        stopping.is_best(loss)
    assert (stopping.ended, stopping.epoch, stopping.best_epoch) == (True, epochs, best)


def driven(frames: int) -> Any:
    pictures, steering = data.made_up(frames, 160, 120)
    return donkeycar.Driven(pictures, steering[:, 0], np.linspace(0.1, 0.7, frames, dtype=np.float32))


def test_frames_come_round_and_round(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    really = donkeycar.augment

    def spy(pictures: Any, steering: Any, *others: Any) -> Any:
        seen.extend(steering[:, 0].tolist())
        return really(pictures, steering, *others)

    monkeypatch.setattr(donkeycar, "augment", spy)
    frames = driven(5)
    recipe = donkeycar.Recipe(batch=4, epochs=2)
    donkeycar.train_pilot("categorical", frames, frames, 0, recipe, Augment.none())
    assert len(seen) == 2 * 2 * 4
    assert sorted(seen[:5]) == sorted(frames.angle.tolist())
    assert seen[5:] == (seen[:5] * 4)[: len(seen) - 5]


def test_the_best_epoch_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = driven(3)
    train = lambda epochs: donkeycar.train_pilot(  # noqa: E731
        "linear", frames, frames, 3, donkeycar.Recipe(batch=3, epochs=epochs), Augment.none()
    ).net.state_dict()
    first = train(1)
    monkeypatch.setattr(donkeycar._Stopping, "is_best", lambda self, loss: self.__dict__.update(
        epoch=self.epoch + 1) or self.epoch == 1)  # fmt: skip
    kept = train(2)
    assert all(torch.equal(first[name], kept[name]) for name in first)
    monkeypatch.undo()
    assert not torch.equal(train(2)["angle.weight"], first["angle.weight"])


def test_pictures_lie_in_zero_to_one() -> None:
    pictures = np.zeros((1, 120, 160, 3), np.uint8)
    pictures[0, 5, 7] = (255, 51, 0)
    seen = donkeycar.as_seen(pictures)
    assert seen.shape == (1, 3, 120, 160)
    assert seen[0, :, 5, 7].tolist() == pytest.approx([1.0, 0.2, 0.0])
    assert seen.sum() == pytest.approx(1.2)


# The measure


def test_temperatures_come_from_the_other_half() -> None:
    rng = np.random.default_rng(0)
    label = rng.uniform(-1, 1, 60).astype(np.float32)
    classes = accuracy.nearest_classes(label, 7)
    logits = rng.normal(0, 1, (60, 15)) + 2.0 * np.eye(15)[classes]
    logits[30:] *= 4.0  # far too sure
    found = accuracy.tempered(softmax(logits), label)
    fitted = [fit_temperature(logits[part], classes[part]) for part in (slice(0, 30), slice(30, 60))]
    assert fitted[1] > 2.0 * fitted[0]
    assert np.allclose(found[:30], softmax(logits[:30] / fitted[1]), atol=1e-9)
    assert np.allclose(found[30:], softmax(logits[30:] / fitted[0]), atol=1e-9)


def test_rows_by_hand() -> None:
    label = np.array([0.0, 0.5, -1.0], np.float32)
    row = accuracy.angle_row("m", np.array([0.05, 0.1, -0.8]), label)
    assert row["MAE"] == pytest.approx((0.05 + 0.4 + 0.2) / 3)
    assert row["RMSE"] == pytest.approx(math.sqrt((0.05**2 + 0.4**2 + 0.2**2) / 3))
    assert row["accuracy"] == pytest.approx(1 / 3)
    assert row["NLL"] is None
    # Each is half sure of straight ahead and half of a seventh to the right.
    probability = np.zeros((3, 15))
    probability[:, 7], probability[:, 8] = 0.6, 0.4
    row = accuracy.distribution_row("m", probability, label)
    mean = 0.4 / 7
    assert row["MAE"] == pytest.approx((mean + (0.5 - mean) + (1 + mean)) / 3)
    assert row["accuracy"] == pytest.approx(1 / 3)
    assert row["ECE"] == pytest.approx(0.6 - 1 / 3)
    assert row["NLL"] == pytest.approx((-math.log(0.6) - 2 * math.log(1e-12)) / 3)
    assert set(row) == {"method", *accuracy.COLUMNS}


@pytest.mark.parametrize(("kind", "method"), [("linear", "linear"), ("categorical", "categorical")])
def test_their_angles_are_read_as_donkeycar_reads_them(kind: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = donkeycar.Driven(np.zeros((2, 1, 1, 3), np.uint8), np.array([1.0, -0.5], np.float32), np.zeros(2))
    logits = torch.log(torch.tensor([0.4, 0.6])).repeat(2, 1)
    angle = torch.tensor([[3.0], [-0.25]]) if kind == "linear" else torch.full((2, 15), -80.0)
    if kind == "categorical":
        angle[:, [13, 14]] = logits
    monkeypatch.setattr(donkeycar, "train_pilot", lambda *_: donkeycar.Trained(None, 4, 2))
    monkeypatch.setattr(donkeycar, "predict", lambda *_: (angle, None))
    found = accuracy.train_theirs(method, kind, frames, frames, 0, accuracy.Study(threads=1), Augment.none())
    assert (found["epochs"], found["best_epoch"]) == (4, 2)
    if kind == "linear":
        assert [row["MAE"] for row in found["rows"]] == [pytest.approx(0.25 / 2)]
    else:
        mean = 0.4 * 6 / 7 + 0.6
        assert [row["method"] for row in found["rows"]] == ["categorical, likeliest", "categorical, mean"]
        assert found["rows"][0]["MAE"] == pytest.approx(1.5 / 2)
        assert found["rows"][1]["MAE"] == pytest.approx((1 - mean + mean + 0.5) / 2)


def test_each_method_gets_what_its_name_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tub(tmp_path / "tub", 40)
    own, theirs = (data.load(folder, SteeringConfig(width=w, height=h)) for w, h in ((32, 48), (160, 120)))
    parts = data.part(own.samples, 1, 5)
    given: dict[str, Any] = {}
    for name in ("train_ours", "train_theirs"):
        monkeypatch.setattr(accuracy, name, lambda method, *rest: given.__setitem__(method, rest))
    study = accuracy.Study(size=(32, 48), gap=1, epochs=9, patience=8, peer_epochs=7)
    throttle = data.throttles(theirs.samples)
    for method in accuracy.METHODS:
        row = accuracy._work(method, study, 5, own, theirs, throttle, parts)()
    middle = np.median(own.samples.steering[parts.train])
    label = own.samples.steering[parts.validation, 0]
    assert row["rows"][0]["MAE"] == pytest.approx(np.abs(label - middle).mean())
    for method, sigma in (("hrt, Gaussian labels", SteerSpec().sigma), ("hrt, hard labels", 0.0)):
        config, spec, training, validation = given[method]
        assert (config.width, config.height) == (32, 48)
        assert (spec.sigma, spec.seed, spec.epochs, spec.gap) == (sigma, 5, 9, 1)
        assert (training.rows == parts.train).all()
        assert (validation.rows == parts.validation).all()
    for method in ("linear", "linear, augmented", "categorical"):
        kind, training, validation, seed, _, strengths = given[method]
        assert (kind, seed) == (method.split(",")[0], 5)
        assert strengths == (Augment() if "augmented" in method else Augment.none())
        for frames, rows in ((training, parts.train), (validation, parts.validation)):
            assert (frames.pictures == theirs.pictures[rows]).all()
            assert (frames.angle == own.samples.steering[rows, 0]).all()
            assert (frames.throttle == throttle[rows]).all()
    assert (study.recipe().epochs, study.recipe().patience) == (7, 8)


def test_ratios_pair_the_seeds() -> None:
    last = [f"{method}, last" for method in accuracy.OURS]
    rows = [
        {"seed": seed, "method": method, **dict.fromkeys(accuracy.COLUMNS, value * (seed + 1)), "NLL": value + seed}
        for seed in (0, 1)
        for method, value in zip([*accuracy.METHODS, *last], (1.0, 2.0, 4.0, 5.0, 8.0, 16.0, 3.0, 9.0), strict=True)
    ]
    rows[13]["NLL"] = rows[5]["NLL"] = None
    means, ratios = accuracy.summaries(rows, (0, 1))
    assert means.rows[0]["MAE"] == "1.500 ± 0.707"
    assert means.rows[5]["NLL"] is None
    by_title = {row["ratio"]: row for row in ratios.rows}
    assert by_title["MAE, Gaussian / linear"] == {
        "ratio": "MAE, Gaussian / linear", "seed 0": 0.25, "seed 1": 0.25, "all": "0.250 ± 0.000",
    }  # fmt: skip
    assert by_title["ECE, Gaussian / hard"]["seed 1"] == 0.5
    assert by_title["NLL, Gaussian / hard"]["seed 1"] == 2.0 / 3.0
    assert by_title["NLL, Gaussian / hard, last epochs"]["seed 1"] == 0.4


def test_a_long_run_can_be_cut_into_parts(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    results = accuracy.Results(path, {"gap": 20})
    assert results.get("a", lambda: {"rows": [1]})["rows"] == [1]
    on_disk = json.loads(path.read_text(encoding="utf-8"))
    assert on_disk["results"]["a"]["rows"] == [1]
    again = accuracy.Results(path, {"gap": 20})
    assert again.get("a", lambda: pytest.fail("is there already"))["rows"] == [1]
    again.get("b", lambda: {"rows": [2]})
    assert set(json.loads(path.read_text(encoding="utf-8"))["results"]) == {"a", "b"}
    with pytest.raises(SystemExit, match=r"other settings \(gap\)"):
        accuracy.Results(path, {"gap": 10})


# The data


def test_the_split_is_that_of_the_command_with_a_gap(tmp_path: Path) -> None:
    folder = tub(tmp_path / "tub", 100)
    config = SteeringConfig(width=32, height=32)
    recorded = data.load(folder, config)
    parts = data.part(recorded.samples, 6, 1)
    away = np.abs(parts.train[:, None] - parts.validation[None])
    assert away.min() == 7
    assert parts.validation.size == 20
    gathered = gather([folder], [], SteerSpec(split="block", share=0.2, gap=6, seed=1), config)
    assert (gathered.training.rows == parts.train).all()
    assert (gathered.validation.rows == parts.validation).all()
    frames = recorded.frames(parts.validation)
    assert (frames.steering == gathered.validation.steering).all()


def test_throttles_are_those_of_the_frames(tmp_path: Path) -> None:
    folder = tub(tmp_path / "tub", 12)
    catalog = folder / "catalog_0.catalog"
    catalog.write_text("\n".join(reversed(catalog.read_text().splitlines())) + "\n")
    samples = data.read_samples([folder])
    assert data.throttles(samples).tolist() == pytest.approx([n / 1000 for n in range(12)])
    catalog.write_text(catalog.read_text().replace("user/throttle", "user/brake"))
    with pytest.raises(data.Skipped, match="no user/throttle"):
        data.throttles(samples)


def test_packed_data_is_unpacked_for_the_time_being(tmp_path: Path) -> None:
    folder = tub(tmp_path / "tub", 4)
    with tarfile.open(tmp_path / "tub.tar.gz", "w:gz") as packed:
        packed.add(folder, "tub")
    with data.opened(tmp_path / "tub.tar.gz") as unpacked:
        assert len(data.read_samples([unpacked]).paths) == 4
    assert not unpacked.exists()


def test_absent_data_is_skipped_with_a_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for section in ("accuracy", "latency"):
        assert bench.main([section, "--data", str(tmp_path / "none.tar.gz")]) == 0
        assert f"{section}: skipped, {tmp_path / 'none.tar.gz'} is absent" in capsys.readouterr().out


# Speed


def test_the_plain_training_computes_what_ours_does() -> None:
    pictures, steering = data.made_up(8, 32, 32)
    frames = Frames(pictures, np.arange(8), steering, None)
    spec = SteerSpec(epochs=1, batch=8, augment=Augment.none(), threads=1)
    plain = speed.PlainTraining(SteeringConfig(width=32, height=32), frames, spec, "cpu")
    net = SteeringNet(plain.net.config)
    net.load_state_dict(plain.net.state_dict())
    for each in (plain.net, net):
        torch.nn.init.constant_(each.dropout.p_logit, -30.0)  # else each draws masks of its own
    with repeatable(Arithmetic("cpu", False), 1):
        trainer = Trainer(net, frames, frames, spec, Arithmetic("cpu", False))
        trainer.run()
    seen: list[bool] = []
    plain.net.trunk.conv1.register_forward_pre_hook(lambda _, given: seen.append(given[0].is_contiguous()))
    assert plain.step(np.arange(8)) == pytest.approx(trainer.course.history[0].train_loss, rel=1e-4)
    assert seen == [True]
    assert plain.net.trunk.layer1[0].conv1.weight.is_contiguous()
    assert not trainer.net.trunk.layer1[0].conv1.weight.is_contiguous()


def test_predictors_take_turns() -> None:
    asked: list[tuple[str, int]] = []

    def answer(name: str) -> Any:
        return lambda pictures: asked.append((name, int(pictures[0, 0, 0, 0])))

    pictures = np.arange(7, dtype=np.uint8)[:, None, None, None]
    spent = speed.timed({"a": answer("a"), "b": answer("b")}, pictures, 2)
    assert {name: len(each) for name, each in spent.items()} == {"a": 16, "b": 16}
    assert [name for name, _ in asked] == (["a"] * 10 + ["b"] * 10) * 2
    assert [number for _, number in asked[20:30]] == [(10 + n) % 7 for n in range(10)]


@pytest.mark.slow
def test_speed_and_latency_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnxruntime")
    monkeypatch.setattr(
        speed, "QUICK", replace(speed.QUICK, width=32, height=32, trainings=((32, 32, 4),), steps=2, turns=1)
    )
    out = tmp_path / "out.json"
    assert bench.main(["speed", "--quick", "--threads", "1", "--json", str(out)]) == 0
    (row,) = json.loads(out.read_text(encoding="utf-8"))["tables"][0]["rows"]
    assert row["hrt, images/s"] > 0
    assert row["least"] <= row["hrt is faster by"] <= row["most"]
    folder = tub(tmp_path / "tub", 60)
    given = ["--quick", "--threads", "1", "--data", str(folder), "--gap", "2", "--json", str(out)]
    assert bench.main(["latency", *given]) == 0
    rows = {row["predictor"]: row for row in json.loads(out.read_text(encoding="utf-8"))["tables"][0]["rows"]}
    assert rows["PyTorch, eager"]["faster than eager by"] == 1.0
    base = rows["PyTorch, eager"]["MAE"]
    assert all(rows[name]["MAE"] == pytest.approx(base, abs=1e-4) for name in ("hrt, PyTorch", "ONNX, float32"))
    assert 0 < abs(rows["ONNX, int8"]["MAE"] - base) < 0.05
    assert "bfloat16" in capsys.readouterr().out


@pytest.mark.slow
def test_accuracy_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tub(tmp_path / "tub", 40)
    out = tmp_path / "out.json"
    given = ["accuracy", "--quick", "--threads", "1", "--data", str(folder), "--gap", "1", "--json", str(out)]
    assert bench.main([*given, "--seeds", "0"]) == 0
    told = json.loads(out.read_text(encoding="utf-8"))["results"]
    assert len(told) == len(accuracy.METHODS)
    assert all(math.isfinite(row["MAE"]) for each in told.values() for row in each["rows"])
    shown = capsys.readouterr().out
    assert "MAE, Gaussian / linear" in shown
    assert bench.main([*given, "--seeds", "0"]) == 0
    assert "seed 0: " not in capsys.readouterr().out.split("accuracy")[0]


# Resuming


def test_a_process_is_killed_in_time() -> None:
    sleeper = [sys.executable, "-c", "import time; time.sleep(60)"]
    tally = resume.Tally()
    process = subprocess.Popen(sleeper, stderr=subprocess.PIPE, text=True)
    assert resume.killed(process, 0.1, signal.SIGTERM, tally) == 1
    assert tally.codes == {"SIGTERM:-15": 1}
    said = "import sys; print('Note: going on after step 7 of 12 (x)', file=sys.stderr)"
    process = subprocess.Popen([sys.executable, "-c", said], stderr=subprocess.PIPE, text=True)
    assert resume.killed(process, 60.0, signal.SIGKILL, tally) == 0
    assert tally.resumed == [7]
    process = subprocess.Popen([sys.executable, "-c", "raise SystemExit(3)"], stderr=subprocess.PIPE, text=True)
    with pytest.raises(RuntimeError, match="status 3"):
        resume.killed(process, 60.0, signal.SIGKILL, tally)


def test_nothing_but_the_model_may_be_left(tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(b"x")
    assert resume.sum_of(tmp_path) == "2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"
    (tmp_path / ".model.safetensors.hrt-checkpoint").write_bytes(b"y")
    with pytest.raises(RuntimeError, match="hrt-checkpoint"):
        resume.sum_of(tmp_path)


@pytest.mark.slow
def test_resume_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(resume, "QUICK", resume.Size(20, 32, 1, 8))
    assert bench.main(["resume", "--quick", "--kills", "2", "--threads", "1"]) == 0
    shown = capsys.readouterr().out
    assert "2 kills" in shown
    assert "1 of 1 trainings that were finished are the unbroken one" in shown


def test_help_of_every_section(capsys: pytest.CaptureFixture[str]) -> None:
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "steering.py"), "--help"], capture_output=True, text=True, check=True
    )
    for section in ("speed", "latency", "accuracy", "resume"):
        assert f"benchmarks/steering.py {section}" in done.stdout
        with pytest.raises(SystemExit) as end:
            bench.main([section, "--help"])
        assert end.value.code == 0
        assert "--threads" in capsys.readouterr().out
