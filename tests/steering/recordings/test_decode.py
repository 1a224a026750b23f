"""Pictures are read whole or refused."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_files import picture, put_picture

from hrt_cli.errors import InputError
from hrt_cli.steering.recordings import decode
from hrt_cli.steering.recordings.decode import decode_picture, read_picture

RGB = picture(3, 24, 32)


def encoded(rgb: np.ndarray, ending: str, *options: int) -> bytes:
    done, data = cv2.imencode(ending, rgb[..., ::-1] if rgb.ndim == 3 and rgb.shape[2] == 3 else rgb, options)
    assert done
    return data.tobytes()


JPEG = encoded(RGB, ".jpg")
PROGRESSIVE = encoded(RGB, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTARTS = encoded(RGB, ".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
PNG = encoded(RGB, ".png")


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(header: tuple[int, int, int, int, int, int, int], rows: bytes, *more: bytes) -> bytes:
    start = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", *header))
    return start + b"".join(more) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def jpeg_with(segment: bytes) -> bytes:
    """The JPEG with one more segment after its beginning."""
    return JPEG[:2] + segment + JPEG[2:]


def with_size(rows: int, cols: int) -> bytes:
    at = JPEG.index(b"\xff\xc0") + 5
    return JPEG[:at] + struct.pack(">HH", rows, cols) + JPEG[at + 4 :]


class TestWhole:
    def test_png_to_the_bit(self, tmp_path: Path) -> None:
        found = read_picture(put_picture(tmp_path / "a.png", RGB))
        np.testing.assert_array_equal(found, RGB)
        assert (found.dtype, found.flags.c_contiguous) == (np.uint8, True)

    @pytest.mark.parametrize("data", [JPEG, PROGRESSIVE, RESTARTS], ids=["baseline", "progressive", "restarts"])
    def test_jpeg(self, data: bytes) -> None:
        found = decode_picture(Path("a"), data)
        assert found.shape == RGB.shape
        assert np.abs(found.astype(int) - RGB).mean() < 6
        np.testing.assert_array_equal(decode_picture(Path("a"), data + b"a trailer of the camera"), found)

    @pytest.mark.parametrize("ending", [".jpg", ".png"])
    def test_grey(self, ending: str) -> None:
        found = decode_picture(Path("a"), encoded(RGB[..., 0], ending))
        assert found.shape == RGB.shape
        assert (found == found[..., :1]).all()
        assert np.abs(found[..., 0].astype(int) - RGB[..., 0]).mean() < 6

    def test_a_palette(self) -> None:
        data = png((2, 1, 8, 3, 0, 0, 0), b"\0\1\0", chunk(b"PLTE", bytes([1, 2, 3, 250, 120, 7])))
        np.testing.assert_array_equal(decode_picture(Path("a"), data), np.uint8([[[250, 120, 7], [1, 2, 3]]]))

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_the_orientation_in_exif_is_ignored(self, orientation: int) -> None:
        tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0" + struct.pack("<HH", orientation, 0) + b"\0\0\0\0"
        exif = b"Exif\0\0" + tiff
        data = jpeg_with(b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif)
        np.testing.assert_array_equal(decode_picture(Path("a"), data), decode_picture(Path("a"), JPEG))
        turned = chunk(b"eXIf", tiff)
        data = PNG[:33] + turned + PNG[33:]
        np.testing.assert_array_equal(decode_picture(Path("a"), data), RGB)

    def test_a_thumbnail_in_a_segment_is_no_end(self) -> None:
        segment = b"\xff\xe1" + struct.pack(">H", len(JPEG) + 2) + JPEG
        data = jpeg_with(segment)
        assert decode_picture(Path("a"), data).shape == RGB.shape
        with pytest.raises(InputError, match="cut short"):
            decode_picture(Path("a"), data[:-200])

    def test_alpha_that_is_opaque_is_dropped(self) -> None:
        alpha = np.dstack([RGB[..., ::-1], np.full(RGB.shape[:2], 255, np.uint8)])
        np.testing.assert_array_equal(decode_picture(Path("a"), encoded(alpha, ".png")), RGB)


class TestRefused:
    @pytest.mark.parametrize("data", [JPEG, PROGRESSIVE, RESTARTS, PNG], ids=["jpeg", "progressive", "restarts", "png"])
    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(share=st.floats(0.0, 1.0))
    def test_every_cut(self, data: bytes, share: float) -> None:
        with pytest.raises(InputError):
            decode_picture(Path("a"), data[: min(len(data) - 1, int(share * len(data)))])

    @pytest.mark.parametrize("data", [JPEG, PROGRESSIVE, PNG], ids=["jpeg", "progressive", "png"])
    def test_a_tail_of_zeros(self, data: bytes) -> None:
        """What a file system leaves after a power cut: the length is right."""
        half = len(data) // 2
        with pytest.raises(InputError):
            decode_picture(Path("a"), data[:half] + bytes(len(data) - half))

    @given(at=st.integers(8, len(PNG) - 1), bit=st.integers(0, 7))
    def test_any_bit_of_a_png(self, at: int, bit: int) -> None:
        damaged = bytearray(PNG)
        damaged[at] ^= 1 << bit
        with pytest.raises(InputError):
            decode_picture(Path("a"), bytes(damaged))

    @given(at=st.integers(0, len(JPEG) - 1), value=st.integers(0, 255))
    def test_any_byte_of_a_jpeg_is_refused_or_read(self, at: int, value: int) -> None:
        damaged = bytearray(JPEG)
        damaged[at] = value
        try:
            found = decode_picture(Path("a"), bytes(damaged))
        except InputError:
            return
        assert found.dtype == np.uint8
        assert found.ndim == 3

    @pytest.mark.parametrize(
        ("data", "problem"),
        [
            (b"<html><body>404</body></html>", "is neither JPEG nor PNG"),
            (encoded(RGB, ".bmp"), "is neither JPEG nor PNG"),
            (b"GIF89a", "is neither JPEG nor PNG"),
            (encoded(RGB.astype(np.uint16) * 257, ".png"), "has 16 bits a channel"),
            (encoded(RGB[..., 0].astype(np.uint16), ".png"), "has 16 bits a channel"),
            (JPEG.replace(b"\xff\xc0\x00\x11\x08", b"\xff\xc0\x00\x11\x0c"), "has 12 bits a channel"),
            (with_size(0, 32), "it says that it has no pixels"),
            (with_size(60_000, 60_000), "has 60000 x 60000 pixels; more than 64 million"),
            (png((60_000, 60_000, 8, 2, 0, 0, 0), b""), "has 60000 x 60000 pixels"),
            (png((0, 4, 8, 2, 0, 0, 0), b""), "no pixels"),
            (png((2, 1, 8, 5, 0, 0, 0), b"\0\1\2"), "unknown colour type 5"),
            (png((2, 2, 8, 0, 0, 0, 0), b"\0\1\2"), "is damaged"),
            (png((1, 1, 8, 0, 0, 0, 0), b"\0\1", chunk(b"tRNS", b"\0\1")), "has transparent pixels"),
            (PNG[:8] + chunk(b"IEND", b""), "a PNG without a picture"),
            (JPEG[:2] + b"\xff\xd9", "a JPEG without a picture"),
            (JPEG[:2] + b"\0\0" + JPEG[2:], "neither JPEG nor PNG"),
            (JPEG[:20] + b"\0\0" + JPEG[20:], "does not begin where it should"),
            (PNG[:45] + b"x" + PNG[46:], "the checksum of its 'IDAT' is wrong"),
        ],
    )
    def test_what_cannot_be_used(self, data: bytes, problem: str, tmp_path: Path) -> None:
        path = tmp_path / "a.jpg"
        path.write_bytes(data)
        with pytest.raises(InputError, match=problem) as refused:
            read_picture(path)
        assert refused.value.path == str(path)

    def test_cmyk(self) -> None:
        at = JPEG.index(b"\xff\xc0")
        frame = struct.pack(">HBHHB", 20, 8, 24, 32, 4) + bytes([1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0, 4, 0x11, 0])
        (length,) = struct.unpack_from(">H", JPEG, at + 2)
        with pytest.raises(InputError, match="has 4 colour channels"):
            decode_picture(Path("a"), JPEG[: at + 2] + frame + JPEG[at + 2 + length :])

    def test_transparent_pixels(self) -> None:
        alpha = np.dstack([RGB, np.full(RGB.shape[:2], 255, np.uint8)])
        alpha[3, 4, 3] = 254
        with pytest.raises(InputError, match="has transparent pixels"):
            decode_picture(Path("a"), encoded(alpha, ".png"))

    def test_files(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "empty.jpg").touch()
        for name, problem in [
            ("absent.jpg", "no such file"),
            ("empty.jpg", "is empty"),
            (".", "no such file"),
            ("n" * 300, "File name"),
        ]:
            with pytest.raises(InputError, match=problem):
                read_picture(tmp_path / name)
        monkeypatch.setattr(decode, "_MAX_BYTES", 100)
        with pytest.raises(InputError, match="is larger than"):
            read_picture(put_picture(tmp_path / "a.png", RGB))
