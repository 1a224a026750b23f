"""The topics of a bag as a drive log: which one tells what, and in which frame and clock.

Conventions are those of ROS (REP-103, REP-105): x forward, y left, z up, seconds of the header's stamp. A positive
pitch of ROS has the nose down, that of a drive log up; a positive roll has the right side down in both.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.logs.assemble import log_of_columns
from hrt_cli.logs.bag import COMMAND, FIX, IMU, ODOMETRY, Bag, Topic, read_bag
from hrt_cli.logs.kinds import Kind
from hrt_cli.logs.resample import held, interpolated

Floats = NDArray[np.float64]

_FUSED = re.compile(r"filter|fused", re.IGNORECASE)
_SAME_CLOCK_S = 1.0
"""Stamps of two topics farther apart than this, against the recording, come from different clocks."""
_UPSIDE_DEG = 60.0
"""A robot that leans more than this half of the time does not; its IMU is mounted otherwise."""
_PLANAR_DEG = 1e-4
_STILL_M = 0.5


def read_ros(path: Path, kind: Kind) -> DriveLog:
    """Return the drive in a bag.

    Places are those of NavSatFix, else of Odometry in the robot's own frame. Of several topics of a kind the fused one
    is taken (`filter` or `fused` in its name), else the one with the most (of NavSatFix: the most with a fix). Speeds
    are those of Odometry, roll and pitch of Imu, else of Odometry; commands those of Twist or TwistStamped on a topic
    named so.

    Raises
    ------
    InputError
        The bag cannot be read (`bag.read_bag`), tells no places, or times of places go backwards.
    """
    return _Drive(path, read_bag(path, kind)).log()


class _Drive:
    """A drive, put together topic by topic."""

    def __init__(self, path: Path, bag: Bag) -> None:
        self._path, self._bag = path, bag
        self._sources: list[str] = []
        self._notes: list[str] = [f"is damaged: {lack}" for lack in bag.lacking]
        self._unused: list[str] = []

    def log(self) -> DriveLog:
        odometry = self._one(ODOMETRY, [len(each.values) for each in self._bag.read[ODOMETRY]])
        time, place, frame = self._places(odometry)
        known = {}
        if odometry is not None and (speed := self._speed(odometry)) is not None:
            known["speed_m_s"] = interpolated(time, self._time(odometry), speed)
        command = self._one(COMMAND, [len(each.values) for each in self._bag.read[COMMAND]])
        if command is not None:
            self._sources.append(f"commanded speed from {command.name}")
            known["commanded_m_s"] = held(time, self._time(command), np.hypot(*command.values.T))
        known |= self._attitude(time, odometry)
        notes = ["takes " + ", ".join(self._sources)]
        if unused := sorted(set(self._unused) | set(self._bag.other_twists)):
            notes.append(f"passes over {', '.join(unused)}")
        return log_of_columns(self._path, time, place, known, own_frame=frame, notes=[*notes, *self._notes])

    def _one(self, kind: str, counts: Sequence[int]) -> Topic | None:
        """Return the topic of a kind to read: the fused one, else the one that counts most, else the first by name."""
        ranked = sorted(
            zip(self._bag.read[kind], counts, strict=True),
            key=lambda each: (_FUSED.search(each[0].name) is None, -each[1], each[0].name),
        )
        usable = [topic for topic, count in ranked if count]
        self._unused += [topic.name for topic, _ in ranked if topic not in usable[:1]]
        return usable[0] if usable else None

    def _places(self, odometry: Topic | None) -> tuple[Floats, Floats, str | None]:
        """Return times [n] and places [n, 2] of the records, and the robot's own frame where they are in it."""
        fixes = {id(each): _has_fix(each) for each in self._bag.read[FIX]}
        fix = self._one(FIX, [int(fixes[id(each)].sum()) for each in self._bag.read[FIX]])
        if fix is not None:
            self._clock = fix
            self._sources.append(f"places from {fix.name}")
            good = fixes[id(fix)]
            if not good.all():
                self._notes.append(f"drops {good.size - good.sum()} of {good.size} places: the receiver had no fix")
            return self._time(fix)[good], fix.values[good, :2], None
        if odometry is None:
            had = "none with a fix" if self._bag.read[FIX] else "no NavSatFix and no Odometry"
            raise InputError(self._path, f"tells no places: {had} among its topics")
        self._clock = odometry
        frame = odometry.frame or "odom"
        self._sources.append(f"places from {odometry.name}")
        self._notes.append(f"has no GPS fix: its places are in the robot's own frame {frame}, not on the map")
        return self._time(odometry), odometry.values[:, :2], frame

    def _time(self, topic: Topic) -> Floats:
        """Return the times of a topic in the clock of the places: by its stamps, else by when it was recorded."""
        shift, own = _shift_s(self._clock), _shift_s(topic)
        if shift is None:
            return topic.recorded_s
        if own is not None and abs(own - shift) <= _SAME_CLOCK_S:
            return topic.stamp_s
        if own is not None:
            off = f"the clock of {topic.name} is {own - shift:.1f} s off that of {self._clock.name}"
            note = f"{off}: set right by when they were recorded"
            self._notes += [note] if note not in self._notes else []
        return topic.recorded_s + shift

    def _speed(self, odometry: Topic) -> Floats | None:
        """Return the speeds of an odometry; None if it tells places only, as that of a converted GPS does."""
        speed = np.hypot(odometry.values[:, 2], odometry.values[:, 3])
        if not speed.any() and np.ptp(odometry.values[:, :2], axis=0).max() > _STILL_M:
            self._notes.append(f"{odometry.name} moves at a speed of 0: its speeds are passed over")
            return None
        self._sources.append(f"achieved speed from {odometry.name}")
        return speed

    def _attitude(self, time: Floats, odometry: Topic | None) -> dict[str, Floats]:
        turns = [_turned(each.values) for each in self._bag.read[IMU]]
        imu = self._one(IMU, [int(np.isfinite(roll).sum()) for roll, _ in turns])
        for topic, turn in ((imu, None if imu is None else imu.values),
                            (odometry, None if odometry is None else odometry.values[:, 4:])):  # fmt: skip
            if topic is None or turn is None:
                continue
            roll, pitch = _turned(turn)
            lean = np.maximum(np.abs(roll), np.abs(pitch))
            if not np.isfinite(lean).any() or np.nanmax(lean) < _PLANAR_DEG:
                continue
            if np.nanmedian(lean) > _UPSIDE_DEG:
                self._notes.append(
                    f"{topic.name} leans by {np.nanmedian(lean):.0f}°: it is not mounted as the robot is"
                )
                continue
            self._sources.append(f"roll and pitch from {topic.name}, as if mounted like the robot (x forward, z up)")
            when = self._time(topic)
            return {
                "roll_deg": interpolated(time, when, roll, angle=True),
                "pitch_deg": interpolated(time, when, pitch),
            }
        return {}


def _has_fix(topic: Topic) -> NDArray[np.bool_]:
    place, status = topic.values[:, :2], topic.values[:, 2]
    return np.asarray(np.isfinite(place).all(axis=1) & (status >= 0) & (place != 0).any(axis=1))


def _shift_s(topic: Topic) -> float | None:
    """Return by how much the stamps of a topic are ahead of its recording; None if they are not all set."""
    if not (topic.stamp_s > 0).all():
        return None
    return float(np.median(topic.stamp_s - topic.recorded_s))


def _turned(quaternion: Floats) -> tuple[Floats, Floats]:
    """Return roll (right side down) and pitch (nose up) in degrees of orientations x, y, z, w [n, 4]; NaN for none."""
    size = np.linalg.norm(quaternion, axis=1)
    valid = np.abs(size - 1.0) < 0.1
    x, y, z, w = (quaternion / np.where(valid, size, np.nan)[:, None]).T
    roll = np.degrees(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    pitch = -np.degrees(np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)))
    return roll, pitch
