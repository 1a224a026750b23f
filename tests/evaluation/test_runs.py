"""`hrt evaluate runs`: plans of several sites and seeds side by side, by a second reading of the plans."""

from __future__ import annotations

import csv
import json
import statistics
from pathlib import Path

import cv2
import pytest
from click.testing import CliRunner, Result
from plan_files import put, scores

from hrt_cli.artifacts.jsonio import to_text
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.errors import InputError, OutputError
from hrt_cli.main import cli
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file


def make_plan(scoremap: Path, output: Path, budget: str = "25", objective: str = "total", **more: object) -> Path:
    output.parent.mkdir(exist_ok=True)
    request = PlanRequest(
        (parse_start("cell:3,4"),), parse_budget(budget), method="random", objective=objective, **more
    )
    plan_file(scoremap, output, request)
    return output


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sites, of the first three seeds and a second budget, of the second one seed of either objective."""
    folder = tmp_path_factory.mktemp("runs")
    first, second = put(folder / "a.tif", scores()), put(folder / "b.tif", scores() * 0.5)
    made = [make_plan(first, folder / "a" / f"{seed}.json", seed=seed) for seed in (3, 1, 2)]
    made.append(make_plan(first, folder / "a" / "long.json", "40"))
    made.append(make_plan(second, folder / "b" / "0.json", objective="discounted"))
    # The same task as the first three, but for the map.
    made.append(make_plan(second, folder / "b" / "5.json", seed=5))
    return made


def run(*args: object) -> Result:
    found = CliRunner().invoke(cli, ["evaluate", "runs", *map(str, args)])
    if found.exception and not isinstance(found.exception, SystemExit):
        raise found.exception
    return found


def test_plans_that_differ_in_the_seed_alone_are_of_one_task(plans: list[Path]) -> None:
    # Two sites in turns: the order of the files decides that of the rows, never who belongs together.
    given = [plans[0], plans[4], plans[1], plans[5], plans[3], plans[2]]
    found = json.loads(run(*given, "--json").stdout)
    assert list(found["plans"]) == [str(path) for path in given]
    assert [task["plans"] for task in found["tasks"]] == [
        [str(plans[0]), str(plans[1]), str(plans[2])],
        [str(plans[4])],
        [str(plans[5])],
        [str(plans[3])],
    ]
    a, b = str(plans[0].parent), str(plans[4].parent)
    assert [task["name"] for task in found["tasks"]] == [a, b, f"{b} (2)", f"{a} (2)"]
    assert {run["seed"] for run in found["plans"].values()} == {0, 1, 2, 3, 5}


def test_the_figures_are_those_of_the_plans_and_their_spread(plans: list[Path]) -> None:
    read = [json.loads(path.read_text()) for path in plans[:3]]
    found = json.loads(run(*plans[:3], "--json").stdout)
    (task,) = found["tasks"]
    bound = min(plan["upper_bound"] for plan in read)
    assert task["upper_bound"] == bound
    scores_found = [plan["score"] for plan in read]
    assert len(set(scores_found)) > 1
    expected = {
        "score": scores_found,
        "length_m": [plan["length_m"] for plan in read],
        "fraction_of_bound": [plan["score"] / bound for plan in read],
    }
    for name, values in expected.items():
        assert [each[name] for each in found["plans"].values()] == pytest.approx(values)
        spread = {"mean": sum(values) / 3, "sd": statistics.stdev(values), "min": min(values), "max": max(values)}
        assert task[name] == pytest.approx(spread)
    assert task["best"] == str(plans[scores_found.index(max(scores_found))])
    assert task["fraction_of_discounted_bound"] is None


def test_one_plan_has_no_spread_and_a_discounted_one_its_own_bound(plans: list[Path]) -> None:
    (task,) = json.loads(run(plans[4], "--json").stdout)["tasks"]
    read = json.loads(plans[4].read_text())
    share = read["discounted_score"] / read["discounted_upper_bound"]
    assert task["fraction_of_discounted_bound"] == {"mean": share, "sd": None, "min": share, "max": share}
    line = run(plans[4]).stdout
    assert f"1 plan by random: score {read['score']:.2f}, {share:.1%} of the discounted bound" in line


def test_the_table_has_a_row_for_each_plan(plans: list[Path], tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    found = json.loads(run(*plans, "--table", table, "--json").stdout)
    rows = list(csv.DictReader(table.open(newline="")))
    assert [row.pop("plan") for row in rows] == list(found["plans"])
    for row, each in zip(rows, found["plans"].values(), strict=True):
        assert row == {name: "" if value is None else str(value) for name, value in each.items()}
    kept = table.stat().st_mtime_ns
    run(*plans, "--table", table)
    assert table.stat().st_mtime_ns == kept
    with pytest.raises(OutputError, match="exists and differs"):
        run(*plans[:2], "--table", table)
    run(*plans[:2], "--table", table, "--overwrite")
    assert table.read_text().count("\n") == 3


def test_the_figure_has_a_row_for_each_task_and_no_folder(plans: list[Path], tmp_path: Path) -> None:
    one, all_ = tmp_path / "1.png", tmp_path / "3.png"
    run(*plans[:3], "--figure", one)
    run(*plans, "--figure", all_)
    found = png_provenance(all_)
    assert found is not None
    assert found.parameters["labels"] == ["a, random", "a (2), random", "b, random", "b (2), random"]
    assert cv2.imread(str(all_)).shape[0] > cv2.imread(str(one)).shape[0]
    assert cv2.imread(str(all_)).std() > 5
    assert str(tmp_path).encode() not in all_.read_bytes()


def test_plans_that_nobody_vouches_for_are_refused(plans: list[Path], tmp_path: Path) -> None:
    plan = json.loads(plans[0].read_text())
    anonymous = tmp_path / "anonymous.json"
    anonymous.write_text(to_text({key: value for key, value in plan.items() if key != "provenance"}))
    with pytest.raises(InputError, match="does not say what it was planned on"):
        run(anonymous)
    edited = tmp_path / "edited.json"
    edited.write_text(to_text(plan | {"score": plan["score"] + 1}))
    with pytest.raises(InputError, match="edited"):
        run(edited)
    copy = tmp_path / "copy.json"
    copy.write_bytes(plans[0].read_bytes())
    with pytest.raises(InputError, match="is the same plan as"):
        run(plans[0], copy)


def test_a_team_counts_as_one_plan(tmp_path: Path) -> None:
    scoremap = put(tmp_path / "a.tif", scores())
    team = tmp_path / "team.json"
    request = PlanRequest((parse_start("cell:3,4"),), parse_budget("12"), method="greedy", robots=2)
    plan_file(scoremap, team, request)
    read = json.loads(team.read_text())
    (found,) = json.loads(run(team, "--json").stdout)["plans"].values()
    assert found["score"] == read["score"]
    assert found["length_m"] == pytest.approx(sum(robot["length_m"] for robot in read["robots"]))
