"""The scoremap stage: classes and their scores, from file to file."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.scores import PRIOR, ClassScore, read_scores
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.drivability.cells import Cover, cover, score_cells
from hrt_cli.drivability.interest import Interest, degree, open_interest, values_on, weighed
from hrt_cli.drivability.limits import NO_LIMITS, Limits, place_limits, taken_by
from hrt_cli.errors import InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.cog import cog_provenance
from hrt_cli.raster.gate import open_raster
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
    interest_range : (float, float) or None
        The values of the raster of interest that count 0 and 1, if there is one.
    interest_cells : int or None
        Cells that may be entered and are of interest.
    aoi_cells, keep_out_cells : int or None
        Cells that may not be entered only for the area of interest, and of the others those only for the keep-outs.
    limit_notes : list of str
        What the user ought to know of the files of either.
    """

    up_to_date: bool
    rows: int
    cols: int
    cell_size_m: float
    go_cells: int
    mean_score: float
    unknown: list[int]
    seconds: float
    interest_range: tuple[float, float] | None = None
    interest_cells: int | None = None
    aoi_cells: int | None = None
    keep_out_cells: int | None = None
    limit_notes: list[str] = field(default_factory=list)


def make_scoremap(
    classes_path: Path,
    output: Path,
    *,
    scores_path: Path | None = None,
    unknown_as_prior: bool = False,
    cell_m: float = 1.0,
    explore: float = 0.0,
    no_go_below: float | None = None,
    no_go_share: float = 1.0,
    margin_m: float = 0.0,
    limits: Limits = NO_LIMITS,
    interest: Interest | None = None,
    creation: dict[str, str] | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> ScoremapSummary:
    """Make `output` (a scoremap) from a class raster and a score table.

    Without a table every class has the uniform prior. With one, every class of the raster must stand in it, or with
    `unknown_as_prior` has the prior too. No-go are cells that score less than `no_go_below`, those of which more than
    `no_go_share` is of classes that do, and those within `margin_m` of either; so are those that `limits` bar, with the
    same margin. With an `interest` a cell's score is its expected drivability times what it is worth; where the robot
    may go does not depend on it.

    Raises
    ------
    InputError
        The class raster, the table, a limit or the raster of interest cannot be used, a class of the raster is not in
        the table, no cell may be entered, or none is of interest.
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
    if no_go_share < 1.0:
        parameters["no_go_share"] = no_go_share
    if margin_m > 0.0:
        parameters["margin_m"] = margin_m
    if unknown_as_prior:
        parameters["unknown_as_prior"] = True
    inputs |= limits.files()
    if interest:
        inputs |= _files_of(interest)
        parameters["interest"] = interest.parameters
    job = begin(
        STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs={output: cog_provenance}, existing=existing
    )
    scores = read_scores(scores_path) if scores_path else {}
    unknown: list[int] = []
    if job.up_to_date:
        scoremap = read_scoremap(output)
        placed = place_limits(limits, margin_m, scoremap.grid, classes_path)
    else:
        with open_classes(classes_path) as classes:
            placed = place_limits(limits, margin_m, classes.grid.coarse(cell_m), classes_path)
            covered = cover(classes.grid, classes.read, cell_m, progress)
        table = _scores_for(covered, scores, classes_path, scores_path, unknown_as_prior)
        unknown = [k for k in covered.classes if k not in scores]
        score, sd = score_cells(covered, table, explore, no_go_below, no_go_share, margin_m)
        if np.isnan(score).all():
            raise InputError(classes_path, "gives no cell that may be entered: all are nodata or below --no-go-below")
        scoremap, tags = placed.bar(Scoremap(score, sd, covered.grid, cell_m), classes_path)
        if interest:
            scoremap, more = _with_interest(scoremap, interest)
            tags |= more
        publish_scoremap(output, scoremap, job.provenance, tags=tags, creation=creation)
    go = np.isfinite(scoremap.score)
    interest_range, interest_cells = _interest_in(output) if interest else (None, None)
    taken = taken_by(limits, output)
    return ScoremapSummary(
        job.up_to_date,
        scoremap.grid.rows,
        scoremap.grid.cols,
        cell_m,
        int(go.sum()),
        float(scoremap.score[go].mean(dtype=np.float64)),
        unknown,
        time.monotonic() - began,
        interest_range,
        interest_cells,
        **taken,
        limit_notes=placed.notes,
    )


def _files_of(interest: Interest) -> dict[str, Path]:
    """Return the files of the raster of interest by role: itself, a mask side-car, the parts of a VRT."""
    with open_interest(interest.path) as raster:
        return {role.replace("raster", "interest", 1): path for role, path in raster.sources().items()}


def _with_interest(scoremap: Scoremap, interest: Interest) -> tuple[Scoremap, dict[str, Any]]:
    """Return the scoremap with its scores weighed by interest, and the tags that tell of it."""
    with open_interest(interest.path) as raster:
        values = values_on(raster, scoremap.grid, interest.cell)
    go = np.isfinite(scoremap.score)
    share, low, high = degree(interest, values, go)
    score, sd = (weighed(plain, share, interest.weight) for plain in (scoremap.score, scoremap.sd))
    tags = {"interest_range": [low, high], "interest_cells": int(((share > 0) & go).sum())}
    return Scoremap(score, sd, scoremap.grid, scoremap.cell_size_m), tags


def _interest_in(path: Path) -> tuple[tuple[float, float], int]:
    """Return the limits and the number of cells of interest that a scoremap of ours was tagged with."""
    with open_raster(path) as raster:
        tags = raster.hrt_tags
    try:
        low, high = json.loads(tags["INTEREST_RANGE"])
        return (float(low), float(high)), int(tags["INTEREST_CELLS"])
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise InputError(path, "its tags are damaged", "use --force to make it again") from error


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
