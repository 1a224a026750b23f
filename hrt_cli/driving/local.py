"""The local planners' common ground: what one knows at a moment, what it commands, and the simplest, pure pursuit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from hrt_cli.driving.course import Carrot, Course
from hrt_cli.driving.vehicle import Vehicle

_SLOW_RAD = math.radians(70.0)
"""Heading error at which a robot turns on the spot."""
_FULL_RAD = math.radians(45.0)
"""Heading error at which it turns as fast as it can: where yaw is 1."""
_ON_THE_SPOT = 0.9
"""Yaw from which on one that is careful turns on the spot."""


@dataclass(frozen=True)
class Pose:
    """Where a robot is, as it knows (the expert: as it is): metres and radians as in `world.site`; height absolute."""

    east_m: float
    south_m: float
    height_m: float
    heading_rad: float
    pitch_rad: float


@dataclass(frozen=True)
class Command:
    """What a local planner wants.

    Attributes
    ----------
    yaw : float
        Steering in [-1, 1], right positive: 1 is a heading error of 45 degrees or more.
    pitch : float
        Nose up in [-1, 1], as a share of the robot's steepest pitch; 0 on the ground.
    speed : float
        Share of the cruising speed in [0, 1].
    """

    yaw: float
    pitch: float = 0.0
    speed: float = 1.0


class LocalPlanner(Protocol):
    """Steers a robot along a course."""

    name: str

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """Return the command at this moment; None where it sees no way on.

        Parameters
        ----------
        known : Pose
            As it is measured: all that a robot is told.
        true : Pose
            As it is: where its camera stands, and what the expert alone knows.
        """

    @property
    def along_m(self) -> float:
        """How far along the course the robot has come."""


def wrapped(angle_rad: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def steer_to(pose: Pose, east_m: float, south_m: float, pitch: float = 0.0) -> Command:
    """Return the command that heads for a place, slower the more it has to turn."""
    error = wrapped(math.atan2(east_m - pose.east_m, -(south_m - pose.south_m)) - pose.heading_rad)
    return turning(error / _FULL_RAD, pitch)


def turning(yaw: float, pitch: float = 0.0) -> Command:
    """Return the command that turns by so many times 45 degrees, slower the more there is to turn."""
    speed = max(0.0, 1.0 - abs(yaw) * _FULL_RAD / _SLOW_RAD)
    return Command(max(-1.0, min(1.0, yaw)), pitch, speed)


class Pursuit:
    """Follow the course by pure pursuit (Coulter 1992): aim at the point `lookahead_m` ahead on it.

    It sees nothing. The AUV keeps the depth at which it began.
    """

    name = "pursuit"

    def __init__(self, course: Course, vehicle: Vehicle) -> None:
        self._carrot, self._vehicle = Carrot(course, vehicle.lookahead_m), vehicle
        self._depth_m: float | None = None

    @property
    def along_m(self) -> float:
        """See `LocalPlanner`."""
        return self._carrot.along_m

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`."""
        if self._depth_m is None:
            self._depth_m = known.height_m
        aim = self._carrot.aim(known.east_m, known.south_m)
        return steer_to(known, *aim, pitch=level_pitch(self._vehicle, known, self._depth_m))


def careful(vehicle: Vehicle, yaw: float, pitch: float = 0.0) -> Command:
    """Return the command of one that goes by what it sees, and so by what may not be so.

    A ground vehicle comes to a stand before it turns by 45 degrees: turning on the spot it cannot run into anything.
    """
    if vehicle.kind == "auv":
        return turning(yaw, pitch)
    return Command(max(-1.0, min(1.0, yaw)), pitch, max(0.0, 1.0 - abs(yaw) / _ON_THE_SPOT))


def level_pitch(vehicle: Vehicle, pose: Pose, height_m: float) -> float:
    """Return the pitch, as a share of the steepest, that brings an AUV to a height within two metres of way."""
    if vehicle.pitch_limit_rad == 0.0:
        return 0.0
    wanted = math.atan2(height_m - pose.height_m, 2.0)
    return max(-1.0, min(1.0, wanted / vehicle.pitch_limit_rad))
