"""PNG figures that carry their provenance in a text chunk, so that they are cached and verified like any artifact."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import canonical, parse_strict
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KEYWORD = b"hrt-provenance\x00"
_END = b"IEND"


def publish_png(target: Path, png: bytes, provenance: Provenance) -> None:
    """Publish the bytes of a PNG with its provenance (PNG specification, 11.3.4.3 tEXt)."""
    chunks = [(kind, data) for kind, data in _chunks(target, png) if not _is_ours(kind, data)]
    stamped = provenance.with_content(_content_sha256(chunks))
    text = _KEYWORD + canonical(stamped.model_dump(mode="json"))
    *body, end = chunks
    written = _SIGNATURE + b"".join(_packed(kind, data) for kind, data in [*body, (b"tEXt", text), end])
    with publishing(target, png_provenance) as draft:
        draft.write_bytes(written)


def png_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a PNG and check its pixels against it; None if it carries none."""
    try:
        chunks = list(_chunks(path, path.read_bytes()))
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    ours = [data for kind, data in chunks if _is_ours(kind, data)]
    if not ours:
        return None
    if len(ours) > 1:
        raise InputError(path, "carries two provenance records")
    try:
        text = ours[0].removeprefix(_KEYWORD).decode("ascii")
    except UnicodeDecodeError as error:
        raise InputError(path, "its provenance record is damaged") from error
    found = parse_provenance(path, parse_strict(path, text))
    return checked(path, found, _content_sha256([c for c in chunks if not _is_ours(*c)]))


def _chunks(path: Path, png: bytes) -> Iterator[tuple[bytes, bytes]]:
    if not png.startswith(_SIGNATURE):
        raise InputError(path, "is not a PNG")
    at = len(_SIGNATURE)
    while at < len(png):
        if at + 12 > len(png):
            raise InputError(path, "is cut short")
        (length,) = struct.unpack_from(">I", png, at)
        kind, data = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        tail = png[at + 8 + length : at + 12 + length]
        if len(tail) < 4 or struct.unpack(">I", tail)[0] != zlib.crc32(kind + data):
            raise InputError(path, "is damaged or cut short")
        yield kind, data
        at += 12 + length
        if kind == _END:
            if at != len(png):
                raise InputError(path, "has bytes after its end")
            return
    raise InputError(path, "is cut short")


def _is_ours(kind: bytes, data: bytes) -> bool:
    return kind == b"tEXt" and data.startswith(_KEYWORD)


def _packed(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _content_sha256(chunks: list[tuple[bytes, bytes]]) -> str:
    digest = hashlib.sha256()
    for kind, data in chunks:
        digest.update(kind + struct.pack(">I", len(data)) + data)
    return digest.hexdigest()
