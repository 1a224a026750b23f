from __future__ import annotations

import errno
import fcntl
import os
import random
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import hrt_cli
from hrt_cli.artifacts.publish import check_target, publishing, publishing_folder, sweep
from hrt_cli.errors import OutputError

ROOT = Path(hrt_cli.__file__).parents[1]
KILLS = 30

WRITER = """
import sys
from pathlib import Path
from hrt_cli.artifacts.publish import publishing

target, letter, times = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
content = letter.encode() * 300_000

def check(draft):
    assert draft.read_bytes() == content

print("ready", flush=True)
for _ in range(times):
    with publishing(target, check) as draft:
        draft.with_suffix(".qml").write_text(letter)
        draft.write_bytes(content)
"""

DISK = """
import subprocess, sys
from pathlib import Path
import numpy as np
from hrt_cli.artifacts.carriers import publish_json, publish_npz
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import OutputError

folder = Path(sys.argv[1])
provenance = record("test", 1, {}, {})
noise = np.random.default_rng(0).integers(0, 255, 60_000, np.uint8)
outputs = {
    "a.npz": lambda path: publish_npz(path, {"noise": noise}, provenance),
    "a.json": lambda path: publish_json(path, {"noise": noise.tolist()}, provenance),
}
full = whole = 0
for name, publish in outputs.items():
    for kib in range(16, 513, 31):
        subprocess.run(["mount", "-o", f"remount,size={kib}k", "tmpfs", str(folder)], check=True)
        target = folder / name
        target.write_bytes(b"old" * 100)
        try:
            publish(target)
            whole += 1
        except OutputError as error:
            assert "No space left" in str(error) and str(target) in str(error), error
            assert target.read_bytes() == b"old" * 100
            full += 1
        assert [p.name for p in folder.iterdir()] == [name], list(folder.iterdir())
        target.unlink()
print("full", full, "whole", whole)
"""


def accept(draft: Path) -> None:
    assert draft.is_file()


def publish(target: Path, content: bytes) -> None:
    with publishing(target, accept) as draft:
        draft.write_bytes(content)


def leftovers(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir() if ".hrt-" in p.name)


def start_writer(target: Path, letter: str, times: int) -> subprocess.Popen[bytes]:
    # Without the site packages, which publishing does not need: a process starts in a fraction of the time.
    return subprocess.Popen(
        [sys.executable, "-S", "-c", WRITER, str(target), letter, str(times)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]},
    )


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def test_publishes_the_file_and_its_companions(tmp_path: Path) -> None:
    target = tmp_path / "out.tif"
    with publishing(target, accept) as draft:
        assert draft.name == target.name
        assert draft.parent.parent == tmp_path
        draft.write_bytes(b"pixels")
        draft.with_suffix(".qml").write_text("style")
        assert not target.exists()
    assert target.read_bytes() == b"pixels"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.qml", "out.tif"]


def test_deletes_the_side_cars_of_the_old_file_only(tmp_path: Path) -> None:
    stale = ["out.tif.msk", "out.tif.aux.xml", "out.tif.ovr", "out.tif.ovr.msk", "out.tif.msk.ovr"]
    others = ["out2.tif.msk", "out.tif.txt", "out.tfw"]
    for name in stale + others:
        (tmp_path / name).touch()
    publish(tmp_path / "out.tif", b"x")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*others, "out.tif"])


class Stopped(BaseException):
    pass


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, Stopped])
def test_an_error_in_the_work_leaves_the_old_bytes(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "out.json"
    target.write_bytes(b"old")
    before = target.stat().st_mtime_ns

    def work() -> None:
        with publishing(target, accept) as draft:
            draft.write_bytes(b"half of the n")
            raise error

    with pytest.raises(error):
        work()
    assert target.read_bytes() == b"old"
    assert target.stat().st_mtime_ns == before
    assert leftovers(tmp_path) == []


def test_a_failed_check_leaves_the_old_bytes_and_side_cars(tmp_path: Path) -> None:
    target, sidecar = tmp_path / "out.tif", tmp_path / "out.tif.msk"
    target.write_bytes(b"old")
    sidecar.touch()

    def check(draft: Path) -> None:
        raise OutputError("did not read back")

    with pytest.raises(OutputError, match="did not read back"), publishing(target, check) as draft:
        draft.write_bytes(b"new")
    assert target.read_bytes() == b"old"
    assert sidecar.exists()
    assert leftovers(tmp_path) == []


def test_a_body_that_writes_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"out\.json: cannot be written"), publishing(tmp_path / "out.json", os.stat):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file"), publishing(tmp_path / "no" / "out.json", accept):
        raise AssertionError("not reached")


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_the_mode_follows_the_umask(tmp_path: Path, mask: int, mode: int) -> None:
    with umask(mask):
        publish(tmp_path / "out.json", b"x")
    assert (tmp_path / "out.json").stat().st_mode & 0o777 == mode


