"""The export stage: a plan becomes a mission file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.publish import check_target, publishing
from hrt_cli.artifacts.stage import REFUSE, Existing, freshen
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.missions.formats import export_text, format_for
from hrt_cli.missions.mission import MissionOptions


@dataclass(frozen=True)
class Export:
    """What the export stage wrote: the format, the number of waypoints, and whether the file was already so."""

    up_to_date: bool
    format: str
    waypoints: int
    length_m: float


def export_file(
    plan_path: Path,
    output: Path,
    options: MissionOptions,
    *,
    format_name: str | None = None,
    existing: Existing = REFUSE,
) -> Export:
    """Write the plan in `plan_path` as a mission.

    Mission formats have no room for provenance, so the rule of the caching reads: a file with these very bytes is up
    to date, any other is refused unless it may be overwritten.

    Raises
    ------
    InputError
        The plan cannot be used.
    ArgumentError
        The format is not known.
    OutputError
        The output exists and differs, or cannot be written.
    """
    target = format_for(output, format_name)
    check_target(output, [plan_path])
    plan = read_plan(plan_path)
    try:
        content = export_text(plan, options, target).encode("utf-8")
    except ArgumentError as error:
        raise InputError(plan_path, str(error)) from error
    summary = (target.name, len(plan.waypoints), plan.length_m)
    if output.exists() and not existing.force:
        if output.read_bytes() == content:
            freshen([output], [plan_path])
            return Export(True, *summary)
        if not existing.overwrite:
            raise OutputError(f"{output}: exists and differs; use --overwrite to replace it")

    def check(draft: Path) -> None:
        if draft.read_bytes() != content:
            raise OutputError(f"{output}: did not read back as it was written (is the disk full?)")

    with publishing(output, check) as draft:
        draft.write_bytes(content)
    return Export(False, *summary)
