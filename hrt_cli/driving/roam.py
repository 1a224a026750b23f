"""Courses without a plan: straight legs between random places of a site."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.driving.course import Course
from hrt_cli.driving.field import rim_distance
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.errors import ArgumentError
from hrt_cli.world.site import Site

_ROOM_M = 0.25
"""Beyond its radius, how far from obstacles and the rim the robot is sent."""
_SLOWEST = 0.3
"""Nor is it sent onto ground slower than this share of its speed."""
_DEPTH_M = 2.0
"""An AUV is sent where the water is deeper."""
_LONGEST_LEG_M = 30.0
_DRAWN = 256
"""Places from which the end of a leg is chosen."""
_BLOCKED, _CHOICE = 0.75, 64
"""Share of the legs that lead across what has to be gone round, where one of so many places offers such a leg."""


def roam_course(site: Site, vehicle: Vehicle, length_m: float, seed: int) -> Course:
    """Return a course of straight legs, at most 30 m each, between random places that can be reached from one another.

    Three in four lead across what stands between them, where there is such a leg: it is for the local planner to go
    round it. None leads off the survey.

    Raises
    ------
    ArgumentError
        The site has no room for it.
    """
    room = vehicle.radius_m + _ROOM_M
    inside = rim_distance(site) > room
    free = inside.copy()
    if vehicle.kind == "auv":
        free &= site.surface_m < -_DEPTH_M
    else:
        free &= (site.clearance_m > room) & (site.speed_factor > _SLOWEST)
    pieces, count = ndimage.label(free)
    if count == 0:
        raise ArgumentError(f"the site has no place with {room:.1f} m of free ground about it to roam from")
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    places = (np.argwhere(pieces == largest)[:, ::-1] + 0.5) * site.pixel_m
    rng = np.random.default_rng([seed, 0x50])
    points = [places[rng.integers(len(places))]]
    length = 0.0
    while length < length_m:
        leg_m = rng.uniform(0.2, 1.0) * min(_LONGEST_LEG_M, length_m)
        turn = rng.uniform(0.0, 2.0 * math.pi)
        wanted = points[-1] + leg_m * np.array([math.sin(turn), math.cos(turn)])
        near = places[rng.integers(len(places), size=_DRAWN)]
        near = near[np.hypot(*(near - wanted).T).argsort(kind="stable")]
        legs = [each for each in near if _is_all(inside, site, points[-1], each)] or [near[0]]
        blocked = [each for each in legs[:_CHOICE] if not _is_all(free, site, points[-1], each)]
        points.append(blocked[0] if blocked and rng.random() < _BLOCKED else legs[0])
        length += float(np.hypot(*(points[-1] - points[-2])))
    return Course(np.array(points))


def _is_all(good: NDArray[np.bool_], site: Site, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    """Whether a straight leg leads over good pixels alone."""
    steps = math.ceil(float(np.hypot(*(end - start))) / site.pixel_m) + 1
    cols, rows = np.floor(np.linspace(start, end, steps) / site.pixel_m).astype(np.int64).T
    return bool(good[rows, cols].all())
