"""Two scoremaps, cell by cell: scores, their standard deviations, and where a robot may go."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.evaluation.compare.grids import common_windows, compare_grids
from hrt_cli.evaluation.compare.result import Figure, Found, apart
from hrt_cli.raster.scoremap import read_scoremap

_STRIP_CELLS = 2**20


def compare_scoremaps(path_a: Path, path_b: Path) -> Found:
    """Compare two scoremaps, whose size is bounded by `read_scoremap`.

    `rmse` and `max` are of the scores where both may be entered, `no_go` the cells that may be entered in A only, `go`
    those in B only; `sd_rmse` and `sd_max` likewise of the standard deviations, `sd_unknown` the cells where only one
    has any.

    Raises
    ------
    InputError
        A scoremap cannot be used.
    """
    a, b = read_scoremap(path_a), read_scoremap(path_b)
    figures = compare_grids(path_a, a.grid, path_b, b.grid)
    common = common_windows(a.grid, b.grid)
    if common is None:
        return Found(figures, ["cells are not compared: they do not lie on one another"])
    in_a, in_b = (window.slices for window in common)
    score_a, score_b = a.score[in_a], b.score[in_b]
    go_a, go_b = np.isfinite(score_a), np.isfinite(score_b)
    no_go, go = int((go_a & ~go_b).sum()), int((go_b & ~go_a).sum())
    found = [
        *_apart("", score_a, score_b),
        apart("no_go", float(no_go)),
        apart("go", float(go)),
        *_apart("sd_", a.sd[in_a], b.sd[in_b]),
        apart("sd_unknown", float((np.isnan(a.sd[in_a]) ^ np.isnan(b.sd[in_b]))[go_a & go_b].sum())),
    ]
    lines, detail = [], {"cells": int(score_a.size), "go_a": int(go_a.sum()), "go_b": int(go_b.sum())}
    place = _farthest(score_a, score_b)
    more: dict[str, Any] = {"farthest_cell": None}
    if place is not None:
        row, col = place[0] + in_a[0].start, place[1] + in_a[1].start
        more = {"farthest_cell": [row, col]}
        lines.append(f"farthest apart: cell {row},{col}, {score_a[place]:.6g} in A and {score_b[place]:.6g} in B")
    for cells, which in ((go_a & ~go_b, "is no-go in B only"), (go_b & ~go_a, "is no-go in A only")):
        if cells.any():
            row, col = np.argwhere(cells)[0]
            others = f", and {int(cells.sum()) - 1} more" if cells.sum() > 1 else ""
            lines.append(f"cell {row + in_a[0].start},{col + in_a[1].start} {which}{others}")
    return Found([*found, *figures], lines, {**detail, **more})


def _apart(prefix: str, a: NDArray[np.float32], b: NDArray[np.float32]) -> list[Figure]:
    """Return root mean square and largest absolute difference where both have values; none without such a cell."""
    squares, count, most = 0.0, 0, 0.0
    step = max(1, _STRIP_CELLS // a.shape[1])
    for top in range(0, len(a), step):
        strip = slice(top, top + step)
        gap = np.abs(a[strip].astype(np.float64) - b[strip])
        gap = gap[np.isfinite(gap)]
        squares += float((gap * gap).sum())
        count += gap.size
        most = max(most, float(gap.max(initial=0.0)))
    if not count:
        return []
    family = f"{prefix}score"
    return [
        apart(f"{prefix}rmse", math.sqrt(squares / count), family=family),
        apart(f"{prefix}max", most, family=family),
    ]


def _farthest(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[int, int] | None:
    gap = np.nan_to_num(np.abs(a - b))
    if not gap.any():
        return None
    row, col = np.unravel_index(int(gap.argmax()), gap.shape)
    return int(row), int(col)
