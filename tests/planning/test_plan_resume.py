"""A training that is stopped goes on where it was, and ends as if it had never been stopped."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hrt_cli import main as shell
from hrt_cli.artifacts.carriers import read_stamped_npz
from hrt_cli.artifacts.npz import read_npz, write_npz
from hrt_cli.errors import InputError, OutputError
from hrt_cli.main import Stopped
from hrt_cli.planning import checkpoint
from hrt_cli.planning.families import make_map
from hrt_cli.planning.train import TrainSpec, TrainState, _map_seeds, start_cells, train
from hrt_cli.planning.training import train_file

SPEC = TrainSpec(iterations=9, maps_per_iteration=3, rollouts=4, map_side=14, moves=25, seed=5)
STOP_AT = 4


def stopping(at: int, error: BaseException):
    def progress(done: int, total: int) -> None:
        if done == at:
            raise error

    return progress


def begin_and_stop(output: Path, spec: TrainSpec = SPEC, at: int = STOP_AT, **options) -> Path:
    """Leave behind what a training that gets a signal leaves; return the checkpoint."""
    with pytest.raises(Stopped):
        train_file((), output, spec, progress=stopping(at, Stopped(signal.SIGTERM)), **options)
    assert not output.exists()
    return checkpoint_of(output)


def checkpoint_of(output: Path) -> Path:
    return output.with_name(f".{output.name}.hrt-checkpoint")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of an uninterrupted training."""
    path = tmp_path_factory.mktemp("whole") / "policy.npz"
    done = train_file((), path, SPEC)
    assert done.resumed_at == 0
    assert [each.name for each in path.parent.iterdir()] == ["policy.npz"]
    return path.read_bytes()


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("estimator", ["gpomdp", "reinforce"])
def test_a_training_goes_on_from_any_state_of_it(estimator: str, given: bool) -> None:
    spec = TrainSpec(
        estimator=estimator, layout="manjanna24", iterations=6, maps_per_iteration=3, rollouts=4, map_side=12, moves=20
    )
    maps = [make_map("gaussians", (12, 9 + i), np.random.default_rng(i)) for i in range(3)] if given else None
    arrays: list[dict[str, np.ndarray]] = []
    policy, curve = train(spec, maps, keep=lambda state: arrays.append({**state.to_arrays()}))
    assert [each["curve"].size for each in arrays] == list(range(1, 7))
    for kept in arrays:
        done: list[int] = []
        again, curve_again = train(
            spec, maps, lambda i, n, done=done: done.append(i), state=TrainState.from_arrays(spec, kept)
        )
        assert done == list(range(kept["curve"].size + 1, 7))
        np.testing.assert_array_equal(again.weights, policy.weights)
        np.testing.assert_array_equal(curve_again, curve)


def test_the_maps_of_a_step_are_drawn_from_one_stream() -> None:
    spec = TrainSpec(seed=11, maps_per_iteration=7)
    stream = np.random.default_rng(11)
    for step in range(5):
        assert _map_seeds(spec, step) == stream.integers(0, 2**62, 7).tolist()


@pytest.mark.parametrize("error", [Stopped(signal.SIGINT), RuntimeError("power"), OutputError("full")])
def test_a_stopped_training_goes_on_and_writes_the_same_bytes(
    tmp_path: Path, whole: bytes, error: BaseException
) -> None:
    output = tmp_path / "policy.npz"
    notes: list[str] = []
    with pytest.raises(type(error)):
        train_file((), output, SPEC, progress=stopping(STOP_AT, error), note=notes.append)
    assert [each.name for each in tmp_path.iterdir()] == [".policy.npz.hrt-checkpoint"]
    assert notes == [f"Note: stopped after iteration {STOP_AT} of 9; the same command goes on from there"]
    # Once more, before it ends, and before anything new is done.
    with pytest.raises(type(error)):
        train_file((), output, SPEC, progress=stopping(STOP_AT + 2, error))
    seen: list[int] = []
    done = train_file((), output, SPEC, progress=lambda i, n: seen.append(i), note=notes.append)
    assert seen == [7, 8, 9]
    assert done.resumed_at == STOP_AT + 2
    assert done.steps_per_second is not None
    assert output.read_bytes() == whole
    assert [each.name for each in tmp_path.iterdir()] == ["policy.npz"]
    assert notes[-1] == f"Note: going on after iteration 6 of 9 ({checkpoint_of(output)})"


