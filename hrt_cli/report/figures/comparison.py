"""Pictures of a comparison: maps of A, of B and of what differs; bars and dots where there is no map."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hrt_cli.artifacts.plan import team_members
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import ArgumentError
from hrt_cli.evaluation.compare.kinds import kind_of
from hrt_cli.logs.kinds import files_of
from hrt_cli.report.figures import comparison_maps as maps
from hrt_cli.report.figures.canvas import Drawing, begin_drawing
from hrt_cli.report.figures.palette import BLUE, BOUND, GRID, INK, ORANGE, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hrt_cli.evaluation.compare.result import Verdict
    from hrt_cli.evaluation.compare.stage import Comparison

STAGE_VERSION = 1
_OF_A, _OF_B = maps.OF_A, maps.OF_B
_BEYOND, _WITHIN = ORANGE, BLUE
_MOST_ROWS = 30
_ROW_INCHES = 0.27
_MAX_NAME = 46
_CAPTION_CHARS = 130


@dataclass(frozen=True)
class ComparisonFigure:
    """A figure that may be written, decided before the comparison that fills it."""

    a: Path
    b: Path
    scoremap: Path | None
    drawing: Drawing

    def draw(self, found: Comparison) -> None:
        """Draw what was found, unless that is there already."""
        if not self.drawing.up_to_date:
            self.drawing.publish(_figure(self.a, self.b, self.scoremap, found))


def begin_comparison(
    a: Path,
    b: Path,
    output: Path,
    tolerances: Mapping[str, float],
    *,
    scoremap: Path | None = None,
    existing: Existing,
) -> ComparisonFigure:
    """Decide whether a figure of a comparison has to be drawn.

    Parameters
    ----------
    a, b : Path
        Two artifacts of one kind.
    output : Path
        The PNG to write.
    tolerances : mapping of str to float
        As in `hrt_cli.evaluation.compare.stage.compare_files`.
    scoremap : Path, optional
        Scoremap to draw plans on.
    existing : Existing
        What to do where `output` exists.

    Raises
    ------
    InputError, ArgumentError, OutputError
        An input cannot be used; a scoremap is given for what is no plan; see `hrt_cli.artifacts.stage.begin`.
    """
    kind = kind_of(a)
    if scoremap is not None and kind not in ("plan", "team plan"):
        raise ArgumentError(f"--scoremap {scoremap}: plans are drawn on a scoremap, and {a} is none")
    inputs = _files("a", a, kind) | _files("b", b, kind_of(b)) | ({"scoremap": scoremap} if scoremap else {})
    drawing = begin_drawing(
        "figure-compare",
        STAGE_VERSION,
        inputs=inputs,
        parameters={"tolerances": dict(sorted(tolerances.items()))},
        output=output,
        existing=existing,
    )
    return ComparisonFigure(a, b, scoremap, drawing)


def _files(role: str, path: Path, kind: str) -> dict[str, Path]:
    robots = team_members(path) if kind == "team plan" else []
    return files_of(role, path) | {f"{role}/robot/{k}": member for k, member in enumerate(robots)}


def _figure(a: Path, b: Path, scoremap: Path | None, found: Comparison) -> Figure:
    names = tuple(os.fsencode(path.name).decode("utf-8", "backslashreplace") for path in (a, b))
    caption = _caption(names, found)
    if found.kind == "classes":
        return maps.draw_classes(a, b, found.verdicts, caption)
    if found.kind == "scoremap":
        return maps.draw_scoremaps(a, b, found.verdicts, caption)
    if found.kind in ("plan", "team plan"):
        return maps.draw_plans(a, b, scoremap, caption)
    if found.kind == "drive log":
        return maps.draw_drives(a, b, caption)
    if found.kind == "scores":
        return _draw_scores(found.detail["per_class"], caption)
    if found.kind == "figures":
        return _draw_figures(found.verdicts, caption)
    return _draw_tensors(found.detail["per_tensor"], caption)


def _caption(names: tuple[str, ...], found: Comparison) -> str:
    beyond = [verdict.figure for verdict in found.differing]
    told = [each.name + (f" {each.difference:.4g} {each.unit}".rstrip() if each.difference else "") for each in beyond]
    more = f", {len(told) - 4} more" if len(told) > 4 else ""
    words = "the same within tolerances" if found.same else f"different in {', '.join(told[:4])}{more}"
    return "\n".join(textwrap.wrap(f"A: {names[0]}, B: {names[1]}; {words}", _CAPTION_CHARS))


def _rows(count: int, caption: str) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, max(2.6, count * _ROW_INCHES + 1.5)), layout="constrained")
    figure.suptitle(caption, x=0.01, ha="left", fontsize=10, parse_math=False)
    axes = figure.add_subplot()
    axes.grid(axis="x", color=GRID, lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    return figure, axes


def _draw_scores(per_class: list[dict[str, Any]], caption: str) -> Figure:
    """Draw the mean of each class in A and in B, with one standard deviation to either side."""
    shown = per_class[:_MOST_ROWS]
    figure, axes = _rows(2 * len(shown), caption)
    at = np.arange(len(shown))
    for key, colour, move in (("a", _OF_A, -0.19), ("b", _OF_B, 0.19)):
        means = [each[key]["mean"] if each[key] else 0.0 for each in shown]
        sds = [each[key]["sd"] if each[key] else 0.0 for each in shown]
        axes.barh(at + move, means, 0.36, xerr=sds, color=colour, ecolor=INK, capsize=2, label=key.upper())
        for place, each in zip(at, shown, strict=True):
            if each[key] is None:
                axes.text(0.005, place + move, f"not in {key.upper()}", va="center_baseline", fontsize=8)
    labels = [f"{each['id']}  {((each['a'] or each['b'])['name'])[:_MAX_NAME]}".strip() for each in shown]
    axes.set_yticks(at, labels, parse_math=False)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlim(0, 1.02)
    axes.set_xlabel("expected score ± one standard deviation" + _left_out(per_class, shown, "classes"))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=9, frameon=False)
    return figure


def _draw_tensors(per_tensor: dict[str, dict[str, Any]], caption: str) -> Figure:
    """Draw the largest difference of a weight in each tensor, on a logarithmic axis."""
    order = sorted(per_tensor, key=lambda name: -per_tensor[name]["max"])
    shown = order[:_MOST_ROWS]
    figure, axes = _rows(len(shown), caption)
    most = np.array([per_tensor[name]["max"] for name in shown])
    floor = most[most > 0].min() / 10 if (most > 0).any() else 1e-12
    axes.barh(range(len(shown)), most, 0.7, color=_WITHIN)
    if (most > 0).any():
        axes.set_xscale("log")
    axes.set_xlim(floor, 3 * max(float(most.max(initial=0.0)), floor))
    for row, value in enumerate(most):
        axes.text(max(value, floor) * 1.05, row, f" {value:.3g}", va="center_baseline", fontsize=8)
    axes.set_yticks(range(len(shown)), [name[:_MAX_NAME] for name in shown], parse_math=False)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlabel("largest absolute difference of a weight" + _left_out(order, shown, "tensors"))
    return figure


def _draw_figures(verdicts: list[Verdict], caption: str) -> Figure:
    """Draw by how much of the larger of both each figure changed, with its values beside it."""
    numbers = [each for each in verdicts if isinstance(each.figure.a, int | float) and each.figure.difference]
    order = sorted(
        numbers, key=lambda each: (each.state != "DIFFERENT", each.figure.name.count("."), -abs(_change(each)))
    )
    shown = order[:_MOST_ROWS]
    figure, axes = _rows(max(1, len(shown)), caption)
    for row, each in enumerate(shown):
        colour = {"DIFFERENT": _BEYOND, "ok": _WITHIN, "told": SOFT}[each.state]
        change = _change(each)
        axes.plot([0, change], [row, row], color=colour, lw=1.4)
        axes.plot(change, row, "os"[each.state == "DIFFERENT"], color=colour, ms=6)
        told = f"{each.figure.a:.6g} → {each.figure.b:.6g}"
        axes.text(1.01, row, told, transform=axes.get_yaxis_transform(), va="center_baseline", fontsize=8)
    if not shown:
        axes.text(0.5, 0.5, "no number differs", transform=axes.transAxes, ha="center", fontsize=10)
    for state, colour, mark in (("DIFFERENT", _BEYOND, "s"), ("ok", _WITHIN, "o"), ("told", SOFT, "o")):
        if any(each.state == state for each in shown):
            words = {"DIFFERENT": "beyond its tolerance", "ok": "within its tolerance", "told": "does not count"}
            axes.plot([], [], mark, color=colour, label=words[state])
    axes.axvline(0, color=BOUND, lw=0.8)
    names = [each.figure.name for each in shown]
    short = [name if len(name) <= _MAX_NAME else f"…{name[-_MAX_NAME:]}" for name in names]
    axes.set_yticks(range(len(shown)), short, parse_math=False)
    axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    reach = max([1.0, *(abs(_change(each)) for each in shown)]) * 1.1
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("change from A to B, % of the larger" + _left_out(order, shown, "figures that differ"))
    if shown:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9, frameon=False)
    return figure


def _change(verdict: Verdict) -> float:
    a, b = float(verdict.figure.a or 0), float(verdict.figure.b or 0)
    return 100 * (b - a) / (max(abs(a), abs(b)) or 1.0)


def _left_out(all_of: list[Any], shown: list[Any], what: str) -> str:
    return f"; {len(all_of) - len(shown)} more {what} are not shown" if len(all_of) > len(shown) else ""
