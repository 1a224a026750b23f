"""What the steering commands do with bad recordings and bad models: one line, the right exit code, nothing changed."""

from __future__ import annotations

import io
import json
import os
import pickle
import signal
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from recording_files import picture, put_labels
from refusals import Outcome, check_refused, contents, here, process, refused
from tiny_trunk import TinyTrunk
from world_files import map_xy, put_plan, put_world

from hrt_cli.artifacts.provenance import record
from hrt_cli.steering.network import net as network
from hrt_cli.steering.network.model import publish_model, publish_tensors
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet

CONFIG = SteeringConfig(width=32, height=32, half_classes=3)
SMALL = ["--size", "32x32", "--half-classes", "3", "--epochs", "2", "--batch", "8", "--gap", "0", "--threads", "1"]
FRAMES = 20


@pytest.fixture(autouse=True)
def _tiny(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Networks with a tiny trunk, and one thread."""
    monkeypatch.setattr(network, "ResNet18", TinyTrunk)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self._marker = marker

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, (f"touch '{self._marker}'",)


@pytest.fixture
def marker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A file that must not come to be."""
    path = tmp_path_factory.mktemp("marker") / "ran"
    yield path
    assert not path.exists(), "a pickle ran"


def test_the_payload_would_run(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Payload(tmp_path / "ran")))
    assert (tmp_path / "ran").exists()


def put_drive(folder: Path, **more: object) -> Path:
    """A recording in which nothing is wrong."""
    put_labels(folder, [round(0.09 * (k - 10), 2) for k in range(FRAMES)], **more)  # type: ignore[arg-type]
    return folder


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return put_drive(tmp_path / "drive é")


def put_model(path: Path, config: SteeringConfig = CONFIG) -> Path:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        net = SteeringNet(config)
    publish_model(path, net, config, record("train-steer", 1, {}, {}))
    return path


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return put_model(tmp_path / "good.safetensors")


# -- data that are no recording ---------------------------------------------------------------------------------------


def pickled_npz(marker: Path) -> bytes:
    """E30: an object array, opened lazily."""
    file = io.BytesIO()
    np.savez(file, images=np.zeros(3), labels=np.array([Payload(marker)], object), allow_pickle=True)
    return file.getvalue()


def endless_npz(marker: Path) -> bytes:
    """E32: a header that says 7.3 TiB, and no data."""
    header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (2000000, 2000, 2000), }"
    header += b" " * (63 - (len(header) + 10) % 64) + b"\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("images.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    return file.getvalue()


def flipped_npz(marker: Path) -> bytes:
    """E53: a flipped bit, which shows only when the array is read."""
    file = io.BytesIO()
    np.savez(file, images=np.arange(999))
    content = bytearray(file.getvalue())
    content[700] ^= 1
    return bytes(content)


def pickled_state(marker: Path) -> bytes:
    file = io.BytesIO()
    torch.save({"images": Payload(marker)}, file)
    return file.getvalue()


FILES: dict[str, tuple[str, Callable[[Path], bytes]]] = {
    "an npz with a pickle": ("data.npz", pickled_npz),
    "an endless npz": ("data.npz", endless_npz),
    "an npz with a flipped bit": ("data.npz", flipped_npz),
    "a pth": ("data.pth", pickled_state),
    "a pickle": ("data.pkl", lambda marker: pickle.dumps(Payload(marker))),
    "an empty file": ("data", lambda marker: b""),
}


READERS = {
    "train-steer": (["train-steer", "DATA", *SMALL], "-o", "out.safetensors"),
    "train-steer --validation": (["train-steer", "GOOD", *SMALL, "--validation", "DATA"], "-o", "out.safetensors"),
    "steer": (["steer", "MODEL", "DATA", "--passes", "0"], "-o", "out.json"),
    "evaluate steer": (["evaluate", "steer", "MODEL", "DATA"], "--figure", "out.png"),
    "export-steer": (["export-steer", "MODEL", "--calibrate", "DATA"], "-o", "out.onnx"),
}
"""What reads recordings: the words, the option for the output, and its name."""


