"""A recording that was stopped goes on, to the same bytes."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from world_files import put_world

from hrt_cli.artifacts.stage import Existing
from hrt_cli.driving import glance_checkpoint
from hrt_cli.driving.glance_stage import GlanceRequest, GlanceSummary, record_folder
from hrt_cli.driving.glances import IN_ONE_WEATHER
from hrt_cli.errors import OutputError

FRAMES = IN_ONE_WEATHER + 8
CHECKPOINT = ".recording.json.hrt-checkpoint"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    posts = np.zeros((100, 100))
    posts[20:80:20, 20:80:20] = 1.0
    return put_world(tmp_path_factory.mktemp("land"), posts, classes=posts.astype(int))


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(world: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What an unbroken recording writes; the name of its folder goes into it."""
    folder = tmp_path_factory.mktemp("whole") / "g"
    record_folder(world, folder, GlanceRequest(FRAMES))
    found = content(folder)
    assert len(found) == FRAMES + 2
    return found


class Stopped(Exception):
    """In place of a signal."""


def stop_at(frame: int) -> object:
    def progress(done: int, total: int) -> None:
        if done == frame:
            raise Stopped

    return progress


def begun(world: Path, folder: Path, frame: int, request: GlanceRequest = GlanceRequest(FRAMES)) -> list[str]:  # noqa: B008
    notes: list[str] = []
    with pytest.raises(Stopped):
        record_folder(world, folder, request, progress=stop_at(frame), note=notes.append)  # type: ignore[arg-type]
    return notes


def ended(world: Path, folder: Path, **options: object) -> tuple[GlanceSummary, list[str]]:
    notes: list[str] = []
    return record_folder(world, folder, GlanceRequest(FRAMES), note=notes.append, **options), notes  # type: ignore[arg-type]


@pytest.mark.parametrize("frame", [1, 7, IN_ONE_WEATHER, IN_ONE_WEATHER + 3, FRAMES])
def test_it_goes_on_where_it_was(world: Path, whole: dict[str, bytes], tmp_path: Path, frame: int) -> None:
    folder = tmp_path / "g"
    assert begun(world, folder, frame) == [f"Note: stopped; the same command goes on after frame {frame} of {FRAMES}"]
    if frame < FRAMES:
        (folder / "frames" / f"{frame:06d}.jpg").write_bytes(b"half of a pict")
    done, notes = ended(world, folder)
    assert done.resumed_at == frame
    assert notes == [f"Note: going on after frame {frame} of {FRAMES} ({folder / CHECKPOINT})"]
    assert content(folder) == whole


def test_a_second_stop(world: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    begun(world, tmp_path / "g", 5)
    begun(world, tmp_path / "g", 60)
    assert ended(world, tmp_path / "g")[0].resumed_at == 60
    assert content(tmp_path / "g") == whole


@pytest.mark.parametrize("damage", ["changed", "gone", "checkpoint", "state"])
def test_what_is_not_as_it_was_left_begins_anew(
    world: Path, whole: dict[str, bytes], tmp_path: Path, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "g"
    if damage == "state":
        monkeypatch.setattr("hrt_cli.driving.glances.Glances.random", '{"bit_generator": "PCG64", "state": 3}')
    begun(world, folder, 9)
    monkeypatch.undo()
    picture = folder / "frames" / "000004.jpg"
    if damage == "changed":
        picture.write_bytes(picture.read_bytes() + b"\0")
    if damage == "gone":
        picture.unlink()
    if damage == "checkpoint":
        (folder / CHECKPOINT).write_bytes((folder / CHECKPOINT).read_bytes()[:-40])
    done, notes = ended(world, folder)
    assert done.resumed_at == 0
    assert len(notes) == 1
    assert notes[0].startswith("Warning: ")
    assert notes[0].endswith("; the recording begins anew")
    assert content(folder) == whole


def test_of_other_settings_it_is_replaced(world: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    begun(world, tmp_path / "g", 9, GlanceRequest(FRAMES, seed=3))
    done, notes = ended(world, tmp_path / "g")
    assert done.resumed_at == 0
    assert "is of a recording with other settings and will be replaced" in notes[0]
    assert content(tmp_path / "g") == whole


def test_what_a_killed_process_left_of_its_publishing_is_swept(
    world: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "g"
    for name in ("labels.csv", "recording.json", CHECKPOINT):
        (folder / f".{name}.hrt-0123abcd").mkdir(parents=True)
    assert ended(world, folder)[0].frames == FRAMES
    assert content(folder) == whole


def test_a_finished_recording_is_still_not_replaced_unasked(world: Path, tmp_path: Path) -> None:
    folder = tmp_path / "g"
    record_folder(world, folder, GlanceRequest(2))
    before = content(folder)
    with pytest.raises(OutputError, match="use --overwrite"):
        ended(world, folder)
    assert content(folder) == before
    ended(world, folder, existing=Existing(overwrite=True))
    assert len(content(folder)) == FRAMES + 2


def test_killed_after_its_last_word_it_leaves_nothing(world: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / "g"
    begun(world, folder, FRAMES)
    kept = (folder / CHECKPOINT).read_bytes()
    ended(world, folder)
    (folder / CHECKPOINT).write_bytes(kept)
    assert ended(world, folder)[0].up_to_date
    assert content(folder) == whole


def test_where_it_cannot_be_kept_it_goes_on(
    world: Path, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, document: object, provenance: object) -> None:
        raise OutputError(f"{path}: No space left on device")

    monkeypatch.setattr(glance_checkpoint, "publish_json", full)
    monkeypatch.setattr(glance_checkpoint, "EVERY_S", 0.0)
    _, notes = ended(world, tmp_path / "g")
    assert len(notes) == 1
    assert notes[0].endswith("should the recording be stopped, this part of it is lost")
    assert content(tmp_path / "g") == whole


def test_killed_at_any_moment(world: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    folder = tmp_path / "g"
    program = (
        "from hrt_cli.driving import glance_checkpoint; glance_checkpoint.EVERY_S, glance_checkpoint._SHARE = .02, 1.0;"
        "from hrt_cli.main import main;"
        f"main(['record', {str(world)!r}, '-o', {str(folder)!r}, '--frames', '{FRAMES}'])"
    )
    chance, kills = random.Random(4), 0
    for turn in range(30):
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        number = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[turn % 3]
        if turn < 3:
            # Not before it draws: starting takes longer than all of it.
            count = len(list((folder / "frames").glob("*"))) if folder.exists() else 0
            until = time.monotonic() + 60
            while process.poll() is None and time.monotonic() < until:
                now = len(list((folder / "frames").glob("*"))) if folder.exists() else 0
                if now != count:
                    break
            time.sleep(chance.uniform(0, 0.1))
            process.send_signal(number)
        _, errors = process.communicate(timeout=100)
        if process.returncode == 0:
            break
        assert process.returncode in (-number, 128 + number), errors.decode()
        kills += 1
    assert kills >= 1
    assert content(folder) == whole
    assert not [name for name in os.listdir(folder) if name.startswith(".")]
