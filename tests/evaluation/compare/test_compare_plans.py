"""Plans, of one robot and of a team: every planted change is named; and the distances between ways."""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from compare_files import PLACE, compare, differing, edit, figures, put_plan, put_scoremap
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import directed_hausdorff

from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.tracks import frechet


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plan")
    return put_plan(folder / "plan.json", put_scoremap(folder / "s.tif"))


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("team")
    return put_plan(folder / "team.json", put_scoremap(folder / "s.tif"), robots=2)


def test_the_same_plan_by_another_name_is_the_same(plan: Path, tmp_path: Path) -> None:
    assert differing(plan, plan) == set()
    shutil.copy(plan, tmp_path / "copy.json")
    assert differing(plan, tmp_path / "copy.json") == set()


def test_a_plan_on_a_grid_with_noise_is_the_same(plan: Path, tmp_path: Path) -> None:
    noisy = put_scoremap(tmp_path / "s.tif", transform=PLACE @ Affine.translation(1e-9, 1e-9) @ Affine.scale(1 + 1e-12))
    assert differing(plan, put_plan(tmp_path / "b.json", noisy)) == set()


def last_cell_moved(document: dict[str, Any]) -> None:
    """The walk ends one cell to another side."""
    cells = document["cells"]
    (row, col), (from_row, from_col) = cells[-1], cells[-2]
    sides = [(from_row + r, from_col + c) for r, c in ((0, 1), (1, 0), (0, -1), (-1, 0))]
    new = next(side for side in sides if min(side) >= 0 and side != (row, col))
    cells[-1] = list(new)
    document["waypoints"][-1]["cell"] = list(new)
    for place in (document["xy"], document["lonlat"]):
        place[-1] = [place[-1][0], place[-1][1]]


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda d: d.update(score=d["score"] + 1), {"score"}),
        (lambda d: d.update(upper_bound=d["upper_bound"] + 1), {"upper_bound"}),
        (lambda d: d.update(length_m=d["length_m"] * 1.001), {"length_m"}),
        (lambda d: d["waypoints"][2].update(x=d["waypoints"][2]["x"] + 3.0), {"coordinates_m"}),
        (lambda d: d["waypoints"][2].update(lon=d["waypoints"][2]["lon"] + 1e-4), {"coordinates_m"}),
        (lambda d: d["lonlat"][5].__setitem__(1, d["lonlat"][5][1] + 1e-5), {"coordinates_m"}),
        (lambda d: d["xy"][5].__setitem__(1, d["xy"][5][1] + 1), {"coordinates_m"}),
        (lambda d: d["waypoints"].pop(2), {"waypoints"}),
        (lambda d: d["waypoints"][2].update(cell=[0, 0]), {"waypoints", "coordinates_m"}),
        (lambda d: d.update(seed=7), {"settings"}),
        (lambda d: d["budget"].update(value=99), {"settings"}),
        (lambda d: d.update(blocked=[[1, 1]]), {"settings"}),
        (lambda d: d.update(lonlat=None), {"settings"}),
        (last_cell_moved, {"apart_m", "overlap", "order", "end_m", "coordinates_m", "waypoints"}),
    ],
)
@pytest.mark.parametrize("signed", [True, False])
def test_a_plan_with_one_change(
    plan: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object], wanted: set[str], signed: bool
) -> None:
    other = edit(plan, tmp_path / "b.json", change, signed=signed)
    assert differing(plan, other) == wanted
    assert ("edited by hand" in compare(plan, other).stderr) is (not signed)
    assert "edited by hand" not in compare(plan, other, "-q").stderr


def test_a_moved_waypoint_is_told_in_metres(plan: Path, tmp_path: Path) -> None:
    other = edit(plan, tmp_path / "b.json", lambda d: d["waypoints"][2].update(x=d["waypoints"][2]["x"] + 3.0))
    assert figures(plan, other)["coordinates_m"]["difference"] == pytest.approx(3.0, rel=2e-3)
    assert differing(plan, other, "--tolerance", "coordinates_m=3.1") == set()


def reverse(document: dict[str, Any]) -> None:
    for name in ("cells", "xy", "lonlat"):
        document[name].reverse()
    steps = document["steps"]
    document["waypoints"].reverse()
    for each in document["waypoints"]:
        each["step"] = steps - each["step"]
    document["start"] = document["cells"][0]


