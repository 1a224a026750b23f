"""The feedback stage: drive logs and the classes they went over, from file to file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hrt_cli.artifacts.carriers import json_provenance, publish_json
from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.artifacts.scores import PRIOR, ClassScore, ScoreTable, read_score_table, scores_document
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.drivability.feedback import Ease, Evidence, FeedbackSettings, evidence_of, settled, updated
from hrt_cli.drivability.footprint import NODATA, Footprints
from hrt_cli.drivability.relief import eased
from hrt_cli.drivability.terrain import Terrain
from hrt_cli.errors import InputError
from hrt_cli.logs.kinds import files_of, log_sha256, reading
from hrt_cli.logs.read import log_notes, read_drive_log
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import ClassRaster, open_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import open_heights
from hrt_cli.raster.track import track_on
from hrt_cli.raster.windows import blocks

STAGE = "feedback"
STAGE_VERSION = 3
_SCAN_PX = 2048


@dataclass(frozen=True)
class LogSummary:
    """What one log gave: metres of evidence, metres on ground without a class, and episodes counted."""

    log: str
    sha256: str
    evidence_m: float
    off_map_m: float
    events: int


@dataclass(frozen=True)
class FeedbackSummary:
    """What the feedback stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done.
    before, after : dict of int to ClassScore
        The beliefs by class id.
    logs : list of LogSummary, or None
        In the order of counting; None where nothing had to be done.
    notes : list of str
        What the user ought to know.
    """

    up_to_date: bool
    before: dict[int, ClassScore]
    after: dict[int, ClassScore]
    logs: list[LogSummary] | None
    notes: list[str]

    def totals(self) -> dict[str, float | int | None]:
        """Return `evidence_m`, `off_map_m` and `events` over all logs; None where nothing had to be done."""
        if self.logs is None:
            return dict.fromkeys(("evidence_m", "off_map_m", "events"))
        return {
            "evidence_m": math.fsum(each.evidence_m for each in self.logs),
            "off_map_m": math.fsum(each.off_map_m for each in self.logs),
            "events": sum(each.events for each in self.logs),
        }


def learn_scores(
    log_paths: Sequence[Path],
    classes_path: Path,
    output: Path,
    settings: FeedbackSettings,
    *,
    scores_path: Path | None = None,
    dsm_path: Path | None = None,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> FeedbackSummary:
    """Make `output` (a score table) from drives over a class raster, going on from an earlier table.

    Every class of the raster and of the table stands in the output; those that no drive touched keep their beliefs.
    Without forgetting the order of the logs does not matter. Episodes at one spot share the weight of one over the logs
    given; the table does not tell where those that it counts were, so that they count beside these.

    Raises
    ------
    InputError
        A log, the class raster, the table or the surface model cannot be used, a log lies off the raster, is given
        twice, or is counted in the table already.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    prior = read_score_table(scores_path) if scores_path else ScoreTable({})
    logs = _distinct(log_paths, prior, scores_path)
    if settings.forget_m is None:
        logs = dict(sorted(logs.items()))
    inputs = {"classes": classes_path}
    for index, path in enumerate(logs.values()):
        inputs |= files_of(f"log/{index}", path)
    inputs |= {role: path for role, path in (("scores", scores_path), ("dsm", dsm_path)) if path}
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs=inputs,
        parameters=settings.parameters(terrain=dsm_path is not None) | reading(logs.values()),
        outputs={output: json_provenance},
        existing=existing,
    )
    if job.up_to_date:
        after = read_score_table(output).scores
        return FeedbackSummary(True, _as_before(prior.scores, after), after, None, [])
    with open_classes(classes_path) as classes, _ease(dsm_path, classes.grid, settings) as ease:
        before = _beliefs(classes, prior.scores)
        footprints = Footprints(classes.grid, classes.read)
        drives, notes = [], []
        for index, path in enumerate(logs.values()):
            log = read_drive_log(path)
            places = _placed(path, log, classes)
            drives.append(evidence_of(log, classes.grid, places, footprints, settings, ease))
            notes += _notes(path, log, drives[-1], classes_path)
            progress(index + 1, len(logs))
    drives = settled(drives)
    if dsm_path is not None:
        notes += _terrain_notes(dsm_path, drives)
    met = {int(k) for each in drives for k in np.unique(each.class_id)}
    before = dict(sorted((dict.fromkeys(met, PRIOR) | before).items()))
    after = updated(before, drives, settings.forget_m)
    publish_json(output, scores_document(after, [*prior.logs, *logs]), job.provenance)
    told = [
        LogSummary(str(path), sha256, math.fsum(each.weight_m.tolist()), each.off_map_m, each.events)
        for (sha256, path), each in zip(logs.items(), drives, strict=True)
    ]
    return FeedbackSummary(False, before, after, told, notes)


