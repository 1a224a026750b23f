from __future__ import annotations

import io
import os
import random
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray

from hrt_cli.artifacts.npz import content_sha256, read_npz, write_npz
from hrt_cli.errors import InputError


def npy_bytes(array: NDArray[Any], **options: Any) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, **options)
    return buffer.getvalue()


def with_header(header: str, body: bytes, version: tuple[int, int] = (1, 0)) -> bytes:
    text = header.encode("latin1") + b"\n"
    return b"\x93NUMPY" + bytes(version) + struct.pack("<H" if version == (1, 0) else "<I", len(text)) + text + body


def archive_of(path: Path, *members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return path


def refused(path: Path) -> str:
    """The message of the refusal; no more than a few megabytes may be allocated on the way."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as refusal:
            read_npz(path)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    assert str(refusal.value).startswith(f"{path}: ")
    return str(refusal.value)


@pytest.fixture
def sample(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    arrays = {"weights": rng.normal(size=(7, 11)), "names": np.array(["a", "b"]), "version": np.array(3)}
    write_npz(tmp_path / "sample.npz", arrays)
    return tmp_path / "sample.npz"


simple = st.one_of(
    npst.boolean_dtypes(),
    npst.integer_dtypes(endianness="?"),
    npst.floating_dtypes(endianness="?", sizes=(16, 32, 64)),
    npst.unicode_string_dtypes(max_len=4),
)


@settings(deadline=None)
@given(array=npst.arrays(simple, npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)))
def test_arrays_are_read_back_the_same(tmp_path_factory: pytest.TempPathFactory, array: NDArray[Any]) -> None:
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    write_npz(path, {"a": array})
    back = read_npz(path)
    assert list(back) == ["a"]
    assert back["a"].dtype == array.dtype
    assert back["a"].shape == array.shape
    assert back["a"].tobytes() == array.tobytes()
    with np.load(path, allow_pickle=False) as plain:
        np.testing.assert_array_equal(plain["a"], array)


def test_equal_arrays_give_equal_bytes(tmp_path: Path) -> None:
    c_order = np.arange(12.0).reshape(3, 4)
    variants = {
        "one": {"a": c_order, "b": np.arange(4)},
        "reversed": {"b": np.arange(4), "a": c_order},
        "fortran": {"a": np.asfortranarray(c_order), "b": np.arange(4)},
        "strided": {"a": c_order, "b": np.arange(8)[::2] // 2},
    }
    for name, arrays in variants.items():
        write_npz(tmp_path / name, arrays)
        os.utime(tmp_path / name, (0, 0))
    assert len({(tmp_path / name).read_bytes() for name in variants}) == 1
    assert len({content_sha256(arrays) for arrays in variants.values()}) == 1


def test_the_content_hash_sees_names_types_shapes_and_values() -> None:
    base = np.arange(6, dtype=np.int32)
    variants = [
        {"a": base},
        {"b": base},
        {"a": base.astype(np.int64)},
        {"a": base.astype(">i4")},
        {"a": base.reshape(2, 3)},
        {"a": base + 1},
        {"a": base.view(np.uint32)},
        {"a": base, "b": base},
        {},
    ]
    assert len({content_sha256(arrays) for arrays in variants}) == len(variants)


def test_what_numpy_wrote_is_read(tmp_path: Path) -> None:
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    np.savez(tmp_path / "stored.npz", fortran=fortran, none=np.zeros((0, 3)))
    np.savez_compressed(tmp_path / "packed.npz", fortran=fortran, none=np.zeros((0, 3)))
    for name in ("stored.npz", "packed.npz"):
        back = read_npz(tmp_path / name)
        np.testing.assert_array_equal(back["fortran"], fortran)
        assert back["none"].shape == (0, 3)
    archive_of(tmp_path / "v2.npz", ("a.npy", npy_bytes(fortran, version=(2, 0))))
    np.testing.assert_array_equal(read_npz(tmp_path / "v2.npz")["a"], fortran)


class Payload:
    """Leaves a marker file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.marker,))


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    objects = np.array([Payload(marker)], dtype=object)
    np.savez(tmp_path / "objects.npz", a=objects)
    assert "holds Python objects, which are never unpickled" in refused(tmp_path / "objects.npz")
    # The header lies: the bytes of the pickle stand under a plain type, or without any header.
    body = npy_bytes(objects).split(b"\n", 1)[1]
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({len(body)},), }}"
    archive_of(tmp_path / "lies.npz", ("a.npy", with_header(header, body)))
    assert read_npz(tmp_path / "lies.npz")["a"].dtype == np.uint8
    archive_of(tmp_path / "bare.npz", ("a.npy", body))
    refused(tmp_path / "bare.npz")
    nested = "{'descr': [('x', '|O')], 'fortran_order': False, 'shape': (1,), }"
    archive_of(tmp_path / "nested.npz", ("a.npy", with_header(nested, b"\0" * 8)))
    assert "Python objects" in refused(tmp_path / "nested.npz")
    assert not marker.exists()


def test_objects_are_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a: arrays of Python objects"):
        write_npz(tmp_path / "a.npz", {"a": np.array([None])})


