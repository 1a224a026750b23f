"""A folder of pictures with predictions drawn in: whose it is, whether it is whole, how it is written."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import json_provenance, publish_json
from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import check_target
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import HrtError, InputError, OutputError

ABOUT = "overlay.json"
"""Written last: what the pictures were made from, and their hash."""
FORMAT, VERSION = "hrt-steering-overlay", 1
_OURS = re.compile(r"[0-9]{6,}_.*\.jpg", re.DOTALL)
_QUALITY = 92
_STEM_BYTES = 120
"""Of a picture's own name in that of its overlay."""


class OverlayWriter:
    """Writes numbered JPEGs into an empty folder, and in the end what they are.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count, self._digest = folder, 0, hashlib.sha256()

    def add(self, rgb: NDArray[np.uint8], name: str) -> None:
        """Write the next picture, uint8 RGB, under its number and the frame's own name."""
        stem = Path(name).stem.encode()[:_STEM_BYTES].decode(errors="ignore")
        name = f"{self._count:06d}_{stem}.jpg"
        done, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            raise OutputError(f"{self._folder / name}: cannot be encoded")
        (self._folder / name).write_bytes(data.tobytes())
        self._digest.update(name.encode() + hashlib.sha256(data.tobytes()).digest())
        self._count += 1

    def finish(self, provenance: Provenance) -> None:
        """Write `overlay.json`."""
        about = {"format": FORMAT, "version": VERSION, "frames": self._count, "sha256": self._digest.hexdigest()}
        publish_json(self._folder / ABOUT, about, provenance)


def check_overlays(folder: Path) -> Provenance | None:
    """Return the provenance of a folder of overlays after checking that its pictures are those that were written.

    Raises
    ------
    InputError
        They are not, or it is no such folder.
    """
    about = parse_strict(folder / ABOUT, read_text(folder / ABOUT))
    provenance = json_provenance(folder / ABOUT)
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise InputError(folder / ABOUT, "does not describe overlays")
    pictures = sorted(path for path in folder.iterdir() if path.name != ABOUT)
    digest = hashlib.sha256()
    for path in sorted(pictures, key=lambda path: (len(path.name.split("_")[0]), path.name)):
        digest.update(path.name.encode(errors="surrogateescape") + hashlib.sha256(path.read_bytes()).digest())
    if digest.hexdigest() != about.get("sha256"):
        raise InputError(folder, "its pictures are not those that were written")
    return provenance


def overlays_current(folder: Path, wanted: Provenance, inputs: Sequence[Path], existing: Existing) -> bool:
    """Say whether a folder holds just the overlays that this run would draw; refuse it if it must not be replaced.

    Parameters
    ----------
    inputs : sequence of Path
        And the other output: what must not lie in the folder.

    Raises
    ------
    OutputError
        The folder holds something else, or overlays that may not be replaced, or cannot be made.
    """
    if any(folder.resolve() in (path.resolve(), *path.resolve().parents) for path in inputs):
        raise OutputError(f"{folder}: is a folder of this run's inputs or output; draw into another one")
    if not folder.exists():
        check_target(folder, [])
        return False
    if not folder.is_dir():
        raise OutputError(f"{folder}: is a file; overlays need a folder")
    foreign = sorted(p.name for p in folder.iterdir() if p.name != ABOUT and not _OURS.fullmatch(p.name))
    if foreign:
        raise OutputError(f"{folder}: holds {foreign[0]!r}, which is no overlay; draw into another folder")
    if not any(folder.iterdir()):
        return False
    try:
        found = check_overlays(folder)
    except HrtError:
        found = None
    current = found is not None and found.fingerprint == wanted.fingerprint
    if not (current or existing.overwrite or existing.force):
        raise OutputError(f"{folder}: holds overlays that were not made by this run; use --overwrite to replace them")
    return current and not existing.force
