"""What made two artifacts, by the provenance that they carry: to tell, never to judge by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.stage import ReadProvenance
from hrt_cli.errors import InputError
from hrt_cli.progress import Note


def read_origin(path: Path, read: ReadProvenance, note: Note) -> Provenance | None:
    """Read the provenance of a file; a content that is not what it recorded is told, and compared as it stands."""
    try:
        return read(path)
    except InputError as error:
        note(f"Note: {error}")
        return None


def compare_origins(a: Provenance | None, b: Provenance | None) -> dict[str, Any]:
    """Return what two records of provenance have in common, as JSON values; None where one is missing."""
    if a is None or b is None:
        return {"same_inputs": None, "same_parameters": None, "differing_parameters": []}
    differing = sorted(key for key in {*a.parameters, *b.parameters} if a.parameters.get(key) != b.parameters.get(key))
    return {
        "same_inputs": _inputs(a) == _inputs(b),
        "same_parameters": not differing and (a.stage, a.stage_version) == (b.stage, b.stage_version),
        "differing_parameters": differing,
    }


def _inputs(record: Provenance) -> set[tuple[str, str]]:
    return {(each.role, each.sha256) for each in record.inputs}