def check_data(
    reader: str, model: Path, data: Path, capfd: pytest.CaptureFixture[str], named: str, problem: str
) -> None:
    words, option, name = READERS[reader]
    meant = {"DATA": data, "MODEL": model, "GOOD": model.with_name("other")}
    if "GOOD" in words:
        put_drive(meant["GOOD"])
    args = [str(meant.get(word, word)) for word in words]
    refused(lambda a: here(a, capfd), args, model.with_name(name), 1, named, problem, option)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", FILES)
def test_data_that_are_a_file_are_refused(
    tmp_path: Path, model: Path, marker: Path, kind: str, reader: str, capfd: pytest.CaptureFixture[str]
) -> None:
    name, make = FILES[kind]
    path = tmp_path / name
    path.write_bytes(make(marker))
    problem = "is empty" if not path.stat().st_size else "is neither JPEG nor PNG"
    if reader not in ("steer", "export-steer"):  # these take pictures, too
        problem = "is a file, and steering data is a folder"
    check_data(reader, model, path, capfd, name, problem)


# -- pictures ---------------------------------------------------------------------------------------------------------


def encoded(kind: str, pixels: np.ndarray) -> bytes:
    return cv2.imencode(kind, pixels)[1].tobytes()


def cut_jpeg(path: Path, marker: Path) -> None:
    path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])


def sixteen_bits(path: Path, marker: Path) -> None:
    path.write_bytes(encoded(".png", picture(1).astype(np.uint16) * 257))


