"""`hrt evaluate plan` as a user runs it: keys, exit codes, the table, the figure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from plan_files import put, scores

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.errors import ArgumentError, DifferenceError, HrtError
from hrt_cli.evaluation.plans import BASELINES, PLANNERS
from hrt_cli.main import cli
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file

WORTH = {"score", "discounted_score", "fraction_of_bound", "fraction_of_discounted_bound"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("site")
    scoremap = put(folder / "s.tif", scores())
    request = PlanRequest((parse_start("cell:3,4"),), parse_budget("25"), method="greedy")
    plan_file(scoremap, folder / "p.json", request)
    return scoremap, folder / "p.json"


def run(*args: object) -> Result:
    return CliRunner().invoke(cli, ["evaluate", "plan", *map(str, args)])


def test_json_keys(site: tuple[Path, Path]) -> None:
    found = json.loads(run(*site, "--json").stdout)
    assert set(found) == {"plans", "planner", "baselines", "upper_bound", "discounted_upper_bound"}
    assert list(found["plans"]) == [str(site[1])]
    assert set(found["planner"]) == set(PLANNERS)
    assert set(found["baselines"]) == set(BASELINES)
    for each in (*found["plans"].values(), *found["planner"].values(), *found["baselines"].values()):
        assert set(each) == WORTH
        assert each["fraction_of_bound"] == pytest.approx(each["score"] / found["upper_bound"])
        share = each["discounted_score"] / found["discounted_upper_bound"]
        assert each["fraction_of_discounted_bound"] == pytest.approx(share)
        assert 0 < share <= 1
    assert found["baselines"]["greedy"] == found["plans"][str(site[1])]
    assert json.loads(run(*site, "--json", "--no-planner").stdout)["planner"] == {}


def test_json_keys_over_starts(site: tuple[Path, Path], tmp_path: Path) -> None:
    options = ("--starts", 4, "--seeds", 2, "--no-planner", "--seed", 5)
    found = json.loads(run(*site, *options, "--json", "--figure", tmp_path / "f.png").stdout)["starts"]
    assert (found["count"], found["seeds"]) == (4, 2)
    assert set(found["methods"]) == set(BASELINES)
    for method in found["methods"].values():
        assert set(method) == WORTH
        for each in method.values():
            assert each["worst"] <= each["mean"]
            assert each["low"] <= each["mean"] <= each["high"]
    assert json.loads(run(*site, *options, "--json", "--workers", 2).stdout)["starts"] == found
    lines = run(*site, *options).stdout.splitlines()
    title = next(k for k, line in enumerate(lines) if line.startswith("4 starts, 2 seeds"))
    assert len({len(line) for line in lines[title + 1 :]}) == 1
    assert [line.split()[0] for line in lines[title + 2 :]] == list(BASELINES)
    provenance = png_provenance(tmp_path / "f.png")
    assert provenance is not None
    assert provenance.parameters["starts"] == 4


def test_require_fails_below_the_fraction_only(site: tuple[Path, Path]) -> None:
    fraction = json.loads(run(*site, "--json", "--no-planner").stdout)["plans"][str(site[1])]["fraction_of_bound"]
    demand = f"fraction_of_bound>={fraction!r}"
    assert run(*site, "--no-planner", "--require", demand).exit_code == 0
    failed = run(*site, "--no-planner", "--require", f"fraction_of_bound>={float(np.nextafter(fraction, 1))!r}")
    assert isinstance(failed.exception, DifferenceError)
    assert failed.exception.exit_code == 3
    assert str(failed.exception).startswith(f"plans.{site[1]}.fraction_of_bound is {fraction:.6g}, and ")
    assert "upper bound" in failed.stdout


def test_a_demand_names_every_plan_but_no_baseline_unless_it_says_so(site: tuple[Path, Path], tmp_path: Path) -> None:
    second = tmp_path / "second.json"
    request = PlanRequest((parse_start("cell:3,4"),), parse_budget("25"), method="random")
    plan_file(site[0], second, request)
    found = json.loads(run(*site, second, "--json", "--no-planner").stdout)
    low, high = sorted(each["score"] for each in found["plans"].values())
    assert min(each["score"] for each in found["baselines"].values()) < (low + high) / 2
    for demand, code in (
        (f"score>={low!r}", 0),
        (f"score>{low!r}", 3),
        (f"plans.{site[1]}.score>={high!r}", 0),
        (f"plans.{second}.score>{low!r}", 3),
        (f"baselines.*.score>={low + 1e-6!r}", 3),
        (f"baselines.greedy.score=={found['baselines']['greedy']['score']!r}", 0),
        ("upper_bound > 0", 0),
    ):
        done = run(*site, second, "--no-planner", "--require", demand)
        assert getattr(done.exception, "exit_code", 0) == code, demand
    for name in ("scores", "starts.count", "plans", "baselines.lucky.score", "plans.*.mood"):
        refused = run(*site, "--no-planner", "--require", f"{name}>0")
        assert isinstance(refused.exception, ArgumentError), name
        assert "upper_bound" in str(refused.exception)


def test_a_figure_that_may_not_be_replaced_is_told_before_the_work(site: tuple[Path, Path], tmp_path: Path) -> None:
    figure = tmp_path / "f.png"
    assert run(*site, "--no-planner", "--figure", figure).exit_code == 0
    before = figure.read_bytes(), figure.stat().st_mtime_ns
    assert run(*site, "--no-planner", "--figure", figure).exit_code == 0
    assert (figure.read_bytes(), figure.stat().st_mtime_ns) == before
    refused = run(*site, "--figure", figure)
    assert isinstance(refused.exception, HrtError)
    assert "--overwrite" in str(refused.exception)
    assert refused.stdout == ""
    assert run(*site, "--figure", figure, "--overwrite").exit_code == 0
    assert figure.read_bytes() != before[0]


def test_the_objective_is_told(site: tuple[Path, Path], tmp_path: Path) -> None:
    request = PlanRequest(
        (parse_start("cell:3,4"),), parse_budget("20.5m"), "greedy", "discounted", connectivity=8, return_home=True
    )
    plan_file(site[0], tmp_path / "p.json", request)
    out = run(site[0], tmp_path / "p.json", "--no-planner", "--starts", 2, "--figure", tmp_path / "f.png").stdout
    assert "% of its bound" in out.splitlines()[0]
    assert "% of discounted bound" in out


@pytest.mark.parametrize("options", [("--seeds", 2), ("--starts", 0), ("--require", 0.9), ("--require", "score>=nan")])
def test_wrong_options_are_usage_errors(site: tuple[Path, Path], options: tuple[object, ...]) -> None:
    assert run(*site, *options).exit_code == 2


def test_too_many_starts_are_one_refusal(site: tuple[Path, Path]) -> None:
    refused = run(*site, "--starts", 900)
    assert isinstance(refused.exception, HrtError)
    assert "only 476 cells" in str(refused.exception)


def test_a_team_is_valued_together(site: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, team, figure = site[0], tmp_path / "team.json", tmp_path / "f.png"
    starts = tuple(parse_start(text) for text in ("cell:3,4", "cell:9,9"))
    made = plan_file(scoremap, team, PlanRequest(starts, parse_budget("25"), method="greedy", robots=2))
    found = json.loads(run(scoremap, team, "--figure", figure, "--json").stdout)
    worth = found["plans"][str(team)]
    assert worth["score"] == pytest.approx(made.document.score)
    assert worth["discounted_score"] == pytest.approx(made.document.discounted_score)
    assert found["baselines"]["greedy"] == worth
    assert found["planner"]["refined"]["score"] >= worth["score"]
    assert worth["fraction_of_bound"] <= found["planner"]["refined"]["fraction_of_bound"] <= 1
    alone = [json.loads(run(scoremap, tmp_path / f"team-{k}.json", "--no-planner", "--json").stdout) for k in (1, 2)]
    assert found["upper_bound"] <= sum(each["upper_bound"] for each in alone) * (1 + 1e-9)

    made_before = png_provenance(figure)
    assert made_before is not None
    assert {each.role for each in made_before.inputs} == {"scoremap", "plan/0", "plan/0/0", "plan/0/1"}
    for wrong, message in (
        (run(scoremap, team, "--starts", 2), "one robot"),
        (run(scoremap, team, tmp_path / "team-1.json"), "another start"),
    ):
        assert isinstance(wrong.exception, HrtError)
        assert message in str(wrong.exception)


def test_a_team_whose_robots_were_planned_apart_is_refused(site: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, team = site[0], tmp_path / "team.json"
    start = (parse_start("cell:3,4"),)
    plan_file(scoremap, team, PlanRequest(start, parse_budget("25"), method="greedy", robots=2))
    (tmp_path / "team-2.json").unlink()
    assert "team-2.json" in str(run(scoremap, team).exception)
    plan_file(scoremap, tmp_path / "team-2.json", PlanRequest(start, parse_budget("25"), "greedy", gamma=0.5))
    assert "differ in more" in str(run(scoremap, team).exception)
