"""A contact sheet of recorded frames, each with the steering that its label gives and the bearing of its goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import InputError
from hrt_cli.report.figures.canvas import begin_drawing, show_caption
from hrt_cli.report.figures.palette import ACCENT, PATH_EDGE, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STAGE_VERSION = 1
_COLUMNS, _ROWS = 6, 4
_CELL_IN = 2.0
_TURN_RAD = math.pi / 3
"""By how much the arrow is turned at yaw 1."""
_LENGTH = 0.55
_CAPTION_CHARS = 130


class Frame(Protocol):
    """A recorded frame; see `hrt_cli.steering.recordings.rows.Frame`."""

    @property
    def path(self) -> Path: ...  # noqa: D102
    @property
    def steering(self) -> tuple[float, ...]: ...  # noqa: D102
    @property
    def goal_rad(self) -> float | None: ...  # noqa: D102


def draw_frames(recording: Path, frames: Sequence[Frame], output: Path, *, caption: str, existing: Existing) -> bool:
    """Draw up to 24 frames, evenly taken from a recording.

    Parameters
    ----------
    recording : Path
        The file that describes it, for the figure's provenance.
    frames : sequence of Frame
        At least one.
    output : Path
        The PNG to write.
    caption : str
        The title.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        A picture cannot be read; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs, parameters = {"recording": recording}, {"caption": caption}
    job = begin_drawing(
        "figure-frames", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    from matplotlib.figure import Figure

    count = min(len(frames), _COLUMNS * _ROWS)
    chosen = [frames[int(k)] for k in np.linspace(0, len(frames) - 1, count).round()]
    rows = -(-count // _COLUMNS)
    figure = Figure(figsize=(_COLUMNS * _CELL_IN, rows * (_CELL_IN * 0.75 + 0.3) + 0.6), layout="constrained")
    show_caption(figure, caption, _CAPTION_CHARS)
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for axes, frame in zip(panels, chosen, strict=False):
        _show_frame(axes, frame)
    for axes in panels[count:]:
        axes.set_axis_off()
    job.publish(figure)
    return False


def _show_frame(axes: Axes, frame: Frame) -> None:
    """Show a picture, its steering as an arrow from the bottom (right is right), and the goal as a tick at the top."""
    from matplotlib import patheffects

    picture = cv2.imread(str(frame.path), cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError(frame.path, "cannot be read as a picture")
    height, width = picture.shape[:2]
    axes.imshow(picture[..., ::-1], extent=(0, width, height, 0))
    yaw, *pitch = frame.steering
    angle = yaw * _TURN_RAD
    foot = (width / 2, height * 0.98)
    tip = (foot[0] + math.sin(angle) * _LENGTH * height, foot[1] - math.cos(angle) * _LENGTH * height)
    edge = [patheffects.withStroke(linewidth=4.8, foreground=PATH_EDGE)]
    arrow = {"arrowstyle": "-|>", "color": ACCENT, "lw": 2.6, "shrinkA": 0, "shrinkB": 0, "path_effects": edge}
    axes.annotate("", tip, foot, arrowprops=arrow)
    text = f"{yaw:+.2f}" + (f", pitch {pitch[0]:+.2f}" if pitch else "")
    if frame.goal_rad is not None:
        text += f", goal {math.degrees(frame.goal_rad):+.0f}°"
        # 180 degrees to either side lie at the edges.
        at = width * (0.5 + frame.goal_rad / (2 * math.pi))
        axes.plot(at, height * 0.05, "v", color=SKY, mec=PATH_EDGE, ms=7)
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_title(text, fontsize=8)
    axes.set_xticks([])
    axes.set_yticks([])
