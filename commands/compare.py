"""`hrt compare`: two artifacts of one kind, and how they differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hrt_cli import options as opt
from hrt_cli.manual import Command
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from hrt_cli.artifacts.stage import Existing
    from hrt_cli.evaluation.compare.result import Value, Verdict
    from hrt_cli.evaluation.compare.stage import Comparison

_STATES = {"told": "not counted"}
_MOST_ROWS = 40
_MOST_LINES = 20


@click.command(
    cls=Command,
    sections={"What counts": "--tolerance"},
    difference="a figure is larger than its tolerance",
    keys=("kind", "same", "figures", "origin"),
    see_also=("verify", "evaluate"),
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o site/classes.tif --classes 6
  hrt segment site/ortho.tif -o site/again.tif --classes 6 --co COMPRESS=LZW
  hrt compare site/classes.tif site/again.tif
""",
)
@click.argument("a", type=opt.PATH)
@click.argument("b", type=opt.PATH)
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    type=opt.Tolerance(),
    help="How large a figure may be, in its unit; of a similarity, how far below 1  [default: 0]",
)
@click.option("--scoremap", type=opt.SCOREMAP, help="Scoremap to draw plans on (with --figure).")
@opt.figure_opt
@opt.existing_options
@opt.console_options
def compare(
    a: Path,
    b: Path,
    tolerances: tuple[tuple[str, float], ...],
    scoremap: Path | None,
    figure: Path | None,
    existing: Existing,
    console: Console,
) -> None:
    """Tell how two artifacts of one kind, A and B, differ.

    Class rasters, scoremaps, score tables, plans, models, drive logs, and the JSON that --json prints. It is what they
    hold that counts, not how it is stored or what made it. Exits with 3 if a figure is larger than its tolerance, and
    names it; rasters are compared pixel by pixel only where they lie on one another.
    """
    from hrt_cli.evaluation.compare.stage import compare_files, require_same

    if scoremap is not None and figure is None:
        raise click.UsageError("--scoremap is drawn on: give --figure, too")
    names = [name for name, _ in tolerances]
    if len(set(names)) < len(names):
        raise click.UsageError("--tolerance is given twice for one figure")
    drawing = None
    if figure is not None:
        from hrt_cli.report.figures.comparison import begin_comparison

        drawing = begin_comparison(a, b, figure, dict(tolerances), scoremap=scoremap, existing=existing)
    with console.bar("compare") as progress:
        found = compare_files(a, b, dict(tolerances), progress=progress, note=console.note)
    if drawing is not None:
        drawing.draw(found)
    console.result("\n".join(_lines(a, b, found)), _document(found), only_here=True)
    require_same(a, b, found)


def _document(found: Comparison) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for verdict in found.verdicts:
        each = verdict.figure
        figures[each.name] = {
            "a": each.a,
            "b": each.b,
            "difference": each.difference,
            "tolerance": verdict.tolerance,
            "ok": {"ok": True, "DIFFERENT": False, "told": None}[verdict.state],
            "unit": each.unit,
        } | ({} if each.similarity is None else {"similarity": each.similarity})
    return {"kind": found.kind, "same": found.same, "figures": figures, **found.detail, "origin": found.origin}


def _lines(a: Path, b: Path, found: Comparison) -> list[str]:
    made = {True: "made from the same inputs", False: "made from other inputs", None: ""}[found.origin["same_inputs"]]
    equal = all(each.figure.difference == 0 for each in found.verdicts)
    verdict = "DIFFERENT" if not found.same else "the same" if equal else "the same within the tolerances"
    lines = [f"{found.kind}: {a} (A) and {b} (B) are {verdict}" + (f"; {made}" if made else "")]
    shown = found.verdicts
    if len(shown) > _MOST_ROWS:
        shown = [each for each in shown if each.figure.difference != 0]
        lines.append(f"{len(found.verdicts) - len(shown)} of {len(found.verdicts)} figures are equal")
    rows = [["figure", "A", "B", "difference", "tolerance", ""], *map(_row, shown[:_MOST_ROWS])]
    widths = [max(len(row[k]) for row in rows) for k in range(6)]
    table = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += table if shown else []
    lines += [f"and {len(shown) - _MOST_ROWS} more"] if len(shown) > _MOST_ROWS else []
    lines += found.lines[:_MOST_LINES]
    return lines + ([f"and {len(found.lines) - _MOST_LINES} more"] if len(found.lines) > _MOST_LINES else [])


def _row(verdict: Verdict) -> list[str]:
    each = verdict.figure
    difference = "yes" if each.difference is None else f"{each.difference:.6g} {each.unit}".rstrip()
    limit = "" if verdict.tolerance is None else f"{verdict.tolerance:g}"
    b = each.b if each.similarity is None else each.similarity
    return [each.name, _cell(each.a), _cell(b), difference, limit, _STATES.get(verdict.state, verdict.state)]


def _cell(value: Value) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else str(value) if isinstance(value, bool) else f"{value:.6g}"
