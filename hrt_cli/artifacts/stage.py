"""The caching rule: one decision, taken before any work, for every stage that writes an artifact.

An output made from the same inputs and parameters is "up to date" and left alone; anything else that stands in its
place is refused unless `--overwrite`; `--force` recomputes even what is up to date.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.provenance import Provenance, record
from hrt_cli.artifacts.publish import check_target
from hrt_cli.errors import HrtError, OutputError

ReadProvenance = Callable[[Path], Provenance | None]
"""Return the provenance in a file, checking that the content is what it says; None if it carries none."""


@dataclass(frozen=True)
class Existing:
    """What to do where an output already exists (`--overwrite`, `--force`)."""

    overwrite: bool = False
    force: bool = False


REFUSE = Existing()
"""Leave what exists alone unless it is up to date."""


@dataclass(frozen=True)
class Job:
    """A stage about to run: its provenance, and whether each of its outputs is already there."""

    provenance: Provenance
    up_to_date: bool


def begin(
    stage: str,
    stage_version: int,
    *,
    inputs: dict[str, Path],
    parameters: dict[str, Any],
    outputs: Mapping[Path, ReadProvenance],
    existing: Existing,
) -> Job:
    """Decide whether a stage has to run.

    Parameters
    ----------
    stage, stage_version, parameters, inputs
        As in `provenance.record`.
    outputs : mapping of Path to callable
        Each output file and how to read its provenance.
    existing : Existing
        What the user allows.

    Raises
    ------
    OutputError
        An output exists, differs, and may not be overwritten; or cannot be written at all.
    """
    for path in outputs:
        check_target(path, list(inputs.values()))
    provenance = record(stage, stage_version, parameters, inputs)
    if existing.force:
        return Job(provenance, up_to_date=False)
    states = {path: _is_current(path, read, provenance) for path, read in outputs.items() if path.exists()}
    if len(states) == len(outputs) and all(states.values()):
        freshen(list(outputs), list(inputs.values()))
        return Job(provenance, up_to_date=True)
    for path, current in states.items():
        if not (current or existing.overwrite):
            raise OutputError(
                f"{path}: exists and was not made by this run; use --overwrite to replace it (it was "
                "made from other inputs or parameters, or by another program)"
            )
    return Job(provenance, up_to_date=False)


def _is_current(path: Path, read: ReadProvenance, wanted: Provenance) -> bool:
    try:
        found = read(path)
    except HrtError:
        return False  # damaged or foreign: not ours to keep, and not ours to replace unasked
    return found is not None and found.fingerprint == wanted.fingerprint


def freshen(outputs: list[Path], inputs: list[Path]) -> None:
    """Make outputs no older than their inputs, so that `make` does not ask for them again."""
    newest = max((path.stat().st_mtime_ns for path in inputs), default=0)
    for path in outputs:
        if path.stat().st_mtime_ns < newest:
            # An input written by a machine whose clock is ahead may be newer than the present.
            now = max(newest, time.time_ns())
            with suppress(PermissionError):
                os.utime(path, ns=(now, now))
