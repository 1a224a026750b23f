"""The plan stage: a scoremap becomes the plan of a robot or of a team, from file to file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts import plan as artifact
from hrt_cli.artifacts.carriers import json_provenance, publish_json, read_stamped_npz
from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.logs.kinds import files_of, reading
from hrt_cli.planning.document import plan_document, staying_document, team_document
from hrt_cli.planning.planner import MOST_ROBOTS, plan_team, plans_alone
from hrt_cli.planning.policy import Policy, default_policies_sha256
from hrt_cli.planning.problem import NothingLeftError, Problem
from hrt_cli.planning.request import PlanRequest, Spending, budget_in_cells, start_cell
from hrt_cli.planning.resume import Driven, mark_driven, read_drives
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

STAGE = "plan"
STAGE_VERSION = 4


@dataclass(frozen=True)
class Planned:
    """What the plan stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    document : PlanDocument or TeamPlanDocument
        What stands in the output.
    robots : list of PlanDocument
        The plan of each robot; the document itself for one.
    seconds : float
        Wall-clock time of the planning.
    notes : list of str
        What the user should know about the start.
    """

    up_to_date: bool
    document: artifact.PlanDocument | artifact.TeamPlanDocument
    robots: list[artifact.PlanDocument]
    seconds: float
    notes: list[str]


def plan_file(
    scoremap_path: Path,
    output: Path,
    request: PlanRequest,
    *,
    policy_paths: tuple[Path, ...] = (),
    visited: tuple[Path, ...] = (),
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> Planned:
    """Plan on the scoremap in `scoremap_path` and write the plan to `output`.

    With several robots `output` is the plan of the team, and the plan of each robot stands beside it (`robot_path`).
    With `visited`, the drive logs of all robots, of one, or of the successive drives of one robot, cells that they
    went through pay nothing, what they spent is taken off the budget, and the cells where they got stuck may not be
    entered.

    Raises
    ------
    InputError
        The scoremap, a policy or a log cannot be used.
    ArgumentError
        The request does not fit the map: a start outside it or on a no-go cell, a budget of nothing.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    _check_counts(request, visited)
    inputs = {"scoremap": scoremap_path}
    inputs |= {f"policy/{index}": path for index, path in enumerate(policy_paths)}
    for index, path in enumerate(visited):
        inputs |= files_of(f"visited/{index}", path)
    files = [output] if request.robots == 1 else [artifact.robot_path(output, robot) for robot in range(request.robots)]
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=inputs,
        parameters=_parameters(request, policy_paths) | reading(visited),
        outputs=dict.fromkeys([*files, output] if request.robots > 1 else files, json_provenance),
        existing=existing,
    )
    if job.up_to_date:
        robots = [artifact.read_plan(path) for path in files]
        whole = robots[0] if request.robots == 1 else read_model(output, artifact.TeamPlanDocument)
        return Planned(True, whole, robots, 0.0, [])
    scoremap = read_scoremap(scoremap_path)
    policies = [read_policy(path) for path in policy_paths] or None
    teams = [visited] if request.robots == 1 and visited else [(path,) for path in visited]
    driven = [read_drives(paths, scoremap) for paths in teams]
    notes = [note for each in driven for note in each.notes]
    try:
        problems, collected, blocked = _problems(scoremap, request, driven)
        notes += [note for problem in problems for note in _pocket(problem)]
        found = plan_team(
            problems,
            request.method,
            policies=policies,
            effort=request.effort,
            samples=request.samples,
            seed=request.seed,
            progress=progress,
        )
        plans = [found.together] if request.robots == 1 else plans_alone(problems, found)
    except NothingLeftError as error:
        may_stay = request.or_stay and request.robots == 1
        document = staying_document(scoremap, request, driven) if may_stay else None
        if document is None:
            raise ArgumentError(f"{scoremap_path}: {error}") from error
        publish_json(output, document.model_dump(mode="json", exclude={"provenance"}), job.provenance)
        return Planned(False, document, [document], 0.0, [*notes, f"{error}: the robot stays where it is"])
    except ArgumentError as error:
        raise ArgumentError(f"{scoremap_path}: {error}") from error
    robots = [
        plan_document(each, problem.budget.limit, problem.end, scoremap, request, collected, blocked)
        for each, problem in zip(plans, problems, strict=True)
    ]
    for path, document in zip(files, robots, strict=True):
        publish_json(path, document.model_dump(mode="json", exclude={"provenance"}), job.provenance)
    seconds = found.together.seconds
    if request.robots == 1:
        return Planned(False, robots[0], robots, seconds, notes)
    team = team_document(found, robots, files, request)
    publish_json(output, team.model_dump(mode="json", exclude={"provenance"}), job.provenance)
    return Planned(False, team, robots, seconds, notes)


