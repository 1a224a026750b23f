"""NPZ without pickle and without surprises: sizes are checked before anything is allocated, bytes are reproducible."""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hrt_cli.errors import InputError

MAX_BYTES = 4 * 2**30
_EPOCH = (1980, 1, 1, 0, 0, 0)

Arrays = dict[str, NDArray[Any]]


def write_npz(path: Path, arrays: Arrays) -> None:
    """Write arrays so that equal arrays give equal bytes (sorted names, a fixed date, a fixed compression)."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(arrays):
            array = np.asarray(arrays[name])
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
            if len({entry.filename for entry in entries}) != len(entries):
                raise InputError(path, "holds two arrays of the same name")
            if sum(entry.file_size for entry in entries) > max_bytes:
                raise InputError(path, f"unpacks to more than {max_bytes} bytes")
            return {entry.filename.removesuffix(".npy"): _read(path, archive, entry) for entry in entries}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError, RuntimeError) as error:
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


def _read(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if not entry.filename.endswith(".npy"):
        raise InputError(path, f"holds {entry.filename!r}, which is not an array")
    with archive.open(entry) as member:
        version = npy.read_magic(member)
        shape, dtype = _header(member, version)
        if dtype.hasobject:
            raise InputError(path, f"{entry.filename} holds Python objects, which are never unpickled")
        stored = entry.file_size - member.tell()
        if math.prod(shape) * dtype.itemsize != stored:
            raise InputError(path, f"{entry.filename} promises shape {shape}, but holds {stored} bytes")
    with archive.open(entry) as member:
        # Reading to the end makes zipfile compare the checksum.
        array: NDArray[Any] = npy.read_array(io.BytesIO(member.read()), allow_pickle=False)
    return array


def _header(member: IO[bytes], version: tuple[int, int]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    if version == (1, 0):
        shape, _, dtype = npy.read_array_header_1_0(member)
    elif version == (2, 0):
        shape, _, dtype = npy.read_array_header_2_0(member)
    else:
        raise ValueError(f"array format {version} is not supported")
    return shape, dtype
