from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli.artifacts.jsonio import MAX_DEPTH, Document, canonical, parse_strict, read_model, read_text, to_text
from hrt_cli.errors import InputError

HERE = Path("some.json")


class Sample(Document):
    count: int
    share: float
    name: str = ""


def written(tmp_path: Path, content: bytes | str) -> Path:
    path = tmp_path / "some.json"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def nested(depth: int) -> str:
    return "[" * depth + "]" * depth


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"a": NaN}', "NaN is not a number"),
        ('{"a": [Infinity]}', "Infinity is not a number"),
        ('{"a": -Infinity}', "-Infinity is not a number"),
        ('{"a": 1e999}', "the number 1e999 is too large"),
        ('{"a": -1e999}', "the number -1e999 is too large"),
        ('{"a": 1, "b": 2, "a": 1}', "the key 'a' stands twice"),
        ('{"a": 1, "\\u0061": 2}', "the key 'a' stands twice"),
        ('{"x": [{"y": {"b": 0, "b": 0}}]}', "the key 'b' stands twice"),
        (nested(100_000), "nested deeper than"),
        ('{"a":' * 100_000, "nested deeper than"),
        (nested(MAX_DEPTH + 1), "nested deeper than"),
        ("", "is not valid JSON"),
        (" \n", "is not valid JSON"),
        ('{"a": 1} x', "is not valid JSON"),
        ('{"a": 1}{"a": 1}', "is not valid JSON"),
        ('{"a": 1', "is not valid JSON"),
        ("{'a': 1}", "is not valid JSON"),
        ('{"a": 01}', "is not valid JSON"),
        ('{"a": .5}', "is not valid JSON"),
        ('{"a": "\n"}', "is not valid JSON"),
        ('{"a": 1,}', "is not valid JSON"),
        ("<!DOCTYPE html>", "is not valid JSON"),
        ("9" * 5000, "is not valid JSON"),
    ],
)
def test_what_is_not_strict_json_is_refused(text: str, problem: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse_strict(HERE, text)
    assert str(refusal.value).startswith("some.json: ")
    assert problem in str(refusal.value)
    assert len(str(refusal.value)) < 300


def test_every_depth_is_taken_or_refused_and_what_is_taken_can_be_hashed() -> None:
    for depth in [*range(1, MAX_DEPTH + 3), *range(900, 1100)]:
        try:
            canonical(parse_strict(HERE, nested(depth)))
        except InputError:
            assert depth > MAX_DEPTH
        else:
            assert depth <= MAX_DEPTH


def test_a_duplicate_among_many_keys_is_found_quickly() -> None:
    members = ", ".join(f'"{key}": 0' for key in range(200_000))
    began = time.process_time()
    with pytest.raises(InputError, match="the key '199999' stands twice"):
        parse_strict(HERE, f'{{{members}, "199999": 1}}')
    assert time.process_time() - began < 5


@pytest.mark.parametrize("content", [b"\xff\xfe{\x00}\x00", '{"a": 1}'.encode("utf-16-be"), b'{"a": "\xe9"}', b"\x80"])
def test_other_encodings_are_refused(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path, content)
    with pytest.raises(InputError, match=r"some\.json: is not"):
        parse_strict(path, read_text(path))


def test_a_byte_order_mark_and_unicode_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, b"\xef\xbb\xbf" + '{"count": 1, "share": 0.5, "name": "Grüße 🗺"}'.encode())
    assert read_model(path, Sample) == Sample(count=1, share=0.5, name="Grüße 🗺")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('{"count": 1}', "share: Field required"),
        ('{"count": 1, "share": 0.5, "more": 1}', "more: Extra inputs"),
        ('{"count": 1.0, "share": 0.5}', "count: "),
        ('{"count": "1", "share": 0.5}', "count: "),
        ('{"count": true, "share": 0.5}', "count: "),
        ('{"count": 1, "share": "0.5"}', "share: "),
        ('{"count": 1, "share": null}', "share: "),
        (f'{{"count": 1, "share": {"9" * 400}}}', "share: "),
        ('{"count": 1, "share": 0.5, "name": "\\ud800"}', ""),
        ("[]", "the document: "),
        ("null", "the document: "),
        ('"text"', "the document: "),
    ],
)
def test_a_document_that_is_not_the_model_is_refused(tmp_path: Path, text: str, where: str) -> None:
    with pytest.raises(InputError) as refusal:
        read_model(written(tmp_path, text), Sample)
    assert f"some.json: {where}" in str(refusal.value)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_text(tmp_path / "absent.json")
    with pytest.raises(InputError, match="no such file"):
        read_text(tmp_path)
    with pytest.raises(InputError, match="is 11 bytes long, more than the 10"):
        read_text(written(tmp_path, "x" * 11), max_bytes=10)


# No lone surrogates: they have no UTF-8.
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4), max_leaves=20
)


@settings(deadline=None)
@given(st.dictionaries(texts, values, max_size=5))
def test_what_to_text_writes_is_read_back_the_same(document: dict[str, Any]) -> None:
    text = to_text(document)
    back = parse_strict(HERE, text)
    assert back == document
    assert list(back) == list(document)
    assert to_text(back) == text
    assert canonical(back) == canonical(document)


@settings(deadline=None)
@given(st.recursive(scalars | st.just(math.nan) | st.just(math.inf), st.lists, max_leaves=8))
def test_parse_strict_takes_exactly_what_has_no_nan(value: Any) -> None:
    text = json.dumps(value)
    if "NaN" in text or "Infinity" in text:
        strings = [part for part in text.split('"')[1::2] if "NaN" in part or "Infinity" in part]
        if not strings:
            with pytest.raises(InputError):
                parse_strict(HERE, text)
    else:
        assert parse_strict(HERE, text) == value


def test_to_text_puts_one_item_a_line() -> None:
    document = {"a": 1, "items": [{"x": 1}, {"x": 2}], "by_id": {"0": {"y": 1}, "1": {"y": 2}}, "list": [1, 2]}
    assert to_text(document) == (
        '{\n  "a": 1,\n  "items": [\n    {"x": 1},\n    {"x": 2}\n  ],\n'
        '  "by_id": {\n    "0": {"y": 1},\n    "1": {"y": 2}\n  },\n  "list": [1, 2]\n}\n'
    )


@pytest.mark.parametrize("bad", [math.nan, math.inf, [math.nan], [{"x": -math.inf}], {"k": {"x": math.nan}}])
def test_what_is_no_json_number_is_never_written(bad: Any) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        to_text({"a": bad})
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical(bad)


@settings(deadline=None)
@given(st.dictionaries(texts, scalars, max_size=6))
def test_canonical_bytes_do_not_depend_on_the_order_of_members(document: dict[str, Any]) -> None:
    assert canonical(document) == canonical(dict(reversed(document.items())))
