"""`hrt init`: a ready project folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing

_NAMED = 6
"""Files up to which they are named."""


@click.command(
    cls=Command,
    keys=("output", "files", "up_to_date"),
    see_also=("synth", "inspect"),
    epilog="""\b
Example:
  hrt init survey
  # put your orthomosaic at survey/ortho.tif, then: make -C survey
""",
)
@click.argument("folder", type=opt.File("FOLDER", writes=True))
@opt.existing_options
@opt.console_options
def init(folder: Path, existing: Existing, console: Console) -> None:
    """Make a project FOLDER with the workflows (make and snakemake) and their config.yaml."""
    from hrt_cli.project import create_project

    written = create_project(folder, existing=existing)
    names = ", ".join(str(path.relative_to(folder)) for path in written) or "nothing, all is there"
    what = names if len(written) <= _NAMED else f"{len(written)} files"
    console.result(
        f"{folder}: wrote {what}; edit config.yaml, then run make -C {folder}, or snakemake in it",
        {"output": str(folder), "files": [str(path) for path in written], "up_to_date": not written},
    )
