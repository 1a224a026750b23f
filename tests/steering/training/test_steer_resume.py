"""A training that is stopped, by whatever and whenever, goes on and ends in the bytes of one that was not."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from steer_files import put_recording

from hrt_cli.errors import InputError, OutputError
from hrt_cli.main import Stopped
from hrt_cli.steering.network.model import publish_tensors, read_tensors
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.training import checkpoint
from hrt_cli.steering.training.stage import train_steer_file
from hrt_cli.steering.training.train import SteerSpec, Trainer

pytestmark = pytest.mark.usefixtures("tiny_throughout")
SPEC = SteerSpec(epochs=3, batch=8, gap=0, threads=1)
CONFIG = SteeringConfig(width=32, height=32, half_classes=3)
STEPS, STOP_AT = 9, 4
# By the number of the frames: the first pass of `progress` is over the pictures.


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_recording(tmp_path_factory.mktemp("data") / "a", 30)


@pytest.fixture(scope="module")
def whole(tiny_throughout: None, data: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    output = tmp_path_factory.mktemp("whole") / "m.safetensors"
    assert run(data, output).resumed_at == 0
    assert [path.name for path in output.parent.iterdir()] == [output.name]
    return output.read_bytes()


def run(data: Path, output: Path, spec: SteerSpec = SPEC, **options):
    return train_steer_file([data], output, spec, CONFIG, **options)


def checkpoint_of(output: Path) -> Path:
    return output.with_name(f".{output.name}.hrt-checkpoint")


def stopping(at: int, error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise an error in a training, after step `at`."""
    plain = Trainer.run

    def run(self: Trainer, progress, keep) -> None:
        def kept() -> None:
            keep()
            if self.step == at:
                raise error

        plain(self, progress, kept)

    monkeypatch.setattr(Trainer, "run", run)


def begin_and_stop(data: Path, output: Path, spec: SteerSpec = SPEC, at: int = STOP_AT, **options) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        stopping(at, Stopped(signal.SIGTERM), patch)
        with pytest.raises(Stopped):
            run(data, output, spec, **options)
    assert not output.exists()
    return checkpoint_of(output)


@pytest.mark.parametrize("at", range(1, STEPS + 1))
def test_it_goes_on_after_any_step(data: Path, tmp_path: Path, whole: bytes, at: int) -> None:
    output, notes = tmp_path / "m.safetensors", list[str]()
    path = begin_and_stop(data, output, at=at, note=notes.append)
    assert notes[-1] == (f"Note: stopped; the same command goes on after step {at} of {STEPS} (epoch {at // 3 + 1})")
    assert path.exists()
    notes.clear()
    assert run(data, output, note=notes.append).resumed_at == at
    assert notes == [f"Note: going on after step {at} of {STEPS} ({path})"]
    assert output.read_bytes() == whole
    assert not path.exists()


def test_it_may_be_stopped_time_and_again(data: Path, tmp_path: Path, whole: bytes) -> None:
    output = tmp_path / "m.safetensors"
    for at in (1, 2, 5, 6, 9):
        begin_and_stop(data, output, at=at)
    assert run(data, output).resumed_at == 9
    assert output.read_bytes() == whole


