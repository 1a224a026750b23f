"""Steering data without a drive: what a robot would see at random places of a site, and what it ought to do there.

A drive shows mostly open ground, and the same obstacle many times over. Places are drawn here so that most have
something in the way, and pictures of one obstacle are taken from all round it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.driving.album import Lesson
from hrt_cli.driving.climb import climb_rad
from hrt_cli.driving.elsewhere import GOALS, Elsewhere, Goals, place_at, random_bearings
from hrt_cli.driving.field import cost_map, rim_distance, water_map
from hrt_cli.driving.goal import AHEAD_M
from hrt_cli.driving.lens import camera_of, look
from hrt_cli.driving.local import Pose
from hrt_cli.driving.motion import sample
from hrt_cli.driving.turns import ANGLES
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.errors import ArgumentError
from hrt_cli.world.site import Site

IN_ONE_WEATHER = 100
"""Pictures in a row that share their weather, and are a session."""
_RIM_M = 1.5
"""Beyond its radius, how far from the rim the robot stands: no camera sees where a survey ends."""
_BLOCKED = 0.25
"""Where so large a share of random goals cannot be gone straight to, something is in the way."""
_ASKED = 16
"""Goals by which that is found out."""
_TRIES = 100
"""Places that are drawn for one picture at most."""
_CLIMBS = 0.3
"""Share of its steepest pitch from which on an AUV climbs over something."""
_ALTITUDES = (0.6, 1.8)
"""Of an AUV, in units of the altitude that it keeps."""
_PITCH_RAD = 0.25
"""Standard deviation of an AUV's pitch."""
_AROUND = tuple(k * math.pi / 6 for k in range(12))
_BELOW_SURFACE_M = 0.2


