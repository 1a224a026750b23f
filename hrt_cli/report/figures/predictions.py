"""A picture of predictions: the angles that a network steers by, how sure it is frame by frame, and where least."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.report.figures.canvas import begin_drawing, plain, shortened, show_caption
from hrt_cli.report.figures.palette import ACCENT, GREEN, INK, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    Floats = NDArray[np.float64]

STAGE_VERSION = 1
_WIDTH_IN, _ROW_IN = 12.0, 4.6
_CAPTION_CHARS = 130
_BINS = 41
_LEAST_SURE = 5


class Frame(Protocol):
    """The prediction of one frame; see `hrt_cli.steering.prediction.predictions.Prediction`."""

    @property
    def image(self) -> str: ...  # noqa: D102
    @property
    def index(self) -> int | None: ...  # noqa: D102
    @property
    def uncertainty(self) -> Mapping[Any, Any] | None: ...  # noqa: D102
    @property
    def label(self) -> Mapping[Any, float] | None: ...  # noqa: D102


def draw_predictions(
    path: Path, frames: Sequence[Frame], outputs: Sequence[str], output: Path, *, caption: str, existing: Existing
) -> bool:
    """Draw predictions: for each output the angles as a histogram, and frame by frame with what they may be off by.

    Parameters
    ----------
    path : Path
        What `hrt steer` wrote, for the figure's provenance.
    frames : sequence of Frame
        At least one.
    outputs : sequence of str
        `yaw`, and `pitch` where there is one.
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
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    inputs, parameters = {"predictions": path}, {"caption": caption}
    job = begin_drawing(
        "figure-predictions", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    job.publish(predictions_figure(frames, outputs, caption))
    return False


def predictions_figure(frames: Sequence[Frame], outputs: Sequence[str], caption: str) -> Figure:
    """Return the figure; see `draw_predictions`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH_IN, _ROW_IN * len(outputs) + 0.4), layout="constrained")
    show_caption(figure, caption, _CAPTION_CHARS)
    parts = figure.subfigures(len(outputs), 1, squeeze=False)[:, 0]
    for part, name in zip(parts, outputs, strict=True):
        _show_output(part, frames, name)
    return figure


def _show_output(part: SubFigure, frames: Sequence[Frame], name: str) -> None:
    grid = part.add_gridspec(2, 2, width_ratios=(1.0, 2.6), height_ratios=(1.6, 1.0))
    mean, spread, modes = (
        np.array([getattr(each, f"{name}{end}") for each in frames], np.float64) for end in ("", "_spread", "_modes")
    )
    angles = part.add_subplot(grid[:, 0])
    angles.hist(mean, bins=np.linspace(-1, 1, _BINS + 1).tolist(), color=SERIES)
    angles.axvline(float(mean.mean()), color=ACCENT, lw=1.6, label=f"mean {mean.mean():+.3f}")
    angles.set_xlim(-1, 1)
    angles.set_xlabel(f"{name} ({'up' if name == 'pitch' else 'right'} positive)")
    angles.set_ylabel("frames")
    angles.legend(frameon=False, fontsize=9)
    plain(angles)
    above = part.add_subplot(grid[0, 1])
    _over_frames(above, frames, name, mean, spread, modes)
    _doubts(part.add_subplot(grid[1, 1], sharex=above), frames, name, spread)


def _over_frames(axes: Axes, frames: Sequence[Frame], name: str, mean: Floats, spread: Floats, modes: Floats) -> None:
    at = np.arange(len(frames))
    mark = "." if len(frames) <= 60 else None
    axes.fill_between(
        at, np.clip(mean - spread, -1, 1), np.clip(mean + spread, -1, 1), color=SERIES, alpha=0.2, lw=0,
        label="one standard deviation",
    )  # fmt: skip
    axes.plot(at, mean, color=SERIES, lw=1.1, marker=mark, label="predicted")
    label = [(k, each.label[name]) for k, each in enumerate(frames) if each.label and name in each.label]
    if label:
        axes.plot(*zip(*label, strict=True), ls="none", marker=".", ms=3, color=INK, label="label")
    torn = modes > 1
    if torn.any():
        axes.plot(
            at[torn], mean[torn], ls="none", marker="x", ms=5, color=ACCENT, label=f"sees two ways ({torn.sum()})"
        )
    axes.set_xlim(-0.5, len(frames) - 0.5)
    axes.set_ylim(-1.05, 1.05)
    axes.set_ylabel(name)
    axes.tick_params(labelbottom=False)
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    plain(axes)


def _doubts(axes: Axes, frames: Sequence[Frame], name: str, spread: Floats) -> None:
    """Show what a prediction may be off by: in all, and for want of training, as far as networks were drawn."""
    at = np.arange(len(frames))
    mark = "." if len(frames) <= 60 else None
    axes.plot(at, spread, color=SERIES, lw=1.0, marker=mark, label="of the angle")
    drawn = [(k, each.uncertainty[name].epistemic) for k, each in enumerate(frames) if each.uncertainty]
    if drawn:
        axes.plot(*zip(*drawn, strict=True), color=GREEN, lw=1.0, marker=mark, label="for want of training (epistemic)")
    least = np.argsort(-spread, kind="stable")[:_LEAST_SURE]
    axes.plot(
        least, spread[least], ls="none", marker="v", ms=5, color=ACCENT, label=f"least sure: {_named(frames, least)}"
    )
    axes.set_ylim(bottom=0)
    axes.set_ylabel("standard deviation")
    axes.set_xlabel("frame")
    legend = axes.legend(
        frameon=False, fontsize=8, ncols=1, loc="upper left", bbox_to_anchor=(0.0, -0.32), borderaxespad=0.2
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    plain(axes)


def _named(frames: Sequence[Frame], least: NDArray[np.intp]) -> str:
    def one(frame: Frame) -> str:
        name = shortened(frame.image.rsplit("/", 1)[-1], 24)
        return name if frame.index is None else f"{name} #{frame.index}"

    return ", ".join(one(frames[int(k)]) for k in least)