def test_the_same_cells_in_reverse_order_are_another_walk(plan: Path, tmp_path: Path) -> None:
    other = edit(plan, tmp_path / "b.json", reverse, signed=True)
    names = differing(plan, other)
    assert {"apart_m", "order", "start_m", "end_m"} <= names
    assert not names & {"overlap", "coordinates_m", "score", "settings"}
    found = figures(plan, other)
    document = json.loads(plan.read_text())
    ends = np.hypot(*(np.array(document["cells"][0]) - document["cells"][-1]))
    assert found["start_m"]["difference"] == pytest.approx(ends, rel=2e-3)
    assert found["order"]["similarity"] < 0.5
    assert "order" not in differing(plan, other, "--tolerance", "apart_m=100", "--tolerance", "overlap=0.1")


def test_a_plan_on_a_shifted_grid_is_apart_by_the_shift(plan: Path, tmp_path: Path) -> None:
    moved = put_plan(tmp_path / "b.json", put_scoremap(tmp_path / "s.tif", transform=PLACE @ Affine.translation(2, 0)))
    names = differing(plan, moved)
    assert {"shift_m", "apart_m", "start_m", "end_m", "overlap"} <= names
    found = figures(plan, moved)
    assert found["start_m"]["difference"] == pytest.approx(2.0, rel=2e-3)
    half = put_plan(tmp_path / "c.json", put_scoremap(tmp_path / "h.tif", transform=PLACE @ Affine.translation(0.5, 0)))
    found = figures(plan, half)
    assert "overlap" not in found, "its cells do not lie on these"
    assert found["apart_m"]["difference"] == pytest.approx(0.5, rel=2e-3)


def test_teams_are_compared_robot_by_robot(team: Path, plan: Path, tmp_path: Path) -> None:
    assert differing(team, team) == set()
    for path in team.parent.glob("team*.json"):
        shutil.copy(path, tmp_path)
    copy = tmp_path / "team.json"
    assert differing(team, copy) == set()
    edit(copy, copy, lambda d: d.update(score=d["score"] - 1))
    assert differing(team, copy) == {"score"}
    shutil.copy(team, copy)
    second = tmp_path / "team-2.json"
    edit(second, second, reverse, signed=True)
    assert {"apart_m", "order"} <= differing(team, copy)
    second.unlink()
    done = compare(team, copy)
    assert isinstance(done.exception, InputError)
    assert "team-2.json" in str(done.exception)
    done = compare(team, plan)
    assert isinstance(done.exception, InputError)
    assert "is a plan, and" in str(done.exception)


def test_what_is_no_plan_any_more_is_refused(plan: Path, tmp_path: Path) -> None:
    for change in (
        lambda d: d["cells"].pop(),
        lambda d: d["waypoints"][1].update(step=999),
        lambda d: d["grid"].update(crs="EPSG:1"),
        lambda d: d.update(extra=1),
    ):
        assert isinstance(compare(plan, edit(plan, tmp_path / "b.json", change)).exception, InputError)


WAY = st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=2, max_size=9).map(np.array)


def by_recursion(a: np.ndarray, b: np.ndarray) -> float:
    """Eiter and Mannila (1994), table 1."""

    @functools.cache
    def lead(i: int, j: int) -> float:
        here = float(np.hypot(*(a[i] - b[j])))
        before = [lead(*at) for at in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(at) >= 0]
        return max(here, min(before)) if before else here

    return lead(len(a) - 1, len(b) - 1)


@given(WAY, WAY)
def test_the_frechet_distance_is_that_of_its_definition_and_no_less_than_hausdorff_s(
    a: np.ndarray, b: np.ndarray
) -> None:
    found = frechet(a.astype(float), b.astype(float))
    assert found == pytest.approx(by_recursion(a, b))
    # No peer: GEOS 3.14 says 2 of (0,1) (0,-1) (0,0) and (0,0) (0,1) (0,0) (0,1) (0,2) (0,0), which a lead of 1 joins.
    assert found >= max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0]) - 1e-9
    assert found == pytest.approx(frechet(b.astype(float), a.astype(float)))
    assert frechet(a, a) == 0
    assert frechet(a, a[::-1]) >= np.hypot(*(a[0] - a[-1]))
