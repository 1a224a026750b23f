"""The simulator: a robot drives a course on a site, and what it would have logged comes out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import End
from hrt_cli.driving import motion
from hrt_cli.driving.course import Course
from hrt_cli.driving.local import Command, LocalPlanner, Pose, wrapped
from hrt_cli.driving.motion import CONTACT, EAST, HEADING, HEIGHT, PITCH, SOUTH, SPEED, State
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.progress import Progress, silent
from hrt_cli.world.site import Site

CONTROL_S = 0.1
"""Between two commands."""
_SUBSTEPS = 2
_LOG_EVERY = 4
"""Commands from one record to the next."""
_ARRIVED_M = 0.4

PATIENCE_S, _LEAST_M = 10.0, 0.5
"""A robot that was told to drive for so long and got on by less than `_LEAST_M` is stuck (Nav2's progress checker)."""
_FUTILE_S, _FUTILE_M = 90.0, 2.0
"""So is one that has not got away from a place by `_FUTILE_M` for so long: it goes round in circles."""

_SLIP_SD, _SLIP_S = 0.08, 1.0
"""Spread of the speed about what the ground allows, and how long a deviation lasts."""
_FIX_SD_M, _DRIFT_SD_M, _DRIFT_S = 0.03, 0.10, 30.0
"""Errors of the position: from fix to fix, and a drift that lasts."""
_SPEED_SD_M_S = 0.02
_HEADING_SD_RAD = math.radians(1.0)
_CURRENT_M_S = 0.08


@dataclass(frozen=True)
class Drive:
    """A drive.

    Attributes
    ----------
    records : float64 [n, 8]
        Time in s, east_m, south_m, heading_rad, pitch_rad, height_m, speed and commanded speed in m/s, as measured.
    events : list of (int, str)
        Record, and 'collision', 'intervention' (it was stopped at the rim of the surveyed area) or 'stuck'.
    end : str
        Why it ended.
    along_m : float
        How far along the course the robot came.
    """

    records: NDArray[np.float64]
    events: list[tuple[int, str]]
    end: End
    along_m: float


Watch = Callable[[float, Pose, Pose, Command], None]
"""Called at every command with the time in s, the pose as measured, the true pose, and what was commanded."""


def unwatched(time_s: float, known: Pose, true: Pose, command: Command) -> None:
    """Look at nothing."""


@dataclass(frozen=True)
class Setting:
    """What a drive depends on besides who steers.

    Attributes
    ----------
    site : Site
    vehicle : Vehicle
    course : Course
    cruise_m_s : float
        Commanded speed on a straight way.
    limit_s : float
        The drive ends after so long; infinite for none.
    heading_rad : float
        At the start.
    seed : int
    """

    site: Site
    vehicle: Vehicle
    course: Course
    cruise_m_s: float
    limit_s: float
    heading_rad: float
    seed: int


class _Chance:
    """What varies and what is measured wrongly in one drive: one stream of random numbers."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 0x4D52])
        self.drift_m = self._rng.normal(0.0, _DRIFT_SD_M, 2)
        self.slip = 1.0
        turn = self._rng.uniform(0.0, 2 * math.pi)
        self.current_m_s = (_CURRENT_M_S * math.cos(turn), _CURRENT_M_S * math.sin(turn))

    def step(self) -> None:
        draw = self._rng.standard_normal(3)
        keep = math.exp(-CONTROL_S / _DRIFT_S)
        self.drift_m = keep * self.drift_m + math.sqrt(1 - keep * keep) * _DRIFT_SD_M * draw[:2]
        keep = math.exp(-CONTROL_S / _SLIP_S)
        self.slip = 1.0 + keep * (self.slip - 1.0) + math.sqrt(1 - keep * keep) * _SLIP_SD * float(draw[2])

    def measured(self, pose: Pose) -> Pose:
        """Return a pose as the robot is told it."""
        return replace(pose, east_m=pose.east_m + self.drift_m[0], south_m=pose.south_m + self.drift_m[1])

    def record(self, time_s: float, state: State, commanded_m_s: float) -> list[float]:
        east, south = state[[EAST, SOUTH]] + self.drift_m + self._rng.normal(0.0, _FIX_SD_M, 2)
        heading = state[HEADING] + self._rng.normal(0.0, _HEADING_SD_RAD)
        speed = max(0.0, state[SPEED] + self._rng.normal(0.0, _SPEED_SD_M_S)) if state[SPEED] > 0 else 0.0
        return [time_s, east, south, heading, state[PITCH], state[HEIGHT], speed, commanded_m_s]


class _Stall:
    """Tells when a robot that is told to drive does not, or gets nowhere."""

    def __init__(self) -> None:
        self._recent: deque[float] = deque()
        self._anchor, self._since_s = (math.inf, math.inf), 0.0

    def is_stuck(self, time_s: float, commanded_m_s: float, state: State) -> bool:
        east, south = float(state[EAST]), float(state[SOUTH])
        if math.hypot(east - self._anchor[0], south - self._anchor[1]) > _FUTILE_M:
            self._anchor, self._since_s = (east, south), time_s
        if commanded_m_s > 0.05:
            self._recent.append(float(state[SPEED]))
            while len(self._recent) > PATIENCE_S / CONTROL_S:
                self._recent.popleft()
        whole = len(self._recent) >= PATIENCE_S / CONTROL_S
        gone_m = CONTROL_S * sum(self._recent)
        return (whole and gone_m < _LEAST_M) or time_s - self._since_s > _FUTILE_S


def simulate(setting: Setting, local: LocalPlanner, *, watch: Watch = unwatched, progress: Progress = silent) -> Drive:
    """Drive a course until the robot arrives, is stuck, or its time is over.

    The same setting and planner give the same drive.
    """
    vehicle, course = setting.vehicle, setting.course
    state = starting_state(setting)
    chance, stall = _Chance(setting.seed), _Stall()
    records: list[list[float]] = []
    events: list[tuple[int, str]] = []
    touching, commanded, time_s, tick = motion.FREE, 0.0, 0.0, 0
    records.append(chance.record(0.0, state, 0.0))
    while True:
        pose = _pose(state)
        known = chance.measured(pose)
        command = local.decide(known, pose)
        end = _ended(setting, local, state, time_s, command)
        if end is not None or command is None:
            break
        watch(time_s, known, pose, command)
        most = setting.cruise_m_s * command.speed
        change = vehicle.ramp_m_s2 * CONTROL_S
        # It brakes at once, and speeds up by the ramp.
        commanded = min(most, commanded + change)
        chance.step()
        met = _move(setting, state, command, commanded, chance)
        tick += 1
        time_s = tick * CONTROL_S
        new = met if met != touching else motion.FREE
        touching = met
        stuck = stall.is_stuck(time_s, commanded, state)
        if new != motion.FREE or stuck or tick % _LOG_EVERY == 0:
            records.append(chance.record(time_s, state, commanded))
        if new != motion.FREE:
            events.append((len(records) - 1, "collision" if new == CONTACT else "intervention"))
        if stuck:
            end = "stuck"
            break
        progress(min(int(local.along_m), int(course.length_m)), int(course.length_m))
    if end == "stuck":
        records.append(chance.record(time_s, state, commanded))
        events.append((len(records) - 1, "stuck"))
    elif records[-1][0] < time_s:
        records.append(chance.record(time_s, state, commanded))
    return Drive(np.array(records), events, end or "stuck", local.along_m)


def starting_state(setting: Setting) -> State:
    """Return the state of a robot put down at the start of its course."""
    site, vehicle = setting.site, setting.vehicle
    east, south = setting.course.points[0]
    height = motion.sample(site.ground_m if vehicle.kind == "ugv" else site.surface_m, site.pixel_m, east, south)
    height += vehicle.altitude_m
    if vehicle.kind == "auv":
        height = min(height, -vehicle.radius_m)
    return np.array([east, south, height, setting.heading_rad, 0.0, 0.0])


def _pose(state: State) -> Pose:
    east, south, height, heading, pitch = (float(state[k]) for k in (EAST, SOUTH, HEIGHT, HEADING, PITCH))
    return Pose(east, south, height, heading, pitch)


def first_heading(course: Course) -> float:
    """Return the heading of a course's first half metre."""
    east, south = course.point(0.5)
    return math.atan2(east - float(course.points[0, 0]), -(south - float(course.points[0, 1])))


def _ended(setting: Setting, local: LocalPlanner, state: State, time_s: float, command: Command | None) -> End | None:
    course = setting.course
    east, south = course.points[-1]
    near = math.hypot(east - state[EAST], south - state[SOUTH]) < _ARRIVED_M
    if local.along_m >= course.length_m - _ARRIVED_M and near:
        return "arrived"
    if command is None:
        return "stuck"
    return "out of time" if time_s >= setting.limit_s else None


def _move(setting: Setting, state: State, command: Command, commanded_m_s: float, chance: _Chance) -> int:
    site, vehicle = setting.site, setting.vehicle
    dt = CONTROL_S / _SUBSTEPS
    # A heading error of 45 degrees (yaw 1) is made up at the fastest turn; a smaller one in proportion.
    yaw_rate = command.yaw * vehicle.yaw_rate_rad_s
    if vehicle.kind == "ugv":
        return int(
            motion.roll_on(
                state, commanded_m_s, yaw_rate, chance.slip, _SUBSTEPS, dt, vehicle.radius_m,
                site.clearance_m, site.speed_factor, site.ground_m, site.seen, site.pixel_m,
            )
        )  # fmt: skip
    error = wrapped(command.pitch * vehicle.pitch_limit_rad - state[PITCH])
    pitch_rate = max(-1.0, min(1.0, error / 0.15)) * vehicle.pitch_rate_rad_s
    return int(
        motion.swim_on(
            state, commanded_m_s, yaw_rate, pitch_rate, *chance.current_m_s, _SUBSTEPS, dt, vehicle.radius_m,
            vehicle.pitch_limit_rad, site.surface_m, site.seen, site.pixel_m,
        )
    )  # fmt: skip