def _distinct(paths: Sequence[Path], prior: ScoreTable, scores_path: Path | None) -> dict[str, Path]:
    """Return the logs by sha256, in the order given; refuse what would count twice."""
    found: dict[str, Path] = {}
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file")
        sha256 = log_sha256(path)
        if sha256 in found:
            raise InputError(path, f"holds the same drive as {found[sha256]}, which would count twice")
        if sha256 in prior.logs:
            raise InputError(path, f"is counted in {scores_path} already", "leave it out")
        found[sha256] = path
    return found


def _placed(path: Path, log: DriveLog, classes: ClassRaster) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the places of a log [n, 2] as rows and columns of the class raster."""
    grid = classes.grid
    places = np.stack(track_on(path, log, grid, "class raster"), axis=1)
    if not ((places >= 0) & (places < np.array(grid.shape))).all(axis=1).any():
        raise InputError(path, f"lies wholly off the class raster {classes.raster.path}")
    try:
        grid.lonlat(*grid.xy(places[:, 0], places[:, 1]))
    except ValueError as error:
        raise InputError(path, f"cannot be laid on the class raster: {error}") from error
    return places


def _beliefs(classes: ClassRaster, prior: dict[int, ClassScore]) -> dict[int, ClassScore]:
    """Return what is believed of every class of the raster and of the table before the drives."""
    names = dict(enumerate(classes.names[:NODATA]))
    # A raster of the tool says how many classes it has; of another the pixels have to be asked.
    ids = set(names) if names else _present(classes)
    table = dict.fromkeys(sorted(ids), PRIOR) | prior
    return {
        k: s if s.name or not names.get(k) else ClassScore(s.alpha, s.beta, s.evidence_m, names[k])
        for k, s in table.items()
    }


def _present(classes: ClassRaster) -> set[int]:
    seen = np.zeros(NODATA + 1, np.bool_)
    for window in blocks(classes.grid.shape, _SCAN_PX):
        seen |= np.bincount(classes.read(window).ravel(), minlength=NODATA + 1) > 0
    return {int(k) for k in np.flatnonzero(seen[:NODATA])}


def _as_before(prior: dict[int, ClassScore], after: dict[int, ClassScore]) -> dict[int, ClassScore]:
    return {k: prior.get(k, PRIOR) for k in after}


@contextmanager
def _ease(dsm_path: Path | None, grid: Grid, settings: FeedbackSettings) -> Iterator[Ease | None]:
    """Yield how much progress counts at a place on the class raster, where there is a surface model."""
    if dsm_path is None:
        yield None
        return
    with open_heights(dsm_path) as dsm:
        if dsm.count != 1:
            raise InputError(dsm_path, f"has {dsm.count} bands; a surface model has one: heights in metres")
        terrain = Terrain(dsm, grid)

        def ease(row: float, col: float) -> float:
            slope_deg, rugosity_m = terrain.at(row, col)
            if math.isnan(slope_deg):
                return math.nan
            return float(eased(slope_deg, rugosity_m, settings.slope_limit_deg, settings.rugosity_limit_m))

        yield ease


def _notes(path: Path, log: DriveLog, drive: Evidence, classes_path: Path) -> list[str]:
    notes = []
    if not log.geographic and log.crs is None:
        notes.append(f"{path}: names no CRS: its x, y are taken to be in that of {classes_path}")
    if drive.estimated_m_s:
        notes.append(
            f"{path}: does not tell the commanded speed: taken as {drive.estimated_m_s:.3g} m/s, below which it stays "
            "for 90 % of its moving time (--commanded gives another)"
        )
    if drive.jumps:
        notes.append(f"{path}: its positions jump: {drive.jumps} records or intervals count nothing")
    if not drive.weight_m.size:
        notes.append(f"{path}: holds no evidence: the robot did not drive on ground that has a class")
    return notes + log_notes(path, log)


def _terrain_notes(dsm_path: Path, drives: list[Evidence]) -> list[str]:
    unknown_m = math.fsum(each.unknown_terrain_m for each in drives)
    driven_m = math.fsum(each.off_map_m for each in drives) + math.fsum(
        w for each in drives for w in each.weight_m.tolist()
    )
    if unknown_m > 0 and unknown_m >= driven_m * (1 - 1e-9):
        raise InputError(dsm_path, "tells the height of no place that was driven over")
    return [f"{dsm_path}: has no heights for {unknown_m:.1f} m, which count as level"] if unknown_m > 0 else []
