"""How an ONNX file of ours carries what it is: one metadata property, with a hash of everything else in the file.

An ONNX file is one protobuf message (`ModelProto`), and a message is its fields one after another, in any order. Ours
ends in the entry `hrt` of `metadata_props`, a JSON string; the bytes before it are the model, and the hash in its
provenance covers them and the rest of the JSON. So a file is checked without parsing the graph, and before anything
else reads it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import canonical, parse_strict
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError

MAX_BYTES = 2 * 2**30
"""A protobuf message is no longer."""
_KEY = b"hrt"
_METADATA_PROPS, _PROP_KEY, _PROP_VALUE = 14, 1, 2
"""Numbers of fields: in ModelProto, and in its StringStringEntryProto."""
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
"""Wire types."""


def publish_onnx(
    target: Path, model: bytes, document: dict[str, Any], provenance: Provenance, check: Callable[[Path], object]
) -> None:
    """Publish an ONNX model with a JSON document and its provenance.

    Parameters
    ----------
    model : bytes
        A serialised ModelProto without an entry `hrt`.
    document : dict
    check : callable
        Called with the written file, after its content has been checked; raises if it is not fit to be published.
    """
    stamped = provenance.with_content(_content_sha256(model, document))
    text = canonical({**document, "provenance": stamped.model_dump(mode="json")})
    entry = _field(_PROP_KEY, _KEY) + _field(_PROP_VALUE, text)

    def whole(draft: Path) -> None:
        onnx_provenance(draft)
        check(draft)

    with publishing(target, whole) as draft:
        draft.write_bytes(model + _field(_METADATA_PROPS, entry))


def read_onnx(path: Path) -> tuple[bytes, dict[str, Any], Provenance]:
    """Read what `publish_onnx` wrote: the model, the document and the provenance, against which both are checked.

    Raises
    ------
    InputError
        It is absent, no ONNX file of hrt, or not as it was written.
    """
    try:
        if not path.is_file():
            raise InputError(path, "no such file")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(path, f"is larger than the {MAX_BYTES} bytes that are read")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    model, text = _split(path, data)
    document = parse_strict(path, text)
    found = document.pop("provenance", None) if isinstance(document, dict) else None
    if found is None:
        raise InputError(path, "its description of itself is damaged")
    provenance = parse_provenance(path, found)
    return model, document, checked(path, provenance, _content_sha256(model, document))


def onnx_provenance(path: Path) -> Provenance:
    """Read the provenance of an ONNX file of ours and check its content against it."""
    return read_onnx(path)[2]


def _split(path: Path, data: bytes) -> tuple[bytes, str]:
    """Return the model and our text, which is the last field of the file."""
    start = at = 0
    number = kind = 0
    try:
        while at < len(data):
            start = at
            number, kind, at = _skip(data, at)
        if not data or (number, kind) != (_METADATA_PROPS, _BYTES):
            raise InputError(path, "is no ONNX file that hrt wrote")
        key, value = _entry(data[start:])
    except (ValueError, IndexError) as error:
        raise InputError(path, "is no ONNX file, or a damaged one") from error
    if key != _KEY:
        raise InputError(path, "is no ONNX file that hrt wrote")
    try:
        return data[:start], value.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(path, "its description of itself is damaged") from error


def _skip(data: bytes, at: int) -> tuple[int, int, int]:
    """Return the number and wire type of the field at a place, and where the next one begins."""
    tag, at = _varint(data, at)
    number, kind = tag >> 3, tag & 7
    if kind == _VARINT:
        _, at = _varint(data, at)
    elif kind == _BYTES:
        length, at = _varint(data, at)
        at += length
    elif kind in (_FIXED32, _FIXED64):
        at += 4 if kind == _FIXED32 else 8
    else:
        raise ValueError(f"there is no wire type {kind}")
    if number == 0 or at > len(data):
        raise ValueError("a field is cut short")
    return number, kind, at


def _entry(field: bytes) -> tuple[bytes, bytes]:
    """Return key and value of a whole field of `metadata_props`."""
    _, at = _varint(field, 0)
    _, at = _varint(field, at)
    parts: dict[int, bytes] = {}
    while at < len(field):
        number, kind, end = _skip(field, at)
        if kind != _BYTES:
            raise ValueError("no text")
        _, inside = _varint(field, _varint(field, at)[1])
        parts[number], at = field[inside:end], end
    return parts.get(_PROP_KEY, b""), parts.get(_PROP_VALUE, b"")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number that is written at a place, seven bits a byte, and where it ends."""
    value = 0
    for shift in range(0, 64, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number is too long")


def _field(number: int, content: bytes) -> bytes:
    return _as_varint(number << 3 | _BYTES) + _as_varint(len(content)) + content


def _as_varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _content_sha256(model: bytes, document: dict[str, Any]) -> str:
    return hashlib.sha256(canonical(document) + b"\n" + model).hexdigest()