class Glances:
    """Draws places and looks from there.

    Parameters
    ----------
    site : Site
    vehicle : Vehicle
    near : float
        Share of the pictures with something in the way.
    seed : int
        All that is random comes from it.

    Attributes
    ----------
    number : int
        Pictures so far.
    near : int
        How many of them have something in the way: as many as asked for, where the site has them.

    Raises
    ------
    ArgumentError
        There is nowhere to stand.
    """

    def __init__(self, site: Site, vehicle: Vehicle, near: float, seed: int) -> None:
        self._site, self._vehicle, self._share, self._seed = site, vehicle, near, seed
        self._swims = vehicle.kind == "auv"
        self._map = (water_map if self._swims else cost_map)(site, vehicle.radius_m)
        self._elsewhere = Elsewhere(self._map, vehicle, vehicle.cruise_m_s)
        self._room = rim_distance(site) - vehicle.radius_m - _RIM_M
        pieces, count = ndimage.label(np.isfinite(self._map.cost))
        if count == 0:
            raise ArgumentError("the site has no place where the robot may be")
        # What it cannot get to from most of the site it will never see.
        self._cells = np.argwhere(pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:])))
        self.begin()

    def begin(self) -> None:
        """Begin anew."""
        self.number = self.near = 0
        self._rng = np.random.default_rng([self._seed, 0x61])

    @property
    def random(self) -> str:
        """State of the generator, as JSON."""
        return json.dumps(self._rng.bit_generator.state)

    def go_on(self, number: int, near: int, random: str) -> None:
        """Go on as after so many pictures, with the generator as it then was.

        Raises
        ------
        ValueError
            That is no state of the generator.
        """
        rng = np.random.default_rng()
        try:
            rng.bit_generator.state = json.loads(random)
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise ValueError("holds no state of the random numbers") from error
        self.number, self.near, self._rng = number, near, rng

    def __call__(self, count: int) -> Iterator[tuple[NDArray[np.uint8], Lesson]]:
        """Yield pictures, uint8 [rows, cols, 3], with what they teach, until there are so many.

        Raises
        ------
        ArgumentError
            There seems to be no way from anywhere to anywhere.
        """
        rng, weather = self._rng, -1
        while self.number < count:
            number = self.number
            if weather != number // IN_ONE_WEATHER:
                weather = number // IN_ONE_WEATHER
                camera = camera_of(self._site, self._vehicle, 1_000_003 * self._seed + weather * IN_ONE_WEATHER)
            pose, goals = self._place(bool(rng.random() < self._share), rng)
            noise = 2_000_003 * self._seed + number
            self.number += 1
            yield look(camera, self._site, self._vehicle, pose, noise_seed=noise).rgb, self._lesson(pose, goals)

    def _place(self, near: bool, rng: np.random.Generator) -> tuple[Pose, Goals]:
        """Return a place and goals; where none of those drawn is as wanted, one that is not."""
        others = []
        for _ in range(_TRIES):
            pose = self._pose(rng)
            if pose is None:
                continue
            if self._is_near(pose, rng) != near:
                others.append(pose)
                continue
            goals = self._elsewhere.goals(pose, 1 + GOALS, rng)
            if goals is not None:
                self.near += near
                return pose, goals
        for pose in others:
            goals = self._elsewhere.goals(pose, 1 + GOALS, rng)
            if goals is not None:
                self.near += not near
                return pose, goals
        raise ArgumentError(f"from none of {_TRIES} random places there is a way to any goal")

    def _is_near(self, pose: Pose, rng: np.random.Generator) -> bool:
        """Whether something is in the way of the robot, the rim aside: no goal lies beyond that.

        Under water it is what has to be swum over.
        """
        if self._swims and climb_rad(self._site, self._vehicle, pose) > _CLIMBS * self._vehicle.pitch_limit_rad:
            return True
        places = [place_at(pose, bearing, AHEAD_M) for bearing in random_bearings(_ASKED, rng)]
        inside = [place for place in places if sample(self._room, self._site.pixel_m, *place) > 0]
        blocked = sum(not self._elsewhere.is_straight(pose, place) for place in inside)
        return blocked >= max(1.0, _BLOCKED * len(inside))

    def _pose(self, rng: np.random.Generator) -> Pose | None:
        """Return a random pose; None where the robot may not be there."""
        row, col = self._cells[rng.integers(len(self._cells))] + rng.random(2)
        east_m, south_m = float(col * self._map.cell_m), float(row * self._map.cell_m)
        heading = float(rng.uniform(-math.pi, math.pi))
        if sample(self._room, self._site.pixel_m, east_m, south_m) < 0:
            return None
        if not self._swims:
            return Pose(east_m, south_m, 0.0, heading, 0.0)
        robot = self._vehicle
        height = self._top(east_m, south_m) + float(rng.uniform(*_ALTITUDES)) * robot.altitude_m
        pitch = float(np.clip(rng.normal(0.0, _PITCH_RAD), -robot.pitch_limit_rad, robot.pitch_limit_rad))
        around = max(
            self._top(east_m + robot.radius_m * math.sin(turn), south_m + robot.radius_m * math.cos(turn))
            for turn in _AROUND
        )
        if around > height - robot.radius_m or height > -robot.radius_m - _BELOW_SURFACE_M:
            return None
        return Pose(east_m, south_m, height, heading, pitch)

    def _top(self, east_m: float, south_m: float) -> float:
        return float(sample(self._site.surface_m, self._site.pixel_m, east_m, south_m))

    def _lesson(self, pose: Pose, goals: Goals) -> Lesson:
        """Return what to do: by the first of the goals, the turn that costs least."""
        bearings, costs = goals
        pitch = 0.0
        if self._swims:
            limit = self._vehicle.pitch_limit_rad
            pitch = max(-1.0, min(1.0, climb_rad(self._site, self._vehicle, pose) / limit))
        yaw = float(ANGLES[int(costs[0].argmin())])
        return Lesson(yaw, pitch, float(bearings[0]), costs[0], bearings[1:], costs[1:])
