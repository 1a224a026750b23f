"""A drive log cut into intervals: how fast the robot went in each, and how fast it was told to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.drivability.episodes import Episode
from hrt_cli.drivability.smooth import drift_speed, smoothed
from hrt_cli.raster.grid import Grid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NO_PROGRESS = 0.1
"""Below this share of the commanded speed a robot stands."""

_LENGTH_S = 1.0
_TOO_FAST = 3.0
"""Times the usual speed, from which on positions have jumped."""
_USUAL = 0.9
"""The commanded speed that a log does not tell is the speed that it keeps below for this share of its moving time."""
_CREEP_M_S = 0.05

_DROPPED, _LOGGED, _UNLOGGED = 0, 1, 2


@dataclass(frozen=True)
class Intervals:
    """The intervals of a drive that say something, in order.

    Attributes
    ----------
    first, last : int64 [m]
        Records at which each begins and ends.
    duration_s, achieved_m_s, commanded_m_s : float64 [m]
        How long each is, and the speeds in it.
    logged : bool [m]
        The log tells the commanded speed.
    places : float64 [n, 2]
        Row and column of every record of the drive, with the receiver's noise smoothed.
    estimated_m_s : float or None
        The commanded speed where it had to be estimated.
    jumps : int
        Intervals left out because positions jump.
    """

    first: Ints
    last: Ints
    duration_s: Floats
    achieved_m_s: Floats
    commanded_m_s: Floats
    logged: NDArray[np.bool_]
    places: Floats
    estimated_m_s: float | None
    jumps: int

    @property
    def stands(self) -> NDArray[np.bool_]:
        """Whether the robot makes no progress, bool [m]."""
        return self.achieved_m_s < NO_PROGRESS * self.commanded_m_s

    @property
    def weight_m(self) -> Floats:
        """Metres that each interval counts, float64 [m].

        Those that were commanded, so that a stall weighs what should have been driven. Where the log does not tell the
        command, those that were driven: a robot that stands may have been told to.
        """
        driven = np.where(self.stands, 0.0, self.achieved_m_s)
        return np.asarray(np.where(self.logged, self.commanded_m_s, driven) * self.duration_s)


def intervals_of(
    log: DriveLog,
    grid: Grid,
    places: Floats,
    episodes: list[Episode],
    *,
    gap_s: float,
    commanded_m_s: float | None,
) -> Intervals:
    """Cut a drive into intervals of about a second.

    Records closer together are merged, never across an event, a gap, or a change of what the log tells. The speed in
    an interval is the mean of what its records say (each stretch between two records has the mean of both), where they
    do; else the ground between its ends, over the time.

    Parameters
    ----------
    places : float64 [n, 2]
        Row and column of every record on `grid`.
    gap_s : float
        Records farther apart have no interval between them.
    commanded_m_s : float or None
        The commanded speed where the log does not tell it; None estimates it.
    """
    legs = _Legs(log, gap_s)
    starts = np.array([each.event for each in episodes], np.int64)
    stretch = _stretches(legs.kind, starts, log.time_s.size)
    calm = smoothed(log.time_s, places, stretch)
    first, last = _merged(legs.kind, legs.step_s, set(starts.tolist()))
    duration = log.time_s[last] - log.time_s[first]
    told = legs.sums(legs.speed_m_s * legs.step_s, first, last) / duration
    told_command = legs.sums(legs.command_m_s * legs.step_s, first, last) / duration
    measured = _between(grid, calm, first, last) / duration
    drift = drift_speed(log.time_s, calm * np.array(grid.pixel_m), stretch, first, last)
    by_place = np.isnan(told)
    speed = np.where(by_place, measured, told)
    # Over seconds noise adds to what is driven; over a longer way it does not, and the straights tell the speed.
    usual = _usual_speed(np.where(by_place, np.minimum(drift, speed), told), duration)
    unlogged = usual if commanded_m_s is None else commanded_m_s
    logged = legs.kind[first] == _LOGGED
    command = np.where(logged, told_command, unlogged)
    # The receiver's noise looks like driving, but it leads nowhere.
    speed = np.where(by_place & (drift < NO_PROGRESS * command), np.minimum(drift, speed), speed)
    jump = by_place & (speed > _TOO_FAST * max(usual, float(command.max(initial=0.0))))
    keep = ~jump & (command > 0)
    return Intervals(
        first[keep],
        last[keep],
        duration[keep],
        speed[keep],
        command[keep],
        logged[keep],
        calm,
        usual if commanded_m_s is None and not logged.all() else None,
        int(jump.sum()),
    )


class _Legs:
    """What lies between one record and the next: n - 1 of them.

    `kind` is `_LOGGED` or `_UNLOGGED`, whether the log tells the commanded speed, or `_DROPPED`: a gap, or a standing
    robot that was told to stand. Speeds are the mean of those at both ends that are known, else NaN.
    """

    def __init__(self, log: DriveLog, gap_s: float) -> None:
        self.step_s = np.diff(log.time_s)
        self.speed_m_s = _mean_of_ends(log.speed_m_s)
        self.command_m_s = _mean_of_ends(log.commanded_m_s)
        gap = self.step_s > gap_s
        gap[np.array(log.breaks, np.int64) - 1] = True
        logged = np.where(np.isnan(self.command_m_s), _UNLOGGED, _LOGGED)
        self.kind = np.where(gap | (self.command_m_s == 0), _DROPPED, logged)

    def sums(self, values: Floats, first: Ints, last: Ints) -> Floats:
        """Return the sums of values of legs over intervals of them; NaN where one is."""
        if not first.size:
            return np.zeros(0)
        # `reduceat` sums from each index to the next: every other one is what lies between two intervals.
        edges = np.stack([first, last], axis=1).ravel()
        return np.asarray(np.add.reduceat(np.append(values, 0.0), edges)[::2], np.float64)


def _mean_of_ends(values: Floats) -> Floats:
    a, b = values[:-1], values[1:]
    return np.where(np.isnan(a), b, np.where(np.isnan(b), a, (a + b) / 2))


def _stretches(kind: Ints, events: Ints, records: int) -> Ints:
    """Return for each record the number of its stretch: gaps and what a robot runs into begin a new one."""
    new = np.zeros(records, np.int64)
    new[1:] = kind == _DROPPED
    after = events + 1
    new[after[after < records]] = 1
    return np.cumsum(new)


def _merged(kind: Ints, step_s: Floats, events: set[int]) -> tuple[Ints, Ints]:
    """Return the records at which intervals begin and end."""
    edges: list[tuple[int, int]] = []
    begin, long = 0, 0.0
    for leg, (each, step) in enumerate(zip(kind.tolist(), step_s.tolist(), strict=True)):
        if leg > begin and (each != kind[leg - 1] or leg in events):
            edges.append((begin, leg))
            begin, long = leg, 0.0
        long += step
        # Ten steps of 0.1 s are a second, whatever the last digit of their sum.
        if each == _DROPPED or long >= _LENGTH_S - 1e-6:
            edges.append((begin, leg + 1))
            begin, long = leg + 1, 0.0
    edges.append((begin, step_s.size))
    found = np.array(edges, np.int64).reshape(-1, 2)
    kept = found[found[:, 0] < found[:, 1]]
    kept = kept[kind[kept[:, 0]] != _DROPPED]
    lasting = np.add.reduceat(np.append(step_s, 0.0), kept.ravel())[::2] > 0 if kept.size else np.zeros(0, np.bool_)
    return kept[lasting, 0], kept[lasting, 1]


def _between(grid: Grid, places: Floats, first: Ints, last: Ints) -> Floats:
    """Return the metres of ground between the ends of intervals."""
    if not first.size:
        return np.zeros(0)
    ends = places[np.stack([first, last], axis=1).ravel()]
    return grid.ground_length_m(ends[:, 0], ends[:, 1])[::2]


def _usual_speed(speed: Floats, duration: Floats) -> float:
    """Return the speed below which the robot stays for `_USUAL` of the time in which it moves; 0 if it never does."""
    moves = speed > _CREEP_M_S
    if not moves.any():
        return 0.0
    order = np.argsort(speed[moves], kind="stable")
    passed = np.cumsum(duration[moves][order])
    return float(speed[moves][order][np.searchsorted(passed, _USUAL * passed[-1])])
