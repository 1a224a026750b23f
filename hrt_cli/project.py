"""A project folder: the workflow files and their config, copied out of the package."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from hrt_cli.artifacts.publish import publishing
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import OutputError

WORKFLOW_FILES = (
    "Makefile",
    "Snakefile",
    "common.smk",
    "rounds.mk",
    "rounds.smk",
    "rounds_common.smk",
    "steer.mk",
    "steer.smk",
    "steer_common.smk",
    "config.yaml",
    "config.schema.yaml",
    "sites.schema.yaml",
    "profiles/default/config.yaml",
    "profiles/slurm/config.yaml",
    *(
        f"report/{name}.rst"
        for name in (
            "workflow",
            "classes",
            "scoremap",
            "plan",
            "mission",
            "policy",
            "rewards",
            "summary",
            "round",
            "steering",
        )
    ),
)


def create_project(folder: Path, *, existing: Existing = REFUSE) -> list[Path]:
    """Copy the workflow files into `folder` (made if absent, as are folders in it); return those that were written.

    Files that are the same already are left alone.

    Raises
    ------
    OutputError
        A file of that name exists and differs, or the folder cannot be made.
    """
    for place in sorted({(folder / name).parent for name in WORKFLOW_FILES}):
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{place}: cannot be made: {error.strerror}") from error
    packaged = resources.files("hrt_pipelines")
    contents = {folder / name: packaged.joinpath(name).read_bytes() for name in WORKFLOW_FILES}
    differing = [path for path, content in contents.items() if path.exists() and path.read_bytes() != content]
    if differing and not (existing.overwrite or existing.force):
        raise OutputError(f"{differing[0]}: exists and differs; use --overwrite to replace it")
    wanted = [path for path in contents if not path.exists() or path in differing or existing.force]
    for path in wanted:
        content = contents[path]

        def check(draft: Path, content: bytes = content) -> None:
            if draft.read_bytes() != content:
                raise OutputError(f"{draft.name}: did not read back as it was written (is the disk full?)")

        with publishing(path, check) as draft:
            draft.write_bytes(content)
    return wanted
