"""A picture of how a steering model did: is its confidence earned, which angles it takes for which, frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.report.figures.canvas import begin_drawing, plain, show_caption
from hrt_cli.report.figures.palette import ACCENT, EMPTY, INK, MATRIX_RAMP, SERIES, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

STAGE_VERSION = 1
_CAPTION_CHARS = 150
_WIDTH_IN, _PANELS_IN, _TIME_IN, _CAPTION_IN = 13.0, 4.3, 2.9, 0.5
_ERROR_BINS = 40
_MOST_NAMED = 8
"""Sessions up to which their names are written over the frames."""
_NAME_CHARS = 24


class Bins(Protocol):
    """How often predictions of a confidence are right, by equally wide bins of confidence; NaN in empty ones."""

    @property
    def count(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def confidence(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def accuracy(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def ece(self) -> float: ...  # noqa: D102


class Measured(Protocol):
    """Labels and predictions [n, outputs], the session of each frame [n], and by output bins and confusions."""

    @property
    def steering(self) -> NDArray[np.float32]: ...  # noqa: D102
    @property
    def expected(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def spread(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def session(self) -> NDArray[np.int32]: ...  # noqa: D102
    @property
    def sessions(self) -> Iterable[str]: ...  # noqa: D102
    @property
    def reliability(self) -> Mapping[Any, Bins]: ...  # noqa: D102
    @property
    def confusion(self) -> Mapping[Any, NDArray[np.int64]]: ...  # noqa: D102


def draw_steering(
    inputs: dict[str, Path], output: Path, found: Measured, *, digest: str, caption: str, existing: Existing
) -> bool:
    """Draw reliability, confusion, errors, and the steering over the frames, for each output, as a PNG.

    Parameters
    ----------
    inputs : dict of str to Path
        The files that the figures come from by role: model and labels.
    output : Path
    found : Measured
    digest : str
        Hash of the frames.
    caption : str
    existing : Existing

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    parameters = {"caption": caption, "frames": digest}
    job = begin_drawing(
        "figure-steering", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    job.publish(_figure(found, caption))
    return False


def _figure(found: Measured, caption: str) -> Figure:
    from matplotlib.figure import Figure

    names = list(found.reliability)
    height = len(names) * (_PANELS_IN + _TIME_IN) + _CAPTION_IN
    figure = Figure(figsize=(_WIDTH_IN, height), layout="constrained")
    show_caption(figure, caption, _CAPTION_CHARS)
    parts = figure.subfigures(2 * len(names), 1, height_ratios=[_PANELS_IN, _TIME_IN] * len(names), squeeze=False)
    for column, name in enumerate(names):
        above, below = parts[2 * column, 0], parts[2 * column + 1, 0]
        _panels(above, found, column, name)
        _over_time(below.subplots(), found, column, name)
    return figure


def _panels(figure: SubFigure, found: Measured, column: int, name: str) -> None:
    grid = figure.add_gridspec(2, 3, height_ratios=(3.2, 1.0), width_ratios=(1.0, 1.1, 1.1), wspace=0.08)
    diagram = figure.add_subplot(grid[0, 0])
    _reliability(diagram, figure.add_subplot(grid[1, 0], sharex=diagram), found.reliability[name])
    _confusion(figure.add_subplot(grid[:, 1]), found.confusion[name], name)
    _errors(figure.add_subplot(grid[:, 2]), found.expected[:, column] - found.steering[:, column], name)


def _reliability(axes: Axes, counts: Axes, bins: Bins) -> None:
    """Draw the accuracy in each bin of confidence, how far it is from the confidence there, and the frames in it."""
    n = len(bins.count)
    filled = bins.count > 0
    middle, width = (np.arange(n) + 0.5) / n, 0.9 / n
    axes.plot([0, 1], [0, 1], color=SOFT, lw=1.0, ls=(0, (4, 4)), zorder=1)
    axes.bar(middle[filled], bins.accuracy[filled], width, color=SERIES, label="accuracy")
    axes.plot(
        middle[filled], bins.confidence[filled], ls="none", marker="_", ms=13, mew=2.2, color=ACCENT,
        label="confidence",
    )  # fmt: skip
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.set_ylabel("mean over the bin")
    axes.set_title(f"is confidence earned? (ECE {bins.ece:.3f})", fontsize=10, loc="left")
    axes.legend(frameon=False, fontsize=9, loc="upper left")
    axes.tick_params(labelbottom=False)
    plain(axes)
    counts.bar(middle, bins.count, width, color="#9a9a9a")
    counts.set_ylabel("frames")
    counts.set_xlabel("probability of the likeliest class")
    counts.margins(y=0.3)
    for at, count in zip(middle[filled], bins.count[filled], strict=True):
        counts.annotate(f"{count}", (at, count), (0, 1), textcoords="offset points", ha="center", fontsize=6.5)
    plain(counts)


def _confusion(axes: Axes, table: NDArray[np.int64], name: str) -> None:
    """Draw which share of the frames of each class is taken for each; rows without frames are grey."""
    from matplotlib.colors import LinearSegmentedColormap

    ramp = LinearSegmentedColormap.from_list("share", list(MATRIX_RAMP)).with_extremes(bad=EMPTY)
    frames = table.sum(axis=1, keepdims=True)
    share = np.ma.masked_invalid(np.where(frames > 0, table / np.maximum(frames, 1), np.nan))
    half = table.shape[0] // 2
    edge = 1.0 + 0.5 / half
    shown = axes.imshow(share, cmap=ramp, vmin=0, vmax=1, origin="lower", extent=(-edge, edge, -edge, edge))
    axes.plot([-edge, edge], [-edge, edge], color=SOFT, lw=0.6, ls=(0, (4, 4)))
    axes.set_xlabel(f"likeliest {name}")
    axes.set_ylabel(f"{name} of the label")
    axes.set_title("what is taken for what", fontsize=10, loc="left")
    bar = axes.figure.colorbar(shown, ax=axes, shrink=0.75, ticks=[0, 0.5, 1])
    bar.set_label("share of the label's frames", fontsize=8)
    bar.ax.set_yticklabels(["0 %", "50 %", "100 %"], fontsize=8)


def _errors(axes: Axes, error: NDArray[np.float64], name: str) -> None:
    reach = max(float(np.abs(error).max()), 0.05)
    weights = np.full(error.size, 100 / error.size)
    axes.hist(error, bins=np.linspace(-reach, reach, _ERROR_BINS + 1).tolist(), weights=weights, color=SERIES)
    axes.axvline(float(error.mean()), color=ACCENT, lw=1.6, label=f"mean {error.mean():+.3f}")
    inner = float(np.quantile(np.abs(error), 0.9))
    for side in (-inner, inner):
        label = f"90 % within {inner:.3f}" if side > 0 else None
        axes.axvline(side, color=SOFT, lw=1.0, ls=(0, (4, 4)), label=label)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel(f"predicted {name} - label (positive: too far {'up' if name == 'pitch' else 'right'})")
    axes.set_ylabel("share of the frames, %")
    axes.set_title("errors", fontsize=10, loc="left")
    axes.margins(y=0.2)
    axes.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=9)
    plain(axes)


