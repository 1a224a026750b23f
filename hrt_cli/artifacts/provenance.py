"""Provenance: which tool, parameters and input bytes made an artifact, and a hash of what it holds."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

from pydantic import Field, JsonValue

from hrt_cli import __version__
from hrt_cli.artifacts.jsonio import Document, canonical
from hrt_cli.errors import InputError


class InputRecord(Document):
    """One input: its bare name (never its folder: artifacts do not depend on where they were made) and bytes."""

    role: str
    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    size: int = Field(ge=0)


class Provenance(Document):
    """What made an artifact.

    `fingerprint` covers the stage, its version, the parameters and the input bytes: two runs with the same
    fingerprint give the same bytes. `content_sha256` covers what the artifact holds.
    """

    tool: str
    version: str
    stage: str
    stage_version: int
    parameters: dict[str, JsonValue]
    inputs: list[InputRecord]
    fingerprint: str = Field(pattern="^[0-9a-f]{64}$")
    content_sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$")

    def with_content(self, sha256: str) -> Provenance:
        """Return a copy that records the hash of the artifact's content."""
        return self.model_copy(update={"content_sha256": sha256})


def file_sha256(path: Path) -> str:
    """Hash a file's bytes in constant memory."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def record(stage: str, stage_version: int, parameters: dict[str, Any], inputs: dict[str, Path]) -> Provenance:
    """Hash the inputs and take the fingerprint of a run.

    Parameters
    ----------
    stage : str
        The command, and `stage_version` a number raised whenever the same inputs would give another result.
    parameters : dict
        All that changes the result, as JSON values (never `--workers`, verbosity or file names).
    inputs : dict of str to Path
        Input files by role.
    """
    records = []
    for role, path in inputs.items():
        if not path.is_file():
            raise InputError(path, "no such file")
        # A name that is not UTF-8 has no place in JSON.
        name = os.fsencode(path.name).decode("utf-8", "backslashreplace")
        records.append(InputRecord(role=role, name=name, sha256=file_sha256(path), size=path.stat().st_size))
    what = {
        "stage": stage,
        "stage_version": stage_version,
        "parameters": parameters,
        "inputs": [[r.role, r.sha256] for r in records],
    }
    return Provenance(
        tool="hrt",
        version=__version__,
        stage=stage,
        stage_version=stage_version,
        parameters=parameters,
        inputs=records,
        fingerprint=hashlib.sha256(canonical(what)).hexdigest(),
    )