@pytest.mark.parametrize("dangling", [False, True])
def test_a_link_is_replaced_and_what_it_points_to_left_alone(tmp_path: Path, dangling: bool) -> None:
    store = tmp_path / "store"
    store.mkdir()
    if not dangling:
        (store / "old.tif").write_bytes(b"old")
    link = tmp_path / "out.tif"
    link.symlink_to(store / "old.tif")
    publish(link, b"new")
    assert not link.is_symlink()
    assert link.read_bytes() == b"new"
    assert [p.read_bytes() for p in store.iterdir()] == ([] if dangling else [b"old"])


def test_a_hard_linked_target_does_not_change_its_twin(tmp_path: Path) -> None:
    (tmp_path / "twin").write_bytes(b"old")
    os.link(tmp_path / "twin", tmp_path / "out")
    publish(tmp_path / "out", b"new")
    assert (tmp_path / "twin").read_bytes() == b"old"


def test_a_name_of_glob_characters_is_swept_as_itself(tmp_path: Path) -> None:
    target = tmp_path / "a[1]*? é & b.json"
    dead, other = tmp_path / f".{target.name}.hrt-abcd1234", tmp_path / ".a1xx é & b.json.hrt-abcd1234"
    dead.mkdir()
    other.mkdir()
    publish(target, b"x")
    assert not dead.exists()
    assert other.exists()


@pytest.mark.parametrize("locked_before", [True, False])
def test_dead_work_folders_are_swept(tmp_path: Path, locked_before: bool) -> None:
    dead = tmp_path / ".out.tif.hrt-k1ll_ed8"
    dead.mkdir()
    (dead / "out.tif").write_bytes(b"half")
    if locked_before:
        (dead / ".lock").touch()
    publish(tmp_path / "out.tif", b"x")
    assert leftovers(tmp_path) == []


def test_what_only_looks_like_a_work_folder_is_left_alone(tmp_path: Path) -> None:
    mine, file = tmp_path / ".out.tif.hrt-notes", tmp_path / ".out.tif.hrt-12345678"
    mine.mkdir()
    file.touch()
    (tmp_path / ".other.tif.hrt-12345678").mkdir()
    sweep(tmp_path / "out.tif")
    assert leftovers(tmp_path) == [".other.tif.hrt-12345678", ".out.tif.hrt-12345678", ".out.tif.hrt-notes"]


def test_work_folders_in_use_are_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "out.tif"
    with publishing(target, accept) as first:
        first.write_bytes(b"first")
        publish(target, b"second")
        assert target.read_bytes() == b"second"
        assert first.read_bytes() == b"first"
    assert target.read_bytes() == b"first"
    assert leftovers(tmp_path) == []


def test_no_work_folder_is_swept_before_it_is_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "out.json"
    real_flock, rivals = fcntl.flock, []

    def slow_flock(file: object, operation: int) -> None:
        if getattr(file, "name", "") and operation == fcntl.LOCK_EX and not rivals:
            rivals.append(threading.Thread(target=publish, args=(target, b"rival")))
            rivals[0].start()
            rivals[0].join(0.3)
        real_flock(file, operation)  # type: ignore[arg-type]

    monkeypatch.setattr(fcntl, "flock", slow_flock)
    publish(target, b"mine")
    rivals[0].join()
    assert target.read_bytes() in (b"mine", b"rival")
    assert leftovers(tmp_path) == []


def test_a_file_system_without_locks_is_written_and_never_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    (tmp_path / ".out.hrt-12345678").mkdir()
    publish(tmp_path / "out", b"x")
    assert leftovers(tmp_path) == [".out.hrt-12345678"]


def test_killed_at_any_moment_the_target_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "out.tif"
    rng = random.Random(0)
    allowed: list[bytes | None] = [None]
    interrupted = 0
    for turn in range(KILLS):
        letter = "abc"[turn % 3]
        with start_writer(target, letter, 10_000) as child:
            assert child.stdout is not None
            assert child.stdout.readline() == b"ready\n"
            threading.Event().wait(rng.uniform(0, 0.02))
            child.kill()
        interrupted += bool(leftovers(tmp_path))
        allowed.append(letter.encode() * 300_000)
        found = target.read_bytes() if target.exists() else None
        assert found in allowed
        allowed = [found]
        if turn % 5 == 4:
            publish(target, b"next")
            allowed = [b"next"]
            assert leftovers(tmp_path) == []
    assert interrupted, "no kill fell into the work: the test proves nothing"


