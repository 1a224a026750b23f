"""What a robot ran into: an event and the standstill around it are one episode, which counts once.

The contact is looked for well ahead of the hull: the class boundaries of a segmentation lie up to a metre off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.raster.grid import Grid

Floats = NDArray[np.float64]

REACH_M = 0.7
"""What stopped a robot lies so far ahead of its hull."""
EVENT_SHARE = {"collision": 1.0, "stuck": 1.0, "intervention": 0.5}
"""By what an event of each kind counts: a person steps in for reasons that are not always the ground's."""

_STANDSTILL_M = 0.5
_TRAVEL_M = 0.5


@dataclass(frozen=True)
class Episode:
    """A robot came to a standstill.

    Attributes
    ----------
    event : int
        The record of its first event of the gravest kind.
    begin, end : int
        The first and the last record that lie where the event does, without leaving in between.
    share : float
        By what it counts.
    place : (float, float)
        Row and column of the event.
    contact : (float, float)
        Row and column of the ground ahead that stopped the robot; its own place where its heading is not known.
    """

    event: int
    begin: int
    end: int
    share: float
    place: tuple[float, float]
    contact: tuple[float, float]

    @property
    def stops(self) -> bool:
        """Whether the ground or what stands on it stopped the robot, and not a person."""
        return self.share >= 1.0


def episodes_of(log: DriveLog, grid: Grid, places: Floats, radius_m: float) -> list[Episode]:
    """Return the episodes of a drive, in order.

    A later event belongs to the episode of an earlier one while the robot has not gone farther from it than its
    diameter (0.5 m at least): a collision, and the standstill that is then reported as stuck.

    Parameters
    ----------
    places : float64 [n, 2]
        Row and column of every record on `grid`.
    radius_m : float
        The robot's.
    """
    scale = np.array(grid.pixel_m)
    near_m = max(_STANDSTILL_M, 2 * radius_m)
    found: list[Episode] = []
    index = 0
    while index < len(log.events):
        first = log.events[index][0]
        begin = _while_near(places, scale, first, -1, near_m, found[-1].end if found else -1)
        end = _while_near(places, scale, first, 1, near_m, len(places))
        here = []
        while index < len(log.events) and log.events[index][0] <= end:
            here.append(log.events[index])
            index += 1
        share = max(EVENT_SHARE[kind] for _, kind in here)
        event = next(at for at, kind in here if EVENT_SHARE[kind] == share)
        contact = _contact(log, grid, places, event, radius_m + REACH_M)
        row, col = places[event]
        found.append(Episode(event, begin, end, share, (float(row), float(col)), contact))
    return found


def _while_near(places: Floats, scale: Floats, start: int, step: int, near_m: float, stop: int) -> int:
    """Return the last record before `stop`, from `start` in steps of `step`, up to which all lie near it."""
    at = start
    while at + step != stop and np.hypot(*((places[at + step] - places[start]) * scale)) <= near_m:
        at += step
    return at


def _contact(log: DriveLog, grid: Grid, places: Floats, event: int, ahead_m: float) -> tuple[float, float]:
    row, col = places[event]
    heading = log.heading_deg[event]
    if np.isfinite(heading):
        along_row, along_col = grid.steps_towards(row, col, heading)
        return float(row + ahead_m * along_row[0]), float(col + ahead_m * along_col[0])
    scale = np.array(grid.pixel_m)
    for before in range(event - 1, -1, -1):
        way_m = (places[event] - places[before]) * scale
        length_m = float(np.hypot(*way_m))
        if length_m >= _TRAVEL_M:
            row, col = places[event] + way_m / length_m * ahead_m / scale
            break
    return float(row), float(col)
