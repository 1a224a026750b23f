"""The picture of drives: what it shows, and that it is an artifact like any other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import ArgumentError, OutputError
from hrt_cli.report.figures import drives as module
from hrt_cli.report.figures.drives import draw_drives

CLEARANCE = np.array([0.0, 0.12, 0.3, 0.7, 1.2, 5.0])
WEIGHT = np.array([1.0, 1.0, 2.0, 1.0, 1.0, 4.0])
VIEW = [(float(k), 0.1 + 0.01 * k) for k in range(30)]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "d.jsonl"
    path.write_text("a log\n")
    return path


def draw(log: Path, output: Path, existing: Existing = REFUSE, view=VIEW, caption: str = "drives", **arrays) -> None:
    clearance, weight = arrays.get("clearance", CLEARANCE), arrays.get("weight", WEIGHT)
    draw_drives({"log/0": log}, output, clearance, weight, view, caption=caption, existing=existing)


def test_the_figure_is_drawn_once(log: Path) -> None:
    output = log.with_name("f.png")
    draw(log, output)
    picture = cv2.imread(str(output))
    assert picture.shape[1] > 1000
    assert picture.std() > 10
    before = output.read_bytes()
    draw(log, output)
    draw(log, output, Existing(force=True))
    assert output.read_bytes() == before
    assert [each.role for each in png_provenance(output).inputs] == ["log/0"]
    with pytest.raises(OutputError, match="--overwrite"):
        draw(log, output, caption="other drives")
    draw(log, output, Existing(overwrite=True), caption="other drives")
    assert output.read_bytes() != before


@pytest.mark.parametrize("view", [[], VIEW[:1], VIEW])
def test_short_and_blind_drives_have_a_figure_too(log: Path, view) -> None:
    draw(log, log.with_name("f.png"), view=view, clearance=np.zeros(1), weight=np.zeros(1))
    assert log.with_name("f.png").exists()


def test_without_a_world_there_is_nothing_to_draw(log: Path) -> None:
    with pytest.raises(ArgumentError, match=r"f\.png: there is nothing to draw without a --world"):
        draw(log, log.with_name("f.png"), clearance=np.zeros(0), weight=np.zeros(0))
    assert not log.with_name("f.png").exists()


@pytest.mark.parametrize("top", [0.0, 0.05, 0.3, 0.7, 2.9, 5.0, 4.999999])
def test_all_of_the_time_is_in_the_histogram(top: float) -> None:
    axes = Figure().subplots()
    clearance = np.append(CLEARANCE[top >= CLEARANCE], top)
    module._histogram(axes, clearance, np.ones(clearance.size))
    assert sum(bar.get_height() for bar in axes.patches) == pytest.approx(100)
    assert axes.lines[0].get_xdata()[0] == pytest.approx(clearance.mean())


def test_the_curve_is_smoothed_over_the_way() -> None:
    axes = Figure().subplots()
    view = np.array([(float(k), float(k == 50)) for k in range(101)])
    module._curve(axes, view)
    raw, smooth, mean = axes.lines
    np.testing.assert_array_equal(raw.get_ydata(), 100 * view[:, 1])
    assert smooth.get_ydata()[50] == pytest.approx(100 / 21)
    assert smooth.get_ydata()[30] == 0
    assert mean.get_ydata()[0] == pytest.approx(100 / 101)
