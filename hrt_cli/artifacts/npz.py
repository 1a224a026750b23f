"""NPZ without pickle and without surprises: sizes are checked before anything is allocated, bytes are reproducible."""

from __future__ import annotations

import hashlib
import io
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hrt_cli.errors import InputError

MAX_BYTES = 512 * 2**20
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
    SyntaxError,
    EOFError,
    NotImplementedError,
    ArithmeticError,
    ValueError,
    RuntimeError,
)
"""What zipfile and NumPy raise for damaged archives and array headers."""
_END_RECORD = struct.Struct("<4s4H2LH")
_EPOCH = (1980, 1, 1, 0, 0, 0)

Arrays = dict[str, NDArray[Any]]


def write_npz(path: Path, arrays: Arrays) -> None:
    """Write arrays so that equal arrays give equal bytes (sorted names, a fixed date, a fixed compression)."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(arrays):
            array = np.asarray(arrays[name], order="C")
            if array.dtype.hasobject:
                raise ValueError(f"{name}: arrays of Python objects cannot be written")
            buffer = io.BytesIO()
            npy.write_array(buffer, array, allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, buffer.getvalue())


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Arrays:
    """Read every array of an NPZ file.

    Raises
    ------
    InputError
        The file is absent, not an NPZ, damaged, holds Python objects (never unpickled), two members of one name, a
        header that promises other than what is stored, or more than `max_bytes` in all.
    """
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) != _entry_count(path):
                raise InputError(path, "does not hold the number of arrays that it says: damaged")
            if len({entry.filename for entry in entries}) != len(entries):
                raise InputError(path, "holds two arrays of the same name")
            if sum(entry.file_size for entry in entries) > max_bytes:
                raise InputError(path, f"unpacks to more than {max_bytes} bytes")
            return {entry.filename.removesuffix(".npy"): _read(path, archive, entry) for entry in entries}
    except _DAMAGE as error:
        raise InputError(path, f"is not a readable NPZ file: {error}") from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def content_sha256(arrays: Arrays) -> str:
    """Hash names, dtypes, shapes and values of arrays (not the archive around them)."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}|{array.dtype.str}|{array.shape}|".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _entry_count(path: Path) -> int:
    """Return the number of members in the record that ends the archive (APPNOTE.TXT 4.3.16).

    zipfile does not look at it, and a flipped bit in a length can make one entry of the directory swallow the next.
    """
    with open(path, "rb") as file:
        file.seek(-_END_RECORD.size, io.SEEK_END)
        signature, _, _, _, count, _, _, _ = _END_RECORD.unpack(file.read(_END_RECORD.size))
    if signature != b"PK\x05\x06":
        raise InputError(path, "has bytes after its end")
    return int(count)


def _read(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if not entry.filename.endswith(".npy"):
        raise InputError(path, f"holds {entry.filename!r}, which is not an array")
    if entry.compress_type not in _COMPRESSIONS:
        raise InputError(path, f"{entry.filename} is packed in a way that NumPy does not write")
    # Reading to the end makes zipfile compare the checksum, before anything is made of the header.
    member = io.BytesIO(archive.read(entry))
    shape, dtype = _header(member, npy.read_magic(member))
    if dtype.hasobject:
        raise InputError(path, f"{entry.filename} holds Python objects, which are never unpickled")
    stored = entry.file_size - member.tell()
    if math.prod(shape) * dtype.itemsize != stored or (dtype.itemsize == 0 and math.prod(shape) > 1):
        raise InputError(path, f"{entry.filename} promises shape {shape}, but holds {stored} bytes")
    member.seek(0)
    array: NDArray[Any] = npy.read_array(member, allow_pickle=False)
    return array


def _header(member: IO[bytes], version: tuple[int, int]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"array format {version} is not supported")
    try:
        shape, _, dtype = readers[version](member)
    except MemoryError as error:
        # Python's parser says so of any deep nesting, however short the text.
        raise ValueError("an array's header is nested too deep") from error
    return shape, dtype