def _check_counts(request: PlanRequest, visited: tuple[Path, ...]) -> None:
    if not 1 <= request.robots <= MOST_ROBOTS:
        raise ArgumentError(f"plans are made for 1 to {MOST_ROBOTS} robots, not {request.robots}")
    drives = visited if request.robots > 1 else ()
    for name, given in (("--start", request.starts), ("--end", request.ends), ("--visited", drives)):
        if len(given) > 1 and len(given) != request.robots:
            raise ArgumentError(
                f"{name} is given {len(given)} times: once, or once for each of {request.robots} robots"
            )
    if not request.starts and not visited:
        raise ArgumentError("a plan needs a --start, or an earlier drive (--visited) that it goes on from")
    if request.return_home and request.ends:
        raise ArgumentError("a path that returns home ends at its start: give --return-home or --end, not both")


def _problems(
    scoremap: Scoremap, request: PlanRequest, driven: list[Driven]
) -> tuple[list[Problem], list[artifact.Cell], list[artifact.Cell]]:
    """Return the problem of each robot, and the cells that pay nothing and that are blocked for earlier drives."""
    collected = sorted({(int(row), int(col)) for each in driven for row, col in each.cells})
    blocked = sorted({cell for each in driven for cell in each.blocked})
    stands = [] if request.starts else [each.stands for each in driven]
    score = mark_driven(scoremap.score, collected, blocked, stands)
    problems = []
    for robot in range(request.robots):
        before = driven[robot if len(driven) > 1 else 0] if driven else None
        if request.starts:
            start = start_cell(request.starts[robot if len(request.starts) > 1 else 0], scoremap)
        else:
            start = before.stands if before else (0, 0)
        end = start if request.return_home else None
        if request.ends:
            end = start_cell(request.ends[robot if len(request.ends) > 1 else 0], scoremap, "end")
        left = request.budget
        if before is not None:
            spent = before.spent(left.unit, request.connectivity)
            if spent >= left.value:
                raise NothingLeftError(f"the earlier drive took {spent:g} {left.unit} of a budget of {left.value:g}")
            left = Spending(left.value - spent, left.unit)
        problems.append(
            Problem(
                score,
                start,
                budget_in_cells(left, scoremap.cell_size_m, request.speed_m_s),
                connectivity=request.connectivity,
                objective=request.objective,
                gamma=request.gamma,
                end=end,
            )
        )
    return problems, collected, blocked


def _pocket(problem: Problem) -> list[str]:
    """Say so where no-go cells cut the start off from most of the map."""
    from scipy import ndimage

    shape = np.ones((3, 3)) if problem.connectivity == 8 else None
    labels, count = ndimage.label(~np.isnan(problem.score), structure=shape)
    if count < 2:
        return []
    sizes = np.bincount(labels.ravel())[1:]
    mine = int(sizes[labels[problem.start] - 1])
    if mine * 2 >= int(sizes.sum()):
        return []
    row, col = problem.start
    return [
        f"the start {row},{col} lies in a pocket of {mine} cells that no-go cells cut off from the other "
        f"{int(sizes.sum()) - mine} of the map: nothing outside it is planned"
    ]


def read_policy(path: Path) -> Policy:
    """Read a policy.

    Raises
    ------
    InputError
        The file is no NPZ, is damaged, or does not hold a policy of a version known here.
    """
    arrays, _ = read_stamped_npz(path)
    try:
        return Policy.from_arrays(arrays)
    except ValueError as error:
        raise InputError(path, f"is not a usable policy: {error}") from error


def _parameters(request: PlanRequest, policy_paths: tuple[Path, ...]) -> dict[str, Any]:
    budget = request.budget
    return {
        "policy": "given" if policy_paths else default_policies_sha256(),
        "starts": [[start.kind, start.first, start.second] for start in request.starts],
        "ends": [[end.kind, end.first, end.second] for end in request.ends],
        "robots": request.robots,
        "budget": [budget.value, budget.unit],
        "method": request.method,
        "objective": request.objective,
        "gamma": request.gamma,
        "connectivity": request.connectivity,
        "return_home": request.return_home,
        "speed_m_s": request.speed_m_s,
        "effort": request.effort,
        "samples": request.samples,
        "seed": request.seed,
    } | ({"or_stay": True} if request.or_stay else {})
