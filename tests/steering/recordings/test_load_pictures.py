"""All pictures of a training in one array: whole, in order, and the same digest wherever they lie."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from recording_files import picture, put_labels, put_picture, put_text

from hrt_cli.errors import InputError, OutputError
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.steering.recordings import load
from hrt_cli.steering.recordings.decode import read_picture
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import read_samples

CONFIG = SteeringConfig(width=40, height=32, crop_top=0.25)
YAWS = [n / 10 for n in range(8)]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    put_labels(tmp_path / "drive", YAWS, sessions=["a"] * 4 + ["b"] * 4, goals_deg=[10 * n for n in range(8)])
    return tmp_path / "drive"


def digest_of(folder: Path, **options: bool) -> str:
    return load_pictures(read_samples([folder]), CONFIG, **options)[2]


def test_each_picture_in_its_place(drive: Path) -> None:
    done: list[tuple[int, int]] = []
    samples = read_samples([drive])
    kept, pictures, _ = load_pictures(samples, CONFIG, progress=lambda *now: done.append(now))
    assert kept.paths == samples.paths
    assert (pictures.shape, pictures.dtype) == ((8, 32, 40, 3), np.uint8)
    for path, found in zip(samples.paths, pictures, strict=True):
        np.testing.assert_array_equal(found, fitted(read_picture(path), CONFIG))
    assert done == [(n, 8) for n in range(1, 9)]


def damage(drive: Path) -> None:
    """The cases of a folder after a bad day: cut, empty, HTML, absent, 16 bits."""
    frame = "frames/{:06d}.jpg".format
    whole = (drive / frame(1)).read_bytes()
    (drive / frame(1)).write_bytes(whole[: len(whole) // 2])
    (drive / frame(2)).write_bytes(b"")
    (drive / frame(3)).write_text("<html></html>")
    (drive / frame(4)).unlink()
    deep = put_picture(drive / "deep.png", picture().astype(np.uint16) * 256)
    deep.rename(drive / frame(6))


def test_damaged_pictures(drive: Path) -> None:
    damage(drive)
    samples = read_samples([drive])
    with pytest.raises(InputError) as refused:
        load_pictures(samples, CONFIG)
    assert refused.value.path == str(drive / "frames" / "000001.jpg")
    assert "is cut short" in str(refused.value)
    assert "5 of 8 pictures cannot be used" in str(refused.value)
    notes: list[str] = []
    kept, pictures, _ = load_pictures(samples, CONFIG, skip_bad=True, note=notes.append)
    assert kept.steering[:, 0].tolist() == samples.steering[[0, 5, 7], 0].tolist()
    assert kept.skipped == 5
    assert len(pictures) == 3
    for path, found in zip(kept.paths, pictures, strict=True):
        np.testing.assert_array_equal(found, fitted(read_picture(path), CONFIG))
    assert [note.split(": ")[2].split(";")[0] for note in notes[:3]] == [
        "is cut short",
        "is empty",
        "is neither JPEG nor PNG",
    ]
    assert notes[3] == "Warning: 2 more pictures cannot be used and are left out"


def test_skipped_rows_and_pictures_add_up(drive: Path) -> None:
    damage(drive)
    text = (drive / "labels.csv").read_text().replace(",0.7,", ",nan,")
    put_text(drive / "labels.csv", text)
    kept, _, _ = load_pictures(read_samples([drive], skip_bad=True), CONFIG, skip_bad=True)
    assert (kept.skipped, len(kept.paths)) == (6, 2)


def test_no_picture_left(drive: Path) -> None:
    shutil.rmtree(drive / "frames")
    with pytest.raises(InputError, match="none of the 8 pictures can be used"):
        load_pictures(read_samples([drive]), CONFIG, skip_bad=True)


def test_pictures_of_one_shape(drive: Path) -> None:
    put_picture(drive / "frames" / "000005.jpg", picture(0, 48, 64))  # larger, and as wide
    load_pictures(read_samples([drive]), CONFIG)
    put_picture(drive / "frames" / "000005.jpg", picture(0, 480, 653))  # by 2.03 %
    with pytest.raises(InputError, match=r"000005\.jpg: is 1\.360 times as wide as high, and .*000000\.jpg is 1\.333"):
        load_pictures(read_samples([drive]), CONFIG)


class TestDigest:
    def test_is_the_same_elsewhere(self, drive: Path, tmp_path: Path) -> None:
        first = digest_of(drive)
        shutil.copytree(drive, tmp_path / "other" / "name")
        assert digest_of(tmp_path / "other" / "name") == first == digest_of(drive)
        assert len(first) == 64

    def test_is_the_same_with_one_thread(self, drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        first = digest_of(drive)
        monkeypatch.setattr(load.os, "cpu_count", lambda: 1)
        assert digest_of(drive) == first

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            (",0.3,", ",0.30001,"),
            (",b,", ",a,"),
            (",40\n", ",41\n"),
            ("000002.jpg", "copy.jpg"),
            ("\n", "\r\n"),
        ],
        ids=["label", "session", "goal", "name", "nothing"],
    )
    def test_changes_with_what_is_in_it(self, old: str, new: str, drive: Path) -> None:
        first = digest_of(drive)
        shutil.copy(drive / "frames" / "000002.jpg", drive / "frames" / "copy.jpg")
        text = (drive / "labels.csv").read_text()
        assert old in text
        put_text(drive / "labels.csv", text.replace(old, new))
        assert (digest_of(drive) == first) == (new == "\r\n")

    def test_changes_with_what_turns_cost(self, tmp_path: Path) -> None:
        costs = ["0 1 2", "0 1 2.5"]
        found = [
            digest_of(put_labels(tmp_path / f"{n}" / "d", [0.2], costs_s=[each]).parent) for n, each in enumerate(costs)
        ]
        assert found[0] != found[1]

    def test_changes_with_the_pictures_and_their_order(self, drive: Path) -> None:
        seen = {digest_of(drive)}
        a, b = (drive / "frames" / f"00000{n}.jpg" for n in (1, 2))
        with a.open("ab") as file:
            file.write(b"trailer")
        seen.add(digest_of(drive))
        put_text(drive / "spare", "")
        swap = (a.read_bytes(), b.read_bytes())
        a.write_bytes(swap[1])
        b.write_bytes(swap[0])
        seen.add(digest_of(drive))
        lines = (drive / "labels.csv").read_text().splitlines()
        lines[1], lines[2] = lines[2], lines[1]
        put_text(drive / "labels.csv", "\n".join(lines) + "\n")
        seen.add(digest_of(drive))
        assert len(seen) == 4


class TestLargerThanMemory:
    def test_pictures_in_a_file_without_a_name(
        self, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        samples = read_samples([drive])
        _, in_memory, digest = load_pictures(samples, CONFIG)
        (tmp_path / "tmp").mkdir()
        monkeypatch.setattr(load.tempfile, "tempdir", str(tmp_path / "tmp"))
        monkeypatch.setattr(load, "_IN_MEMORY_BYTES", 1000)
        _, in_file, again = load_pictures(samples, CONFIG)
        assert isinstance(in_file, np.memmap)
        assert not isinstance(in_memory, np.memmap)
        np.testing.assert_array_equal(in_file, in_memory)
        assert again == digest
        assert list((tmp_path / "tmp").iterdir()) == []

    def test_no_room(self, drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(*args: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(load, "_IN_MEMORY_BYTES", 1000)
        monkeypatch.setattr(load.os, "posix_fallocate", full)
        with pytest.raises(OutputError, match=r"no room for 0\.0 GiB of pictures: No space left on device; set TMPDIR"):
            load_pictures(read_samples([drive]), CONFIG)
