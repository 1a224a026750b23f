"""What `steer` looks at: which files, in which order, with which goals and labels, and what is left out."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from predict_files import noise, put_pictures, put_recording, put_video

from hrt_cli.errors import InputError
from hrt_cli.steering.prediction.sources import Frame, Reader, find_sources, goal_deg, natural, stills_digest


def read(*inputs: Path, every: int = 1, skip_bad: bool = False) -> list[Frame]:
    return list(Reader(find_sources(inputs), every=every, skip_bad=skip_bad).frames())


def test_numbers_in_names_count_by_their_value() -> None:
    names = ["10.jpg", "9.jpg", "a2b10", "a2b9", "a10", "007", "7.jpg"]
    assert sorted(names, key=natural) == ["007", "7.jpg", "9.jpg", "10.jpg", "a2b9", "a2b10", "a10"]


def test_a_folder_by_name_and_files_as_given(tmp_path: Path) -> None:
    put_pictures(tmp_path / "f", 11)
    (tmp_path / "f" / "._1.png").write_bytes(b"of another system")
    found = read(tmp_path / "f")
    assert [frame.name for frame in found] == [f"{k}.png" for k in range(11)]
    assert np.array_equal(np.stack([frame.rgb for frame in found]), noise(11))
    found = read(tmp_path / "f" / "5.png", tmp_path / "f" / "2.png")
    assert [(frame.input, frame.name) for frame in found] == [(0, "5.png"), (1, "2.png")]
    assert found[0].goal is found[0].label is found[0].index is None


def test_what_a_folder_holds_besides_is_told(tmp_path: Path) -> None:
    put_pictures(tmp_path, 1)
    (tmp_path / "clip.avi").write_bytes(b"")
    told: list[str] = []
    find_sources([tmp_path], note=told.append)
    assert len(told) == 1
    assert "1 files" in told[0]


def test_a_recording_brings_goals_and_labels(tmp_path: Path) -> None:
    found = read(put_recording(tmp_path / "r", 3, goal=True))
    assert [frame.name for frame in found] == ["frames/0.png", "frames/1.png", "frames/2.png"]
    np.testing.assert_allclose([frame.goal for frame in found], np.radians([0, 10, 20]), atol=1e-6)
    assert [frame.label for frame in found] == [{"yaw": 0.25}] * 3


def test_a_video_is_read_frame_by_frame(tmp_path: Path) -> None:
    found = read(put_video(tmp_path / "v.avi", 7), every=3)
    assert [(frame.name, frame.index) for frame in found] == [("v.avi", 0), ("v.avi", 3), ("v.avi", 6)]
    np.testing.assert_allclose([frame.time_s for frame in found], [0.0, 0.3, 0.6], atol=2e-3)


def test_inputs_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no JPEG or PNG"):
        find_sources([tmp_path / "empty"])
    for name in ("absent", "absent.png", "absent.mp4"):
        with pytest.raises(InputError, match="no such file"):
            find_sources([tmp_path / name])


def test_bad_pictures_are_refused_or_counted(tmp_path: Path) -> None:
    put_pictures(tmp_path, 6)
    for k in (1, 2, 3, 4):
        (tmp_path / f"{k}.png").write_bytes(b"<html>")
    with pytest.raises(InputError, match=r"1\.png"):
        read(tmp_path)
    told: list[str] = []
    reader = Reader(find_sources([tmp_path]), every=1, skip_bad=True, note=told.append)
    assert reader.expected == 6
    assert [frame.name for frame in reader.frames()] == ["0.png", "5.png"]
    assert reader.skipped == 4
    assert len(told) == 3
    assert "1.png" in told[0]


def test_a_cut_video_is_taken_as_far_as_it_goes_if_asked(tmp_path: Path) -> None:
    path = put_video(tmp_path / "v.avi", 12)
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rfind(b"00dc", 0, 3 * len(whole) // 4)])
    with pytest.raises(InputError, match="cut off"):
        find_sources([path])
    told: list[str] = []
    reader = Reader(find_sources([path], skip_bad=True, note=told.append), every=1, skip_bad=True, note=told.append)
    found = list(reader.frames())
    assert 1 <= len(found) < 12
    assert reader.skipped == 1
    assert len(told) == 2


def test_the_digest_is_of_names_bytes_and_labels_and_not_of_the_place(tmp_path: Path) -> None:
    first = put_recording(tmp_path / "a" / "r", 2, goal=True)
    digest = stills_digest(find_sources([first]))
    assert digest == stills_digest(find_sources([shutil.copytree(first, tmp_path / "b" / "r")]))
    seen = {digest}
    for number, (old, new) in enumerate([("0.25", "0.26"), (",10\n", ",11\n")]):
        other = shutil.copytree(first, tmp_path / str(number) / "r")
        text = (other / "labels.csv").read_text()
        (other / "labels.csv").write_text(text.replace(old, new, 1))
        seen.add(stills_digest(find_sources([other])))
    put_pictures(first / "frames", 2, seed=1)
    seen.add(stills_digest(find_sources([first])))
    assert len(seen) == 4


def test_bearings_in_degrees() -> None:
    assert goal_deg(math.radians(30)) == pytest.approx(30)
    assert goal_deg(math.radians(350)) == pytest.approx(-10)
    assert abs(goal_deg(math.pi)) == pytest.approx(180)
