"""The model file: what is written comes back, twice the same bytes, and whatever is wrong with it is refused."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from predict_files import put_net, small_net
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.steering.network import model
from hrt_cli.steering.network.model import model_provenance, publish_model, publish_tensors, read_model, read_tensors
from hrt_cli.steering.network.net import SteeringNet

pytestmark = pytest.mark.usefixtures("tiny_throughout")


@pytest.fixture(scope="module")
def net(tiny_throughout: None) -> SteeringNet:
    return small_net(outputs=("yaw", "pitch"), goal=True, spatial_dropout=True, temperature={"yaw": 1.5})


@pytest.fixture(scope="module")
def file(net: SteeringNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_net(tmp_path_factory.mktemp("model") / "m.safetensors", net)


def tensors_of(net: SteeringNet) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in net.state_dict().items()}


def put(path: Path, net: SteeringNet, tensors: dict[str, torch.Tensor] | None = None, **changes: Any) -> Path:
    document = {"format": "hrt-steering", "version": 1, "config": json.loads(net.config.model_dump_json())} | changes
    publish_tensors(path, tensors or tensors_of(net), document, record("train-steer", 1, {}, {}))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_model(path)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


def test_what_is_written_comes_back(net: SteeringNet, file: Path) -> None:
    back = read_model(file)
    assert back.config == net.config
    assert not back.training
    for name, tensor in net.state_dict().items():
        assert torch.equal(back.state_dict()[name], tensor), name
    x, goal = torch.randn(1, 3, 48, 64), torch.zeros(1)
    with torch.no_grad():
        assert torch.equal(back(x, goal)["pitch"], net(x, goal)["pitch"])
    provenance = model_provenance(file)
    assert provenance is not None
    assert provenance.stage == "train-steer"


def test_the_configuration_may_say_more_than_the_network(net: SteeringNet, tmp_path: Path) -> None:
    config = net.config.model_copy(update={"temperature": {"yaw": 2.0, "pitch": 0.5}})
    publish_model(tmp_path / "m.safetensors", net, config, record("train-steer", 1, {}, {}))
    assert read_model(tmp_path / "m.safetensors").config == config


def test_twice_the_same_bytes(net: SteeringNet, file: Path, tmp_path: Path) -> None:
    assert put_net(tmp_path / "again.safetensors", net).read_bytes() == file.read_bytes()


def test_absent_empty_or_other_files(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    assert "no such file" in refusal(path)
    for content in (b"", b"<html>", b"\xff" * 64, b"\x08\x00\x00\x00\x00\x00\x00\x00{}      "):
        path.write_bytes(content)
        refusal(path)


def test_cut_files(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    path = tmp_path / "m.safetensors"
    for share in (0.0001, 0.3, 0.9999):
        path.write_bytes(whole[: int(share * len(whole))])
        assert "damaged" in refusal(path)


def test_every_flipped_bit_counts(file: Path, tmp_path: Path) -> None:
    whole = bytearray(file.read_bytes())
    path = tmp_path / "m.safetensors"
    for at in (len(whole) // 3, len(whole) - 3, len(whole) // 2):
        flipped = whole.copy()
        flipped[at] ^= 1
        path.write_bytes(flipped)
        assert "not what its provenance recorded" in refusal(path)


def test_a_changed_configuration(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    path = tmp_path / "m.safetensors"
    assert whole.count(b'\\"crop_top\\":0.0') == 1
    path.write_bytes(whole.replace(b'\\"crop_top\\":0.0', b'\\"crop_top\\":0.1'))
    assert "not what its provenance recorded" in refusal(path)


@pytest.mark.parametrize(
    ("version", "words"), [(2, "update hrt"), (99, "update hrt"), (0, "version"), ("1", "version")]
)
def test_other_versions(net: SteeringNet, tmp_path: Path, version: object, words: str) -> None:
    assert words in refusal(put(tmp_path / "m.safetensors", net, version=version))


def test_other_documents(net: SteeringNet, file: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    assert "is not a steering model" in refusal(put(path, net, format="hrt-texture"))
    assert "more" in refusal(put(path, net, more=1))
    config = json.loads(net.config.model_dump_json())
    assert "config.layers" in refusal(put(path, net, config=config | {"layers": 18}))
    assert "config.half_classes" in refusal(put(path, net, config=config | {"half_classes": "7"}))
    save_file(tensors_of(net), path)
    assert "is not a steering model of hrt" in refusal(path)
    with safe_open(file, framework="pt") as opened:
        unsigned = json.loads(opened.metadata()["hrt"])
    del unsigned["provenance"]
    save_file(tensors_of(net), path, metadata={"hrt": json.dumps(unsigned)})
    assert "provenance" in refusal(path)
    save_file(tensors_of(net), path, metadata={"hrt": "[1]"})
    assert "damaged" in refusal(path)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers(net: SteeringNet, tmp_path: Path, value: float) -> None:
    tensors = tensors_of(net)
    tensors["heads.yaw.weight"][3, 100] = value
    assert "'heads.yaw.weight' are not all finite" in refusal(put(tmp_path / "m.safetensors", net, tensors))


def test_weights_that_do_not_fit(net: SteeringNet, tmp_path: Path) -> None:
    path, tensors = tmp_path / "m.safetensors", tensors_of(net)
    assert "lacks weights 'spatial.p_logit'" in refusal(
        put(path, net, {name: tensor for name, tensor in tensors.items() if name != "spatial.p_logit"})
    )
    assert "unknown weights 'more'" in refusal(put(path, net, tensors | {"more": torch.zeros(1)}))
    assert "'heads.yaw.bias'" in refusal(put(path, net, tensors | {"heads.yaw.bias": torch.zeros(13)}))
    assert "'heads.yaw.bias'" in refusal(put(path, net, tensors | {"heads.yaw.bias": torch.zeros(15).double()}))


def test_no_pickle_is_read(tmp_path: Path) -> None:
    marker = tmp_path / "ran"

    class Payload:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.system, (f"touch {marker}",)

    path = tmp_path / "m.pth"
    torch.save({"weights": Payload()}, path)
    assert "safetensors" in refusal(path)
    assert not marker.exists()


def test_a_failed_write_leaves_the_old_file(net: SteeringNet, tmp_path: Path) -> None:
    path = put_net(tmp_path / "m.safetensors", net)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="Out of range"):
        publish_tensors(path, {}, {"format": float("nan")}, record("train-steer", 1, {}, {}))
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["m.safetensors"]


def test_tensors_of_other_kinds_come_back(tmp_path: Path) -> None:
    path = tmp_path / "t.safetensors"
    tensors = {"a": torch.arange(6).view(2, 3), "b": torch.tensor(2.5), "c": torch.zeros(0), "d": torch.ones(2).half()}
    publish_tensors(path, tensors, {"format": "x"}, record("test", 1, {}, {}))
    back, document, provenance = read_tensors(path)
    assert document == {"format": "x"}
    assert provenance is not None
    for name, tensor in tensors.items():
        assert torch.equal(back[name], tensor)
        assert back[name].dtype == tensor.dtype


def test_a_signal_while_a_file_is_read_is_a_signal_and_no_damage(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Inside the library it would come out as an error of the file."""

    class StoppedError(BaseException):
        pass

    def stop(number: int, frame: object) -> None:
        raise StoppedError

    before = signal.signal(signal.SIGTERM, stop)
    plain = model.safe_open

    def interrupted(*arguments: Any, **options: Any) -> Any:
        try:
            signal.raise_signal(signal.SIGTERM)
        except StoppedError as error:  # as what is raised in the midst of the library is
            raise SafetensorError(str(error)) from error
        return plain(*arguments, **options)

    monkeypatch.setattr(model, "safe_open", interrupted)
    try:
        with pytest.raises(StoppedError):
            read_tensors(file)
    finally:
        signal.signal(signal.SIGTERM, before)
