"""The scoremap stage: classes and their scores, from file to file."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.scores import PRIOR, ClassScore, read_scores
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.drivability.cells import Cover, cover, score_cells
from hrt_cli.errors import InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap, read_scoremap

STAGE = "scoremap"
STAGE_VERSION = 1


@dataclass(frozen=True)
class ScoremapSummary:
    """What the scoremap stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    rows, cols, cell_size_m : int, int, float
        The grid.
    go_cells : int
        Cells that may be entered.
    mean_score : float
        Mean expected score of those.
    unknown : list of int
        Classes that no score was given for: they have the prior's 0.5.
    seconds : float
    """

    up_to_date: bool
    rows: int
    cols: int
    cell_size_m: float
    go_cells: int
    mean_score: float
    unknown: list[int]
    seconds: float


def make_scoremap(
    classes_path: Path,
    output: Path,
    *,
    scores_path: Path | None = None,
    unknown_as_prior: bool = False,
    cell_m: float = 1.0,
    explore: float = 0.0,
    no_go_below: float | None = None,
    creation: dict[str, str] | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> ScoremapSummary:
    """Make `output` (a scoremap) from a class raster and a score table.

    Without a table every class has the uniform prior. With one, every class of the raster must stand in it, or with
    `unknown_as_prior` has the prior too.

    Raises
    ------
    InputError
        The class raster or the table cannot be used, or a class of the raster is not in the table.
    ArgumentError
        The cell does not fit the raster.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    began = time.monotonic()
    creation = creation or {}
    inputs = {"classes": classes_path} | ({"scores": scores_path} if scores_path else {})
    parameters: dict[str, Any] = {
        "cell_m": cell_m,
        "explore": explore,
        "no_go_below": no_go_below,
        "creation": creation,
    }
    if unknown_as_prior:
        parameters["unknown_as_prior"] = True
    job = begin(
        STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs={output: cog_provenance}, existing=existing
    )
    scores = read_scores(scores_path) if scores_path else {}
    unknown: list[int] = []
    if job.up_to_date:
        scoremap = read_scoremap(output)
    else:
        with open_classes(classes_path) as classes:
            covered = cover(classes.grid, classes.read, cell_m, progress)
        table = _scores_for(covered, scores, classes_path, scores_path, unknown_as_prior)
        unknown = [k for k in covered.classes if k not in scores]
        score, sd = score_cells(covered, table, explore, no_go_below)
        if np.isnan(score).all():
            raise InputError(classes_path, "gives no cell that may be entered: all are nodata or below --no-go-below")
        scoremap = Scoremap(score, sd, covered.grid, cell_m)
        publish_scoremap(output, scoremap, job.provenance, tags={}, creation=creation)
    go = np.isfinite(scoremap.score)
    return ScoremapSummary(
        job.up_to_date,
        scoremap.grid.rows,
        scoremap.grid.cols,
        cell_m,
        int(go.sum()),
        float(scoremap.score[go].mean(dtype=np.float64)),
        unknown,
        time.monotonic() - began,
    )


def _scores_for(
    covered: Cover,
    scores: dict[int, ClassScore],
    classes_path: Path,
    scores_path: Path | None,
    unknown_as_prior: bool,
) -> dict[int, ClassScore]:
    if not covered.classes:
        raise InputError(classes_path, "holds no class: all is nodata")
    absent = [k for k in covered.classes if k not in scores]
    if scores_path is not None and absent and not (unknown_as_prior and len(absent) < len(covered.classes)):
        remedy = "give it a score, or say --unknown-as-prior if it is new"
        raise InputError(scores_path, f"says nothing of class {absent[0]}, which {classes_path} holds", remedy)
    return dict.fromkeys(covered.classes, PRIOR) | scores