def _over_time(axes: Axes, found: Measured, column: int, name: str) -> None:
    """Draw label and prediction frame by frame, session after session, nothing joined across their borders."""
    order = np.argsort(found.session, kind="stable")
    session, label = found.session[order], found.steering[order, column]
    expected, spread = found.expected[order, column], found.spread[order, column]
    starts = np.flatnonzero(np.diff(session, prepend=-1))
    ends = np.append(starts[1:], len(session))
    names = list(found.sessions)
    mark = "." if len(session) <= 3 * len(starts) else None
    for index, (first, end) in enumerate(zip(starts, ends, strict=True)):
        at, one = np.arange(first, end), slice(first, end)
        labels = ("one standard deviation of the prediction", "predicted", "label") if index == 0 else (None,) * 3
        low, high = np.clip(expected[one] - spread[one], -1, 1), np.clip(expected[one] + spread[one], -1, 1)
        axes.fill_between(at, low, high, color=SERIES, alpha=0.2, lw=0, label=labels[0])
        axes.plot(at, expected[one], color=SERIES, lw=1.1, marker=mark, label=labels[1])
        axes.plot(at, label[one], color=INK, lw=0.8, marker=mark, label=labels[2])
        if index:
            axes.axvline(first - 0.5, color=SOFT, lw=0.8)
        if len(starts) <= _MOST_NAMED:
            text = names[index] if len(names[index]) <= _NAME_CHARS else f"...{names[index][3 - _NAME_CHARS :]}"
            axes.annotate(
                text, (first, 1.0), (3, 3), xycoords=("data", "axes fraction"), textcoords="offset points",
                fontsize=8, color="#555555",
            )  # fmt: skip
    axes.set_xlim(-0.5, len(session) - 0.5)
    axes.set_ylim(-1.05, 1.05)
    axes.set_yticks([-1, -0.5, 0, 0.5, 1])
    axes.set_ylabel(f"{name} ({'up' if name == 'pitch' else 'right'} positive)")
    axes.set_xlabel("frame")
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper right", bbox_to_anchor=(1.0, -0.08), borderaxespad=0.3)
    plain(axes)
