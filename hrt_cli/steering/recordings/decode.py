"""Pictures from files, whole or not at all.

OpenCV returns half a picture, the rest grey, for a JPEG that was cut short, and scales 16 bits to 8 without a word. So
the file's structure is checked first: a JPEG's segments up to its end marker (ITU T.81, annex B), a PNG's chunks with
their checksums up to IEND (PNG specification, 5.3).
"""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError

MAX_PIXELS = 64_000_000
_MAX_BYTES = 256 * 2**20
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_EOI, _SOS, _SEGMENTS = 0xD9, 0xDA, range(0xC0, 0xFF)
_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""Markers among C0 to CF that begin no frame."""
_SCAN_END = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")
"""In coded data FF stands before 00 or a restart marker; anything else ends the scan."""
_GREY, _RGB, _PALETTE, _GREY_ALPHA, _RGB_ALPHA = 0, 2, 3, 4, 6
_OPAQUE = 255


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file that may be a picture.

    Raises
    ------
    InputError
        It is absent, empty or cannot be read, or is too large to be a picture.
    """
    try:
        if not path.is_file():
            raise InputError(path, "no such file")
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(path, f"is larger than {_MAX_BYTES // 2**20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if not data:
        raise InputError(path, "is empty")
    return data


def decode_picture(path: Path, data: bytes) -> NDArray[np.uint8]:
    """Return the picture in the bytes of a JPEG or PNG, uint8 RGB [rows, cols, 3].

    Grey becomes three equal channels, a palette its colours. An alpha channel is dropped where all of it is opaque.
    The orientation that a camera notes in EXIF is ignored: a camera on a robot does not turn.

    Parameters
    ----------
    path : Path
        For the message.

    Raises
    ------
    InputError
        It is neither, is cut short or damaged, has more than 8 bits, transparent pixels, or four colours.
    """
    if data.startswith(_JPEG):
        rows, cols, alpha = *_jpeg_size(path, data), False
    elif data.startswith(_PNG):
        rows, cols, alpha = _png_size(path, data)
    else:
        raise InputError(path, "is neither JPEG nor PNG")
    flags = cv2.IMREAD_UNCHANGED if alpha else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        found = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        found = None
    if found is None or found.dtype != np.uint8 or found.shape != (rows, cols, 4 if alpha else 3):
        raise InputError(path, "is damaged")
    if alpha and not (found[..., 3] == _OPAQUE).all():
        raise InputError(path, "has transparent pixels, whose colour means nothing")
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGRA2RGB if alpha else cv2.COLOR_BGR2RGB), np.uint8)


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Return the picture in a file, uint8 RGB [rows, cols, 3]; see `decode_picture`."""
    return decode_picture(path, read_bytes(path))


def _checked(path: Path, rows: int, cols: int) -> tuple[int, int]:
    if rows < 1 or cols < 1:
        raise InputError(path, "is damaged: it says that it has no pixels")
    if rows * cols > MAX_PIXELS:
        raise InputError(path, f"has {cols} x {rows} pixels; more than {MAX_PIXELS // 10**6} million are not read")
    return rows, cols


def _jpeg_size(path: Path, data: bytes) -> tuple[int, int]:
    """Walk through a JPEG to its end marker; return rows and columns."""
    cut = InputError(path, "is cut short: it lacks the end of a JPEG")
    size: tuple[int, int] | None = None
    scanned, at = False, 2
    while True:
        while data[at : at + 2] == b"\xff\xff":  # fill bytes
            at += 1
        if at + 2 > len(data):
            raise cut
        if data[at] != 0xFF or data[at + 1] not in _SEGMENTS:
            raise InputError(path, "is damaged: a JPEG segment does not begin where it should")
        marker = data[at + 1]
        if marker == _EOI:
            if size is None or not scanned:
                raise InputError(path, "is damaged: a JPEG without a picture")
            return size
        if at + 4 > len(data):
            raise cut
        (length,) = struct.unpack_from(">H", data, at + 2)
        segment = data[at + 4 : at + 2 + length]
        if len(segment) < length - 2:
            raise cut
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            size = _jpeg_frame(path, segment)
        at += 2 + length
        if marker == _SOS:
            end = _SCAN_END.search(data, at)
            if end is None:
                raise cut
            scanned, at = True, end.end() - 2


def _jpeg_frame(path: Path, segment: bytes) -> tuple[int, int]:
    if len(segment) < 6:
        raise InputError(path, "is damaged: its JPEG frame header is cut")
    bits, rows, cols, components = struct.unpack_from(">BHHB", segment)
    if bits != 8:
        raise InputError(path, f"has {bits} bits a channel; save it with 8")
    if components not in (1, 3):
        raise InputError(path, f"has {components} colour channels; save it as RGB or grey")
    return _checked(path, rows, cols)


def _png_size(path: Path, data: bytes) -> tuple[int, int, bool]:
    """Walk through a PNG to IEND; return rows, columns, and whether it has an alpha channel."""
    kinds: list[bytes] = []
    at = len(_PNG)
    while not kinds or kinds[-1] != b"IEND":
        if at + 12 > len(data):
            raise InputError(path, "is cut short: it lacks the end of a PNG")
        (length,) = struct.unpack_from(">I", data, at)
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        check = data[at + 8 + length : at + 12 + length]
        if len(check) < 4:
            raise InputError(path, "is cut short: it lacks the end of a PNG")
        if struct.unpack(">I", check)[0] != zlib.crc32(kind + body):
            raise InputError(path, f"is damaged: the checksum of its {kind.decode('latin-1')!r} is wrong")
        kinds.append(kind)
        at += 12 + length
    if kinds[0] != b"IHDR" or b"IDAT" not in kinds or len(data) < len(_PNG) + 21:
        raise InputError(path, "is damaged: a PNG without a picture")
    cols, rows, bits, colour = struct.unpack_from(">IIBB", data, len(_PNG) + 8)
    if bits > 8:
        raise InputError(path, f"has {bits} bits a channel; save it with 8")
    if b"tRNS" in kinds:
        raise InputError(path, "has transparent pixels, whose colour means nothing")
    if colour not in (_GREY, _RGB, _PALETTE, _GREY_ALPHA, _RGB_ALPHA):
        raise InputError(path, f"is damaged: a PNG of the unknown colour type {colour}")
    return *_checked(path, rows, cols), colour in (_GREY_ALPHA, _RGB_ALPHA)
