"""Steering data from a drive: what the robot's camera saw, and what the expert would have done there.

The labels are the expert's whoever drives, so that frames of a poor driver teach how to get back (DAgger: Ross,
Gordon and Bagnell 2011).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.driving.album import Album, Lesson
from hrt_cli.driving.lens import camera_of, look
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.simulator import Setting
from hrt_cli.driving.teacher import GroundTeacher

EVERY_S = 0.3
"""Between two frames."""


class Recorder:
    """Takes a frame every 0.3 s of a drive; `watch` is a `simulator.Watch`.

    Parameters
    ----------
    setting : Setting
    teacher : GroundTeacher
        The expert, of its own: it is asked only here.
    folder : Path
        See `album.Album`.
    session : str
        The drive's name.
    """

    def __init__(self, setting: Setting, teacher: GroundTeacher, folder: Path, session: str) -> None:
        self._setting, self._teacher = setting, teacher
        self._camera = camera_of(setting.site, setting.vehicle, setting.seed)
        self._album = Album(folder, setting.vehicle.kind, self._camera.lens)
        self._rng = np.random.default_rng([setting.seed, 0x0E])
        self._session, self._due_s = session, 0.0
        self._times_s: list[float] = []

    def watch(self, time_s: float, known: Pose, true: Pose, command: Command) -> None:
        """Take a frame if one is due; where the expert sees no way on there is nothing to teach."""
        self._teacher.follow(known)
        if time_s < self._due_s:
            return
        advice = self._teacher.advise(true)
        others = None if advice is None else self._teacher.others(true, self._rng)
        if advice is None or others is None:
            return
        wanted, costs = advice
        self._due_s = time_s + EVERY_S
        seed = 1_000_003 * self._setting.seed + len(self._album)
        frame = look(self._camera, self._setting.site, self._setting.vehicle, true, noise_seed=seed)
        lesson = Lesson(wanted.yaw, wanted.pitch, self._teacher.bearing_rad, costs, *others)
        self._album.add(frame.rgb, lesson, self._session)
        self._times_s.append(round(time_s, 3))

    def finish(self, provenance: Provenance) -> int:
        """Write the labels, and when each frame was taken; return how many there are."""
        return self._album.finish(provenance, session=self._session, every_s=EVERY_S, times_s=self._times_s)
