"""A picture of how near plans come to the bounds of their tasks: a row for each task, a dot for each seed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hrt_cli.artifacts.stage import Existing
from hrt_cli.evaluation.runs import Runs, Task
from hrt_cli.report.figures.canvas import begin_drawing, plain
from hrt_cli.report.figures.palette import ACCENT, BOUND, SERIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_VERSION = 1
_ROW_INCHES = 0.32
_MARGIN_INCHES = 1.3
_MAX_INCHES = 60.0
_MAX_NAME = 28
_LEAST_SPAN = 5.0
"""Percent that are shown at least, so that differences that do not matter do not look large."""


def draw_runs(found: Runs, output: Path, *, existing: Existing) -> bool:
    """Draw each plan's share of the bound of its task, and the mean of the seeds.

    Parameters
    ----------
    found : Runs
        The plans, as `compare_runs` put them side by side.
    output : Path
        The PNG to write.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        A plan is gone; see `hrt_cli.artifacts.stage.begin`.
    """
    labels = [_label(task) for task in found.tasks]
    drawing = begin_drawing(
        "figure-runs",
        STAGE_VERSION,
        inputs={f"plan/{index}": Path(name) for index, name in enumerate(found.plans)},
        parameters={"labels": list(labels)},
        output=output,
        existing=existing,
    )
    if not drawing.up_to_date:
        drawing.publish(_figure(found, labels))
    return drawing.up_to_date


def _label(task: Task) -> str:
    """Name a task by the last of its folders, never by where that stands."""
    name = os.fsencode(Path(task.name).name).decode("utf-8", "backslashreplace") or "plans"
    return f"{name if len(name) <= _MAX_NAME else f'{name[:_MAX_NAME]}…'}, {task.method}"


def _shares(found: Runs, task: Task) -> list[float]:
    """Return the shares of the bound on what the plans were made for, percent."""
    runs = [found.plans[name] for name in task.plans]
    if task.objective == "discounted":
        return [100 * run.fraction_of_discounted_bound for run in runs if run.fraction_of_discounted_bound is not None]
    return [100 * run.fraction_of_bound for run in runs]


def _figure(found: Runs, labels: list[str]) -> Figure:
    from matplotlib.figure import Figure

    height = min(_MARGIN_INCHES + _ROW_INCHES * len(labels), _MAX_INCHES)
    figure = Figure(figsize=(8.0, height), layout="constrained")
    axes = figure.add_subplot()
    rows = [_shares(found, task) for task in found.tasks]
    span = max(_LEAST_SPAN, 100 - min((share for shares in rows for share in shares), default=0.0))
    for row, shares in enumerate(rows):
        axes.scatter(shares, [row] * len(shares), s=28, color=SERIES, alpha=0.7, lw=0, zorder=3)
        if shares:
            axes.vlines(float(np.mean(shares)), row - 0.3, row + 0.3, color=ACCENT, lw=2, zorder=2)
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.set_xlabel("share of the bound, %: a dot for each seed, a line for their mean")
    axes.set_xlim(100 - 1.05 * span, 100 + 0.05 * span)
    axes.axvline(100, color=BOUND, lw=1, ls="--", zorder=1)
    plain(axes)
    return figure
