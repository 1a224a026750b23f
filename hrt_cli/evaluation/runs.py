"""Many plans in one table: of several sites, by several seeds, and what the seeds of one task make of its bound."""

from __future__ import annotations

import csv
import io
import os
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.jsonio import canonical, read_model
from hrt_cli.artifacts.plan import PlanDocument, TeamPlanDocument, read_plan, team_members
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import check_target, publishing
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import InputError, OutputError


@dataclass(frozen=True)
class Run:
    """One plan, a robot's or a team's.

    Attributes
    ----------
    task : str
        The name of its task, see `Task`.
    method : str
        Who planned.
    seed : int
        The planner's.
    score, discounted_score : float
        What it collects.
    fraction_of_bound, fraction_of_discounted_bound : float
        Shares of the bounds of its task; the second None where no plan of the task tells such a bound.
    steps : int
        Moves, of a team all robots' together, as is `length_m`.
    length_m, time_s : float
        Metres and seconds; of a team those of the robot that drives longest.
    """

    task: str
    method: str
    seed: int
    score: float
    discounted_score: float
    fraction_of_bound: float
    fraction_of_discounted_bound: float | None
    steps: int
    length_m: float
    time_s: float


@dataclass(frozen=True)
class Spread:
    """A figure over the plans of a task; `sd` with n - 1, None of one plan."""

    mean: float
    sd: float | None
    min: float
    max: float


@dataclass(frozen=True)
class Task:
    """Plans that differ in nothing but the seed: same map (by its bytes), start, budget, method and settings.

    Attributes
    ----------
    name : str
        The folder that all their files lie in, numbered from the second task of that folder.
    plans : list of str
        Their files.
    best : str
        The one that its objective likes best, the first of equals.
    upper_bound, discounted_upper_bound : float
        The least that any of the plans proves, which holds for all; the second None where none tells one.
    score, fraction_of_bound, length_m : Spread
        Over the plans.
    fraction_of_discounted_bound : Spread or None
        Likewise.
    """

    name: str
    method: str
    objective: str
    plans: list[str]
    best: str
    upper_bound: float
    discounted_upper_bound: float | None
    score: Spread
    fraction_of_bound: Spread
    fraction_of_discounted_bound: Spread | None
    length_m: Spread


@dataclass(frozen=True)
class Runs:
    """The plans by file, in the order given, and their tasks, in the order of their first plans."""

    plans: dict[str, Run]
    tasks: list[Task]


_Plan = PlanDocument | TeamPlanDocument


def compare_runs(paths: Sequence[Path]) -> Runs:
    """Put plans side by side, and say for each task what its seeds make of the bound.

    What the plans say of themselves is taken, which their provenance vouches for; the map is not looked at.

    Raises
    ------
    InputError
        A file is no plan that `hrt plan` wrote, was edited, or is the same plan as another.
    """
    tasks: dict[bytes, dict[Path, _Plan]] = {}
    seen: dict[str, Path] = {}
    for path in paths:
        plan, provenance = _read(path)
        if provenance.fingerprint in seen:
            raise InputError(path, f"is the same plan as {seen[provenance.fingerprint]}")
        seen[provenance.fingerprint] = path
        tasks.setdefault(_task_key(provenance), {})[path] = plan
    runs: dict[Path, Run] = {}
    told = []
    names: Counter[str] = Counter()
    for plans in tasks.values():
        folder = _folder(plans)
        names[folder] += 1
        name = folder if names[folder] == 1 else f"{folder} ({names[folder]})"
        task, its_runs = _measure(name, plans)
        told.append(task)
        runs |= its_runs
    return Runs({str(path): runs[path] for path in paths}, told)


def write_table(found: Runs, output: Path, *, existing: Existing = REFUSE) -> bool:
    """Write a row for each plan as CSV (UTF-8, a header); return whether the file was there already.

    Raises
    ------
    OutputError
        The file exists and differs, or cannot be written.
    """
    check_target(output, [Path(name) for name in found.plans])
    text = io.StringIO()
    rows = [{"plan": name} | asdict(run) for name, run in found.plans.items()]
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    if output.exists() and not existing.force:
        if output.read_bytes() == content:
            return True
        if not existing.overwrite:
            raise OutputError(f"{output}: exists and differs; use --overwrite to replace it")

    def check(draft: Path) -> None:
        if draft.read_bytes() != content:
            raise OutputError(f"{output}: did not read back as it was written (is the disk full?)")

    with publishing(output, check) as draft:
        draft.write_bytes(content)
    return False


def _read(path: Path) -> tuple[_Plan, Provenance]:
    plan = read_model(path, TeamPlanDocument) if team_members(path) else read_plan(path)
    provenance = json_provenance(path)
    if provenance is None or provenance.stage != "plan":
        raise InputError(path, "does not say what it was planned on", "take a plan as hrt plan wrote it")
    return plan, provenance


def _task_key(provenance: Provenance) -> bytes:
    """Return all that a plan depends on besides the seed."""
    parameters = {name: value for name, value in provenance.parameters.items() if name != "seed"}
    inputs = [[each.role, each.sha256] for each in provenance.inputs]
    return canonical({"version": provenance.stage_version, "parameters": parameters, "inputs": inputs})


def _folder(paths: Iterable[Path]) -> str:
    """Return the folder that all files lie in."""
    folders = [path.parent for path in paths]
    if len({folder.is_absolute() for folder in folders}) > 1:
        folders = [folder.absolute() for folder in folders]
    return os.path.commonpath(folders) or "."


def _measure(name: str, plans: dict[Path, _Plan]) -> tuple[Task, dict[Path, Run]]:
    first = next(iter(plans.values()))
    bound = min(plan.upper_bound for plan in plans.values())
    discounted = min(
        (p.discounted_upper_bound for p in plans.values() if p.discounted_upper_bound is not None), default=None
    )
    runs = {
        path: Run(
            name,
            plan.method,
            plan.seed,
            plan.score,
            plan.discounted_score,
            _share(plan.score, bound),
            None if discounted is None else _share(plan.discounted_score, discounted),
            plan.steps,
            plan.length_m,
            plan.time_s,
        )
        for path, plan in plans.items()
    }
    shares = [r.fraction_of_discounted_bound for r in runs.values() if r.fraction_of_discounted_bound is not None]
    total = first.objective == "total"
    best = max(runs, key=lambda path: runs[path].score if total else runs[path].discounted_score)
    task = Task(
        name,
        first.method,
        first.objective,
        [str(path) for path in plans],
        str(best),
        bound,
        discounted,
        _spread([run.score for run in runs.values()]),
        _spread([run.fraction_of_bound for run in runs.values()]),
        _spread(shares) if shares else None,
        _spread([run.length_m for run in runs.values()]),
    )
    return task, runs


def _share(value: float, bound: float) -> float:
    return min(value / bound, 1.0) if bound > 0 else 1.0


def _spread(values: Sequence[float]) -> Spread:
    sd = statistics.stdev(values) if len(values) > 1 else None
    return Spread(statistics.fmean(values), sd, min(values), max(values))
