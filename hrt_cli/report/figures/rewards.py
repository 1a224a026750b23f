"""A picture of cumulative rewards: what plans and methods collect on their way, beside the upper bound."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.plan import team_members
from hrt_cli.artifacts.stage import Existing
from hrt_cli.report.figures.canvas import Drawing, begin_drawing, shortened
from hrt_cli.report.figures.palette import BOUND, METHODS, plan_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Floats = NDArray[np.float64]

STAGE_VERSION = 2
_WIDTHS = {"plan": 3.2, "planner": 1.7, "baseline": 1.2}
_MEAN_WIDTHS = {"planner": 2.6, "baseline": 1.4}
_BAND_ALPHA = {"planner": 0.16, "baseline": 0.07}
_BAND_EDGE_ALPHA = 0.45
_BUDGET_ROUNDING = 2e-5
"""A cell's side is known to some digits only, and 399.999 m are to show the tick of 400."""
_FONT = 9
_LABEL_INCHES = 0.175
"""Height of the line of one label."""
_HEIGHT_INCHES = 5.6
_MARGIN_INCHES = 1.1
"""What of the figure's height is not the axes."""
_LEADER = (1.0, 1.012, 1.035, 1.06)
"""Where a label's line leaves the axes, bends twice and ends, in widths of the axes."""
_DIGIT_WIDTH = 0.0095
"""Width of a digit of a label, in widths of the axes."""
_MAX_NAME = 28