def test_a_result_that_cannot_be_written_is_not_lost(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "policy.npz"

    def full(*args: object) -> None:
        raise OutputError("No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("hrt_cli.planning.training.publish_npz", full)
        with pytest.raises(OutputError):
            train_file((), output, SPEC)
    seen: list[int] = []
    done = train_file((), output, SPEC, progress=lambda i, n: seen.append(i))
    assert (done.resumed_at, seen, done.steps_per_second) == (9, [], None)
    assert output.read_bytes() == whole


@pytest.mark.parametrize("change", [{"seed": 6}, {"iterations": 10}, {"learning_rate": 0.1}, {"layout": "manjanna24"}])
def test_a_checkpoint_of_other_settings_is_replaced(tmp_path: Path, whole: bytes, change: dict[str, object]) -> None:
    output = tmp_path / "policy.npz"
    other = TrainSpec(
        **({"iterations": 9, "maps_per_iteration": 3, "rollouts": 4, "map_side": 14, "moves": 25} | change)
    )
    path = begin_and_stop(output, other)
    before = read_stamped_npz(path)[1]
    notes: list[str] = []
    assert begin_and_stop(output, note=notes.append) == path
    assert notes[0] == f"Note: {path}: is of a training with other settings and will be replaced"
    after = read_stamped_npz(path)[1]
    assert before is not None
    assert after is not None
    assert before.fingerprint != after.fingerprint
    assert train_file((), output, SPEC).resumed_at == STOP_AT
    assert output.read_bytes() == whole
    assert not path.exists()


def test_a_checkpoint_of_other_maps_or_another_version_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output, scoremap = tmp_path / "policy.npz", tmp_path / "s.npz"
    for seed in range(2):
        write_npz(scoremap, {"score": make_map("noise", (12, 12), np.random.default_rng(seed))})
        notes: list[str] = []
        with pytest.raises(Stopped):
            train_file((scoremap,), output, SPEC, progress=stopping(3, Stopped(2)), note=notes.append)
        assert sum("other settings" in note for note in notes) == seed
    monkeypatch.setattr("hrt_cli.artifacts.provenance.__version__", "99")
    assert train_file((scoremap,), output, SPEC).resumed_at == 0


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])


def flip_a_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 4
    path.write_bytes(content)


def edit(path: Path) -> None:
    arrays = read_npz(path)
    write_npz(path, {**arrays, "weights": arrays["weights"] + 1e-3})


def empty(path: Path) -> None:
    path.write_bytes(b"")


def unsign(path: Path) -> None:
    arrays = read_npz(path)
    del arrays["provenance"]
    write_npz(path, arrays)


def lengthen(path: Path) -> None:
    arrays, provenance = read_stamped_npz(path)
    checkpoint.publish_npz(path, {**arrays, "curve": np.zeros(10)}, provenance)


def rename_an_array(path: Path) -> None:
    arrays, provenance = read_stamped_npz(path)
    checkpoint.publish_npz(path, {**arrays, "more": np.zeros(1)}, provenance)


def spoil(path: Path) -> None:
    arrays, provenance = read_stamped_npz(path)
    checkpoint.publish_npz(path, {**arrays, "mean": arrays["mean"] * np.nan}, provenance)


@pytest.mark.parametrize("damage", [cut_short, flip_a_bit, edit, empty, unsign, lengthen, rename_an_array, spoil])
def test_a_damaged_checkpoint_is_told_of_and_not_used(tmp_path: Path, whole: bytes, damage) -> None:
    output = tmp_path / "policy.npz"
    path = begin_and_stop(output)
    damage(path)
    notes: list[str] = []
    assert train_file((), output, SPEC, note=notes.append).resumed_at == 0
    (line,) = notes
    assert line.startswith(f"Warning: {path}: ")
    assert line.endswith("; the training begins anew")
    assert output.read_bytes() == whole
    assert not path.exists()


