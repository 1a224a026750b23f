"""Steering data from a drive: what the robot's camera saw, and what the expert would have done there.

The labels are the expert's whoever drives, so that frames of a poor driver teach how to get back (DAgger: Ross,
Gordon and Bagnell 2011).
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.driving.goal import AHEAD_M
from hrt_cli.driving.lens import camera_of, look
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.simulator import Setting
from hrt_cli.driving.teacher import GroundTeacher
from hrt_cli.driving.turns import ANGLES
from hrt_cli.errors import OutputError

LABELS, FRAMES, ABOUT = "labels.csv", "frames", "recording.json"
EVERY_S = 0.3
"""Between two frames."""
_QUALITY = 95


class Recorder:
    """Takes a frame every 0.3 s of a drive; `watch` is a `simulator.Watch`.

    Parameters
    ----------
    setting : Setting
    teacher : GroundTeacher
        The expert, of its own: it is asked only here.
    folder : Path
        Gets `frames/000000.jpg`, ... as the drive goes on, and in the end `labels.csv` and `recording.json`.
    """

    def __init__(self, setting: Setting, teacher: GroundTeacher, folder: Path) -> None:
        self._setting, self._teacher, self._folder = setting, teacher, folder
        self._camera = camera_of(setting.site, setting.vehicle, setting.seed)
        self._swims = setting.vehicle.kind == "auv"
        self._rows: list[tuple[str, str]] = []
        self._due_s = 0.0

    def watch(self, time_s: float, known: Pose, true: Pose, command: Command) -> None:
        """Take a frame if one is due; where the expert sees no way on there is nothing to teach."""
        self._teacher.follow(known)
        if time_s < self._due_s:
            return
        advice = self._teacher.advise(true)
        if advice is None:
            return
        wanted, costs = advice
        self._due_s = time_s + EVERY_S
        number = len(self._rows)
        seed = 1_000_003 * self._setting.seed + number
        frame = look(self._camera, self._setting.site, self._setting.vehicle, true, noise_seed=seed)
        name = f"{FRAMES}/{number:06d}.jpg"
        done, data = cv2.imencode(".jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            raise OutputError(f"{self._folder / name}: cannot be encoded")
        try:
            (self._folder / name).write_bytes(data.tobytes())
        except OSError as error:
            raise OutputError(f"{self._folder / name}: cannot be written: {error.strerror}") from error
        labels = f"{wanted.yaw:.5f},{wanted.pitch:.5f}" if self._swims else f"{wanted.yaw:.5f}"
        spaced = " ".join(f"{each:.2f}" for each in costs.tolist())
        self._rows.append((f"{name},{labels}", f"{math.degrees(self._teacher.bearing_rad):.2f},{spaced}"))

    def finish(self, session: str, provenance: Provenance) -> int:
        """Write the labels; return how many frames there are."""
        columns = f"image,{'yaw,pitch' if self._swims else 'yaw'},session,goal_deg,turn_costs_s"
        text = "\n".join([columns, *(f"{seen},{session},{told}" for seen, told in self._rows)]) + "\n"

        def check(draft: Path) -> None:
            if draft.read_text(encoding="utf-8") != text:
                raise OutputError(f"{draft.name}: did not read back as it was written (is the disk full?)")

        with publishing(self._folder / LABELS, check) as draft:
            draft.write_text(text, encoding="utf-8")
        publish_json(self._folder / ABOUT, self._about(session), provenance)
        return len(self._rows)

    def _about(self, session: str) -> dict[str, Any]:
        lens = self._camera.lens
        return {
            "format": "hrt-recording",
            "version": 1,
            "frames": len(self._rows),
            "session": session,
            "vehicle": self._setting.vehicle.kind,
            "labels": "the expert's steering: yaw 1 is 45 degrees to the right or more, pitch 1 is the steepest climb; "
            f"goal_deg is the bearing of the course {AHEAD_M:g} m ahead, right positive; turn_costs_s is what the way "
            f"there costs after each of {ANGLES.size} turns from yaw -1 to 1, in seconds beyond the best of them",
            "lens": {"width": lens.width, "height": lens.height, "hfov_deg": lens.hfov_deg},
            "every_s": EVERY_S,
        }


def prepare_folder(folder: Path, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Make an empty folder for a recording.

    Raises
    ------
    OutputError
        Something else stands in its place, or a recording that may not be replaced.
    """
    if any(folder.resolve() in path.resolve().parents or folder.resolve() == path.resolve() for path in inputs):
        raise OutputError(f"{folder}: holds an input of the drive; record into another folder")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; a recording needs a folder")
    ours = {LABELS, FRAMES, ABOUT}
    found = {path.name for path in folder.iterdir()} if folder.exists() else set()
    if found - ours:
        raise OutputError(f"{folder}: holds {sorted(found - ours)[0]!r}, which is no part of a recording")
    if LABELS in found and not overwrite:
        raise OutputError(f"{folder}: holds a recording that was not made by this run; use --overwrite to replace it")
    try:
        for name in (LABELS, ABOUT):
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / FRAMES, ignore_errors=True)
        (folder / FRAMES).mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