def test_two_writers_both_succeed_and_one_whole_result_stands(tmp_path: Path) -> None:
    target = tmp_path / "out.tif"
    children = [start_writer(target, letter, 60) for letter in "ab"]
    errors = [child.communicate()[1] for child in children]
    assert [child.returncode for child in children] == [0, 0], errors
    assert target.read_bytes() in (b"a" * 300_000, b"b" * 300_000)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.qml", "out.tif"]


def test_a_full_disk_leaves_the_old_file_at_every_size(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if shutil.which("unshare") is None:
        pytest.skip("there is no unshare to mount a small disk with")
    mount = f"mount -t tmpfs -o size=64k tmpfs '{disk}'"
    if subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True).returncode != 0:
        pytest.skip("this machine does not allow mounting a small disk")
    command = f"{mount} && exec '{sys.executable}' -c \"$0\" '{disk}'"
    done = subprocess.run(["unshare", "-rm", "sh", "-c", command, DISK], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    _, full, _, whole = done.stdout.split()
    assert int(full) >= 8
    assert int(whole) >= 4


@pytest.mark.parametrize("how", ["same", "dotted", "hard link", "symbolic link", "linked folder"])
def test_an_output_that_is_an_input_is_refused(tmp_path: Path, how: str) -> None:
    source = tmp_path / "in.tif"
    source.write_bytes(b"input")
    (tmp_path / "sub").mkdir()
    (tmp_path / "linked").symlink_to(tmp_path)
    target = {
        "same": source,
        "dotted": Path(f"{tmp_path}/sub/../in.tif"),
        "linked folder": tmp_path / "linked" / "in.tif",
    }.get(how, tmp_path / "out.tif")
    if how == "hard link":
        os.link(source, target)
    elif how == "symbolic link":
        target.symlink_to(source)
    with pytest.raises(OutputError, match="the output is also an input"):
        check_target(target, [tmp_path / "absent.json", source])
    assert source.read_bytes() == b"input"


def test_targets_that_cannot_be_published_are_refused_before_the_work(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    refusals = {
        tmp_path / "folder": "is a folder",
        tmp_path / "no" / "out.tif": "does not exist; make it first",
        tmp_path / "pipe": "is a device or a pipe",
        Path("/dev/null"): "is a device or a pipe",
        Path("/dev/stdout"): "is a device or a pipe",
        tmp_path / ("é" * 122): "the name is too long",
    }
    for target, message in refusals.items():
        with pytest.raises(OutputError, match=message) as refusal:
            check_target(target, [])
        assert str(refusal.value).startswith(f"{target}: ")
    check_target(tmp_path / ("a" * 240), [])
    publish(tmp_path / ("a" * 240), b"the longest name")


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Permission bits do not bind root, so the system is asked to say no.
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK)
    with pytest.raises(OutputError, match="cannot be written"):
        check_target(tmp_path / "out.tif", [])


def test_a_signal_just_after_the_folder_was_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = Path.mkdir

    def mkdir(path: Path, *args: int) -> None:
        really(path, *args)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", mkdir)
    with pytest.raises(KeyboardInterrupt), publishing(tmp_path / "out.txt", lambda draft: None):
        pass
    assert not any(tmp_path.iterdir())


def test_a_folder_appears_whole_in_place_of_the_old_one(tmp_path: Path) -> None:
    target = tmp_path / "out"
    for text in ("old", "new"):
        with publishing_folder(target, Path.iterdir) as draft:
            (draft / "a").write_text(text)
            if text == "old":
                (draft / "b").write_text(text)
                assert not target.exists()
            else:
                assert sorted(path.name for path in target.iterdir()) == ["a", "b"]
    assert [(path.name, path.read_text()) for path in target.iterdir()] == [("a", "new")]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_that_fails_leaves_the_old_one(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "a").write_text("old")

    def bad(folder: Path) -> None:
        raise OutputError(f"{folder.name}: damaged")

    with pytest.raises(OutputError, match="damaged"), publishing_folder(target, bad) as draft:
        (draft / "a").write_text("new")
    with pytest.raises(OutputError, match="No space left"), publishing_folder(target, Path.iterdir):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(KeyboardInterrupt), publishing_folder(target, Path.iterdir):
        raise KeyboardInterrupt
    assert (target / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
