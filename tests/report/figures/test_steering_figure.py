"""The picture of a steering model: what it shows, and that it is an artifact like any other."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import OutputError
from hrt_cli.report.figures import steering as module
from hrt_cli.report.figures.steering import draw_steering


@dataclass
class Bins:
    count: np.ndarray = field(default_factory=lambda: np.array([0, 4, 0, 6]))
    confidence: np.ndarray = field(default_factory=lambda: np.array([np.nan, 0.4, np.nan, 0.9]))
    accuracy: np.ndarray = field(default_factory=lambda: np.array([np.nan, 0.25, np.nan, 1.0]))
    ece: float = 0.12


class Found:
    def __init__(self, frames: int = 10, outputs: tuple[str, ...] = ("yaw",), sessions: int = 2) -> None:
        rng = np.random.default_rng(0)
        self.steering = rng.uniform(-1, 1, (frames, len(outputs))).astype(np.float32)
        self.expected = self.steering * 0.5
        self.spread = np.full(self.steering.shape, 0.2)
        self.session = (np.arange(frames) * sessions // frames).astype(np.int32)
        self.sessions = {f"drive {k} of a robot with a long name": None for k in range(sessions)}
        self.reliability = {name: Bins() for name in outputs}
        self.confusion = {name: np.array([[3, 1, 0], [0, 4, 0], [0, 0, 0]]) for name in outputs}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "m.safetensors"
    path.write_text("a model\n")
    return path


def draw(model: Path, output: Path, existing: Existing = REFUSE, found: Found | None = None, **more) -> bool:
    options = {"digest": "d", "caption": "a model"} | more
    return draw_steering({"model": model}, output, found or Found(), existing=existing, **options)


def test_the_figure_is_drawn_once(model: Path) -> None:
    output = model.with_name("f.png")
    assert not draw(model, output)
    picture = cv2.imread(str(output))
    assert picture.shape[1] > 1000
    assert picture.std() > 10
    before = output.read_bytes()
    assert draw(model, output)
    assert not draw(model, output, Existing(force=True))
    assert output.read_bytes() == before
    assert [each.role for each in png_provenance(output).inputs] == ["model"]
    for more in ({"caption": "another"}, {"digest": "other frames"}):
        with pytest.raises(OutputError, match="--overwrite"):
            draw(model, output, **more)


@pytest.mark.parametrize(
    "found", [Found(1, sessions=1), Found(40, ("yaw", "pitch"), 20), Found(3, sessions=3)], ids=["one", "both", "three"]
)
def test_few_frames_many_sessions_and_two_outputs_have_a_figure_too(model: Path, found: Found) -> None:
    draw(model, model.with_name("f.png"), found=found)
    height = cv2.imread(str(model.with_name("f.png"))).shape[0]
    assert (height > 1200) == (len(found.reliability) == 2)


def test_bins_without_frames_are_left_out_of_the_diagram() -> None:
    axes, counts = Figure().subplots(2)
    module._reliability(axes, counts, Bins())
    assert [bar.get_height() for bar in axes.patches] == [0.25, 1.0]
    np.testing.assert_allclose([bar.get_x() + bar.get_width() / 2 for bar in axes.patches], [0.375, 0.875])
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [0.4, 0.9])
    assert [text.get_text() for text in counts.texts] == ["4", "6"]
    assert "0.120" in axes.get_title(loc="left")


def test_rows_of_the_confusion_are_shares_of_their_frames() -> None:
    axes = Figure().subplots()
    module._confusion(axes, np.array([[3, 1, 0], [0, 4, 0], [0, 0, 0]]), "yaw")
    shown = axes.images[0]
    np.testing.assert_allclose(shown.get_array()[:2], [[0.75, 0.25, 0], [0, 1, 0]])
    assert shown.get_array().mask[2].all()
    assert shown.get_extent() == [-1.5, 1.5, -1.5, 1.5]  # angles -1, 0, 1 in the middle of their cells
    assert shown.origin == "lower"


@pytest.mark.parametrize("reach", [0.0, 0.3, 2.0])
def test_all_errors_are_in_the_histogram(reach: float) -> None:
    axes = Figure().subplots()
    error = np.append(np.linspace(-reach, reach, 20), reach)
    module._errors(axes, error, "pitch")
    assert sum(bar.get_height() for bar in axes.patches) == pytest.approx(100)
    assert axes.lines[0].get_xdata()[0] == pytest.approx(error.mean())
    assert "too far up" in axes.get_xlabel()


def test_no_line_joins_two_sessions() -> None:
    found = Found(10, sessions=2)
    found.session = np.array([1, 0] * 5, np.int32)  # recorded by turns
    axes = Figure().subplots()
    module._over_time(axes, found, 0, "yaw")
    lines = [line for line in axes.lines if len(line.get_xdata()) == 5]
    assert len(lines) == 4
    np.testing.assert_array_equal(lines[0].get_xdata(), range(5))
    np.testing.assert_allclose(lines[0].get_ydata(), found.expected[1::2, 0])
    np.testing.assert_allclose(lines[1].get_ydata(), found.steering[1::2, 0])
    np.testing.assert_array_equal(lines[2].get_xdata(), range(5, 10))
    assert axes.texts[0].get_text() == "...obot with a long name"
    assert [line.get_label() for line in lines[:2]] == ["predicted", "label"]
