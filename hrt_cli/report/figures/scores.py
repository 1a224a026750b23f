"""A picture of what drives taught: the drivability of each class before and after, and the metres it rests on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hrt_cli.artifacts.scores import PRIOR, ClassScore, read_score_table
from hrt_cli.artifacts.stage import Existing
from hrt_cli.raster.style import class_colour
from hrt_cli.report.figures.canvas import begin_drawing, plain, shortened
from hrt_cli.report.figures.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_VERSION = 1
_ROW_IN, _MARGIN_IN = 0.34, 1.3
_MAX_CLASSES = 40
_OFFSET = 0.16
"""Of what was believed before, above what is now, in rows."""


def draw_scores(scores_path: Path, prior_path: Path | None, output: Path, *, existing: Existing) -> bool:
    """Draw a score table beside the one that it goes on from.

    Parameters
    ----------
    scores_path : Path
        What `hrt feedback` wrote.
    prior_path : Path or None
        The table that it went on from; None: nothing was known.
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
        A table cannot be read; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {"scores": scores_path} | ({"prior": prior_path} if prior_path else {})
    job = begin_drawing("figure-scores", STAGE_VERSION, inputs=inputs, output=output, existing=existing)
    if job.up_to_date:
        return True
    table = read_score_table(scores_path)
    before = read_score_table(prior_path).scores if prior_path else {}
    job.publish(scores_figure(before, table.scores, len(table.logs)))
    return False


def scores_figure(before: dict[int, ClassScore], after: dict[int, ClassScore], logs: int) -> Figure:
    """Return the figure: a row for each class; of more than `_MAX_CLASSES` those with the most new evidence."""
    from matplotlib.figure import Figure

    was = {k: before.get(k, PRIOR) for k in after}
    gained = {k: s.evidence_m - was[k].evidence_m for k, s in after.items()}
    shown = sorted(sorted(after, key=lambda k: (-gained[k], k))[:_MAX_CLASSES])
    figure = Figure(figsize=(9.0, len(shown) * _ROW_IN + _MARGIN_IN), layout="constrained")
    axes = figure.add_subplot()
    rows = np.arange(len(shown))
    for row, k in enumerate(shown):
        old, new = was[k], after[k]
        axes.errorbar(
            old.mean, row - _OFFSET, xerr=old.sd, fmt="o", ms=5, mfc="white", color=SOFT, elinewidth=1.2,
            label="before, with its standard deviation" if row == 0 else "_before",
        )  # fmt: skip
        axes.errorbar(
            new.mean, row + _OFFSET, xerr=new.sd, fmt="o", ms=7, color=class_colour(k), mec=INK, mew=0.6,
            elinewidth=2.4, label="after" if row == 0 else "_after",
        )  # fmt: skip
        change = f" (+{gained[k]:.1f})" if gained[k] > 0 else ""
        axes.text(1.03, row, f"{new.evidence_m:.1f}{change}", transform=axes.get_yaxis_transform(), va="center")
    axes.text(1.03, 1.0, "m of evidence", transform=axes.transAxes, va="bottom", fontsize=9)
    axes.set_xlim(0, 1)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_yticks(rows, [shortened(f"{k} {after[k].name}".strip()) for k in shown], parse_math=False)
    axes.set_xlabel("drivability")
    least = "" if len(shown) == len(after) else f"; the {len(shown)} of {len(after)} classes that gained most"
    axes.set_title(
        f"{sum(gained.values()):.1f} m of new evidence, {logs} {'log' if logs == 1 else 'logs'} in the table{least}",
        loc="left",
        fontsize=11,
    )
    plain(axes)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.55 / (len(shown) * _ROW_IN)), ncols=2, fontsize=9, frameon=False
    )
    return figure
