"""Courses without a plan: straight legs between random places of a site.

They are as a planner that knows the site would lay them, one that does not see what is small: they keep off what has
to be gone round in a wide arc, and lead across what a robot goes round in a few metres.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.driving.course import Course
from hrt_cli.driving.field import rim_distance
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.errors import ArgumentError
from hrt_cli.world.site import Site

_ROOM_M = 0.25
"""Beyond its radius, how far from obstacles the robot is sent."""
_RIM_M = 1.5
"""Beyond that, how far from the rim: no camera sees where a survey ends, and it goes round things there, too."""
_SLOWEST = 0.3
"""Nor is it sent onto ground slower than this share of its speed."""
_DEPTH_M = 2.0
"""An AUV is sent where the water is deeper."""
_SHORTEST_LEG_M, _LONGEST_LEG_M = 2.0, 30.0
_DRAWN, _CHOICE = 256, 48
"""Places from which the end of a leg is chosen: of so many the nearest to where it should be."""
CROSSING = 0.75
"""Share of the legs that lead across something, where one of the places offers such a leg."""
_WIDEST_M, _AROUND_M = 3.0, 1.5
"""What a leg leads across blocks it for so long at most, and there is a way round it so far from it at most."""
_TRIES, _STARTS = 40, 25
"""How often a next leg is looked for, and from how many places."""


class Leg(Enum):
    """What a straight way between two places leads over."""

    CLEAR = "nothing in the way"
    ROUND = "things that can be gone round"
    NO = "what cannot be gone round nearby, or too near to the rim"


class Grounds:
    """Where a robot may be sent on a site.

    Parameters
    ----------
    site : Site
    vehicle : Vehicle

    Raises
    ------
    ArgumentError
        Nowhere.
    """

    def __init__(self, site: Site, vehicle: Vehicle) -> None:
        room = vehicle.radius_m + _ROOM_M
        self._pixel_m = site.pixel_m
        self._inside = rim_distance(site) > room + _RIM_M
        free = self._inside.copy()
        if vehicle.kind == "auv":
            free &= site.surface_m < -_DEPTH_M
        else:
            free &= (site.clearance_m > room) & (site.speed_factor > _SLOWEST)
        pieces, count = ndimage.label(free)
        if count == 0:
            raise ArgumentError(f"the site has no place with {room:.1f} m of free ground about it to roam from")
        self._free = pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
        self.places = (np.argwhere(self._free)[:, ::-1] + 0.5) * site.pixel_m

    def leg(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> Leg:
        """Return what a straight way between two places leads over."""
        steps = math.ceil(float(np.hypot(*(end - start))) / self._pixel_m) + 1
        cols, rows = np.floor(np.linspace(start, end, steps) / self._pixel_m).astype(np.int64).T
        if not self._inside[rows, cols].all():
            return Leg.NO
        blocked = np.concatenate([[False], ~self._free[rows, cols], [False]])
        edges = np.flatnonzero(np.diff(blocked.astype(np.int8)))
        for first, after in edges.reshape(-1, 2).tolist():
            if first == 0 or after == steps:
                return Leg.NO
            before, beyond = (int(rows[first - 1]), int(cols[first - 1])), (int(rows[after]), int(cols[after]))
            if not self._is_way_round(before, beyond):
                return Leg.NO
        return Leg.ROUND if edges.size else Leg.CLEAR

    def _is_way_round(self, before: tuple[int, int], beyond: tuple[int, int]) -> bool:
        """Whether two free pixels, with something between them, are joined within the disc about both."""
        apart = math.dist(before, beyond) * self._pixel_m
        if apart > _WIDEST_M:
            return False
        reach = (0.5 * apart + _AROUND_M) / self._pixel_m
        row, col = 0.5 * (before[0] + beyond[0]), 0.5 * (before[1] + beyond[1])
        top, left = max(math.ceil(row - reach), 0), max(math.ceil(col - reach), 0)
        part = self._free[top : math.floor(row + reach) + 1, left : math.floor(col + reach) + 1]
        r, c = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        pieces, _ = ndimage.label(part & ((r - row) ** 2 + (c - col) ** 2 <= reach * reach))
        return bool(pieces[before[0] - top, before[1] - left] == pieces[beyond[0] - top, beyond[1] - left])


def roam_course(
    site: Site, vehicle: Vehicle, length_m: float, seed: int, *, crossing: float | None = CROSSING
) -> Course:
    """Return a course of straight legs, at most 30 m each, between random places.

    None leads near the rim of the survey, or across what cannot be gone round close by.

    Parameters
    ----------
    site : Site
    vehicle : Vehicle
    length_m : float
    seed : int
    crossing : float, optional
        Share of the legs that lead across something that can be gone round, where there is such a leg: it is for the
        local planner to do that. None: as they come.

    Raises
    ------
    ArgumentError
        The site has no room for it.
    """
    grounds, rng = Grounds(site, vehicle), np.random.default_rng([seed, 0x50])
    for _ in range(_STARTS):
        points = [grounds.places[rng.integers(len(grounds.places))]]
        length = 0.0
        while length < length_m:
            end = _next(grounds, points[-1], min(_LONGEST_LEG_M, length_m), crossing, rng)
            if end is None:
                break
            length += float(np.hypot(*(end - points[-1])))
            points.append(end)
        else:
            return Course(np.array(points))
    raise ArgumentError(f"the site has no room to roam for {length_m:g} m: from no place, legs lead on and on")


def _next(
    grounds: Grounds, start: NDArray[np.float64], longest_m: float, crossing: float | None, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Return where the next leg ends, None where there seems to be no such place."""
    for _ in range(_TRIES):
        leg_m, turn = rng.uniform(0.2, 1.0) * longest_m, rng.uniform(0.0, 2.0 * math.pi)
        wanted = start + leg_m * np.array([math.sin(turn), math.cos(turn)])
        drawn = grounds.places[rng.integers(len(grounds.places), size=_DRAWN)]
        near = drawn[np.hypot(*(drawn - wanted).T).argsort(kind="stable")[:_CHOICE]]
        near = near[np.hypot(*(near - start).T) >= min(_SHORTEST_LEG_M, 0.2 * longest_m)]
        kinds = [grounds.leg(start, each) for each in near]
        orders: tuple[set[Leg], ...] = ({Leg.CLEAR, Leg.ROUND},)
        if crossing is not None:
            orders = ({Leg.ROUND}, {Leg.CLEAR}) if rng.random() < crossing else ({Leg.CLEAR}, {Leg.ROUND})
        for good in orders:
            for place, kind in zip(near, kinds, strict=True):
                if kind in good:
                    found: NDArray[np.float64] = place
                    return found
    return None
