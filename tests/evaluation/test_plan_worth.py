"""Plans are valued afresh on a scoremap they really lie on, beside the baselines and under the bound."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from plan_files import PLACE, UTM33, put, scores
from rasterio.crs import CRS

from hrt_cli.errors import InputError
from hrt_cli.evaluation.plans import BASELINES, PLANNERS, Trials, evaluate_plans
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file


def planned(scoremap: Path, path: Path, budget: str = "30", start: str = "cell:3,4", **options: object) -> Path:
    request = PlanRequest((parse_start(start),), parse_budget(budget), effort=0.1, **options)  # type: ignore[arg-type]
    plan_file(scoremap, path, request)
    return path


@pytest.fixture
def site(tmp_path: Path) -> tuple[Path, Path]:
    scoremap = put(tmp_path / "s.tif", scores())
    return scoremap, planned(scoremap, tmp_path / "p.json")


def test_worth_is_recomputed_from_the_cells(site: tuple[Path, Path]) -> None:
    scoremap, plan = site
    found = evaluate_plans(scoremap, (plan,))
    document = json.loads(plan.read_text())
    first_visits = list(dict.fromkeys(map(tuple, document["cells"])))
    worth = found.plans[str(plan)]
    assert worth.score == pytest.approx(sum(float(scores()[cell]) for cell in first_visits), rel=1e-6)
    assert worth.discounted_score == pytest.approx(document["discounted_score"], rel=1e-6)
    assert worth.fraction_of_bound == pytest.approx(worth.score / found.upper_bound)
    assert set(found.baselines) == set(BASELINES)
    assert set(found.planner) == set(PLANNERS)
    assert all(0 < each.fraction_of_bound <= 1 + 1e-9 for each in (*found.plans.values(), *found.baselines.values()))


def test_what_lies_on_the_same_cells_passes(site: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, plan = site
    noise = put(tmp_path / "noise.tif", scores(), PLACE @ Affine.translation(1e-9, -1e-9))
    nameless = CRS.from_proj4("+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs")
    bare = put(tmp_path / "bare.tif", scores(), PLACE, nameless)
    for other in (scoremap, noise, bare):
        assert evaluate_plans(other, (plan,)).plans


@pytest.mark.parametrize(
    ("transform", "crs", "score", "problem"),
    [
        (PLACE @ Affine.translation(1, 0), UTM33, scores(), "1.00 px apart"),
        (PLACE, CRS.from_epsg(32634), scores(), "reference systems differ"),
        (PLACE, UTM33, scores()[:-1], "19 x 24"),
        (PLACE, UTM33, np.where(np.arange(24) == 4, np.nan, scores()).astype(np.float32), "no-go"),
    ],
)
def test_another_map_is_refused(
    site: tuple[Path, Path], tmp_path: Path, transform: Affine, crs: CRS, score: np.ndarray, problem: str
) -> None:
    other = put(tmp_path / "other.tif", score, transform, crs)
    with pytest.raises(InputError, match=problem):
        evaluate_plans(other, (site[1],))


@pytest.mark.parametrize("change", [{"budget": "31"}, {"start": "cell:3,5"}, {"connectivity": 8}])
def test_plans_of_different_tasks_are_not_compared(
    site: tuple[Path, Path], tmp_path: Path, change: dict[str, object]
) -> None:
    scoremap, plan = site
    other = planned(scoremap, tmp_path / "other.json", **change)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="another start, budget"):
        evaluate_plans(scoremap, (plan, other))


def test_an_edited_plan_is_refused(site: tuple[Path, Path]) -> None:
    scoremap, plan = site
    plan.write_text(plan.read_text().replace('"gap":', '"gap" :', 1))
    assert evaluate_plans(scoremap, (plan,)).plans  # white space is no change
    document = json.loads(plan.read_text())
    document["score"] += 1
    plan.write_text(json.dumps(document))
    with pytest.raises(InputError, match="edited by hand"):
        evaluate_plans(scoremap, (plan,))


def test_the_bound_is_of_the_map_not_of_the_plan(site: tuple[Path, Path], tmp_path: Path) -> None:
    richer = put(tmp_path / "richer.tif", scores() * 5)
    found = evaluate_plans(richer, (site[1],))
    assert found.plans[str(site[1])].fraction_of_bound <= 1 + 1e-9
    assert found.upper_bound == pytest.approx(5 * evaluate_plans(site[0], (site[1],)).upper_bound, rel=0.02)


def test_the_discounted_bound_is_that_of_the_plans_gamma(site: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, _ = site
    plan = planned(scoremap, tmp_path / "d.json", objective="discounted", gamma=0.9)
    document = json.loads(plan.read_text())
    found = evaluate_plans(scoremap, (plan,), Trials(planner=False))
    assert found.discounted_upper_bound == pytest.approx(document["discounted_upper_bound"], rel=0.05)
    assert found.discounted_upper_bound < 0.7 * found.upper_bound
    worth = found.plans[str(plan)]
    assert worth.fraction_of_discounted_bound == pytest.approx(worth.discounted_score / found.discounted_upper_bound)
    assert 0.9 < worth.fraction_of_discounted_bound <= 1
    undiscounted = planned(scoremap, tmp_path / "u.json", gamma=1.0)
    same = evaluate_plans(scoremap, (undiscounted,), Trials(planner=False))
    assert same.discounted_upper_bound == same.upper_bound


@pytest.mark.parametrize(
    ("options", "unit", "limit", "last"),
    [
        ({"budget": "30"}, "steps", 30, "score"),
        ({"budget": "25.5m", "connectivity": 8}, "m", 25.5, "score"),
        ({"budget": "30", "objective": "discounted"}, "steps", 30, "discounted_score"),
    ],
)
def test_the_chart_ends_at_what_the_walks_are_worth(
    site: tuple[Path, Path], tmp_path: Path, options: dict[str, object], unit: str, limit: float, last: str
) -> None:
    plan = planned(site[0], tmp_path / "c.json", **options)  # type: ignore[arg-type]
    found = evaluate_plans(site[0], (plan,))
    assert (found.chart.unit, found.chart.limit) == (unit, pytest.approx(limit))
    assert found.chart.bound == (found.upper_bound if last == "score" else found.discounted_upper_bound)
    worth = found.plans | found.planner | found.baselines
    assert [curve.name for curve in found.chart.curves] == list(worth)
    for curve in found.chart.curves:
        assert curve.reward[-1] == pytest.approx(getattr(worth[curve.name], last))
        assert curve.travelled[-1] <= limit + 1e-6
        assert (np.diff(curve.reward) >= 0).all()


def test_the_chart_over_starts_is_of_means_and_progress_ends(site: tuple[Path, Path]) -> None:
    told: list[tuple[int, int]] = []
    trials = Trials(planner=False, starts=3, seeds=2)
    found = evaluate_plans(*site[:1], site[1:], trials, progress=lambda done, total: told.append((done, total)))
    assert told == [(k, 15) for k in range(16)]
    assert found.starts is not None
    assert [curve.role for curve in found.chart.curves] == ["baseline"] * 5
    for curve in found.chart.curves:
        assert curve.reward[-1] == pytest.approx(found.starts.methods[curve.name].score.mean)
        assert curve.low is not None
        assert curve.high is not None
        assert (curve.low <= curve.high).all()
    assert found.chart.bound == found.starts.bound
