"""The messages of ArduPilot's DataFlash log (`.bin`), as columns.

A message is A3 95, the number of its type, and its fields; FMT messages (type 128) name types and lay out their fields
(ArduPilot's `libraries/AP_Logger`). There are no checksums: a message counts if another one follows it, or the end.
"""

from __future__ import annotations

import mmap
import struct
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError

Floats = NDArray[np.float64]

_BEGIN = b"\xa3\x95"
_FMT = struct.Struct("<3x2B4s16s64s")
_FMT_TYPE = 128
_MOST_TAIL = 528
"""Bytes at the end that a log leaves unfinished: a message of at most 255, and the rest of a page of the flash."""
_MOST_DAMAGED = 0.01
"""A log of which a larger share is no messages is not trusted."""
_CODES: dict[str, tuple[str, float]] = {
    "b": ("<i1", 1), "B": ("<u1", 1), "M": ("<u1", 1), "h": ("<i2", 1), "H": ("<u2", 1), "i": ("<i4", 1),
    "I": ("<u4", 1), "q": ("<i8", 1), "Q": ("<u8", 1), "g": ("<f2", 1), "f": ("<f4", 1), "d": ("<f8", 1),
    "c": ("<i2", 100), "C": ("<u2", 100), "e": ("<i4", 100), "E": ("<u4", 100), "L": ("<i4", 1e7),
    "n": ("S4", 0), "N": ("S16", 0), "Z": ("S64", 0), "a": ("S64", 0),
}  # fmt: skip
"""Type of a field by its letter, and what its values are divided by; 0 where they are no numbers."""


@dataclass(frozen=True)
class _Layout:
    """A type of message: its length in bytes with the three that begin it, and its fields' letters and names."""

    name: str
    length: int
    codes: str
    fields: tuple[str, ...]


class Messages:
    """What a log holds.

    Attributes
    ----------
    notes : list of str
        What of the file is no messages.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._layouts = {_FMT_TYPE: _Layout("FMT", _FMT.size, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))}
        self._starts: dict[int, NDArray[np.int64]] = {}
        self.notes: list[str] = []

    def read(self, wanted: dict[str, tuple[str, ...]]) -> dict[str, dict[str, Floats]]:
        """Return by name of message the columns [n] of the fields wanted; NaN for fields that it does not have.

        Raises
        ------
        InputError
            The log cannot be read, more than a little of it is damaged, or it lays a message out in two ways.
        """
        try:
            with open(self._path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                self._index(data)
                return {name: self._columns(data, name, fields) for name, fields in wanted.items()}
        except OSError as error:
            raise InputError(self._path, f"cannot be read: {error.strerror or error}") from error

    def _index(self, data: mmap.mmap) -> None:
        """Find where messages begin, and note what lies between them and after the last."""
        lengths = [0] * 256
        lengths[_FMT_TYPE] = _FMT.size
        starts: list[array[int]] = [array("q") for _ in lengths]
        at, size, between, tail = 0, len(data), 0, 0
        begins = data[:2] == _BEGIN
        while at < size:
            kind = data[at + 2] if begins and at + 2 < size else 0
            end = at + lengths[kind]
            follows = data[end : end + 2] == _BEGIN
            whole = end > at and (follows or end == size or (end < size and _is_tail(data, end)))
            if whole and not _is_torn(data, at, end, lengths):
                starts[kind].append(at)
                if kind == _FMT_TYPE:
                    self._add(_FMT.unpack(data[at:end]), lengths)
                at, begins = end, follows
                continue
            after = data.find(_BEGIN, at + 1)
            if after < 0:
                tail = size - at
                break
            between += after - at
            at, begins = after, True
        self._starts = {kind: np.array(found, np.int64) for kind, found in enumerate(starts) if found}
        lost = between + (tail if tail > _MOST_TAIL else 0)
        if lost > _MOST_DAMAGED * size:
            raise InputError(self._path, f"is damaged: {lost} of its {size} bytes are no messages")
        if tail:
            self.notes.append(f"ends within a message: its last {tail} bytes are left out")
        if between:
            self.notes.append(f"is damaged: {between} bytes between its messages are passed over")

    def _add(self, said: tuple[int, int, bytes, bytes, bytes], lengths: list[int]) -> None:
        number, length = said[:2]
        name, codes, fields = (text.split(b"\0")[0].decode("ascii", "replace") for text in said[2:])
        layout = _Layout(name, length, codes, tuple(fields.split(",")))
        if length <= 3 or self._layouts.setdefault(number, layout) != layout:
            raise InputError(self._path, f"lays out the message {name or number} in two ways, or in none")
        lengths[number] = length

    def _columns(self, data: mmap.mmap, name: str, wanted: tuple[str, ...]) -> dict[str, Floats]:
        found = [number for number, layout in self._layouts.items() if layout.name == name and number in self._starts]
        if not found:
            return dict.fromkeys(wanted, np.zeros(0))
        layout, starts = self._layouts[found[0]], self._starts[found[0]]
        offsets, offset = {}, 3
        for code, field in zip(layout.codes, layout.fields, strict=False):
            kind, divisor = _CODES.get(code, ("", 0))
            offsets[field] = (offset, kind, divisor)
            offset += np.dtype(kind).itemsize if kind else layout.length
        if len(found) > 1 or len(layout.codes) != len(layout.fields) or offset != layout.length:
            raise InputError(self._path, f"lays out the message {name} in a way that cannot be read")
        whole = np.frombuffer(data, np.uint8)
        columns = {}
        for field in wanted:
            offset, kind, divisor = offsets.get(field, (0, "", 0))
            if not divisor:
                columns[field] = np.full(starts.size, np.nan)
                continue
            raw = whole[starts[:, None] + offset + np.arange(np.dtype(kind).itemsize)]
            columns[field] = np.ascontiguousarray(raw).view(kind)[:, 0].astype(np.float64) / divisor
        del whole
        return columns


def _is_tail(data: mmap.mmap, at: int) -> bool:
    """Whether from here on a log is what was left unfinished, or the rest of a page."""
    return len(data) - at <= _MOST_TAIL and data.find(_BEGIN, at) < 0


def _is_torn(data: mmap.mmap, at: int, end: int, lengths: list[int]) -> bool:
    """Whether what seems to be a message reaches into a whole one: it was cut, and its end is that of another."""
    inner = data.find(_BEGIN, at + 2, end - 2)
    while inner >= 0:
        length = lengths[data[inner + 2]]
        if length and (inner + length == len(data) or data[inner + length : inner + length + 2] == _BEGIN):
            return True
        inner = data.find(_BEGIN, inner + 2, end - 2)
    return False
