"""Videos as a camera or a recorder leaves them: frames one at a time, and no end that comes too early unnoticed.

FFmpeg hands out what it can of a damaged file and says nothing that OpenCV would pass on. So the container is checked
to be whole before, and the frames are counted after.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

from hrt_cli.errors import InputError

SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".m4v", ".webm")
MAX_PX = 64_000_000
_MISCOUNTED = 0.02
"""Share by which a container may overstate its frames: Matroska's number is its length times its rate."""
_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"
_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")


@dataclass(frozen=True)
class Shot:
    """A frame of a video: its number and time from the start, and uint8 RGB [rows, cols, 3]."""

    index: int
    time_s: float
    rgb: NDArray[np.uint8]


def check_video(path: Path) -> None:
    """Refuse what is no AVI, MP4 (MOV) or Matroska (WebM) file, or one that was cut or never finished.

    Raises
    ------
    InputError
        See above.
    """
    if not path.is_file():
        raise InputError(path, "no such file")
    size = path.stat().st_size
    with open(path, "rb") as file:
        head = file.read(12)
        if head[:4] == b"RIFF" and head[8:] == b"AVI ":
            end = _riff_end(file, size)
        elif head[4:8] in _BOXES:
            end = _boxes_end(file, size)
        elif head[:4] == _EBML:
            end = _matroska_end(file)
        else:
            raise InputError(path, "is no video that hrt reads: AVI, MP4, MOV, Matroska or WebM")
    if end is None or end > size:
        raise InputError(path, "is a video that was cut off or never finished", "repair it, or use --skip-bad")


def shots(path: Path, every: int) -> Iterator[Shot]:
    """Yield each `every`-th frame of a video, the first one first.

    Raises
    ------
    InputError
        It cannot be opened or decoded, or holds less than it says.
    """
    with _opened(path) as capture:
        if not capture.isOpened():
            raise InputError(path, "is a video that cannot be decoded")
        if capture.get(cv2.CAP_PROP_FRAME_WIDTH) * capture.get(cv2.CAP_PROP_FRAME_HEIGHT) > MAX_PX:
            raise InputError(path, f"has frames of more than {MAX_PX // 1_000_000} million pixels")
        told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        seen = 0
        while capture.grab():
            if seen % every == 0:
                done, bgr = capture.retrieve()
                if not done:
                    raise InputError(path, f"its frame {seen} cannot be decoded")
                time_s = max(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0, 0.0)
                yield Shot(seen, time_s, np.asarray(np.ascontiguousarray(bgr[..., ::-1]), np.uint8))
            seen += 1
        if seen == 0:
            raise InputError(path, "is a video of which no frame can be decoded")
        if told - seen > max(1.0, _MISCOUNTED * told):
            raise InputError(path, f"ends after {seen} of {told} frames: the video is damaged")


def told_frames(path: Path, every: int) -> int:
    """Return about how many frames `shots` will yield, by what the container says."""
    with _opened(path) as capture:
        return max(0, -(-int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) // every))


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    """Open a video without what FFmpeg and OpenCV say on stderr of a bad one: hrt says it in its own line."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when the first video is opened
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        # Absolute: FFmpeg takes what looks like a URL for one.
        capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
    finally:
        logging.setLogLevel(level)
    try:
        yield capture
    finally:
        capture.release()


def _riff_end(file: BinaryIO, size: int) -> int | None:
    """Return where the last RIFF chunk says that it ends (OpenDML: an AVI above 1 GB has several)."""
    at = 0
    while at < size:
        file.seek(at)
        head = file.read(8)
        if head[:4] != b"RIFF":
            return at  # what follows an AVI is not part of it
        length = int.from_bytes(head[4:8], "little")
        if length == 0:
            return None  # the recorder writes it in the end
        at += 8 + length + length % 2
    return at


def _boxes_end(file: BinaryIO, size: int) -> int | None:
    """Return where the last box says that it ends; None if none says what the frames are (ISO/IEC 14496-12, 4.2)."""
    at, kinds = 0, set()
    while at < size:
        file.seek(at)
        head = file.read(16)
        length, kind = int.from_bytes(head[:4], "big"), head[4:8]
        if length == 1:
            length = int.from_bytes(head[8:16], "big")
        elif length == 0:
            length = size - at
        if length < 8:
            return None
        kinds.add(kind)
        at += length
    return at if b"moov" in kinds else None


def _matroska_end(file: BinaryIO) -> int | None:
    """Return where the segment says that it ends; 0 if it leaves that open, as live streams do (RFC 8794, 4)."""
    file.seek(4)
    length = _vint(file)
    if length is None:
        return None
    file.seek(file.tell() + length)
    if file.read(4) != _SEGMENT:
        return None
    length = _vint(file)
    return 0 if length is None else file.tell() + length


def _vint(file: BinaryIO) -> int | None:
    """Read a length of 1 to 8 bytes; None where all its bits are set: unknown."""
    first = file.read(1)
    if not first or first[0] == 0:
        return None
    width = 9 - first[0].bit_length()
    value = int.from_bytes(first + file.read(width - 1), "big") & ((1 << 7 * width) - 1)
    return None if value == (1 << 7 * width) - 1 else value
