"""Where everything comes from: each file with what made it, of what, and whether that is still what lies there."""

from __future__ import annotations

from typing import Any, Literal

from hrt_cli.artifacts.provenance import InputRecord
from hrt_cli.report.page.collect import Folder, Item, natural

Status = Literal["here", "changed", "elsewhere"]


def lineage(folder: Folder) -> list[dict[str, Any]]:
    """Return a row for each file: its kind, what made it with which parameters, and its inputs with their status.

    An input is `here` if a file of the folder has its bytes, `changed` if only one of its name does not, else
    `elsewhere`.
    """
    return [_row(folder, item) for item in sorted(folder.items, key=lambda each: natural(each.name))]


def _row(folder: Folder, item: Item) -> dict[str, Any]:
    made = item.provenance
    row: dict[str, Any] = {"name": item.name, "kind": item.kind, "problem": item.problem, "sha256": item.sha256}
    if made is None:
        return row
    inputs = [{"role": r.role, "name": r.name, "sha256": r.sha256, "status": status(folder, r)} for r in made.inputs]
    return row | {
        "stage": made.stage,
        "version": f"{made.tool} {made.version}",
        "parameters": _flat(made.parameters),
        "inputs": inputs,
        "fingerprint": made.fingerprint,
    }


def status(folder: Folder, record: InputRecord) -> Status:
    """Say whether the bytes that something was made from are in the folder."""
    same_size = [item for item in folder.items if item.size == record.size]
    if any(item.sha256 == record.sha256 for item in same_size):
        return "here"
    return "changed" if any(item.path.name == record.name for item in folder.items) else "elsewhere"


def _flat(value: Any, name: str = "") -> list[list[str]]:
    """Return nested parameters as pairs of dotted names and values."""
    if isinstance(value, dict) and value:
        return [pair for key, each in value.items() for pair in _flat(each, f"{name}.{key}" if name else key)]
    return [[name, "" if value is None else str(value)]]
