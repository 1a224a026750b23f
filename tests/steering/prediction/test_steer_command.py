"""`hrt steer` as a user runs it: keys, notes, exit codes, and models that must not steer."""

from __future__ import annotations

import json
import os
import tarfile
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner, Result
from predict_files import put_net, put_pictures, put_recording, small_net

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import HrtError
from hrt_cli.main import cli
from hrt_cli.steering.network.model import publish_tensors
from hrt_cli.steering.network.net import SteeringNet
from hrt_cli.steering.prediction.predictions import read_predictions

TUB = Path(__file__).parents[3].parent / "shared" / "data" / "donkeycar_tub" / "tub.tar.gz"


@pytest.fixture(scope="module")
def net() -> SteeringNet:
    return small_net()


@pytest.fixture
def model(net: SteeringNet, tmp_path: Path) -> Path:
    return put_net(tmp_path / "m.safetensors", net)


def hrt(*args: object) -> Result:
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def test_the_result_and_its_keys(model: Path, tmp_path: Path) -> None:
    put_pictures(tmp_path / "p", 2)
    run = ["steer", model, tmp_path / "p", "-o", tmp_path / "s.json", "--passes", 2, "--overlay", tmp_path / "o"]
    done = hrt(*run, "--saliency", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["output"] == str(tmp_path / "s.json")
    assert (found["frames"], found["skipped"], found["passes"], found["up_to_date"]) == (2, 0, 2, False)
    assert found["frames_per_second"] == pytest.approx(2 / found["seconds"])
    assert found["mean"].keys() == found["mean_spread"].keys() == {"yaw"}
    assert len(list((tmp_path / "o").glob("*.jpg"))) == 2
    again = hrt(*run, "--saliency")
    assert again.exit_code == 0
    assert "2 frames, on average yaw" in again.stdout
    assert "up to date" in again.stdout


def test_the_figure_tells_of_the_predictions(model: Path, tmp_path: Path) -> None:
    put_pictures(tmp_path / "p", 2)
    run = ["steer", model, tmp_path / "p", "-o", tmp_path / "s.json", "--passes", 2, "--figure", tmp_path / "f.png"]
    for _ in range(2):
        assert hrt(*run).exit_code == 0
    found = png_provenance(tmp_path / "f.png")
    assert found is not None
    assert [each.name for each in found.inputs] == ["s.json"]


@pytest.mark.usefixtures("tiny")
def test_options_reach_the_work(tmp_path: Path) -> None:
    model = put_net(tmp_path / "m.safetensors", small_net(goal=True))
    recording = put_recording(tmp_path / "r", 2)
    (recording / "frames" / "1.png").write_bytes(b"")
    run = ["steer", model, recording, "-o", tmp_path / "s.json"]
    done = hrt(*run)
    assert isinstance(done.exception, HrtError)
    assert "give --goal" in str(done.exception)
    done = hrt(*run, "--goal", -30, "--skip-bad", "--passes", 0, "--batch", 1, "--seed", 4)
    assert done.exit_code == 0, done.output
    assert "1 left out" in done.stdout
    found = read_predictions(tmp_path / "s.json")
    assert found.frames[0].goal_deg == -30
    assert found.provenance is not None
    assert {"passes": 0, "batch": 1, "seed": 4, "goal_deg": -30, "skip_bad": True}.items() <= (
        found.provenance.parameters.items()
    )


@pytest.mark.usefixtures("tiny")
def test_two_ways_are_told(tmp_path: Path) -> None:
    torn = small_net()
    with torch.no_grad():
        torn.heads["yaw"].weight.zero_()
        torn.heads["yaw"].bias.fill_(-20.0)
        torn.heads["yaw"].bias[0] = torn.heads["yaw"].bias[14] = 1.0
    put_pictures(tmp_path / "p", 2)
    model = put_net(tmp_path / "m.safetensors", torn)
    done = hrt("steer", model, tmp_path / "p", "-o", tmp_path / "s.json", "--passes", 0)
    assert "in 2 frames the network sees two ways" in done.stderr
    quiet = hrt("steer", model, tmp_path / "p", "-o", tmp_path / "t.json", "--passes", 0, "-q")
    assert quiet.stderr == ""


@pytest.mark.parametrize(
    "more",
    [["--saliency"], ["--passes", "-1"], ["--goal", "nan"], ["--goal", "181"], ["--every", "0"], ["--batch", "0"]],
)
def test_usage(model: Path, tmp_path: Path, more: list[str]) -> None:
    (picture,) = put_pictures(tmp_path / "p", 1)
    assert hrt("steer", model, picture, "-o", tmp_path / "s.json", *more).exit_code == 2


def refused(model: Path, folder: Path) -> str:
    (picture,) = put_pictures(folder / "p", 1)
    done = hrt("steer", model, picture, "-o", folder / "s.json", "--overlay", folder / "o")
    assert isinstance(done.exception, HrtError), done.output
    assert str(model) in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (folder / "s.json").exists()
    assert not (folder / "o").exists()
    return str(done.exception)


@pytest.mark.parametrize("name", ["m.pth", "m.pt", "m.safetensors"])
def test_a_pickle_never_runs(tmp_path: Path, name: str) -> None:
    marker = tmp_path / "ran"

    class Payload:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.system, (f"touch {marker}",)

    torch.save({"state_dict": Payload()}, tmp_path / name)
    assert "no safetensors file" in refused(tmp_path / name, tmp_path)
    assert not marker.exists()


@pytest.mark.usefixtures("tiny")
def test_weights_that_are_no_numbers(tmp_path: Path) -> None:
    bad = small_net()
    with torch.no_grad():
        bad.trunk.conv1.weight[0, 0, 0, 0] = float("nan")
    assert "not all finite" in refused(put_net(tmp_path / "m.safetensors", bad), tmp_path)


@pytest.mark.usefixtures("tiny")
def test_a_later_version(tmp_path: Path) -> None:
    net = small_net()
    path = tmp_path / "m.safetensors"
    document = {"format": "hrt-steering", "version": 2, "config": json.loads(net.config.model_dump_json())}
    publish_tensors(path, dict(net.state_dict()), document, record("train-steer", 1, {}, {}))
    assert "update hrt" in refused(path, tmp_path)


def test_a_flipped_bit(model: Path, tmp_path: Path) -> None:
    data = bytearray(model.read_bytes())
    data[-1000] ^= 4
    model.write_bytes(data)
    assert "not what its provenance recorded" in refused(model, tmp_path)


@pytest.mark.real
@pytest.mark.skipif(not TUB.is_file(), reason="the real data are not here")
def test_real_frames(model: Path, tmp_path: Path) -> None:
    with tarfile.open(TUB) as archive:
        wanted = [f"{k}_cam_image_array_.jpg" for k in (9, 10, 100)]
        for member in archive.getmembers():
            if Path(member.name).name in wanted:
                (tmp_path / Path(member.name).name).write_bytes(archive.extractfile(member).read())  # type: ignore[union-attr]
    done = hrt("steer", model, tmp_path, "-o", tmp_path / "s.json", "--overlay", tmp_path / "o", "--passes", 5)
    assert done.exit_code == 0, done.output
    assert [frame.image for frame in read_predictions(tmp_path / "s.json").frames] == wanted