class Curve(Protocol):
    """One line; see `hrt_cli.evaluation.rewards.Curve`."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def role(self) -> str: ...  # noqa: D102
    @property
    def travelled(self) -> Floats: ...  # noqa: D102
    @property
    def reward(self) -> Floats: ...  # noqa: D102
    @property
    def low(self) -> Floats | None: ...  # noqa: D102
    @property
    def high(self) -> Floats | None: ...  # noqa: D102


class Chart(Protocol):
    """What is drawn; see `hrt_cli.evaluation.rewards.RewardChart`."""

    @property
    def title(self) -> str: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def limit(self) -> float: ...  # noqa: D102
    @property
    def discounted(self) -> bool: ...  # noqa: D102
    @property
    def bound(self) -> float: ...  # noqa: D102
    @property
    def curves(self) -> Sequence[Curve]: ...  # noqa: D102


@dataclass(frozen=True)
class RewardFigure:
    """A figure that may be written, decided before the work that fills it.

    Attributes
    ----------
    drawing : Drawing
    labels : dict of str to str
        What the plans are called in it, by their path.
    """

    drawing: Drawing
    labels: dict[str, str]

    @property
    def up_to_date(self) -> bool:
        """Whether the figure is there already; `draw` then leaves it."""
        return self.drawing.up_to_date

    def draw(self, chart: Chart) -> None:
        """Draw the curves of `chart`, plans thick and baselines thin, with the bound as a dashed line."""
        if self.up_to_date:
            return
        self.drawing.publish(_figure(chart, self.labels))


def begin_figure(
    scoremap_path: Path,
    plan_paths: tuple[Path, ...],
    output: Path,
    parameters: dict[str, Any],
    *,
    existing: Existing,
) -> RewardFigure:
    """Decide whether a figure of cumulative rewards has to be drawn.

    Parameters
    ----------
    scoremap_path, plan_paths : Path
        What the rewards are of; a team's plan stands for its robots', which are inputs too.
    output : Path
        The PNG to write.
    parameters : dict
        All else that changes the rewards, as JSON values.
    existing : Existing
        What to do where `output` exists.

    Raises
    ------
    InputError, OutputError
        An input is missing; see `hrt_cli.artifacts.stage.begin`.
    """
    labels = _labels(plan_paths)
    inputs = {"scoremap": scoremap_path} | {f"plan/{index}": path for index, path in enumerate(plan_paths)}
    for role, path in list(inputs.items())[1:]:
        inputs |= {f"{role}/{robot}": member for robot, member in enumerate(team_members(path))}
    given = parameters | {"labels": list(labels.values())}
    job = begin_drawing(
        "figure-rewards", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=given
    )
    return RewardFigure(job, labels)


def _labels(paths: tuple[Path, ...]) -> dict[str, str]:
    """Name plans by their files, never by their folders; of the same name, by their number."""
    distinct = list(dict.fromkeys(map(str, paths)))
    names = {path: os.fsencode(Path(path).name).decode("utf-8", "backslashreplace") for path in distinct}
    often = Counter(names.values())
    return {
        path: (f"{index} " if often[name] > 1 else "") + shortened(name, _MAX_NAME + 1)
        for index, (path, name) in enumerate(names.items(), 1)
    }


def _figure(chart: Chart, labels: dict[str, str]) -> Figure:
    from matplotlib.figure import Figure

    height = max(_HEIGHT_INCHES, (len(chart.curves) + 1) * _LABEL_INCHES + _MARGIN_INCHES)
    figure = Figure(figsize=(10.5, height), layout="constrained")
    axes = figure.add_subplot()
    plans = [curve for curve in chart.curves if curve.role == "plan"]
    entries = [(chart.bound, "upper bound", BOUND, 1.3, "--")]
    for curve in chart.curves:
        colour = plan_colour(plans.index(curve)) if curve.role == "plan" else METHODS[curve.name]
        label = labels[curve.name] if curve.role == "plan" else curve.name
        width = (_WIDTHS if curve.low is None else _MEAN_WIDTHS)[curve.role]
        _show_curve(axes, curve, colour, width, chart.limit)
        entries.append((float(curve.reward[-1]), label, colour, width, "-"))
    axes.axhline(chart.bound, color=BOUND, lw=1.3, ls="--", zorder=2)
    axes.set_xlim(0, chart.limit * (1 + _BUDGET_ROUNDING))
    top = 1.04 * max([chart.bound, *(float(np.max(c.high)) for c in chart.curves if c.high is not None)])
    axes.set_ylim(0, top or 1.0)
    axes.set_xlabel("steps" if chart.unit == "steps" else f"distance travelled, {chart.unit}")
    axes.set_ylabel("collected score" + (", discounted" if chart.discounted else ""))
    axes.set_title(chart.title, loc="left", fontsize=11)
    axes.grid(axis="y", color="#e4e4e4", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    _show_labels(axes, entries, top or 1.0, _LABEL_INCHES / (height - _MARGIN_INCHES))
    return figure


def _show_curve(axes: Axes, curve: Curve, colour: str, width: float, limit: float) -> None:
    """Draw a line, thin ones above thick ones; dotted where a walk has ended before the budget."""
    order = 5 - width / 4
    axes.plot(curve.travelled, curve.reward, color=colour, lw=width, zorder=order, solid_capstyle="butt")
    end = float(curve.travelled[-1])
    if end < limit:
        axes.plot([end, limit], [curve.reward[-1]] * 2, color=colour, lw=width, ls=":", zorder=order)
    if curve.low is not None and curve.high is not None:
        alpha = _BAND_ALPHA[curve.role]
        axes.fill_between(curve.travelled, curve.low, curve.high, color=colour, alpha=alpha, lw=0, zorder=1)
        for edge in (curve.low, curve.high):
            axes.plot(curve.travelled, edge, color=colour, alpha=_BAND_EDGE_ALPHA, lw=0.6, zorder=1)


def _show_labels(axes: Axes, entries: list[tuple[float, str, str, float, str]], top: float, gap: float) -> None:
    """Name each line where it ends, with its last value; labels do not overlap, and of equals the first is highest."""
    entries = [entries[k] for k in sorted(range(len(entries)), key=lambda k: (entries[k][0], -k))]
    ends = np.array([entry[0] for entry in entries]) / top
    decimals = int(np.clip(3 - np.floor(np.log10(top)), 0, 6))
    numbers = [f"{value:.{decimals}f}" for value, *_ in entries]
    wide = (max(map(len, numbers)) + 1) * _DIGIT_WIDTH
    for at, place, number, (_, label, colour, width, style) in zip(
        ends, _spaced(ends, gap), numbers, entries, strict=True
    ):
        bent = [at, at, place, place]
        axes.plot(
            _LEADER,
            bent,
            transform=axes.transAxes,
            clip_on=False,
            color=colour,
            lw=width,
            ls=style,
            solid_capstyle="butt",
        )
        for x, text, side in ((wide, number, "right"), (wide + _DIGIT_WIDTH, label, "left")):
            axes.text(
                _LEADER[-1] + x,
                place,
                text,
                transform=axes.transAxes,
                ha=side,
                va="center_baseline",
                fontsize=_FONT,
                parse_math=False,
            )


def _spaced(places: Floats, gap: float) -> Floats:
    """Move rising places in [0, 1] as little as makes them `gap` apart (least squares: isotonic regression)."""
    from scipy.optimize import isotonic_regression

    room = gap * np.arange(places.size)
    low, high = gap / 2, max(gap / 2, 1 - gap / 2 - room[-1])
    return np.asarray(np.clip(isotonic_regression(places - room).x, low, high) + room)
