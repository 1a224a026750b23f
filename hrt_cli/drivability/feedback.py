"""What a drive says of the classes it went over: evidence, and the Beta posteriors that follow from it.

Each interval of a drive observes y in [0, 1], its progress, with a weight of w metres, and each class under the robot
takes its share of them: alpha += w y, beta += w (1 - y). What stopped it is an episode of its own weight, which the
standstill around it does not add to; episodes at one spot share the weight of one.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.artifacts.scores import ClassScore
from hrt_cli.drivability.episodes import Episode, episodes_of
from hrt_cli.drivability.footprint import Footprints, Shares, new_ahead
from hrt_cli.drivability.intervals import Intervals, intervals_of
from hrt_cli.drivability.smooth import despiked
from hrt_cli.errors import ArgumentError
from hrt_cli.raster.grid import Grid

Floats = NDArray[np.float64]
Ease = Callable[[float, float], float]
"""By what progress counts at a row and column: steepness and roughness; NaN where they are not known."""

SPOT_M = 1.0
"""Side of the squares of ground by which episodes are told apart."""
UNTRIED_M = 2.0
"""Metres after which a class that never stopped the robot is blamed half as much as one that it never was on."""
CONTACT_RADIUS_M = 0.6
"""Radius of the ground that is looked at for what stopped a robot."""
_KNOWN_SHARE = 0.5
"""Where less of the ground ahead has a class, what stopped the robot is not known."""
_MOST_DISCS = 1000


@dataclass(frozen=True)
class Curve:
    """Progress as a function of achieved over commanded speed: piecewise linear, rising, level beyond its ends."""

    points: tuple[tuple[float, float], ...] = ((0.0, 0.0), (1.0, 1.0))

    @staticmethod
    def parse(text: str) -> Curve:
        """Read `RATIO:PROGRESS,RATIO:PROGRESS,...`.

        Raises
        ------
        ArgumentError
            It is not that, ratios do not rise from 0 on, or progress falls or leaves [0, 1].
        """
        points: list[tuple[float, float]] = []
        for pair in text.split(","):
            ratio, colon, progress = pair.partition(":")
            try:
                point = float(ratio), float(progress)
            except ValueError:
                point = math.nan, math.nan
            if not (colon and all(map(math.isfinite, point))):
                raise ArgumentError(f"{text!r} is not a curve such as 0:0,1:1")
            points.append(point)
        ratios, values = zip(*points, strict=True)
        if len(points) < 2 or ratios[0] < 0 or (np.diff(ratios) <= 0).any():
            raise ArgumentError(f"{text!r}: a curve needs two points or more, with ratios of speed that rise from 0")
        if (np.diff(values) < 0).any() or values[0] < 0 or values[-1] > 1:
            raise ArgumentError(f"{text!r}: progress along a curve must not fall, nor leave 0 to 1")
        return Curve(tuple(points))

    def __call__(self, ratio: Floats) -> Floats:
        """Return the progress at ratios of speed."""
        ratios, values = zip(*self.points, strict=True)
        return np.asarray(np.interp(ratio, ratios, values), np.float64)


@dataclass(frozen=True)
class FeedbackSettings:
    """How drives are read.

    Attributes
    ----------
    curve : Curve
        From the ratio of speeds to progress.
    commanded_m_s : float or None
        The commanded speed where a log does not tell it; None estimates it from the log.
    event_weight_m : float
        Metres without progress that a collision or a standstill counts for, however long the robot tried.
    robot_radius_m : float
        Where a log does not tell it.
    gap_s : float
        Records farther apart than this have no drive between them.
    slope_limit_deg, rugosity_limit_m : float
        Where progress counts nothing, given a surface model.
    forget_m : float or None
        Metres of new evidence of a class after which its older evidence counts half.
    """

    curve: Curve = field(default=Curve())
    commanded_m_s: float | None = None
    event_weight_m: float = 5.0
    robot_radius_m: float = 0.35
    gap_s: float = 10.0
    slope_limit_deg: float = 35.0
    rugosity_limit_m: float = 0.3
    forget_m: float | None = None

    def parameters(self, *, terrain: bool) -> dict[str, Any]:
        """Return what changes the result, as JSON values; limits of the terrain only where they count."""
        found = asdict(self) | {"curve": [list(point) for point in self.curve.points]}
        unused = () if terrain else ("slope_limit_deg", "rugosity_limit_m")
        return {key: value for key, value in found.items() if key not in unused}


@dataclass(frozen=True)
class Evidence:
    """What one drive observed, in the order of its time.

    Attributes
    ----------
    class_id : int64 [n]
    weight_m, progress : float64 [n]
    episode : int64 [n]
        Which of `spots` it is evidence of; -1 for ground that was driven over.
    spots : list of (int, int)
        Of each episode, where it was: the square of `SPOT_M` that its contact lies in.
    off_map_m : float
        Metres on ground without a class.
    unknown_terrain_m : float
        Metres on ground that the surface model does not tell of.
    events : int
        Episodes counted.
    estimated_m_s : float or None
        The commanded speed where it had to be estimated.
    jumps : int
        Records and intervals left out because positions jump.
    """

    class_id: NDArray[np.int64]
    weight_m: Floats
    progress: Floats
    episode: NDArray[np.int64]
    spots: list[tuple[int, int]]
    off_map_m: float
    unknown_terrain_m: float
    events: int
    estimated_m_s: float | None
    jumps: int


def evidence_of(
    log: DriveLog, grid: Grid, places: Floats, footprints: Footprints, settings: FeedbackSettings, ease: Ease | None
) -> Evidence:
    """Return what a drive says of the classes.

    Parameters
    ----------
    places : float64 [n, 2]
        Row and column of every record of the log on `grid`, that of the class raster.
    ease : callable or None
        By what progress counts at a place.
    """
    radius_m = log.robot.radius_m if log.robot is not None else settings.robot_radius_m
    places, spikes = despiked(log.time_s, places, np.array(grid.pixel_m))
    episodes = episodes_of(log, grid, places, radius_m)
    intervals = intervals_of(log, grid, places, episodes, gap_s=settings.gap_s, commanded_m_s=settings.commanded_m_s)
    taking = _Taking(log.time_s, footprints, radius_m, ease)
    spots = [_spot(each, grid) for each in episodes]
    blamed = [_blamed(each, footprints, radius_m) for each in episodes]
    held = _held(episodes, intervals)
    progress = settings.curve(intervals.achieved_m_s / intervals.commanded_m_s)
    ahead = 0
    for index, (weight_m, y) in enumerate(zip(intervals.weight_m.tolist(), progress.tolist(), strict=True)):
        while ahead < len(episodes) and episodes[ahead].event <= intervals.first[index]:
            taking.add(blamed[ahead], episodes[ahead].share * settings.event_weight_m, 0.0, ahead)
            ahead += 1
        # A standstill weighs as its event, however long the robot tried.
        if weight_m > 0 and not held[index]:
            taking.add_way(intervals, index, weight_m, y)
    for index in range(ahead, len(episodes)):
        taking.add(blamed[index], episodes[index].share * settings.event_weight_m, 0.0, index)
    return taking.evidence(sum(map(bool, blamed)), spots, intervals, spikes)


def settled(drives: Sequence[Evidence]) -> list[Evidence]:
    """Return drives with the blame for their episodes settled between classes, and between episodes at one spot.

    What stopped a robot is more likely of a class that it has not been driving over. With obstacles met at a rate that
    is the rarer the farther class k was driven over, m_k metres made good in all drives together (the posterior mean
    under a Gamma prior: 1 / (m_k + `UNTRIED_M`)), a class with the share f_k of the ground ahead is blamed for
    f_k^2 / (m_k + `UNTRIED_M`), scaled to 1: the square, because what lies ahead on a sliver was likely not met.

    All episodes at one spot, a square of `SPOT_M` that the contact lies in, weigh as much as one of them does on
    average: a robot that is driven against the same rock five times has not learnt five times that rocks do not give
    way.
    """
    good = _made_good(drives)
    visits = Counter(spot for each in drives for spot in each.spots)
    found = []
    for each in drives:
        weight_m = each.weight_m.copy()
        for index, spot in enumerate(each.spots):
            mine = each.episode == index
            total = float(weight_m[mine].sum())
            if total > 0:
                rarity = np.array([good[int(k)] + UNTRIED_M for k in each.class_id[mine]])
                blame = (weight_m[mine] / total) ** 2 / rarity
                weight_m[mine] = total / visits[spot] * blame / blame.sum()
        found.append(replace(each, weight_m=weight_m))
    return found


def _made_good(drives: Sequence[Evidence]) -> dict[int, float]:
    """Return the metres of progress on each class; exact sums, so that the order of drives does not matter."""
    parts: defaultdict[int, list[float]] = defaultdict(list)
    for each in drives:
        way = each.episode < 0
        for k, metres in zip(each.class_id.tolist(), (each.weight_m * each.progress * way).tolist(), strict=True):
            parts[k].append(metres)
    return {k: math.fsum(metres) for k, metres in parts.items()}


def _spot(episode: Episode, grid: Grid) -> tuple[int, int]:
    row_m, col_m = grid.pixel_m
    return math.floor(episode.contact[0] * row_m / SPOT_M), math.floor(episode.contact[1] * col_m / SPOT_M)


def posterior(before: ClassScore, weight_m: Floats, progress: Floats, forget_m: float | None) -> ClassScore:
    """Return the belief about a class after new evidence of it.

    Without forgetting the sums are exact before they are rounded once, so that the order of the evidence does not
    matter in any bit. With it, what is believed beyond the uniform Beta(1, 1) halves with every `forget_m` metres.

    Parameters
    ----------
    weight_m, progress : float64 [n]
        In the order of time.
    """
    if not weight_m.size:
        return before
    observed = (weight_m * progress, weight_m * (1.0 - progress), weight_m)
    believed = (before.alpha, before.beta, before.evidence_m)
    if forget_m is None:
        alpha, beta, evidence_m = (math.fsum([old, *new.tolist()]) for old, new in zip(believed, observed, strict=True))
    else:
        # What is kept of the belief, and of each observation, once all that comes after it is counted.
        rest = np.append(np.cumsum(weight_m[::-1])[::-1], 0.0)
        kept = 0.5 ** (rest / forget_m)
        alpha, beta, evidence_m = (
            uniform + (old - uniform) * float(kept[0]) + math.fsum((new * kept[1:]).tolist())
            for uniform, old, new in zip((1.0, 1.0, 0.0), believed, observed, strict=True)
        )
    return ClassScore(alpha, beta, evidence_m, before.name)


def updated(before: dict[int, ClassScore], drives: Sequence[Evidence], forget_m: float | None) -> dict[int, ClassScore]:
    """Return the beliefs after drives, which count in the order given; what nothing was learnt of stays as it is."""
    class_id = np.concatenate([each.class_id for each in drives])
    weight_m = np.concatenate([each.weight_m for each in drives])
    progress = np.concatenate([each.progress for each in drives])
    return {
        k: posterior(belief, weight_m[class_id == k], progress[class_id == k], forget_m) for k, belief in before.items()
    }


def _blamed(episode: Episode, footprints: Footprints, radius_m: float) -> Shares:
    """Return the classes that stopped a robot: what is new on the ground ahead of it; none at the rim of the survey."""
    if footprints.covered(*episode.contact, CONTACT_RADIUS_M) < _KNOWN_SHARE:
        return {}
    ahead = footprints.shares(*episode.contact, CONTACT_RADIUS_M)
    return new_ahead(ahead, footprints.shares(*episode.place, radius_m))


def _held(episodes: list[Episode], intervals: Intervals) -> NDArray[np.bool_]:
    """Return which intervals are without progress because of what stopped the robot, bool [m]."""
    held = np.zeros(intervals.first.size, np.bool_)
    for each in episodes:
        if each.stops:
            low = np.searchsorted(intervals.first, each.begin, "left")
            high = np.searchsorted(intervals.last, each.end, "right")
            held[low:high] |= intervals.stands[low:high]
    return held


class _Taking:
    """Evidence as it is gathered."""

    def __init__(self, time_s: Floats, footprints: Footprints, radius_m: float, ease: Ease | None) -> None:
        self._time_s, self._footprints, self._radius_m, self._ease = time_s, footprints, radius_m, ease
        self._rows: list[tuple[int, float, float, int]] = []
        self._off_map_m: list[float] = []
        self._unknown_m: list[float] = []

    def add(self, shares: Shares, weight_m: float, progress: float, episode: int = -1) -> None:
        """Share an observation out among classes."""
        if not weight_m > 0:
            return
        if not shares:
            self._off_map_m.append(weight_m)
        self._rows.extend((k, weight_m * share, progress, episode) for k, share in shares.items())

    def add_way(self, intervals: Intervals, index: int, weight_m: float, progress: float) -> None:
        """Share an observation out along the way that was driven: discs no farther apart than the robot is wide."""
        begin, end = self._time_s[intervals.first[index]], self._time_s[intervals.last[index]]
        length_m = float(intervals.achieved_m_s[index]) * (end - begin)
        discs = min(max(1, math.ceil(length_m / (2 * self._radius_m) - 1e-9)), _MOST_DISCS)
        when = begin + (np.arange(discs) + 0.5) / discs * (end - begin)
        records = slice(int(intervals.first[index]), int(intervals.last[index]) + 1)
        rows, cols = (np.interp(when, self._time_s[records], intervals.places[records, k]) for k in (0, 1))
        for row, col in zip(rows.tolist(), cols.tolist(), strict=True):
            factor = 1.0 if self._ease is None else self._ease(row, col)
            if math.isnan(factor):
                self._unknown_m.append(weight_m / discs)
                factor = 1.0
            self.add(self._footprints.shares(row, col, self._radius_m), weight_m / discs, progress * factor)

    def evidence(self, events: int, spots: list[tuple[int, int]], intervals: Intervals, spikes: int) -> Evidence:
        """Return all that was added."""
        columns = list(zip(*self._rows, strict=True)) or [(), (), (), ()]
        return Evidence(
            np.array(columns[0], np.int64),
            np.array(columns[1], np.float64),
            np.array(columns[2], np.float64),
            np.array(columns[3], np.int64),
            spots,
            math.fsum(self._off_map_m),
            math.fsum(self._unknown_m),
            events,
            intervals.estimated_m_s,
            intervals.jumps + spikes,
        )
