"""The ONNX container: what is written is read, by others too, and nothing else is taken for it."""

from __future__ import annotations

import hashlib
from pathlib import Path

import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.evaluation.verify import verify_file
from hrt_cli.steering.onnx import file as onnx_file
from hrt_cli.steering.onnx.file import onnx_provenance, publish_onnx, read_onnx

DOCUMENT = {"format": "test", "text": "größer" * 40}
NO_CHECK = bool


def tiny(**properties: str) -> bytes:
    import numpy as np

    weight = numpy_helper.from_array(np.arange(300, dtype=np.float32), "w")
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [300]) for name in "xy")
    graph = helper.make_graph([helper.make_node("Add", ["x", "w"], ["y"])], "g", [x], [y], [weight])
    model = helper.make_model(graph)
    helper.set_model_props(model, properties)
    return model.SerializeToString(deterministic=True)


@pytest.fixture
def put(tmp_path: Path) -> Path:
    path = tmp_path / "m.onnx"
    publish_onnx(path, tiny(), DOCUMENT, record("test", 1, {}, {}), NO_CHECK)
    return path


def test_what_is_written_is_read(put: Path) -> None:
    model, document, provenance = read_onnx(put)
    assert (model, document) == (tiny(), DOCUMENT)
    assert provenance.stage == "test"
    assert onnx_provenance(put) == provenance


def test_others_read_it(put: Path) -> None:
    model = onnx.load(put)
    onnx.checker.check_model(model, full_check=True)
    assert [entry.key for entry in model.metadata_props] == ["hrt"]
    helper.set_model_props(model, {})
    assert model.SerializeToString(deterministic=True) == tiny()


def test_metadata_of_others_is_part_of_the_model(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    publish_onnx(path, tiny(author="somebody"), DOCUMENT, record("test", 1, {}, {}), NO_CHECK)
    assert read_onnx(path)[0] == tiny(author="somebody")
    assert {entry.key for entry in onnx.load(path).metadata_props} == {"author", "hrt"}


def test_no_flipped_bit_changes_what_is_read(put: Path) -> None:
    whole, noticed = put.read_bytes(), 0
    places = range(0, len(whole), 3)
    for at in places:
        put.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :])
        try:
            # Who made it and from what is told, not hashed, as in every artifact.
            assert read_onnx(put)[:2] == (tiny(), DOCUMENT)
        except InputError:
            noticed += 1
    assert noticed > 0.9 * len(places)


def test_a_file_cut_anywhere_is_noticed(put: Path) -> None:
    whole = put.read_bytes()
    for length in range(0, len(whole), 5):
        put.write_bytes(whole[:length])
        with pytest.raises(InputError):
            read_onnx(put)
    put.write_bytes(whole + whole)
    with pytest.raises(InputError, match="not what its provenance recorded"):
        read_onnx(put)


@given(st.binary(max_size=60))
def test_any_bytes_are_refused_in_one_line(data: bytes) -> None:
    with pytest.raises(InputError):
        onnx_file._split(Path("m.onnx"), data)


@pytest.mark.parametrize("properties", [{}, {"author": "somebody"}])
def test_a_file_of_others_is_refused(tmp_path: Path, properties: dict[str, str]) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(tiny(**properties))
    with pytest.raises(InputError, match=r"m\.onnx: is no ONNX file that hrt wrote"):
        read_onnx(path)
    with pytest.raises(InputError, match="no such file"):
        read_onnx(tmp_path / "n.onnx")


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"provenance": {}}', '{"provenance": null}', "\udcff"])
def test_a_damaged_description_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "m.onnx"
    value = text.encode("utf-8", "surrogateescape")
    entry = onnx_file._field(1, b"hrt") + onnx_file._field(2, value)
    path.write_bytes(tiny() + onnx_file._field(14, entry))
    with pytest.raises(InputError, match=r"m\.onnx"):
        read_onnx(path)


def test_a_file_that_does_not_pass_is_not_published(tmp_path: Path) -> None:
    def refuse(draft: Path) -> None:
        assert draft.stat().st_size > 1000
        raise InputError("x", "is not good enough")

    with pytest.raises(InputError, match="not good enough"):
        publish_onnx(tmp_path / "m.onnx", tiny(), DOCUMENT, record("test", 1, {}, {}), refuse)
    assert list(tmp_path.iterdir()) == []


@given(st.integers(0, 2**63))
def test_numbers_are_written_as_protobuf_writes_them(value: int) -> None:
    written = onnx_file._as_varint(value)
    assert onnx_file._varint(written + b"\xff", 0) == (value, len(written))
    assert (len(written) == 1) == (value < 128)


def test_it_is_verified_like_any_artifact(put: Path) -> None:
    assert verify_file(put).verdict == "ok"
    whole = put.read_bytes()
    put.write_bytes(whole[:200] + bytes([whole[200] ^ 4]) + whole[201:])
    assert verify_file(put).verdict == "damaged"


def test_the_hash_covers_model_and_description(put: Path) -> None:
    _, _, provenance = read_onnx(put)
    text = b'{"format":"test","text":"' + ("gr\\u00f6\\u00dfer" * 40).encode() + b'"}'
    assert provenance.content_sha256 == hashlib.sha256(text + b"\n" + tiny()).hexdigest()
