"""Predictions as files: what they say, what they depend on, and folders of overlays that appear whole."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from predict_files import HEIGHT, WIDTH, noise, put_net, put_pictures, put_recording, put_video, small_net

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.steering.network.net import SteeringNet
from hrt_cli.steering.network.predictor import TorchPredictor
from hrt_cli.steering.prediction import stage as predict_stage
from hrt_cli.steering.prediction.overlays import ABOUT, check_overlays
from hrt_cli.steering.prediction.predictions import read_predictions
from hrt_cli.steering.prediction.stage import Steering, SteerRequest, steer_files
from hrt_cli.steering.prediction.uncertainty import uncertainty

# Nothing here depends on what a network makes of a picture.
pytestmark = pytest.mark.usefixtures("tiny_throughout")
FEW = SteerRequest(passes=3, batch=2)


@pytest.fixture(scope="module")
def net(tiny_throughout: None) -> SteeringNet:
    return small_net(crop_top=0.25)


@pytest.fixture(scope="module")
def model(net: SteeringNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_net(tmp_path_factory.mktemp("model") / "m.safetensors", net)


@pytest.fixture(scope="module")
def goal_model(tiny_throughout: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    net = small_net(goal=True, outputs=("yaw", "pitch"), half_classes=2)
    return put_net(tmp_path_factory.mktemp("goal") / "m.safetensors", net)


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    put_pictures(tmp_path / "pictures", 3)
    return tmp_path / "pictures"


def steer(model: Path, inputs: Path | list[Path], output: Path, request: SteerRequest = FEW, **more: Any) -> Steering:
    return steer_files(model, inputs if isinstance(inputs, list) else [inputs], output, request, **more)


def test_what_is_written_is_what_the_network_says(net: SteeringNet, model: Path, pictures: Path) -> None:
    output = pictures.parent / "s.json"
    done = steer(model, pictures, output)
    found = read_predictions(output)
    assert (done.frames, done.skipped, done.passes, done.up_to_date) == (3, 0, 3, False)
    assert found.inputs == ("pictures",)
    assert [frame.image for frame in found.frames] == ["0.png", "1.png", "2.png"]
    assert found.model.angles == tuple(round(k / 7, 6) for k in range(-7, 8))
    # The top quarter is cut off, and the rest scaled up to the network's size.
    seen = np.stack([cv2.resize(p[HEIGHT // 4 :], (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR) for p in noise(3)])
    p = TorchPredictor(net).probabilities(seen)["yaw"]
    sure = uncertainty(TorchPredictor(net).sampled(seen, None, 3, 0)["yaw"])
    angles = np.arange(-7, 8) / 7
    for at, frame in enumerate(found.frames):
        np.testing.assert_allclose(frame.distribution["yaw"], p[at], atol=2e-5)
        assert frame.yaw == pytest.approx(p[at] @ angles, abs=2e-5)
        assert frame.yaw_spread == pytest.approx(np.sqrt(p[at] @ angles**2 - (p[at] @ angles) ** 2), abs=2e-5)
        assert frame.yaw_mode == pytest.approx(angles[p[at].argmax()], abs=1e-6)
        assert frame.uncertainty is not None
        assert frame.uncertainty["yaw"].epistemic == pytest.approx(sure.epistemic[at], abs=2e-5)
        assert frame.uncertainty["yaw"].mutual_information_nats == pytest.approx(
            sure.mutual_information_nats[at], abs=2e-5
        )
        assert frame.label is frame.goal_deg is frame.pitch is None
    assert done.mean["yaw"] == pytest.approx(np.mean([frame.yaw for frame in found.frames]))


def test_two_ways_are_counted_and_the_likelier_is_named(tmp_path: Path, pictures: Path) -> None:
    net = small_net()
    with torch.no_grad():
        net.heads["yaw"].weight.zero_()
        net.heads["yaw"].bias[:] = -20.0
        net.heads["yaw"].bias[torch.tensor([3, 11])] = torch.tensor([1.0, 0.9])
    done = steer(put_net(tmp_path / "two.safetensors", net), pictures, tmp_path / "s.json")
    frame = read_predictions(tmp_path / "s.json").frames[0]
    assert done.two_ways == 3
    assert frame.yaw_modes == 2
    assert frame.yaw_mode == pytest.approx(-4 / 7, abs=1e-6)
    assert abs(frame.yaw) < 0.1
    assert frame.yaw_spread > 0.5


def test_a_recording_gives_goals_and_labels(goal_model: Path, tmp_path: Path) -> None:
    recording = put_recording(tmp_path / "r", 3, goal=True)
    steer(goal_model, recording, tmp_path / "s.json")
    found = read_predictions(tmp_path / "s.json")
    assert [frame.goal_deg for frame in found.frames] == pytest.approx([0, 10, 20], abs=1e-3)
    assert [frame.label for frame in found.frames] == [{"yaw": 0.25}] * 3
    assert found.frames[0].pitch is not None
    assert set(found.frames[0].distribution) == {"yaw", "pitch"}


def test_a_goal_given_is_for_frames_whose_labels_give_none(goal_model: Path, tmp_path: Path) -> None:
    recording, plain = put_recording(tmp_path / "r", 2, goal=True), put_pictures(tmp_path / "p", 1)
    steer(goal_model, [recording, *plain], tmp_path / "s.json", SteerRequest(passes=0, goal_deg=-45.0))
    found = read_predictions(tmp_path / "s.json").frames
    assert [frame.goal_deg for frame in found] == pytest.approx([0, 10, -45], abs=1e-3)
    assert found[0].yaw != found[2].yaw
    assert found[0].uncertainty is None


def test_goals_that_are_missing_or_too_many(model: Path, goal_model: Path, pictures: Path, tmp_path: Path) -> None:
    video = put_video(tmp_path / "v.avi", 2)
    for source in (pictures, put_recording(tmp_path / "r", 1), video):
        with pytest.raises(ArgumentError, match=rf"{source}.*give --goal"):
            steer(goal_model, source, tmp_path / "s.json")
    with pytest.raises(ArgumentError, match="takes no goal"):
        steer(model, pictures, tmp_path / "s.json", SteerRequest(goal_deg=0.0))
    assert not (tmp_path / "s.json").exists()


def test_a_video_gives_frames_with_times(model: Path, tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    done = steer(
        model,
        put_video(tmp_path / "v.avi", 9),
        tmp_path / "s.json",
        SteerRequest(passes=0, every=2, batch=2),
        progress=lambda done, total: calls.append((done, total)),
    )
    found = read_predictions(tmp_path / "s.json").frames
    assert [(frame.image, frame.index) for frame in found] == [("v.avi", k) for k in (0, 2, 4, 6, 8)]
    assert [frame.time_s for frame in found] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8], abs=2e-3)
    assert calls == [(2, 5), (4, 5), (5, 5)]
    assert done.frames == 5


def test_the_same_bytes_wherever_it_lies(model: Path, pictures: Path, tmp_path: Path) -> None:
    steer(model, pictures, tmp_path / "a.json")
    there = shutil.copytree(pictures, tmp_path / "there" / "pictures")
    steer(shutil.copy(model, tmp_path / "there" / "m.safetensors"), there, tmp_path / "there" / "b.json")
    text = (tmp_path / "a.json").read_bytes()
    assert (tmp_path / "there" / "b.json").read_bytes() == text
    assert str(tmp_path).encode() not in text


def test_up_to_date_until_something_changes(model: Path, pictures: Path, tmp_path: Path) -> None:
    output = tmp_path / "s.json"
    first = steer(model, pictures, output)
    again = steer(model, pictures, output)
    assert again.up_to_date
    assert (again.frames, again.mean, again.passes) == (first.frames, first.mean, 3)
    for request in (
        SteerRequest(passes=4, batch=2),
        SteerRequest(passes=3, batch=2, seed=1),
        SteerRequest(passes=3, batch=2, every=2),
        SteerRequest(passes=3, batch=3),
    ):
        with pytest.raises(OutputError, match="--overwrite"):
            steer(model, pictures, output, request)
    (pictures / "1.png").rename(pictures / "4.png")
    with pytest.raises(OutputError, match="--overwrite"):
        steer(model, pictures, output)
    assert not steer(model, pictures, output, existing=Existing(overwrite=True)).up_to_date


def test_bad_pictures_are_left_out_and_counted_if_asked(model: Path, pictures: Path, tmp_path: Path) -> None:
    (pictures / "1.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"1\.png"):
        steer(model, pictures, tmp_path / "s.json")
    assert not (tmp_path / "s.json").exists()
    done = steer(model, pictures, tmp_path / "s.json", SteerRequest(passes=0, skip_bad=True))
    assert (done.frames, done.skipped) == (2, 1)
    assert read_predictions(tmp_path / "s.json").skipped == 1
    for name in ("0.png", "2.png"):
        (pictures / name).write_bytes(b"")
    with pytest.raises(InputError, match="no frame that can be read"):
        steer(model, pictures, tmp_path / "t.json", SteerRequest(passes=0, skip_bad=True))


def test_a_network_that_gives_no_numbers(pictures: Path, tmp_path: Path) -> None:
    net = small_net()
    with torch.no_grad():
        net.heads["yaw"].weight.fill_(3e38)
        net.heads["yaw"].weight[::2] *= -1
    with pytest.raises(InputError, match=r"m\.safetensors.*gives no number"):
        steer(put_net(tmp_path / "m.safetensors", net), pictures, tmp_path / "s.json")


def test_an_exported_model_is_not_sampled(
    net: SteeringNet, model: Path, pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Exported:
        config = net.config
        probabilities = TorchPredictor(net).probabilities

    monkeypatch.setattr(predict_stage, "load_predictor", lambda path: Exported())
    told: list[str] = []
    done = steer(model, pictures, tmp_path / "s.json", note=told.append)
    assert done.passes == 0
    assert read_predictions(tmp_path / "s.json").frames[0].uncertainty is None
    assert "no dropout masks" in told[0]
    with pytest.raises(ArgumentError, match="saliency"):
        steer(model, pictures, tmp_path / "t.json", overlay=tmp_path / "o", saliency=True)


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_overlays_appear_and_are_kept(model: Path, pictures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "o"
    steer(model, pictures, tmp_path / "s.json", overlay=folder, saliency=True)
    made = files(folder)
    assert sorted(made) == ["000000_0.jpg", "000001_1.jpg", "000002_2.jpg", ABOUT]
    assert cv2.imread(str(folder / "000000_0.jpg")).shape == (444, 480, 3)
    assert check_overlays(folder) is not None
    assert steer(model, pictures, tmp_path / "s.json", overlay=folder, saliency=True).up_to_date
    with pytest.raises(OutputError, match="use --overwrite"):
        steer(model, pictures, tmp_path / "s.json", overlay=folder)
    assert files(folder) == made
    steer(model, pictures, tmp_path / "s.json", overlay=folder, existing=Existing(overwrite=True))
    plain = files(folder)
    assert plain.keys() == made.keys()
    assert plain["000000_0.jpg"] != made["000000_0.jpg"]
    steer(model, pictures, tmp_path / "s.json", overlay=tmp_path / "p")
    assert files(tmp_path / "p") == plain
    left = {each.name for each in tmp_path.iterdir()}
    assert left == {"pictures", "s.json", "o", "p"}


def test_overlays_that_were_touched_are_drawn_anew(model: Path, pictures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "o"
    steer(model, pictures, tmp_path / "s.json", overlay=folder)
    made = files(folder)
    (folder / "000001_1.jpg").unlink()
    with pytest.raises(OutputError, match="not made by this run"):
        steer(model, pictures, tmp_path / "s.json", overlay=folder)
    steer(model, pictures, tmp_path / "s.json", overlay=folder, existing=Existing(overwrite=True))
    assert files(folder) == made
    (folder / "000001_1.jpg").write_bytes(made["000000_0.jpg"])
    with pytest.raises(InputError, match="not those that were written"):
        check_overlays(folder)


def test_folders_of_others_are_left_alone(model: Path, pictures: Path, tmp_path: Path) -> None:
    other, file = tmp_path / "other", tmp_path / "file"
    other.mkdir()
    (other / "thesis.tex").write_text("x")
    file.write_text("x")
    force = Existing(overwrite=True, force=True)
    for folder, words in (
        (other, "holds 'thesis.tex', which is no overlay"),
        (file, "is a file"),
        (pictures, "inputs or output"),
        (tmp_path, "inputs or output"),
        (tmp_path / "absent" / "o", "does not exist"),
    ):
        with pytest.raises(OutputError, match=words):
            steer(model, pictures, tmp_path / "s.json", overlay=folder, existing=force)
    assert files(other) == {"thesis.tex": b"x"}
    assert not (tmp_path / "s.json").exists()


def test_a_failure_on_the_way_leaves_the_old_overlays(model: Path, pictures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "o"
    steer(model, pictures, tmp_path / "s.json", overlay=folder)
    made = files(folder)
    (pictures / "2.png").write_bytes(b"")
    with pytest.raises(InputError):
        steer(model, pictures, tmp_path / "s.json", overlay=folder, existing=Existing(overwrite=True))
    assert files(folder) == made
    assert {each.name for each in tmp_path.iterdir()} == {"pictures", "s.json", "o"}


def test_the_reader_is_strict(model: Path, pictures: Path, tmp_path: Path) -> None:
    output = tmp_path / "s.json"
    steer(model, pictures, output, SteerRequest(passes=0))
    whole = json.loads(output.read_text())
    assert json_provenance(output) is not None

    def refused(change: Any, words: str, *, signed: bool = False) -> None:
        document = json.loads(output.read_text())
        change(document)
        if not signed:
            del document["provenance"]
        path = tmp_path / "changed.json"
        path.write_text(json.dumps(document))
        with pytest.raises(InputError, match=words):
            read_predictions(path)

    def frame(**members: Any) -> Any:
        return lambda document: document["frames"][1].update(members)

    refused(frame(yaw=0.123), "not what its provenance recorded", signed=True)
    refused(frame(yaw=1.5), r"frames\.1\.yaw")
    refused(frame(yaw="0.5"), r"frames\.1\.yaw")
    refused(frame(pitch=0.5), "other outputs")
    refused(frame(input=1), "not named")
    refused(frame(distribution={"yaw": [1.0, 0.0, 0.0]}), "none over 15 classes")
    refused(frame(distribution={"yaw": [0.05] * 15}), "none over 15 classes")
    refused(frame(distribution={"pitch": [1 / 15] * 15}), "other outputs")
    refused(frame(more=1), r"frames\.1\.more")
    refused(lambda document: document.update(version=2), "version")
    refused(lambda document: document["model"].update(angles=[0.0]), "15 angles")
    output.write_text(json.dumps({name: each for name, each in whole.items() if name != "provenance"}))
    assert len(read_predictions(output).frames) == 3


def test_the_seed_draws_other_networks_and_leaves_the_prediction(model: Path, pictures: Path, tmp_path: Path) -> None:
    for seed in (0, 1):
        steer(model, pictures, tmp_path / f"{seed}.json", SteerRequest(passes=3, batch=2, seed=seed))
    zero, one = (read_predictions(tmp_path / f"{seed}.json").frames[0] for seed in (0, 1))
    assert zero.distribution == one.distribution
    assert zero.uncertainty != one.uncertainty
