"""The trunk: torchvision's names and shapes, made up here anew, and what of a published file is refused."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hrt_cli.errors import InputError
from hrt_cli.steering.network.resnet import ResNet18, load_published


def names_and_shapes() -> Iterator[tuple[str, tuple[int, ...]]]:
    """What torchvision's resnet18 holds, by the architecture as its paper's table 1 gives it."""

    def norm(name: str, channels: int) -> Iterator[tuple[str, tuple[int, ...]]]:
        for part in ("weight", "bias", "running_mean", "running_var"):
            yield f"{name}.{part}", (channels,)
        yield f"{name}.num_batches_tracked", ()

    yield "conv1.weight", (64, 3, 7, 7)
    yield from norm("bn1", 64)
    before = 64
    for stage, channels in enumerate((64, 128, 256, 512), start=1):
        for block in range(2):
            name = f"layer{stage}.{block}"
            yield f"{name}.conv1.weight", (channels, before, 3, 3)
            yield from norm(f"{name}.bn1", channels)
            yield f"{name}.conv2.weight", (channels, channels, 3, 3)
            yield from norm(f"{name}.bn2", channels)
            if before != channels:
                yield f"{name}.downsample.0.weight", (channels, before, 1, 1)
                yield from norm(f"{name}.downsample.1", channels)
            before = channels
    yield "fc.weight", (1000, 512)
    yield "fc.bias", (1000,)


@pytest.fixture(scope="module")
def published() -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(3)
    return {
        name: torch.tensor(7) if name.endswith("tracked") else torch.rand(shape, generator=generator)
        for name, shape in names_and_shapes()
    }


@pytest.fixture(scope="module")
def trunk() -> ResNet18:
    return ResNet18()


def put(path: Path, tensors: object) -> Path:
    torch.save(tensors, path)
    return path


def refusal(trunk: ResNet18, path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_published(trunk, path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_names_and_shapes_are_torchvisions(trunk: ResNet18) -> None:
    own = {name: tuple(tensor.shape) for name, tensor in trunk.state_dict().items()}
    assert own == {name: shape for name, shape in names_and_shapes() if not name.startswith("fc.")}
    assert sum(parameter.numel() for parameter in trunk.parameters()) == 11_176_512


@pytest.mark.parametrize(("height", "width"), [(32, 32), (48, 65), (120, 160)])
def test_features_are_a_thirty_second(trunk: ResNet18, height: int, width: int) -> None:
    with torch.no_grad():
        x = torch.randn(2, 3, height, width)
        assert trunk(x).shape == (2, 512, -(-height // 32), -(-width // 32))
        assert trunk.to_layer3(x).shape == (2, 256, -(-height // 16), -(-width // 16))


def test_a_block_is_two_convolutions_beside_a_shortcut(trunk: ResNet18) -> None:
    block = trunk.layer2[0].eval()
    x = torch.randn(1, 64, 8, 8)
    with torch.no_grad():
        inner = block.bn2(block.conv2(torch.relu(block.bn1(block.conv1(x)))))
        torch.testing.assert_close(block(x), torch.relu(inner + block.downsample[1](block.downsample[0](x))))


def test_dropout_stands_before_the_last_convolution(trunk: ResNet18) -> None:
    seen = []

    class Spy(torch.nn.Module):
        def forward(self, x: Tensor) -> Tensor:
            seen.append(x)
            return torch.zeros_like(x)

    with torch.no_grad():
        x = torch.randn(1, 3, 32, 32)
        before = trunk.eval().layer4[0](trunk.to_layer3(x))
        found = trunk(x, Spy())
        block = trunk.layer4[1]
        torch.testing.assert_close(seen[0], torch.relu(block.bn1(block.conv1(before))))
        bias = block.bn2(block.conv2(torch.zeros_like(before)))
        torch.testing.assert_close(found, torch.relu(bias + before))


def test_published_weights_are_loaded(published: dict[str, Tensor], tmp_path: Path) -> None:
    trunk = ResNet18()
    load_published(trunk, put(tmp_path / "r.pth", published))
    for name, tensor in trunk.state_dict().items():
        assert torch.equal(tensor, published[name]), name


def test_files_of_old_do_not_count_batches(published: dict[str, Tensor], tmp_path: Path) -> None:
    trunk = ResNet18()
    old = {name: tensor for name, tensor in published.items() if not name.endswith("tracked")}
    load_published(trunk, put(tmp_path / "r.pth", old))
    assert torch.equal(trunk.state_dict()["layer3.1.bn2.running_var"], published["layer3.1.bn2.running_var"])


@pytest.mark.parametrize("name", ["conv1.weight", "layer4.1.bn2.running_var", "fc.bias"])
def test_a_missing_one_is_named(trunk: ResNet18, published: dict[str, Tensor], tmp_path: Path, name: str) -> None:
    less = {each: tensor for each, tensor in published.items() if each != name}
    assert f"lacks '{name}'" in refusal(trunk, put(tmp_path / "r.pth", less))


def test_one_too_many_is_named(trunk: ResNet18, published: dict[str, Tensor], tmp_path: Path) -> None:
    more = published | {"layer3.2.conv1.weight": torch.zeros(1)}
    assert "unknown 'layer3.2.conv1.weight'" in refusal(trunk, put(tmp_path / "r.pth", more))


def test_a_wrong_shape_is_named(trunk: ResNet18, published: dict[str, Tensor], tmp_path: Path) -> None:
    wrong = published | {"conv1.weight": torch.zeros(64, 1, 7, 7)}
    assert "'conv1.weight' is (64, 1, 7, 7), not (64, 3, 7, 7)" in refusal(trunk, put(tmp_path / "r.pth", wrong))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_no_number_is_named_and_nothing_loaded(published: dict[str, Tensor], tmp_path: Path, value: float) -> None:
    trunk = ResNet18()
    before = trunk.state_dict()["conv1.weight"].clone()
    bad = published["layer2.0.bn1.bias"].clone()
    bad[5] = value
    assert "layer2.0.bn1.bias" in refusal(trunk, put(tmp_path / "r.pth", published | {"layer2.0.bn1.bias": bad}))
    assert torch.equal(trunk.state_dict()["conv1.weight"], before)


class Payload:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch {self.marker}",)


@pytest.mark.parametrize("how", ["torch", "pickle"])
def test_code_in_a_file_never_runs(trunk: ResNet18, tmp_path: Path, how: str) -> None:
    marker, path = tmp_path / "ran", tmp_path / "r.pth"
    if how == "torch":
        torch.save({"conv1.weight": Payload(marker)}, path)
    else:
        path.write_bytes(pickle.dumps({"conv1.weight": Payload(marker)}))
    assert "weights alone" in refusal(trunk, path)
    assert not marker.exists()


@pytest.mark.parametrize("content", [b"", b"<html>not found</html>", b"PK\x03\x04", b"\x80\x02.", b"\x00" * 100])
def test_other_files_are_refused(trunk: ResNet18, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "r.pth"
    path.write_bytes(content)
    refusal(trunk, path)


def test_cut_files_are_refused(trunk: ResNet18, tmp_path: Path) -> None:
    whole = put(tmp_path / "r.pth", {"a": torch.zeros(1000)}).read_bytes()
    for share in (0.1, 0.5, 0.9, 0.99):
        (tmp_path / "r.pth").write_bytes(whole[: int(share * len(whole))])
        refusal(trunk, tmp_path / "r.pth")


@pytest.mark.parametrize("what", [[torch.zeros(1)], {"a": 1.0}, {1: torch.zeros(1)}, torch.zeros(3)])
def test_what_is_no_state_dict_is_refused(trunk: ResNet18, tmp_path: Path, what: object) -> None:
    assert "state dict" in refusal(trunk, put(tmp_path / "r.pth", what))


def test_an_absent_file_is_named(trunk: ResNet18, tmp_path: Path) -> None:
    assert "no such file" in refusal(trunk, tmp_path / "r.pth")
