"""Videos: every frame once and in order, and no damaged one taken for a whole one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from predict_files import put_video

from hrt_cli.errors import InputError
from hrt_cli.steering.prediction.video import check_video, shots, told_frames

KINDS = [("avi", "MJPG"), ("mkv", "MJPG"), ("mp4", "mp4v"), ("mov", "mp4v")]


def refusal(path: Path) -> str:
    def look() -> None:
        check_video(path)
        list(shots(path, 1))

    with pytest.raises(InputError) as caught:
        look()
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("suffix", "fourcc"), KINDS)
def test_every_frame_in_order(tmp_path: Path, suffix: str, fourcc: str) -> None:
    path = put_video(tmp_path / f"v.{suffix}", 12, fourcc)
    check_video(path)
    found = list(shots(path, 1))
    assert [shot.index for shot in found] == list(range(12))
    np.testing.assert_allclose([shot.time_s for shot in found], np.arange(12) / 10, atol=2e-3)
    np.testing.assert_allclose([shot.rgb.mean() for shot in found], 10 * np.arange(12), atol=4)
    assert found[0].rgb.shape == (48, 64, 3)
    assert told_frames(path, 1) == 12


def test_each_third_frame(tmp_path: Path) -> None:
    path = put_video(tmp_path / "v.avi", 11)
    found = list(shots(path, 3))
    assert [shot.index for shot in found] == [0, 3, 6, 9]
    np.testing.assert_allclose([shot.time_s for shot in found], [0.0, 0.3, 0.6, 0.9], atol=2e-3)
    assert told_frames(path, 3) == 4


def test_red_is_red(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    writer.write(np.full((48, 64, 3), (0, 0, 250), np.uint8))  # blue, green, red
    writer.release()
    red, green, blue = next(iter(shots(path, 1))).rgb.mean((0, 1))
    assert red > 200
    assert max(green, blue) < 50


@pytest.mark.parametrize(("suffix", "fourcc"), KINDS)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_a_cut_video_is_refused(
    tmp_path: Path, suffix: str, fourcc: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = put_video(tmp_path / f"v.{suffix}", 12, fourcc)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refusal(path)
    assert capfd.readouterr().err == ""


def test_frames_that_are_missing_inside_are_counted(tmp_path: Path) -> None:
    path = put_video(tmp_path / "v.avi", 12)
    data = bytearray(path.read_bytes())
    at = data.rfind(b"00dc", 0, data.rfind(b"idx1"))
    for _ in range(3):  # chunks that are no longer of the video's stream
        data[at : at + 4] = b"JUNK"
        at = data.rfind(b"00dc", 0, at)
    index = data.rfind(b"idx1")
    del data[index:]
    data[4:8] = (len(data) - 8).to_bytes(4, "little")
    path.write_bytes(data)
    check_video(path)
    with pytest.raises(InputError, match="of 12 frames"):
        list(shots(path, 1))


def test_an_unfinished_recording(tmp_path: Path) -> None:
    path = put_video(tmp_path / "v.avi", 5)
    data = bytearray(path.read_bytes())
    data[4:8] = bytes(4)
    path.write_bytes(data)
    assert "never finished" in refusal(path)


@pytest.mark.parametrize(
    "content", [b"", b"<html>", b"#EXTM3U\nhttp://127.0.0.1/x.ts\n", b"RIFF\x04\x00\x00\x00WAVE", bytes(64)]
)
def test_what_is_no_video(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(content)
    assert "is no video" in refusal(path)
    with pytest.raises(InputError, match="no such file"):
        check_video(tmp_path / "absent.mp4")


def test_a_container_without_a_stream(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(b"\x00\x00\x00\x10ftypisom\x00\x00\x00\x00" + b"\x00\x00\x00\x08moov")
    assert "cannot be decoded" in refusal(path)
    assert capfd.readouterr().err == ""


def test_names_that_look_like_something_else(tmp_path: Path) -> None:
    for name in ("frame_%03d.avi", "a b ü.avi", "concat:x.avi"):
        path = put_video(tmp_path / "v.avi", 3).rename(tmp_path / name)
        assert len(list(shots(path, 1))) == 3