def huge(path: Path, marker: Path) -> None:
    """A PNG that says 60 000 x 60 000 pixels and holds none."""
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")]
    parts = [struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def flipped(path: Path, marker: Path) -> None:
    content = bytearray(encoded(".png", picture(1)))
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


PICTURES: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "cut": (cut_jpeg, "is cut short"),
    "empty": (lambda path, marker: path.write_bytes(b""), "is empty"),
    "html": (lambda path, marker: path.write_text("<html>404</html>"), "is neither JPEG nor PNG"),
    "missing": (lambda path, marker: path.unlink(), "no such file"),
    "16 bits": (sixteen_bits, "has 16 bits a channel"),
    "huge": (huge, "60000 x 60000 pixels"),
    "a flipped bit": (flipped, "is damaged"),
    "a folder": (lambda path, marker: (path.unlink(), path.mkdir()), "no such file"),
    "a pickle": (lambda path, marker: path.write_bytes(pickle.dumps(Payload(marker))), "is neither JPEG nor PNG"),
    "an npz": (lambda path, marker: path.write_bytes(pickled_npz(marker)), "is neither JPEG nor PNG"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_that_cannot_be_used_is_named(
    data: Path, model: Path, marker: Path, name: str, reader: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, problem = PICTURES[name]
    make(data / "frames" / "000007.jpg", marker)
    check_data(reader, model, data, capfd, "drive é/frames/000007.jpg", problem)


# -- rows -------------------------------------------------------------------------------------------------------------


def relabelled(data: Path, row: int, change: Callable[[list[str]], list[str]]) -> None:
    path = data / "labels.csv"
    lines = [line.split(",") for line in path.read_text().splitlines()]
    lines[row] = change(lines[row])
    path.write_text("".join(",".join(line) + "\n" for line in lines))


def yaw(text: str) -> Callable[[Path], None]:
    return lambda data: relabelled(data, 5, lambda cells: [cells[0], text])


def named(name: str) -> Callable[[Path], None]:
    return lambda data: relabelled(data, 5, lambda cells: [name, cells[1]])


def linked_out(data: Path) -> None:
    (data / "frames" / "000004.jpg").rename(data.parent / "outside.jpg")
    (data / "frames" / "000004.jpg").symlink_to(data.parent / "outside.jpg")


def goals(text: str) -> Callable[[Path], None]:
    def change(data: Path) -> None:
        put_drive(data, goals_deg=[0.0] * FRAMES)
        relabelled(data, 5, lambda cells: [*cells[:2], text])

    return change


ROWS: dict[str, tuple[Callable[[Path], object], str]] = {
    "nan": (yaw("nan"), "line 6: yaw is 'nan', not a finite number"),
    "inf": (yaw("-inf"), "not a finite number"),
    "nothing": (yaw(""), "not a finite number"),
    "a word": (yaw("left"), "line 6: yaw is 'left'"),
    "a comma": (yaw('"0,5"'), "line 6: yaw is '0,5'"),
    "beyond 1": (yaw("1.01"), "line 6: yaw is 1.01, outside [-1, 1]"),
    "degrees": (yaw("-25"), "line 6: yaw is -25, outside [-1, 1]"),
    "a cell too many": (yaw("0.5,0.5"), "line 6: has 3 fields"),
    "no image": (named(""), "line 6: names no image"),
    "out of the folder": (named("../outside.jpg"), "line 6: the image '../outside.jpg' lies outside the folder"),
    "absolute": (named("/etc/hostname"), "line 6: the image '/etc/hostname' is an absolute path"),
    "a drive letter": (named("C:/frames/000004.jpg"), "is an absolute path"),
    "a link out of the folder": (linked_out, "line 6: the image 'frames/000004.jpg' lies outside the folder"),
    "an image twice": (named("frames/000001.jpg"), "names the image 000001.jpg, which 2 rows name"),
    "cut short": (
        lambda data: (data / "labels.csv").write_text((data / "labels.csv").read_text()[:-2]),
        "line 21: has no end of line",
    ),
    "a goal that is nan": (goals("nan"), "line 6: goal_deg is 'nan'"),
    "a goal of two turns": (goals("720"), "line 6: goal_deg is 720, outside [-180, 180]"),
    "nothing at all": (lambda data: (data / "labels.csv").write_text(""), "is empty"),
    "no row": (lambda data: (data / "labels.csv").write_text("image,yaw\n"), "holds no frames"),
    "no yaw": (lambda data: (data / "labels.csv").write_text("image,angle\n"), "has no column yaw"),
    "an unknown column": (lambda data: relabelled(data, 0, lambda cells: [*cells, "speed"]), "unknown column 'speed'"),
    "a null": (yaw("0.\0005"), "line 6"),
    "an npz": (lambda data: (data / "labels.csv").write_bytes(flipped_npz(data)), "text"),
}  # fmt: skip


@pytest.mark.parametrize("reader", ["train-steer", "evaluate steer"])
@pytest.mark.parametrize("name", ROWS)
def test_a_row_that_is_wrong_is_named(
    data: Path, model: Path, name: str, reader: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, problem = ROWS[name]
    make(data)
    check_data(reader, model, data, capfd, "drive é/labels.csv", problem)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", ["nan", "beyond 1", "out of the folder"])
def test_every_command_refuses_wrong_rows(
    data: Path, model: Path, name: str, reader: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, problem = ROWS[name]
    make(data)
    check_data(reader, model, data, capfd, "drive é/labels.csv", problem)


def test_labels_of_one_class_are_refused(data: Path, model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """All round to one of the angles: one could be learnt by heart."""
    for row in range(1, FRAMES + 1):
        relabelled(data, row, lambda cells: [cells[0], f"{0.001 * len(cells[0]):.3f}"])
    problem = "all 20 labels of yaw fall into one class, +0.00: nothing to be learnt"
    check_data("train-steer", model, data, capfd, "drive é/labels.csv", problem)


def test_bad_frames_are_left_out_on_request_and_said_so(data: Path, capfd: pytest.CaptureFixture[str]) -> None:
    yaw("nan")(data)
    (data / "frames" / "000009.jpg").write_bytes(b"")
    args = ["train-steer", str(data), *SMALL, "--skip-bad", "-o", str(data.with_name("m.safetensors")), "--json"]
    done = here(args, capfd)
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["skipped"] == 2
    assert "line 6: yaw is 'nan'" in done.stderr
    assert "000009.jpg" in done.stderr
    assert "Error" not in done.stderr


# -- models -----------------------------------------------------------------------------------------------------------


def not_a_number(path: Path, marker: Path) -> None:
    net = SteeringNet(CONFIG)
    with torch.no_grad():
        net.trunk.conv1.weight[0, 0, 0, 0] = float("nan")
    publish_model(path, net, CONFIG, record("train-steer", 1, {}, {}))


def of_later(path: Path, marker: Path) -> None:
    document = {"format": "hrt-steering", "version": 2, "config": json.loads(CONFIG.model_dump_json())}
    publish_tensors(path, dict(SteeringNet(CONFIG).state_dict()), document, record("train-steer", 1, {}, {}))


def one_bit_off(path: Path, marker: Path) -> None:
    content = bytearray(put_model(path).read_bytes())
    content[-1000] ^= 4
    path.write_bytes(content)


def cut_model(path: Path, marker: Path) -> None:
    path.write_bytes(put_model(path).read_bytes()[:-100])


def endless_header(path: Path, marker: Path) -> None:
    path.write_bytes(struct.pack("<Q", 2**62) + b"{}")


MODELS: dict[str, tuple[Callable[[Path, Path], object], str, str]] = {
    "a pickle in a pth": (
        lambda path, marker: path.write_bytes(pickled_state(marker)), "m.pth", "is no safetensors file"),
    "a pickle in a pt": (
        lambda path, marker: path.write_bytes(pickled_state(marker)), "m.pt", "is no safetensors file"),
    "a pickle by another name": (
        lambda path, marker: path.write_bytes(pickled_state(marker)), "m.safetensors", "is no safetensors file"),
    "a bare pickle": (
        lambda path, marker: path.write_bytes(pickle.dumps(Payload(marker))), "m.safetensors", "is no safetensors"),
    "an npz with a pickle": (
        lambda path, marker: path.write_bytes(pickled_npz(marker)), "m.npz", "is no safetensors file"),
    "a pickle in an onnx": (
        lambda path, marker: path.write_bytes(pickled_state(marker)), "m.onnx", "is no "),
    "nan weights": (not_a_number, "m.safetensors", "are not all finite"),
    "a later version": (of_later, "m.safetensors", "is of version 2; this hrt reads versions up to 1 (update hrt)"),
    "a flipped bit": (one_bit_off, "m.safetensors", "its content is not what its provenance recorded"),
    "cut": (cut_model, "m.safetensors", "is no safetensors file, or a damaged one"),
    "an endless header": (endless_header, "m.safetensors", "is no safetensors file, or a damaged one"),
    "empty": (lambda path, marker: path.touch(), "m.safetensors", "is no safetensors file, or a damaged one"),
    "absent": (lambda path, marker: None, "m.safetensors", "no such file"),
    "a folder": (lambda path, marker: path.mkdir(), "m.safetensors", "no such file"),
}  # fmt: skip


def put_roaming(folder: Path) -> tuple[Path, Path]:
    world = put_world(folder / "world", np.zeros((60, 60)), classes=np.zeros((60, 60)))
    return world, put_plan(folder / "plan.json", [map_xy(*place) for place in ((2.0, 2.0), (4.0, 2.0))])


@pytest.mark.parametrize("user", ["steer", "evaluate steer", "export-steer", "train-steer --init", "drive"])
@pytest.mark.parametrize("name", MODELS)
def test_a_model_that_cannot_be_trusted_is_refused(
    data: Path, marker: Path, name: str, user: str, capfd: pytest.CaptureFixture[str]
) -> None:
    make, file, problem = MODELS[name]
    path = data.with_name(file)
    make(path, marker)
    if path.suffix == ".onnx" and user in ("export-steer", "train-steer --init"):
        problem = "is no safetensors file"
    where, option, output = str(path), "-o", "out.json"
    if user == "steer":
        args = ["steer", where, str(data)]
    elif user == "evaluate steer":
        args, option, output = ["evaluate", "steer", where, str(data)], "--figure", "out.png"
    elif user == "export-steer":
        args, output = ["export-steer", where], "out.onnx"
    elif user == "drive":
        world, plan = put_roaming(data.parent)
        args = ["drive", str(plan), "--world", str(world), "--local", "steer", "--model", where]
        output = "out.jsonl"
    else:
        args, output = ["train-steer", str(data), *SMALL, "--init", where], "out.safetensors"
    refused(lambda a: here(a, capfd), args, data.with_name(output), 1, file, problem, option)


@pytest.mark.parametrize("content", [pickled_state, pickled_npz, endless_npz, flipped_npz])
def test_published_weights_that_are_none_are_refused(
    data: Path, marker: Path, content: Callable[[Path], bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    weights = data.with_name("resnet18.pth")
    weights.write_bytes(content(marker))
    args = ["train-steer", str(data), *SMALL, "--weights", str(weights)]
    refused(lambda a: here(a, capfd), args, data.with_name("out.safetensors"), 1, "resnet18.pth")


# -- as a program of its own ------------------------------------------------------------------------------------------


def test_the_program_refuses_a_damaged_recording(data: Path, marker: Path) -> None:
    (data / "frames" / "000002.jpg").write_bytes(pickled_npz(marker))
    output = data.with_name("out.safetensors")
    before = contents(data.parent)
    check_refused(process(["train-steer", str(data), "-o", str(output)]), 1, "000002.jpg", "is neither JPEG nor PNG")
    assert contents(data.parent) == before


@pytest.mark.parametrize("user", ["steer", "evaluate steer"])
def test_the_program_runs_no_pickle(data: Path, marker: Path, user: str) -> None:
    path = data.with_name("m.pth")
    path.write_bytes(pickled_state(marker))
    more = ["-o", str(data.with_name("out.json"))] if user == "steer" else []
    before = contents(data.parent)
    check_refused(process([*user.split(), str(path), str(data), *more]), 1, "m.pth", "is no safetensors file")
    assert contents(data.parent) == before


# -- a training that was stopped --------------------------------------------------------------------------------------


def trained(data: Path, output: Path, capfd: pytest.CaptureFixture[str]) -> Outcome:
    done = here(["train-steer", str(data), *SMALL, "-o", str(output)], capfd)
    assert done.code == 0, done.stderr
    return done


def stopped_in(step: int, monkeypatch: pytest.MonkeyPatch, signum: signal.Signals) -> None:
    plain, steps = torch.optim.AdamW.step, [0]

    def counted(self: torch.optim.AdamW, *args: object, **options: object) -> None:
        steps[0] += 1
        if steps[0] == step:
            signal.raise_signal(signum)
        plain(self, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(torch.optim.AdamW, "step", counted)


@pytest.fixture
def _handlers() -> Iterator[None]:
    """The program sets handlers of its own."""
    before = {signum: signal.getsignal(signum) for signum in (signal.SIGINT, signal.SIGTERM)}
    yield
    for signum, handler in before.items():
        signal.signal(signum, handler)


@pytest.mark.usefixtures("_handlers")
@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGINT])
def test_a_training_that_is_stopped_leaves_a_checkpoint_and_goes_on(
    data: Path, signum: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    output, whole = data.with_name("m.safetensors"), data.with_name("whole.safetensors")
    trained(data, whole, capfd)
    before = contents(data.parent)
    with pytest.MonkeyPatch.context() as patch:
        stopped_in(3, patch, signum)
        stopped = here(["train-steer", str(data), *SMALL, "-o", str(output)], capfd)
    assert stopped.code == 128 + signum
    assert [line for line in stopped.stderr.splitlines() if line.startswith("Error:")] == [
        f"Error: {'terminated' if signum == signal.SIGTERM else 'interrupted'}; no output is half-written"
    ]
    assert "Traceback" not in stopped.stderr
    assert set(contents(data.parent)) - set(before) == {".m.safetensors.hrt-checkpoint"}
    done = trained(data, output, capfd)
    assert "going on after step 3 of 4" in done.stderr
    assert output.read_bytes() == whole.read_bytes()
    assert set(contents(data.parent)) - set(before) == {"m.safetensors"}


@pytest.mark.usefixtures("_handlers")
@pytest.mark.parametrize("damage", ["torn", "one bit", "a pickle", "a model"])
def test_a_damaged_checkpoint_is_never_gone_on_from(
    data: Path, marker: Path, damage: str, capfd: pytest.CaptureFixture[str]
) -> None:
    output, whole = data.with_name("m.safetensors"), data.with_name("whole.safetensors")
    trained(data, whole, capfd)
    with pytest.MonkeyPatch.context() as patch:
        stopped_in(3, patch, signal.SIGTERM)
        here(["train-steer", str(data), *SMALL, "-o", str(output)], capfd)
    checkpoint = data.with_name(".m.safetensors.hrt-checkpoint")
    kept = checkpoint.read_bytes()
    bit = bytes([*kept[:-9], kept[-9] ^ 1, *kept[-8:]])
    other = {"torn": kept[: len(kept) // 2], "one bit": bit, "a pickle": pickled_state(marker), "a model": b""}[damage]
    checkpoint.write_bytes(other or whole.read_bytes())
    done = trained(data, output, capfd)
    (line,) = [line for line in done.stderr.splitlines() if "hrt-checkpoint" in line]
    assert line.startswith("Warning: ")
    assert line.endswith("the training begins anew")
    assert output.read_bytes() == whole.read_bytes()
    assert not checkpoint.exists()
