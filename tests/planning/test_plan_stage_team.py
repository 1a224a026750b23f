"""Teams, ends and earlier drives from file to file, and as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hrt_cli.artifacts.jsonio import read_model
from hrt_cli.artifacts.plan import TeamPlanDocument, read_plan
from hrt_cli.errors import InputError
from hrt_cli.main import cli

SCORE = np.random.default_rng(4).random((14, 18)).astype(np.float32)


@pytest.fixture
def scoremap(tmp_path: Path) -> Path:
    path = tmp_path / "map.npz"
    np.savez(path, score=SCORE, cell_size_m=np.float64(2.0))
    return path


def hrt(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def run(*words: object) -> dict:
    result = hrt(*words, "--effort", 0.1, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def refusal(*words: object) -> str:
    """The message of the refusal of a plan."""
    result = hrt(*words)
    assert result.exit_code != 0
    return str(result.exception) + result.output


def log_of(path: Path, cells: list[tuple[int, int]], event: dict[int, str] | None = None) -> Path:
    lines = [json.dumps({"format": "hrt-drive-log", "version": 1, "crs": None})]
    for t, (row, col) in enumerate(cells):
        record = {"t": float(t), "x": (col + 0.5) * 2.0, "y": -(row + 0.5) * 2.0}
        lines.append(json.dumps(record | ({"event": event[t]} if event and t in event else {})))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_team_gets_a_plan_each_and_one_for_all(scoremap: Path, tmp_path: Path) -> None:
    team, figure = tmp_path / "team.json", tmp_path / "team.png"
    said = run(
        "plan", scoremap, "-o", team, "--start", "cell:0,0", "--start", "cell:13,17", "--budget", 30, "--robots", 2,
        "--return-home", "--figure", figure,
    )  # fmt: skip
    document = read_model(team, TeamPlanDocument)
    plans = [read_plan(tmp_path / f"team-{k}.json") for k in (1, 2)]
    assert [each.start for each in plans] == [(0, 0), (13, 17)]
    assert [each.cells[-1] for each in plans] == [(0, 0), (13, 17)]
    visited = {cell for each in plans for cell in each.cells}
    assert document.score == pytest.approx(sum(float(SCORE[cell]) for cell in visited))
    assert sum(robot["score"] for robot in said["robots"]) == pytest.approx(said["score"])
    assert said["steps"] == sum(each.steps for each in plans)
    assert said["length_m"] == pytest.approx(sum(each.length_m for each in plans))
    assert document.score <= document.upper_bound
    assert figure.stat().st_size > 10_000
    assert run("plan", scoremap, "-o", team, "--start", "cell:0,0", "--start", "cell:13,17", "--budget", 30,
               "--robots", 2, "--return-home")["up_to_date"]  # fmt: skip
    (tmp_path / "team-2.json").unlink()
    assert hrt("verify", team, tmp_path / "team-1.json").exit_code == 0


def test_the_plan_of_a_team_is_not_taken_for_that_of_a_robot(scoremap: Path, tmp_path: Path) -> None:
    team = tmp_path / "team.json"
    run("plan", scoremap, "-o", team, "--start", "cell:3,3", "--budget", 20, "--robots", 3)
    with pytest.raises(InputError, match=r"is the plan of a team: take the plans of its robots.*team-3"):
        read_plan(team)


def test_a_plan_ends_where_it_is_told(scoremap: Path, tmp_path: Path) -> None:
    plan = tmp_path / "p.json"
    run("plan", scoremap, "-o", plan, "--start", "cell:0,0", "--end", "cell:9,9", "--budget", 40)
    document = read_plan(plan)
    assert document.cells[-1] == document.end == (9, 9)
    assert document.steps == 40
    base = ["plan", scoremap, "-o", tmp_path / "q.json", "--start", "cell:0,0", "--budget", 10]
    assert "end cell 9,9 cannot be reached" in refusal(*base, "--end", "cell:9,9")
    assert "not both" in refusal(*base, "--end", "cell:1,1", "--return-home")
    assert "the end cell:50,1 is outside the map" in refusal(*base, "--end", "cell:50,1")
    assert "--end 'here'" in refusal(*base, "--end", "here")


def test_a_drive_is_gone_on_from(scoremap: Path, tmp_path: Path) -> None:
    """Collected cells pay nothing, the budget is what is left, and the place where it got stuck is shunned."""
    driven = [(2, 2), (2, 3), (2, 4), (2, 5), (3, 5), (3, 4), (4, 4)]
    log = log_of(tmp_path / "drive.jsonl", driven, {3: "stuck"})
    plan = tmp_path / "p.json"
    run("plan", scoremap, "-o", plan, "--budget", 36, "--visited", log)
    document = read_plan(plan)
    assert document.start == (4, 4)
    assert document.steps == 36 - 6
    assert document.blocked == [(2, 5)]
    assert (2, 5) not in document.cells
    assert set(document.collected) == set(driven)
    fresh = set(document.cells) - set(driven)
    assert document.score == pytest.approx(sum(float(SCORE[cell]) for cell in fresh))
    valued = hrt("evaluate", "plan", scoremap, plan, "--no-planner", "--json")
    assert json.loads(valued.stdout)["plans"][str(plan)]["score"] == pytest.approx(document.score)
    # In metres what counts is the way driven, in minutes the time it took.
    run("plan", scoremap, "-o", plan, "--budget", "40m", "--visited", log, "--overwrite")
    assert read_plan(plan).length_m <= 40 - 12 + 1e-6
    assert read_plan(plan).length_m > 40 - 12 - 2
    run("plan", scoremap, "-o", plan, "--budget", "1min", "--speed", 0.5, "--visited", log, "--overwrite")
    assert read_plan(plan).length_m == pytest.approx((60 - 6) * 0.5, abs=2)


def test_a_robot_still_stuck_turns_away_from_what_stopped_it(scoremap: Path, tmp_path: Path) -> None:
    log = log_of(tmp_path / "drive.jsonl", [(5, 2), (5, 3), (5, 4)], {2: "stuck"})
    plan = tmp_path / "p.json"
    run("plan", scoremap, "-o", plan, "--budget", 20, "--visited", log)
    document = read_plan(plan)
    assert document.start == (5, 4)
    assert document.blocked == [(5, 5)]
    assert (5, 5) not in document.cells


def test_a_robot_that_knew_no_other_ground_may_leave_the_no_go_cell_that_it_stands_in(tmp_path: Path) -> None:
    score = SCORE.copy()
    score[5, 2:5] = np.nan
    scoremap = tmp_path / "s.npz"
    np.savez(scoremap, score=score, cell_size_m=np.float64(2.0))
    plan = tmp_path / "p.json"
    run("plan", scoremap, "-o", plan, "--budget", 20, "--visited", log_of(tmp_path / "a.jsonl", [(5, 2), (5, 3)]))
    document = read_plan(plan)
    assert document.start == (5, 3)
    assert document.steps == 19
    assert not {(5, 2), (5, 3), (5, 4)} & set(document.cells[1:])
    valued = hrt("evaluate", "plan", scoremap, plan, "--no-planner", "--json")
    assert json.loads(valued.stdout)["plans"][str(plan)]["score"] == pytest.approx(document.score)


def test_drives_of_a_team(scoremap: Path, tmp_path: Path) -> None:
    logs = [log_of(tmp_path / "a.jsonl", [(0, 0), (0, 1)]), log_of(tmp_path / "b.jsonl", [(9, 9), (9, 8), (9, 7)])]
    said = run("plan", scoremap, "-o", tmp_path / "t.json", "--budget", 20, "--robots", 2,
               "--visited", logs[0], "--visited", logs[1])  # fmt: skip
    assert [robot["start"] for robot in said["robots"]] == [[0, 1], [9, 7]]
    assert [robot["steps"] for robot in said["robots"]] == [19, 18]
    collected = set(read_plan(tmp_path / "t-1.json").collected)
    assert collected == set(read_plan(tmp_path / "t-2.json").collected) == {(0, 0), (0, 1), (9, 9), (9, 8), (9, 7)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ('{"format": "hrt-drive-log"}\n', "has no records"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": 1, "y": -1}', "was cut off"),
        ('{"format": "hrt-drive-log"}\n{"t": 1, "x": 1, "y": -1}\n{"t": 0, "x": 1, "y": -1}\n', "time goes backwards"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": NaN, "y": -1}\n', "NaN"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": 1}\n', "line 2"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": 900, "y": 900}\n', "wholly off the scoremap"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": 1, "y": -1}\n{"t": 1, "x": 900, "y": 900}\n', "ends off the"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "lon": 1, "lat": 1}\n', "no georeference"),
        ('{"format": "hrt-drive-log"}\n{"t": 0, "x": 1, "y": -1, "evnt": "stuck"}\n', "evnt"),
        ('{"format": "hrt-plan"}\n', "line 1"),
    ],
)
def test_a_log_that_cannot_be_gone_on_from_is_named(scoremap: Path, tmp_path: Path, text: str, message: str) -> None:
    log = tmp_path / "drive.jsonl"
    log.write_text(text)
    found = refusal("plan", scoremap, "-o", tmp_path / "p.json", "--budget", 20, "--visited", log)
    assert message in found
    assert "drive.jsonl" in found
    assert not (tmp_path / "p.json").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y\n0,1,-1\n1,3,-1\n", ""),
        ("when,x,y\n0,1,-1\n", "has no column t"),
        ("t,x,y\n0,1,-1\n1,3,-", "was cut off"),
        ("t,x,y\n0,1,nan\n", "y is 'nan'"),
        ("t,x,y\n0,1,-1,7\n", "more fields"),
        ("t,x,x\n0,1,-1\n", "twice"),
    ],
)
def test_logs_in_csv(scoremap: Path, tmp_path: Path, text: str, message: str) -> None:
    log = tmp_path / "drive.csv"
    log.write_text(text)
    words = ["plan", scoremap, "-o", tmp_path / "p.json", "--budget", 20, "--visited", log, "--effort", 0.1]
    if message:
        assert message in refusal(*words)
    else:
        assert hrt(*words).exit_code == 0
        assert read_plan(tmp_path / "p.json").collected == [(0, 0), (0, 1)]


def test_counts_and_budgets_that_do_not_fit_are_named(scoremap: Path, tmp_path: Path) -> None:
    base = ["plan", scoremap, "-o", tmp_path / "p.json", "--budget", 20]
    log = log_of(tmp_path / "drive.jsonl", [(2, k) for k in range(10)] + [(3, k) for k in range(9, -1, -1)])
    assert "needs a --start" in refusal(*base)
    assert "--start is given 2 times" in refusal(*base, "--start", "cell:0,0", "--start", "cell:1,1")
    assert "took 19 steps of a budget of 19" in refusal(*base[:-1], 19, "--visited", log)
    assert "--visited is given 2 times" in refusal(*base, "--visited", log, "--visited", log, "--robots", 3)


def test_a_pocket_is_explained(tmp_path: Path) -> None:
    score = np.ones((9, 9), np.float32)
    score[3, :4] = score[:4, 3] = np.nan
    np.savez(tmp_path / "map.npz", score=score, cell_size_m=np.float64(1.0))
    result = hrt("plan", tmp_path / "map.npz", "-o", tmp_path / "p.json", "--start", "cell:0,0", "--budget", 20)
    assert result.exit_code == 0
    assert "pocket of 9 cells that no-go cells cut off from the other 65" in result.stderr


def test_policies_of_ones_own_are_part_of_what_made_a_plan(scoremap: Path, tmp_path: Path) -> None:
    policies = [tmp_path / "first.npz", tmp_path / "second.npz"]
    for policy, features in zip(policies, ("rings", "manjanna24"), strict=True):
        trained = hrt(
            "train-plan", scoremap, "-o", policy, "--features", features, "--iterations", 2,
            "--maps-per-iteration", 1, "--rollouts", 2, "--budget", 20,
        )  # fmt: skip
        assert trained.exit_code == 0, trained.output
    output = tmp_path / "plan.json"
    task = ["plan", scoremap, "-o", output, "--start", "cell:3,3", "--budget", 30, "--method", "policy"]
    alone = [run(*task, "--overwrite", "--policy", policy)["score"] for policy in policies]
    both = run(*task, "--overwrite", "--policy", policies[0], "--policy", policies[1])
    assert both["score"] == max(alone)
    provenance = read_plan(output).provenance
    assert provenance is not None
    assert {each.role for each in provenance.inputs} == {"scoremap", "policy/0", "policy/1"}
