"""The scoremap stage: classes and their scores, from file to file."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.scores import PRIOR, ClassScore, read_scores
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.drivability.cells import Cover, Rule, cover, score_cells
from hrt_cli.drivability.interest import Interest
from hrt_cli.drivability.layers import (
    Layers,
    layers_of,
    relief_notes,
    relief_on,
    relief_tags,
    told_by,
    with_interest,
)
from hrt_cli.drivability.limits import NO_LIMITS, Limits, PlacedLimits, place_limits, taken_by
from hrt_cli.drivability.surface import Relief
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
    strangers : list of int
        Classes that a score was given for and that the class raster neither holds nor names.
    interest_range : (float, float) or None
        The values of the raster of interest that count 0 and 1, if there is one.
    interest_cells : int or None
        Cells that may be entered and are of interest.
    interest_out_of_reach : int or None
        With a sensor's radius: spots of interest that are sampled from nowhere.
    thermal_units : str or None
        What temperatures of interest are read in, where that was asked for.
    steep_cells, rough_cells : int or None
        With a surface model: cells with a class whose slope, or ruggedness, is at or beyond its limit.
    terrain_unknown_share : float or None
        Share of the cells to go for which it has no heights.
    aoi_cells, keep_out_cells : int or None
        Cells that may not be entered only for the area of interest, and of the others those only for the keep-outs.
    notes : list of str
        What the user ought to know of these rasters and areas.
    """

    up_to_date: bool
    rows: int
    cols: int
    cell_size_m: float
    go_cells: int
    mean_score: float
    unknown: list[int]
    seconds: float
    strangers: list[int] = field(default_factory=list)
    interest_range: tuple[float, float] | None = None
    interest_cells: int | None = None
    interest_out_of_reach: int | None = None
    thermal_units: str | None = None
    steep_cells: int | None = None
    rough_cells: int | None = None
    terrain_unknown_share: float | None = None
    aoi_cells: int | None = None
    keep_out_cells: int | None = None
    notes: list[str] = field(default_factory=list)


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
    relief: Relief | None = None,
    creation: dict[str, str] | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> ScoremapSummary:
    """Make `output` (a scoremap) from a class raster and a score table.

    Without a table every class has the uniform prior. With one, every class of the raster must stand in it, or with
    `unknown_as_prior` has the prior too. No-go are cells that score less than `no_go_below`, those of which more than
    `no_go_share` is of classes that do, and those within `margin_m` of either; so are those that `limits` bar, with the
    same margin. With an `interest` a cell's score is its expected drivability times what it is worth; where the robot
    may go does not depend on it. With a `relief` steep and rough ground scores less, and is no-go from its limits on.

    Raises
    ------
    InputError
        The class raster, the table, a limit, the raster of interest or the surface model cannot be used, a class of the
        raster is not in the table, no cell may be entered, or none is of interest.
    ArgumentError
        The cell does not fit the raster.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    began = time.monotonic()
    creation = creation or {}
    rule = Rule(explore, no_go_below, no_go_share, margin_m)
    layers = layers_of(interest, relief)
    inputs = {"classes": classes_path} | ({"scores": scores_path} if scores_path else {})
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=inputs | limits.files() | layers.files,
        parameters=_parameters(cell_m, rule, unknown_as_prior, creation) | layers.parameters,
        outputs={output: cog_provenance},
        existing=existing,
    )
    scores = read_scores(scores_path) if scores_path else {}
    unknown: list[int] = []
    strangers: list[int] = []
    if job.up_to_date:
        scoremap = read_scoremap(output)
        placed = place_limits(limits, margin_m, scoremap.grid, classes_path)
    else:
        with open_classes(classes_path) as classes:
            placed = place_limits(limits, margin_m, classes.grid.coarse(cell_m), classes_path)
            covered = cover(classes.grid, classes.read, cell_m, progress)
            # A class that the raster names, but that does not occur in it, is no stranger.
            strangers = [k for k in scores if k not in covered.classes and k >= len(classes.names)]
        table = _scores_for(covered, scores, classes_path, scores_path, unknown_as_prior)
        unknown = [k for k in covered.classes if k not in scores]
        scoremap, tags = _scored(classes_path, covered, table, cell_m, rule, placed, layers, progress)
        publish_scoremap(output, scoremap, job.provenance, tags=tags, creation=creation)
    go = np.isfinite(scoremap.score)
    told = told_by(output, layers) | taken_by(limits, output)
    return ScoremapSummary(
        job.up_to_date,
        scoremap.grid.rows,
        scoremap.grid.cols,
        cell_m,
        int(go.sum()),
        float(scoremap.score[go].mean(dtype=np.float64)),
        unknown,
        time.monotonic() - began,
        strangers=strangers,
        notes=[*layers.notes, *placed.notes, *relief_notes(layers, cell_m, told)],
        **told,
    )


def _parameters(cell_m: float, rule: Rule, unknown_as_prior: bool, creation: dict[str, str]) -> dict[str, Any]:
    """Return what goes into the fingerprint beside the inputs: options came later only where they are used."""
    found: dict[str, Any] = {
        "cell_m": cell_m,
        "explore": rule.explore,
        "no_go_below": rule.no_go_below,
        "creation": creation,
    }
    if rule.no_go_share < 1.0:
        found["no_go_share"] = rule.no_go_share
    if rule.margin_m > 0.0:
        found["margin_m"] = rule.margin_m
    if unknown_as_prior:
        found["unknown_as_prior"] = True
    return found


def _scored(
    classes_path: Path,
    covered: Cover,
    table: dict[int, ClassScore],
    cell_m: float,
    rule: Rule,
    placed: PlacedLimits,
    layers: Layers,
    progress: Progress,
) -> tuple[Scoremap, dict[str, Any]]:
    """Return the scoremap of the classes that cover the cells, and its tags.

    Raises
    ------
    InputError
        No cell may be entered, or a layer cannot be used.
    """
    ground = relief_on(layers.relief, covered, cell_m, progress) if layers.relief else None
    ease = ground.ease(layers.relief) if layers.relief and ground else None
    score, sd = score_cells(covered, table, **asdict(rule), ease=ease)
    if np.isnan(score).all():
        beyond = ", or steep or rough by --dsm" if layers.relief else ""
        what = f"gives no cell that may be entered: all are nodata or below --no-go-below{beyond}"
        raise InputError(classes_path, what)
    scoremap, tags = placed.bar(Scoremap(score, sd, covered.grid, cell_m), classes_path)
    if layers.relief and ground:
        tags |= relief_tags(layers.relief, ground, covered, np.isfinite(scoremap.score))
    if layers.interest:
        scoremap, of_interest = with_interest(scoremap, layers.interest, layers.units)
        tags |= of_interest
    return scoremap, tags


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
