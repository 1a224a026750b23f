"""Two score tables, class by class."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.scores import ClassScore, read_score_table
from hrt_cli.evaluation.compare.result import Found, apart


def compare_scores(path_a: Path, path_b: Path) -> Found:
    """Compare two score tables.

    `rmse` and `max` are of the means of the classes that both have, `sd_max` and `evidence_m` the largest differences
    of their standard deviations and metres of evidence, `classes` the number that only one has, `names` that of the
    classes called otherwise.

    Raises
    ------
    InputError
        A table cannot be used.
    """
    a, b = (read_score_table(path).scores for path in (path_a, path_b))
    both = sorted(a.keys() & b.keys())
    alone = sorted(a.keys() ^ b.keys())
    gaps = [abs(a[k].mean - b[k].mean) for k in both]
    renamed = [k for k in both if a[k].name != b[k].name]
    means = [
        apart("rmse", math.sqrt(math.fsum(gap * gap for gap in gaps) / len(gaps)), family="score"),
        apart("max", max(gaps), family="score"),
        apart("sd_max", max(abs(a[k].sd - b[k].sd) for k in both)),
        apart("evidence_m", max(abs(a[k].evidence_m - b[k].evidence_m) for k in both), "m"),
    ]
    figures = [
        *(means if both else []),
        apart("classes", float(len(alone))),
        apart("names", float(len(renamed))),
    ]
    lines = [f"class {k} is in {'A' if k in a else 'B'} only" for k in alone]
    lines += [f"class {k}: {_told(a[k])} in A, {_told(b[k])} in B" for k in both if a[k] != b[k]]
    detail: dict[str, Any] = {
        "per_class": [{"id": k, "a": _entry(a.get(k)), "b": _entry(b.get(k))} for k in sorted({*a, *b})]
    }
    return Found(figures, lines, detail)


def _entry(score: ClassScore | None) -> dict[str, Any] | None:
    if score is None:
        return None
    return {"name": score.name, "mean": score.mean, "sd": score.sd, "evidence_m": score.evidence_m}


def _told(score: ClassScore) -> str:
    name = f"{score.name!r}, " if score.name else ""
    return f"{name}mean {score.mean:.6g}, sd {score.sd:.6g}, {score.evidence_m:.6g} m of evidence"