@pytest.mark.parametrize(
    ("shape", "descr"),
    [
        ("(1000000000000,)", "<f8"),
        ("(1000000, 1000000)", "<f8"),
        ("(10000000000000000000000000000000,)", "<f8"),
        ("(0, 10000000000000000000000000000000)", "<f8"),
        ("(1000000000000,)", "|V0"),
        ("(1000000000000,)", "<U0"),
        ("(-1, -2)", "<f8"),
        ("(-2,)", "<f8"),
        ("(3,)", "<f8"),
        ("(1.0,)", "<f8"),
        ("2", "<f8"),
        ("(2,)", "<f9"),
        ("(2,)", "("),
        ("(1,", "<f8"),
        ("(" * 300 + "2" + ",)" * 300, "<f8"),
        ("(" * 4500 + "2" + ",)" * 2000, "<f8"),
        ("-" * 9000 + "2", "<f8"),
        ("(__import__('os').getpid(),)", "<f8"),
    ],
)
def test_a_header_that_promises_what_is_not_there_is_refused(tmp_path: Path, shape: str, descr: str) -> None:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    body = b"" if descr in ("|V0", "<U0") or shape.startswith("(0") else b"\0" * 16
    for version in ((1, 0), (2, 0)):
        refused(archive_of(tmp_path / "liar.npz", ("a.npy", with_header(header, body, version))))


def test_other_members_formats_and_packings_are_refused(tmp_path: Path) -> None:
    good = npy_bytes(np.arange(3.0))
    assert "holds 'readme.txt'" in refused(archive_of(tmp_path / "a.npz", ("x.npy", good), ("readme.txt", b"hello")))
    refused(archive_of(tmp_path / "b.npz", ("x.npy", good.replace(b"NUMPY\x01\x00", b"NUMPY\x03\x00"))))
    refused(archive_of(tmp_path / "c.npz", ("x.npy", b"")))
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        assert "packed in a way" in refused(archive_of(tmp_path / "d.npz", ("x.npy", good), method=method))
    with pytest.warns(UserWarning, match="Duplicate name"):
        archive_of(tmp_path / "e.npz", ("x.npy", good), ("x.npy", good))
    assert "two arrays of the same name" in refused(tmp_path / "e.npz")


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    content = bytearray(archive_of(tmp_path / "a.npz", ("x.npy", npy_bytes(np.arange(3.0)))).read_bytes())
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.npz").write_bytes(content)
    refused(tmp_path / "a.npz")


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for index in range(9):
            with archive.open(f"x{index}.npy", "w") as member:
                member.write(b"\x93NUMPY\x01\x00")
                for _ in range(8):
                    member.write(bytes(2**20))
    with pytest.raises(InputError, match="unpacks to more than 33554432 bytes"):
        read_npz(path, max_bytes=32 * 2**20)
    # A directory that understates the size is found out by what the member holds.
    content = path.read_bytes()
    lying = content.replace(struct.pack("<I", 8 * 2**20 + 8), struct.pack("<I", 64))
    path.write_bytes(lying)
    refused(path)


def test_the_limit_stands_in_the_way_of_the_default_too(tmp_path: Path) -> None:
    # A local and a central entry that both declare 1 GiB, above the limit, for a few stored bytes.
    path = archive_of(tmp_path / "big.npz", ("x.npy", npy_bytes(np.arange(3.0))))
    size = len(npy_bytes(np.arange(3.0)))
    path.write_bytes(path.read_bytes().replace(struct.pack("<I", size), struct.pack("<I", 2**30)))
    assert "unpacks to more than" in refused(path)


def test_every_truncation_is_refused(sample: Path) -> None:
    content = sample.read_bytes()
    for length in [*range(0, 60), *range(60, len(content), 41), len(content) - 1]:
        sample.write_bytes(content[:length])
        refused(sample)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_flipped_bit_is_refused_or_changes_no_array(tmp_path: Path, method: int) -> None:
    rng = random.Random(method)
    arrays = {"a": np.arange(40.0), "b": np.array("text")}
    members = [(f"{name}.npy", npy_bytes(array)) for name, array in arrays.items()]
    path = archive_of(tmp_path / "flip.npz", *members, method=method)
    content = path.read_bytes()
    refusals = 0
    for position in range(len(content)):
        flipped = bytearray(content)
        flipped[position] ^= 1 << rng.randrange(8)
        path.write_bytes(flipped)
        try:
            back = read_npz(path)
        except InputError:
            refusals += 1
        else:
            # Dates, attributes and the like carry nothing; a name may change, and its reader then misses it.
            assert sorted(array.tobytes() for array in back.values()) == sorted(a.tobytes() for a in arrays.values())
    assert refusals > len(content) // 2


def test_what_is_no_npz_is_refused(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "absent.npz")
    assert "no such file" in refused(tmp_path)
    for content in (b"", b"<html></html>", npy_bytes(np.arange(3)), b"PK\x05\x06"):
        (tmp_path / "a.npz").write_bytes(content)
        refused(tmp_path / "a.npz")
