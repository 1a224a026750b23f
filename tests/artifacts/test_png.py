from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from hrt_cli.artifacts.png import png_provenance, publish_png
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError

PROVENANCE = record("segment", 1, {"classes": 5}, {})
END = b"\x00\x00\x00\x00IEND\xaeB`\x82"


def picture() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)


def png_bytes() -> bytes:
    return bytes(cv2.imencode(".png", picture())[1])


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.fixture
def figure(tmp_path: Path) -> Path:
    publish_png(tmp_path / "figure.png", png_bytes(), PROVENANCE)
    return tmp_path / "figure.png"


def test_the_provenance_is_read_back_and_the_picture_is_the_same(figure: Path) -> None:
    found = png_provenance(figure)
    assert found is not None
    assert found.fingerprint == PROVENANCE.fingerprint
    np.testing.assert_array_equal(cv2.imread(str(figure)), picture())


def test_publishing_again_gives_the_same_bytes_and_one_record(figure: Path) -> None:
    first = figure.read_bytes()
    publish_png(figure, first, PROVENANCE)
    assert figure.read_bytes() == first
    publish_png(figure, first, record("segment", 1, {"classes": 6}, {}))
    assert figure.read_bytes().count(b"hrt-provenance") == 1


def test_a_foreign_png_has_no_provenance(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_bytes())
    assert png_provenance(tmp_path / "a.png") is None


def test_every_flipped_bit_is_refused(figure: Path) -> None:
    content = figure.read_bytes()
    for position in range(0, len(content), 7):
        flipped = bytearray(content)
        flipped[position] ^= 1 << position % 8
        figure.write_bytes(flipped)
        with pytest.raises(InputError, match=r"figure\.png: "):
            png_provenance(figure)


def test_every_truncation_is_refused(figure: Path) -> None:
    content = figure.read_bytes()
    for length in [*range(0, len(content), 11), len(content) - 1]:
        figure.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"figure\.png: is"):
            png_provenance(figure)


@pytest.mark.parametrize(
    ("inserted", "after", "problem"),
    [
        (chunk(b"tEXt", b"Comment\x00edited"), b"", "its content is not what"),
        (chunk(b"tEXt", b"hrt-provenance\x00{}"), b"", "two provenance records"),
        (b"", b"more", "bytes after its end"),
        (b"\xff\xff\xff\xffIDAT", b"", "damaged or cut short"),
    ],
)
def test_an_edited_png_is_refused(figure: Path, inserted: bytes, after: bytes, problem: str) -> None:
    content = figure.read_bytes()
    assert content.endswith(END)
    figure.write_bytes(content.removesuffix(END) + inserted + END + after)
    with pytest.raises(InputError, match=problem):
        png_provenance(figure)


@pytest.mark.parametrize("record_text", [b"", b"{", b"[]", b"\xff", b'{"tool": NaN}', b"{}"])
def test_a_damaged_record_is_refused(tmp_path: Path, record_text: bytes) -> None:
    added = chunk(b"tEXt", b"hrt-provenance\x00" + record_text)
    (tmp_path / "a.png").write_bytes(png_bytes().removesuffix(END) + added + END)
    with pytest.raises(InputError, match=r"a\.png: "):
        png_provenance(tmp_path / "a.png")


def test_what_is_no_png_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        png_provenance(tmp_path / "absent.png")
    with pytest.raises(InputError, match="is not a PNG"):
        publish_png(tmp_path / "out.png", b"\xff\xd8\xff\xe0", PROVENANCE)
    assert list(tmp_path.iterdir()) == []