def test_a_checkpoint_that_cannot_be_written_stops_nothing(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "policy.npz"
    checkpoint_of(output).mkdir()
    monkeypatch.setattr(checkpoint, "EVERY_S", 0.0)
    notes: list[str] = []
    train_file((), output, SPEC, note=notes.append)
    assert len(notes) == 2
    assert "the training begins anew" in notes[0]
    assert "cannot be written" in notes[1]
    assert output.read_bytes() == whole


def test_checkpoints_are_written_now_and_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = tmp_path / "policy.npz"
    clock = iter(np.arange(0.0, 1000.0, 1.0))
    monkeypatch.setattr(checkpoint, "monotonic", lambda: float(next(clock)))
    ages: list[bool] = []
    train_file((), output, SPEC, progress=lambda i, n: ages.append(checkpoint_of(output).exists()))
    assert not any(ages[:3])
    assert all(ages[5:])


def test_what_ended_but_was_not_tidied_up_is_tidied_up(tmp_path: Path) -> None:
    output = tmp_path / "policy.npz"
    path = begin_and_stop(output)
    kept = path.read_bytes()
    train_file((), output, SPEC)
    path.write_bytes(kept)
    done = train_file((), output, SPEC)
    assert (done.up_to_date, done.resumed_at) == (True, 0)
    assert not path.exists()
    # That of another training is somebody's unfinished work.
    with pytest.raises(OutputError):
        train_file((), output, TrainSpec(seed=9))
    other = tmp_path / "other.npz"
    begin_and_stop(other, TrainSpec(iterations=5, maps_per_iteration=1, rollouts=2, map_side=12, moves=9)).rename(path)
    assert train_file((), output, SPEC).up_to_date
    assert path.exists()


KILLED = """
import sys
from pathlib import Path
from hrt_cli.planning import checkpoint
from hrt_cli.planning.train import TrainSpec
from hrt_cli.planning.training import train_file
checkpoint.EVERY_S = 0.0
def slowly(done, total):
    if done == 4:
        print("there", flush=True)
        sys.stdin.read()
train_file((), Path(sys.argv[1]), TrainSpec(**eval(sys.argv[2])), progress=slowly)
"""


def test_a_killed_process_leaves_what_the_next_one_needs(tmp_path: Path, whole: bytes) -> None:
    output = tmp_path / "policy.npz"
    spec = {"iterations": 9, "maps_per_iteration": 3, "rollouts": 4, "map_side": 14, "moves": 25, "seed": 5}
    assert TrainSpec(**spec) == SPEC
    command = [sys.executable, "-c", KILLED, str(output), repr(spec)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "there\n"
        child.kill()
    assert child.returncode == -signal.SIGKILL
    assert not output.exists()
    # As if it had been killed while it wrote.
    left = tmp_path / f".{checkpoint_of(output).name}.hrt-0123abcd"
    left.mkdir()
    assert train_file((), output, SPEC).resumed_at == STOP_AT
    assert output.read_bytes() == whole
    assert [each.name for each in tmp_path.iterdir()] == ["policy.npz"]


EAGER = "from hrt_cli import main; from hrt_cli.planning import checkpoint; checkpoint.EVERY_S = 0.0; main.main()"


def test_the_program_goes_on_after_a_signal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, fresh = tmp_path / "policy.npz", tmp_path / "fresh.npz"
    options = "--iterations=60 --maps-per-iteration=1 --rollouts=2 --map-side=20 --budget=50 --json -o"
    arguments = ["train-plan", *options.split()]
    eager = [sys.executable, "-c", EAGER, *arguments, output]
    with subprocess.Popen(eager, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        deadline = time.monotonic() + 60
        while not checkpoint_of(output).exists():
            assert child.poll() is None, "finished before the signal"
            assert time.monotonic() < deadline
            time.sleep(0.002)
        child.send_signal(signal.SIGTERM)
        out, err = child.communicate(timeout=60)
    assert child.returncode == 143, err
    assert out == ""
    *_, note, line = err.splitlines()
    assert line == "Error: terminated; no output is half-written"
    assert "the same command goes on from there" in note
    assert [each.name for each in tmp_path.iterdir()] == [checkpoint_of(output).name]
    assert shell._run([*arguments, str(output)]) == 0
    resumed = capsys.readouterr()
    assert 0 < json.loads(resumed.out)["resumed_at"] < 60
    assert resumed.err.startswith("Note: going on after iteration ")
    assert shell._run([*arguments, str(fresh)]) == 0
    whole = capsys.readouterr()
    assert json.loads(whole.out)["resumed_at"] == 0
    assert whole.err == ""
    assert fresh.read_bytes() == output.read_bytes()


def test_which_cells_a_robot_can_start_from() -> None:
    gap = np.nan
    score = np.array([[1, gap, 1], [gap, 1, gap], [gap, gap, gap], [0, 0, gap]])
    np.testing.assert_array_equal(np.argwhere(start_cells(score, 4)), [[3, 0], [3, 1]])
    np.testing.assert_array_equal(np.argwhere(start_cells(score, 8)), [[0, 0], [0, 2], [1, 1], [3, 0], [3, 1]])


def test_a_scoremap_without_a_start_is_named_before_anything_is_done(tmp_path: Path) -> None:
    good, walled = tmp_path / "good.npz", tmp_path / "walled.npz"
    write_npz(good, {"score": np.ones((3, 4))})
    write_npz(walled, {"score": np.where(np.indices((5, 5)).sum(axis=0) % 2, np.nan, 1.0)})
    with pytest.raises(InputError, match=r"walled\.npz: has no cell a robot could start from"):
        train_file((good, walled), tmp_path / "p.npz", SPEC)
    diagonal = TrainSpec(iterations=2, maps_per_iteration=2, rollouts=2, moves=5, eight=1.0)
    assert np.isfinite(train_file((good, walled), tmp_path / "p.npz", diagonal).learning_curve).all()


def test_the_one_open_corner_of_a_large_map_is_found(tmp_path: Path) -> None:
    score = np.where(np.indices((60, 60)).sum(axis=0) % 2, np.nan, 1.0)
    score[0, 1] = 1.0
    _, curve = train(TrainSpec(iterations=3, maps_per_iteration=2, rollouts=2, moves=5, eight=0.0), [score])
    assert np.isfinite(curve).all()


def test_all_of_a_map_smaller_than_the_budget_is_all_there_is() -> None:
    spec = TrainSpec(iterations=2, maps_per_iteration=4, rollouts=4, moves=300)
    _, curve = train(spec, [np.ones((2, 2), np.float32), np.ones((1, 3))])
    # All but the start, which no move earns: three quarters on one map and two thirds on the other.
    assert np.all((curve > 0.66) & (curve <= 0.75))
