"""Strict JSON: what is not plainly valid is refused, never guessed at.

Python's `json` accepts NaN, lets the last of two equal keys win and recurses without bound; here all three are
refused, and a pydantic model with unknown keys forbidden says what the document must hold.
"""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from hrt_cli.errors import InputError

MAX_BYTES = 256 * 2**20
MAX_DEPTH = 64


class Document(BaseModel):
    """Base of every JSON document: immutable, no unknown keys, no coercion, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


_TOO_DEEP = f"is nested deeper than {MAX_DEPTH} levels"

M = TypeVar("M", bound=BaseModel)


def read_model(path: Path, model: type[M]) -> M:
    """Read a JSON file as `model`.

    Raises
    ------
    InputError
        The file is absent, too large, not UTF-8, not strict JSON, or not what `model` describes.
    """
    text = read_text(path)
    parse_strict(path, text)
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        raise InputError(path, describe(error)) from error


def describe(error: ValidationError) -> str:
    """Say in one clause where a document is not what its model asks for."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"]) or "the document"
    return f"{where}: {first['msg']}"


def read_text(path: Path, max_bytes: int = MAX_BYTES) -> str:
    """Read a UTF-8 text file (with or without a byte-order mark) of at most `max_bytes`."""
    try:
        if not path.is_file():
            raise InputError(path, "no such file")
        size = path.stat().st_size
        if size > max_bytes:
            raise InputError(path, f"is {size} bytes long, more than the {max_bytes} that are read")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "is not a UTF-8 text file") from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def parse_strict(path: Path, text: str) -> Any:
    """Parse JSON text, refusing NaN, infinities, duplicate keys and deep nesting (`path` is for the message)."""

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        seen = dict(items)
        if len(seen) != len(items):
            ((twice, _),) = Counter(key for key, _ in items).most_common(1)
            raise InputError(path, f"the key {twice!r} stands twice in one object")
        return seen

    def constant(name: str) -> Any:
        raise InputError(path, f"{name} is not a number that JSON allows")

    def real(digits: str) -> float:
        value = float(digits)
        if not math.isfinite(value):
            raise InputError(path, f"the number {digits} is too large")
        return value

    try:
        document = json.loads(text, object_pairs_hook=pairs, parse_constant=constant, parse_float=real)
    except json.JSONDecodeError as error:
        raise InputError(path, f"is not valid JSON: {error.msg} at line {error.lineno}") from error
    except RecursionError as error:
        raise InputError(path, _TOO_DEEP) from error
    except ValueError as error:
        raise InputError(path, f"is not valid JSON: {error}") from error
    if _is_deeper(document, MAX_DEPTH):
        raise InputError(path, _TOO_DEEP)
    return document


def to_text(document: dict[str, Any]) -> str:
    """Write a JSON object with one top-level member a line; members that are lists of objects one item a line."""
    lines = [f"  {json.dumps(key)}: {_member(value)}" for key, value in document.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def canonical(value: Any) -> bytes:
    """Return the bytes that hashes are taken over: sorted keys, no white space."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _is_deeper(value: Any, depth: int) -> bool:
    # Level by level: what the parser could just recurse through must not overflow whatever recurses next.
    level = [value]
    for _ in range(depth):
        inside = [node.values() if isinstance(node, dict) else node for node in level if isinstance(node, dict | list)]
        level = list(itertools.chain.from_iterable(inside))
        if not level:
            return False
    return True


def _member(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(f"    {json.dumps(item, allow_nan=False)}" for item in value) + "\n  ]"
    if isinstance(value, dict) and value and all(isinstance(item, dict) for item in value.values()):
        inner = [f"    {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in value.items()]
        return "{\n" + ",\n".join(inner) + "\n  }"
    return json.dumps(value, allow_nan=False)
