"""Check artifacts against the provenance they carry: is the content what was written, are the inputs still the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hrt_cli.artifacts.carriers import json_provenance, npz_provenance
from hrt_cli.artifacts.drivelog import drive_provenance
from hrt_cli.artifacts.html import html_provenance
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import Provenance, file_sha256
from hrt_cli.artifacts.stage import ReadProvenance
from hrt_cli.errors import HrtError, InputError
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.steering.onnx.file import onnx_provenance


def _model_provenance(path: Path) -> Provenance | None:
    # Only here: PyTorch takes a second to import.
    from hrt_cli.steering.network.model import model_provenance

    return model_provenance(path)


_READERS: dict[str, ReadProvenance] = {
    ".tif": cog_provenance,
    ".tiff": cog_provenance,
    ".npz": npz_provenance,
    ".json": json_provenance,
    ".geojson": json_provenance,
    ".png": png_provenance,
    ".jsonl": drive_provenance,
    ".onnx": onnx_provenance,
    ".html": html_provenance,
    ".safetensors": _model_provenance,
}

Verdict = Literal["ok", "changed", "damaged", "unsigned"]


@dataclass(frozen=True)
class Verification:
    """The verdict on one file.

    Attributes
    ----------
    path : Path
    verdict : {"ok", "changed", "damaged", "unsigned"}
        As recorded; an input found beside it has changed since; its own content is not what was written; it carries
        no provenance.
    detail : str
        What was found, in one clause.
    inputs_checked, inputs_absent : int
        Inputs found (by name, in the artifact's folder or the folders given) and not found.
    """

    path: Path
    verdict: Verdict
    detail: str
    inputs_checked: int
    inputs_absent: int


def carries_provenance(path: Path) -> bool:
    """Whether a file is, by its name, of a kind that can carry provenance."""
    return path.suffix.lower() in _READERS


def read_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a file of such a kind and check its content against it; None if it carries none.

    Raises
    ------
    InputError
        The file cannot be read, is of no such kind, or its content is not what was written.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, f"is no artifact: {', '.join(_READERS)} carry provenance")
    return reader(path)


def verify_file(path: Path, folders: tuple[Path, ...] = ()) -> Verification:
    """Re-check one artifact.

    Parameters
    ----------
    path : Path
        A GeoTIFF, NPZ, JSON, PNG, drive log, report, or a steering model, exported or not.
    folders : tuple of Path
        Where to look for its inputs besides its own folder.

    Raises
    ------
    InputError
        There is no such file, or it is of no kind that carries provenance.
    """
    if not path.is_file():
        raise InputError(path, "no such file")
    if not carries_provenance(path):
        raise InputError(path, f"is no artifact: {', '.join(_READERS)} carry provenance")
    try:
        provenance = read_provenance(path)
    except HrtError as error:
        return Verification(path, "damaged", str(error).removeprefix(f"{path}: "), 0, 0)
    if provenance is None:
        return Verification(path, "unsigned", "carries no provenance", 0, 0)
    return _check_inputs(path, provenance, (path.parent, *folders))


def _check_inputs(path: Path, provenance: Provenance, folders: tuple[Path, ...]) -> Verification:
    checked = 0
    for record in provenance.inputs:
        found = [folder / record.name for folder in folders if (folder / record.name).is_file()]
        if not found:
            continue
        checked += 1
        if all(file_sha256(candidate) != record.sha256 for candidate in found):
            detail = f"its input {record.name} has changed since"
            return Verification(path, "changed", detail, checked, len(provenance.inputs) - checked)
    made = f"made by hrt {provenance.version} {provenance.stage}"
    return Verification(path, "ok", made, checked, len(provenance.inputs) - checked)
