"""`hrt verify`: artifacts against the provenance they carry."""

from __future__ import annotations

from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.errors import DifferenceError
from hrt_cli.manual import Command
from hrt_cli.progress import Console


@click.command(
    cls=Command,
    difference="a file is not what was written, an input has changed, or there is no provenance",
    keys=("files",),
    see_also=("inspect",),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 5
  hrt verify site/classes.tif
""",
)
@click.argument("files", nargs=-1, required=True, type=opt.PATH)
@click.option("--inputs", "folders", multiple=True, type=opt.FOLDER, help="Folder to look for inputs in.")
@opt.console_options
def verify(files: tuple[Path, ...], folders: tuple[Path, ...], console: Console) -> None:
    """Check artifacts against the provenance they carry.

    For each file: is its content what was written, and are its inputs, where they lie in the same folder (or in one
    given by --inputs), still the bytes it was made from? Exits with 3 if not, or if a file carries no provenance.
    """
    from hrt_cli.evaluation.verify import verify_file

    found = [verify_file(path, folders) for path in files]
    lines = [
        f"{v.path}: {v.verdict}, {v.detail}; {v.inputs_checked} inputs checked, {v.inputs_absent} not found"
        for v in found
    ]
    results = [
        {
            "file": str(v.path),
            "verdict": v.verdict,
            "detail": v.detail,
            "inputs_checked": v.inputs_checked,
            "inputs_absent": v.inputs_absent,
        }
        for v in found
    ]
    console.result("\n".join(lines), {"files": results}, only_here=True)
    bad = [v for v in found if v.verdict != "ok"]
    if bad:
        raise DifferenceError(f"{bad[0].path}: {bad[0].detail} ({len(bad)} of {len(found)} files failed)")
