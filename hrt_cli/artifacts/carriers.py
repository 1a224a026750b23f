"""How JSON and NPZ files carry their provenance: written, read back and checked in one place each."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from hrt_cli.artifacts import jsonio, npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError

_KEY = "provenance"


def publish_json(target: Path, document: dict[str, Any], provenance: Provenance) -> None:
    """Publish a JSON object with its provenance as the last member."""
    stamped = provenance.with_content(_json_sha256(document))
    text = jsonio.to_text({**document, _KEY: stamped.model_dump(mode="json")})
    with publishing(target, json_provenance) as draft:
        draft.write_text(text, encoding="utf-8")


def read_stamped_json(path: Path) -> tuple[dict[str, Any], Provenance | None]:
    """Read a JSON object and its provenance, against which the rest is checked; None where it bears none."""
    document = jsonio.parse_strict(path, jsonio.read_text(path))
    if not isinstance(document, dict):
        return {}, None
    if _KEY not in document:
        return document, None
    found = parse_provenance(path, document.pop(_KEY))
    return document, checked(path, found, _json_sha256(document))


def json_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a JSON object and check its content against it."""
    return read_stamped_json(path)[1]


def publish_npz(target: Path, arrays: npz.Arrays, provenance: Provenance) -> None:
    """Publish arrays with their provenance as the array `provenance` (a JSON string)."""
    stamped = provenance.with_content(npz.content_sha256(arrays))
    text = jsonio.canonical(stamped.model_dump(mode="json")).decode()
    with publishing(target, npz_provenance) as draft:
        npz.write_npz(draft, {**arrays, _KEY: np.array(text)})


def npz_provenance(path: Path) -> Provenance | None:
    """Read the provenance of an NPZ file and check its arrays against it."""
    return read_stamped_npz(path)[1]


def read_stamped_npz(path: Path) -> tuple[npz.Arrays, Provenance | None]:
    """Read an NPZ file: its arrays, and its provenance if it has one (then the arrays are checked against it)."""
    arrays = npz.read_npz(path)
    text = arrays.pop(_KEY, None)
    if text is None:
        return arrays, None
    found = parse_provenance(path, jsonio.parse_strict(path, str(text)))
    return arrays, checked(path, found, npz.content_sha256(arrays))


def parse_provenance(path: Path, value: Any) -> Provenance:
    """Validate a provenance record found in `path`."""
    try:
        return Provenance.model_validate_json(json.dumps(value))
    except ValidationError as error:
        raise InputError(path, "its provenance record is damaged") from error


def checked(path: Path, provenance: Provenance, content_sha256: str) -> Provenance:
    """Return `provenance` if the content is what it recorded, else refuse the file."""
    if provenance.content_sha256 != content_sha256:
        raise InputError(path, "its content is not what its provenance recorded: damaged or edited by hand")
    return provenance


def _json_sha256(document: dict[str, Any]) -> str:
    return hashlib.sha256(jsonio.canonical(document)).hexdigest()
