"""A folder of pictures with steering: `frames/000000.jpg`, ..., `labels.csv` and `recording.json`.

`hrt drive --record` fills one while a robot drives, `hrt record` with what it would see at random places.
"""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing, sweep
from hrt_cli.artifacts.unfinished import checkpoint_path
from hrt_cli.driving.goal import AHEAD_M
from hrt_cli.driving.turns import ANGLES
from hrt_cli.driving.vehicle import Kind
from hrt_cli.errors import OutputError
from hrt_cli.world.camera import Lens

LABELS, FRAMES, ABOUT = "labels.csv", "frames", "recording.json"
_QUALITY = 95


@dataclass(frozen=True)
class Lesson:
    """What ought to be done where a picture was taken.

    Attributes
    ----------
    yaw, pitch : float
        In [-1, 1]; a ground robot has no pitch.
    bearing_rad : float
        Of the goal, right positive.
    costs_s : float64 [turns]
        `turns.turn_costs` on the way to it.
    others_rad : float64 [goals]
        Bearings of other goals.
    other_costs_s : float64 [goals, turns]
        On the way to those.
    """

    yaw: float
    pitch: float
    bearing_rad: float
    costs_s: NDArray[np.float64]
    others_rad: NDArray[np.float64]
    other_costs_s: NDArray[np.float64]


class Album:
    """Takes pictures with what they teach; the labels are written in the end.

    Parameters
    ----------
    folder : Path
        As `prepare_folder` makes it.
    kind : 'ugv' or 'auv'
    lens : Lens
    """

    def __init__(self, folder: Path, kind: Kind, lens: Lens) -> None:
        self._folder, self._kind, self._lens = folder, kind, lens
        self._rows: list[str] = []
        self._pictures = hashlib.sha256()

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> list[str]:
        """The lines of the labels so far, a copy."""
        return list(self._rows)

    @property
    def pictures_sha256(self) -> str:
        """Over the files of the pictures so far, one after the other."""
        return self._pictures.hexdigest()

    def go_on(self, rows: Sequence[str], pictures_sha256: str) -> None:
        """Go on after pictures that lie in the folder, and these lines of their labels.

        Raises
        ------
        ValueError
            They do not lie there as they were written.
        """
        pictures = hashlib.sha256()
        for number in range(len(rows)):
            path = self._folder / _picture(number)
            try:
                pictures.update(path.read_bytes())
            except OSError as error:
                raise ValueError(f"{path} cannot be read: {error.strerror}") from error
        if pictures.hexdigest() != pictures_sha256:
            raise ValueError("the pictures are not those that were recorded")
        self._rows, self._pictures = list(rows), pictures

    def add(self, rgb: NDArray[np.uint8], lesson: Lesson, session: str) -> None:
        """Write a picture, uint8 [rows, cols, 3], and keep what it teaches.

        Pictures of a session must be kept together in a training: they look alike.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        name = _picture(len(self))
        done, encoded = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            raise OutputError(f"{self._folder / name}: cannot be encoded")
        data = encoded.tobytes()
        try:
            (self._folder / name).write_bytes(data)
        except OSError as error:
            raise OutputError(f"{self._folder / name}: cannot be written: {error.strerror}") from error
        labels = f"{lesson.yaw:.5f},{lesson.pitch:.5f}" if self._kind == "auv" else f"{lesson.yaw:.5f}"
        told = [f"{math.degrees(lesson.bearing_rad):.2f}", _spaced(lesson.costs_s)]
        told += [_spaced(np.degrees(lesson.others_rad)), _spaced(lesson.other_costs_s)]
        # It may be named after a file, and file names may hold commas.
        quoted = '"' + session.replace('"', '""') + '"' if set(session) & set(',"') else session
        self._rows.append(",".join([name, labels, quoted, *told]))
        self._pictures.update(data)

    def finish(self, provenance: Provenance, **more: Any) -> int:
        """Write the labels; return how many pictures there are.

        Parameters
        ----------
        provenance : Provenance
        more
            Goes into `recording.json`.
        """
        labels = "yaw,pitch" if self._kind == "auv" else "yaw"
        columns = f"image,{labels},session,goal_deg,turn_costs_s,other_goals_deg,other_costs_s"
        text = "\n".join([columns, *self._rows]) + "\n"

        def check(draft: Path) -> None:
            if draft.read_text(encoding="utf-8") != text:
                raise OutputError(f"{draft.name}: did not read back as it was written (is the disk full?)")

        with publishing(self._folder / LABELS, check) as draft:
            draft.write_text(text, encoding="utf-8")
        publish_json(self._folder / ABOUT, self._about() | more, provenance)
        return len(self)

    def _about(self) -> dict[str, Any]:
        return {
            "format": "hrt-recording",
            "version": 1,
            "frames": len(self),
            "vehicle": self._kind,
            "labels": "the expert's steering: yaw 1 is 45 degrees to the right or more, pitch 1 is the steepest climb; "
            f"goal_deg is the bearing of the goal, about {AHEAD_M:g} m ahead, right positive; turn_costs_s is what the "
            f"way there costs after each of {ANGLES.size} turns from yaw -1 to 1, in seconds beyond the best of them; "
            "other_goals_deg and other_costs_s tell the same of other goals, goal by goal",
            "lens": {"width": self._lens.width, "height": self._lens.height, "hfov_deg": self._lens.hfov_deg},
        }


def _picture(number: int) -> str:
    return f"{FRAMES}/{number:06d}.jpg"


def _spaced(values: NDArray[np.float64]) -> str:
    return " ".join(f"{each:.2f}" for each in values.ravel().tolist())


def prepare_folder(folder: Path, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Make an empty folder for a recording.

    Raises
    ------
    OutputError
        Something else stands in its place, or a recording that may not be replaced.
    """
    if any(folder.resolve() in path.resolve().parents or folder.resolve() == path.resolve() for path in inputs):
        raise OutputError(f"{folder}: holds an input; record into another folder")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; a recording needs a folder")
    unfinished = checkpoint_path(folder / ABOUT)
    for path in (folder / LABELS, folder / ABOUT, unfinished):
        sweep(path)
    ours = {LABELS, FRAMES, ABOUT, unfinished.name}
    found = {path.name for path in folder.iterdir()} if folder.exists() else set()
    if found - ours:
        raise OutputError(f"{folder}: holds {sorted(found - ours)[0]!r}, which is no part of a recording")
    if LABELS in found and not overwrite:
        raise OutputError(f"{folder}: holds a recording that was not made by this run; use --overwrite to replace it")
    try:
        for path in (folder / LABELS, folder / ABOUT, unfinished):
            path.unlink(missing_ok=True)
        shutil.rmtree(folder / FRAMES, ignore_errors=True)
        (folder / FRAMES).mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
