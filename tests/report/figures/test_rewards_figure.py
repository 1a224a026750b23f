"""The figure of cumulative rewards: lines where they belong, labels apart, and an artifact like any other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import InputError, OutputError
from hrt_cli.evaluation.rewards import Curve, RewardChart
from hrt_cli.report.figures import palette
from hrt_cli.report.figures import rewards as drawn


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    for name in ("s.tif", "p.json"):
        (tmp_path / name).write_text("{}")
    return tmp_path / "s.tif", tmp_path / "p.json"


def chart(plan: Path, *, band: bool = False) -> RewardChart:
    at = np.arange(21.0)
    spread = (at * 0.3, at * 0.5) if band else (None, None)
    curves = [Curve("greedy", "baseline", at, at * 0.4, *spread)]
    if not band:
        curves += [Curve(str(plan), "plan", at, at * 0.9), Curve("refined", "planner", at[:-3], at[:-3] * 0.8)]
    return RewardChart("cumulative reward", "steps", 20.0, False, 19.0, curves)


def colours(path: Path) -> set[tuple[int, int, int]]:
    picture = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    return {(int(r), int(g), int(b)) for r, g, b in picture.reshape(-1, 3)}


def rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:], 16)


def test_the_figure_is_cached_signed_and_the_same_bytes(files: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, plan = files
    output = tmp_path / "f.png"
    first = drawn.begin_figure(scoremap, (plan,), output, {"seed": 0}, existing=REFUSE)
    assert not first.up_to_date
    first.draw(chart(plan))
    before = output.read_bytes()
    again = drawn.begin_figure(scoremap, (plan,), output, {"seed": 0}, existing=REFUSE)
    assert again.up_to_date
    again.draw(chart(plan, band=True))
    assert output.read_bytes() == before
    forced = drawn.begin_figure(scoremap, (plan,), output, {"seed": 0}, existing=Existing(force=True))
    assert not forced.up_to_date
    forced.draw(chart(plan))
    assert output.read_bytes() == before
    found = png_provenance(output)
    assert found is not None
    assert [each.role for each in found.inputs] == ["scoremap", "plan/0"]
    with pytest.raises(OutputError, match="--overwrite"):
        drawn.begin_figure(scoremap, (plan,), output, {"seed": 1}, existing=REFUSE)
    with pytest.raises(OutputError, match="also an input"):
        drawn.begin_figure(scoremap, (plan,), plan, {}, existing=Existing(force=True))
    with pytest.raises(InputError, match="no such file"):
        drawn.begin_figure(tmp_path / "no.tif", (plan,), tmp_path / "g.png", {}, existing=REFUSE)


def test_every_line_is_drawn_in_its_colour(files: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, plan = files
    output = tmp_path / "f.png"
    drawn.begin_figure(scoremap, (plan,), output, {}, existing=REFUSE).draw(chart(plan))
    wanted = {palette.plan_colour(0), palette.METHODS["greedy"], palette.METHODS["refined"]}
    assert {rgb(colour) for colour in wanted} <= colours(output)


def test_axes_hold_the_curves_the_bound_and_the_band(files: tuple[Path, Path]) -> None:
    _, plan = files
    figure = drawn._figure(chart(plan), {str(plan): "p.json"})
    (axes,) = figure.axes
    assert axes.get_xlim() == pytest.approx((0.0, 20.0), rel=1e-4)
    assert axes.get_ylim()[1] > 19.0
    lines = [line.get_xydata() for line in axes.lines]
    assert any(np.array_equal(line, np.stack([np.arange(21.0), np.arange(21.0) * 0.9], 1)) for line in lines)
    ended = [line for line in axes.lines if line.get_linestyle() == ":"]
    assert [line.get_xdata().tolist() for line in ended] == [[17.0, 20.0]]
    dashed = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
    assert list(dashed[0]) == [19.0, 19.0]
    texts = [text.get_text() for text in axes.texts]
    assert texts == ["8.00", "greedy", "13.60", "refined", "18.00", "p.json", "19.00", "upper bound"]
    assert axes.get_xlabel() == "steps"
    assert not axes.collections
    assert len(drawn._figure(chart(plan, band=True), {}).axes[0].collections) == 1


def test_labels_do_not_overlap_and_move_little() -> None:
    places = np.array([0.1, 0.5, 0.505, 0.51, 0.99, 1.0])
    found = drawn._spaced(places, 0.05)
    assert (np.diff(found) >= 0.05 - 1e-12).all()
    assert found[0] == places[0]
    assert found[1:4].mean() == pytest.approx(places[1:4].mean())
    assert found[0] > 0
    assert found[-1] < 1


def test_plans_are_named_by_their_files(tmp_path: Path) -> None:
    paths = (tmp_path / "a" / "p.json", tmp_path / "b" / "p.json", tmp_path / "q$1$.json", tmp_path / ("x" * 60))
    assert list(drawn._labels(paths).values()) == ["1 p.json", "2 p.json", "q$1$.json", "x" * 28 + "…"]


def test_many_plans_and_a_name_like_a_formula_can_be_drawn(files: tuple[Path, Path], tmp_path: Path) -> None:
    scoremap, _ = files
    paths = []
    for index in range(40):
        paths.append(tmp_path / f"p_{index}$x^.json")
        paths[-1].write_text(str(index))
    many = RewardChart("t", "m", 1.0, True, 0.0, [Curve(str(p), "plan", np.zeros(1), np.zeros(1)) for p in paths])
    output = tmp_path / "f.png"
    drawn.begin_figure(scoremap, tuple(paths), output, {}, existing=REFUSE).draw(many)
    height, width = cv2.imread(str(output)).shape[:2]
    assert height > 40 * 0.17 * 110
    assert width == 1155
