"""Contact sheets and predictions: which frames are shown, which way the arrows point, how sure the network is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from recording_files import put_picture

from hrt_cli.artifacts.stage import REFUSE
from hrt_cli.errors import InputError
from hrt_cli.report.figures.frames import draw_frames
from hrt_cli.report.figures.predictions import draw_predictions, predictions_figure


@dataclass(frozen=True)
class Recorded:
    path: Path
    steering: tuple[float, ...]
    goal_rad: float | None = None


@dataclass(frozen=True)
class Sure:
    epistemic: float


@dataclass(frozen=True)
class Predicted:
    image: str
    yaw: float
    yaw_spread: float
    yaw_modes: int = 1
    pitch: float = 0.0
    pitch_spread: float = 0.1
    pitch_modes: int = 1
    index: int | None = None
    uncertainty: dict | None = None
    label: dict | None = None


def put(folder: Path, frames: list[Recorded]) -> Path:
    about = folder / "recording.json"
    about.write_text("{}\n")
    return about


def test_arrows_point_where_is_steered(tmp_path: Path, drawn: list[Figure]) -> None:
    picture = put_picture(tmp_path / "0.png")
    frames = [Recorded(picture, (yaw,), goal) for yaw, goal in ((-1.0, None), (0.0, 0.5), (0.5, -math.pi))]
    frames.append(Recorded(picture, (0.25, -0.5)))
    about = put(tmp_path, frames)
    assert not draw_frames(about, frames, tmp_path / "f.png", caption="frames", existing=REFUSE)
    assert draw_frames(about, frames, tmp_path / "f.png", caption="frames", existing=REFUSE)
    panels = [axes for axes in drawn[0].axes if axes.images]
    assert [axes.get_title() for axes in panels] == [
        "-1.00", "+0.00, goal +29°", "+0.50, goal -180°", "+0.25, pitch -0.50",
    ]  # fmt: skip
    for axes, frame in zip(panels, frames, strict=True):
        arrow = axes.texts[0]
        across, up = np.array(arrow.xy) - arrow.get_position()
        assert math.atan2(across, -up) == pytest.approx(frame.steering[0] * math.pi / 3)
    goals = [axes.lines[0].get_xdata()[0] / axes.get_xlim()[1] for axes in panels[1:3]]
    assert goals == pytest.approx([0.5 + 0.25 / math.pi, 0.0])


@pytest.mark.parametrize("count", [1, 7, 100])
def test_frames_are_taken_evenly(tmp_path: Path, drawn: list[Figure], count: int) -> None:
    picture = put_picture(tmp_path / "0.png", np.zeros((3, 4, 3), np.uint8))
    frames = [Recorded(picture, (k / 100,)) for k in range(count)]
    draw_frames(put(tmp_path, frames), frames, tmp_path / "f.png", caption="", existing=REFUSE)
    shown = [round(100 * float(axes.get_title())) for axes in drawn[0].axes if axes.images]
    assert (shown[0], shown[-1], len(shown)) == (0, count - 1, min(count, 24))
    assert np.ptp(np.diff(shown)) <= 1 if count > 2 else True


def test_a_frame_that_is_no_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "0.jpg").write_text("no picture")
    frames = [Recorded(tmp_path / "0.jpg", (0.0,))]
    with pytest.raises(InputError, match=r"0\.jpg: cannot be read"):
        draw_frames(put(tmp_path, frames), frames, tmp_path / "f.png", caption="", existing=REFUSE)


def predicted(count: int = 9) -> list[Predicted]:
    return [
        Predicted(
            f"$f_{k}$.jpg", k / 10 - 0.4, 0.3 if k == 4 else 0.1 + k / 1000, 1 + (k == 2),
            uncertainty={"yaw": Sure(k / 100), "pitch": Sure(0.0)}, label={"yaw": 0.5} if k == 3 else None,
        )
        for k in range(count)
    ]  # fmt: skip


def test_predictions_and_their_doubts_are_shown() -> None:
    angles, above, below = predictions_figure(predicted(), ["yaw"], "a model").axes
    assert sum(bar.get_height() for bar in angles.patches) == 9
    lines = {line.get_label(): line.get_xydata() for line in (*above.lines, *below.lines)}
    np.testing.assert_allclose(lines["predicted"][:, 1], np.arange(9) / 10 - 0.4)
    np.testing.assert_allclose(lines["label"], [(3, 0.5)])
    np.testing.assert_allclose(lines["sees two ways (1)"], [(2, -0.2)])
    np.testing.assert_allclose(lines["for want of training (epistemic)"][:, 1], np.arange(9) / 100)
    (least,) = [name for name in lines if name.startswith("least sure")]
    assert least.split(": ")[1].split(", ")[:2] == ["$f_4$.jpg", "$f_8$.jpg"]
    assert lines[least][0].tolist() == [4, 0.3]


def test_each_output_has_its_row_and_the_figure_is_drawn_once(tmp_path: Path, drawn: list[Figure]) -> None:
    path = put(tmp_path, [])
    options = {"caption": "a model", "existing": REFUSE}
    assert not draw_predictions(path, predicted(2), ["yaw", "pitch"], tmp_path / "f.png", **options)
    assert draw_predictions(path, predicted(2), ["yaw", "pitch"], tmp_path / "f.png", **options)
    labels = [axes.get_xlabel() for axes in drawn[0].axes]
    assert labels == ["yaw (right positive)", "", "frame", "pitch (up positive)", "", "frame"]
