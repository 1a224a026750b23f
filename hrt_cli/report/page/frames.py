"""What a robot's camera saw on a drive, or would have seen: small pictures that a page plays beside the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.evaluation.views import poses_on, seen_from, vehicle_of
from hrt_cli.logs.read import read_drive_log
from hrt_cli.report.page.pictures import jpeg
from hrt_cli.world.site import Site

WIDTH_PX = 240
_QUALITY = 70
RECORDED, RENDERED = "as the camera saw it", "rendered from the survey at the logged places"


def recorded_frames(about: Path, document: dict[str, Any], most: int) -> list[dict[str, Any]]:
    """Return at most so many of the frames of a recording, evenly spread, with the seconds at which they were taken.

    Raises
    ------
    InputError
        A picture is not there or damaged, or the recording does not say when they were taken.
    """
    times = document.get("times_s")
    if not isinstance(times, list) or len(times) != document.get("frames"):
        raise InputError(about, "does not say when its frames were taken")
    chosen = np.unique(np.linspace(0, len(times) - 1, min(most, len(times))).astype(int)).tolist()
    frames = []
    for k in chosen:
        path = about.parent / "frames" / f"{k:06d}.jpg"
        try:
            data = np.frombuffer(path.read_bytes(), np.uint8)
        except OSError as error:
            raise InputError(path, f"cannot be read: {error.strerror}") from error
        bgr = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
        if bgr is None:
            raise InputError(path, "is no picture, or a damaged one")
        frames.append(_frame(float(times[k]), np.asarray(bgr[..., ::-1], np.uint8)))
    return frames


def rendered_frames(path: Path, site: Site, most: int) -> list[dict[str, Any]]:
    """Return at most so many views from the places of a log, evenly spread over its time.

    Raises
    ------
    InputError
        The log cannot be read, or lies wholly off the site.
    """
    log = read_drive_log(path)
    poses = poses_on(path, log, site)
    seconds = log.time_s - log.time_s[0]
    wanted = np.linspace(0.0, seconds[-1], max(1, min(most, len(seconds))))
    at = np.unique(np.searchsorted(seconds, wanted).clip(0, len(seconds) - 1)).tolist()
    views = seen_from(site, poses, vehicle_of(log, site), at)
    return [_frame(float(seconds[k]), view.rgb) for k, view in zip(at, views, strict=True)]


def _frame(time_s: float, rgb: NDArray[np.uint8]) -> dict[str, Any]:
    if rgb.shape[1] > WIDTH_PX:
        height = round(rgb.shape[0] * WIDTH_PX / rgb.shape[1])
        rgb = np.asarray(cv2.resize(rgb, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
    return {"t": round(time_s, 3), "src": jpeg(rgb, _QUALITY)}