def test_a_signal_in_the_middle_of_a_step_waits_for_its_end(
    data: Path, tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "m.safetensors"

    def stop(number: int, frame: object) -> None:
        raise Stopped(number)

    before = signal.signal(signal.SIGTERM, stop)
    plain, signalled = torch.optim.AdamW.step, []

    def step(self, *args, **options) -> None:
        if len(signalled) == 0:
            signalled.append(True)
            signal.raise_signal(signal.SIGTERM)
        plain(self, *args, **options)

    monkeypatch.setattr(torch.optim.AdamW, "step", step)
    try:
        with pytest.raises(Stopped):
            run(data, output)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert run(data, output).resumed_at == 1
    assert output.read_bytes() == whole


def test_a_signal_while_pytorch_is_loading_waits(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(number: int, frame: object) -> None:
        raise Stopped(number)

    before = signal.signal(signal.SIGTERM, stop)
    plain, loaded = Trainer.__init__, []

    def init(self: Trainer, *args: object) -> None:
        signal.raise_signal(signal.SIGTERM)
        plain(self, *args)
        loaded.append(self)

    monkeypatch.setattr(Trainer, "__init__", init)
    try:
        with pytest.raises(Stopped):
            run(data, tmp_path / "m.safetensors")
    finally:
        signal.signal(signal.SIGTERM, before)
    assert loaded
    assert not torch.are_deterministic_algorithms_enabled()
    assert not list(tmp_path.iterdir())


def test_after_an_error_within_a_step_the_last_whole_one_is_kept(
    data: Path, tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    output, notes = tmp_path / "m.safetensors", []
    plain = Trainer._step

    def step(self: Trainer, batch: object) -> None:
        plain(self, batch)
        if self.step == 5:
            raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "_step", step)
        patch.setattr(checkpoint, "EVERY_S", 0.0)
        patch.setattr(checkpoint, "_SHARE", 1e9)
        with pytest.raises(MemoryError):
            run(data, output, note=notes.append)
    assert not notes
    assert run(data, output).resumed_at == 4
    assert output.read_bytes() == whole


def test_a_full_disk_in_the_end_costs_nothing_but_the_end(
    data: Path, tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hrt_cli.steering.training import stage as training

    output = tmp_path / "m.safetensors"

    def full(*args: object) -> None:
        raise OutputError("No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(training, "publish_model", full)
        with pytest.raises(OutputError):
            run(data, output)
    assert run(data, output).resumed_at == STEPS
    assert output.read_bytes() == whole


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip_a_bit(path: Path) -> None:
    damaged = bytearray(path.read_bytes())
    damaged[-5] ^= 16
    path.write_bytes(damaged)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def lose_tensors(path: Path) -> None:
    tensors, document, provenance = read_tensors(path)
    assert provenance is not None
    del tensors["net/trunk.conv1.weight"]
    publish_tensors(path, tensors, document, provenance)


def spoil(path: Path) -> None:
    tensors, document, provenance = read_tensors(path)
    assert provenance is not None
    tensors["exp_avg/trunk.conv1.weight"] *= float("nan")
    publish_tensors(path, tensors, document, provenance)


def rename_the_format(path: Path) -> None:
    tensors, document, provenance = read_tensors(path)
    assert provenance is not None
    publish_tensors(path, tensors, document | {"format": "other"}, provenance)


def forget_the_history(path: Path) -> None:
    tensors, document, provenance = read_tensors(path)
    assert provenance is not None
    publish_tensors(path, tensors, document | {"history": []}, provenance)


@pytest.mark.parametrize(
    "damage", [cut_short, flip_a_bit, empty, lose_tensors, spoil, rename_the_format, forget_the_history]
)
def test_a_damaged_checkpoint_is_told_of_and_not_used(data: Path, tmp_path: Path, whole: bytes, damage) -> None:
    output, notes = tmp_path / "m.safetensors", []
    path = begin_and_stop(data, output)
    damage(path)
    assert run(data, output, note=notes.append).resumed_at == 0
    (line,) = notes
    assert line.startswith(f"Warning: {path}: ")
    assert line.endswith("; the training begins anew")
    assert output.read_bytes() == whole
    assert not path.exists()


def test_a_checkpoint_of_another_training_is_not_used(data: Path, tmp_path: Path, whole: bytes) -> None:
    output, notes = tmp_path / "m.safetensors", []
    path = begin_and_stop(data, output, replace(SPEC, seed=7))
    assert run(data, output, note=notes.append).resumed_at == 0
    assert notes == [f"Note: {path}: is of a training with other settings and will be replaced"]
    assert output.read_bytes() == whole


def test_a_checkpoint_that_cannot_be_written_stops_nothing(
    data: Path, tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    output, notes = tmp_path / "m.safetensors", []
    checkpoint_of(output).mkdir()
    monkeypatch.setattr(checkpoint, "EVERY_S", 0.0)
    run(data, output, note=notes.append)
    assert len(notes) == 2
    assert "the training begins anew" in notes[0]
    assert "cannot be written" in notes[1]
    assert output.read_bytes() == whole


def test_checkpoints_are_written_now_and_then_and_seldom_where_that_is_slow(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = [0.0]
    monkeypatch.setattr(checkpoint, "monotonic", lambda: times[0])
    written: list[int] = []
    plain, lasts = checkpoint.Checkpoint.write, [0.0]

    def write(self, trainer: Trainer) -> bool:
        written.append(trainer.step)
        times[0] += lasts[0]
        return plain(self, trainer)

    def tick(self: Trainer, batch: object, plain=Trainer._step) -> None:
        plain(self, batch)
        times[0] += 11.0

    monkeypatch.setattr(checkpoint.Checkpoint, "write", write)
    monkeypatch.setattr(Trainer, "_step", tick)
    run(data, tmp_path / "m.safetensors")
    assert written == [3, 6, 9]
    written.clear()
    lasts[0] = 3.0
    run(data, tmp_path / "n.safetensors")
    assert written == [3, 9]


def test_what_ended_but_was_not_tidied_up_is_tidied_up(data: Path, tmp_path: Path) -> None:
    output = tmp_path / "m.safetensors"
    path = begin_and_stop(data, output)
    kept = path.read_bytes()
    run(data, output)
    path.write_bytes(kept)
    assert run(data, output).up_to_date
    assert not path.exists()
    # That of another training is somebody's unfinished work.
    other = tmp_path / "other.safetensors"
    begin_and_stop(data, other, replace(SPEC, epochs=4)).rename(path)
    assert run(data, output).up_to_date
    assert path.exists()
    with pytest.raises(InputError, match="no such file"):
        read_tensors(other)


KILLS = """
import os, random, signal, sys, time
from pathlib import Path
import torch
torch.set_num_threads(1)
# What PyTorch loads when it is first asked for, so that each child need not.
torch.optim.AdamW([torch.zeros(1, requires_grad=True)]).step()
torch.use_deterministic_algorithms(True)
torch.use_deterministic_algorithms(False)
from tiny_trunk import TinyTrunk
from hrt_cli import main
from hrt_cli.steering.training import checkpoint
from hrt_cli.steering.network import net as network
from hrt_cli.steering.training import stage as training
network.ResNet18 = TinyTrunk
checkpoint.EVERY_S, checkpoint._SHARE = 0.02, 0.5
data, folder, kills = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])

def begin(output):
    child = os.fork()
    if child == 0:
        os.dup2(os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
        os.dup2(2, 1)
        options = "--size 32x32 --half-classes 3 --epochs 16 --batch 8 --gap 0 --threads 1 --patience 0 -o"
        main.main(["train-steer", data, *options.split(), str(output)])
    return child

def end(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

assert end(begin(folder / "whole")) == 0
began = time.monotonic()
assert end(begin(folder / "again")) == 0
seconds = time.monotonic() - began
assert (folder / "again").read_bytes() == (folder / "whole").read_bytes()
rng, codes, sums = random.Random(0), [], set()
while len(codes) < kills:
    output = folder / "killed"
    child = begin(output)
    # Often enough in the second half of a training that is resumed.
    time.sleep(rng.uniform(0, 0.5 * seconds))
    how = signal.SIGKILL if rng.random() < 0.5 else rng.choice([signal.SIGTERM, signal.SIGINT])
    os.kill(child, how)
    codes.append(end(child))
    # Killed before its first line Python has no handler yet, and the system's own word for it is the negative.
    assert codes[-1] in (0, -how, 128 + how), (how, codes[-1], (folder / "log").read_text())
    if output.exists():
        assert output.read_bytes() == (folder / "whole").read_bytes()
        output.unlink()
assert end(begin(folder / "killed")) == 0
assert (folder / "killed").read_bytes() == (folder / "whole").read_bytes()
names = sorted(path.name for path in folder.iterdir())
assert names == ["again", "killed", "log", "whole"], names
print(sum(code != 0 for code in codes), (folder / "log").read_text().count("going on after"))
"""


@pytest.mark.slow
def test_killed_at_random_moments_it_ends_in_the_same_bytes(data: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLS, str(data), str(tmp_path), "20"]
    path = str(Path(__file__).parents[2])
    folders = os.pathsep.join([path, *filter(None, [os.environ.get("PYTHONPATH")])])
    # CUDA bears no fork.
    env = {**os.environ, "PYTHONPATH": folders, "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, done.stderr
    killed, resumed = map(int, done.stdout.split())
    assert killed >= 15
    assert resumed >= 8
