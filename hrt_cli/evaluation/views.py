"""What a robot's camera sees at the places of a log: rendered from the survey."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.driving.lens import clear_camera, look
from hrt_cli.driving.local import Pose
from hrt_cli.driving.motion import sample
from hrt_cli.driving.vehicle import VEHICLES, Vehicle
from hrt_cli.errors import InputError
from hrt_cli.evaluation.travel import travel_heading
from hrt_cli.raster.track import track_on
from hrt_cli.world.camera import Frame
from hrt_cli.world.site import Site


@dataclass(frozen=True)
class Poses:
    """Places on the site [n, 2], heights [n] (NaN: not known), headings and pitches in radians [n]."""

    place: NDArray[np.float64]
    height_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    pitch_rad: NDArray[np.float64]


def poses_on(path: Path, log: DriveLog, site: Site) -> Poses:
    """Return the poses of a log on a site; headings that it does not tell are those of the way.

    Raises
    ------
    InputError
        The log, of which `path` is the name, lies wholly off the site.
    """
    rows, cols = track_on(path, log, site.grid, "world")
    if not ((rows >= 0) & (rows <= site.grid.rows) & (cols >= 0) & (cols <= site.grid.cols)).any():
        raise InputError(path, "lies wholly off the world")
    place = np.stack([cols, rows], axis=1) * site.pixel_m
    heading = np.radians(log.heading_deg) - site.up_bearing_rad
    unknown = np.isnan(heading)
    heading[unknown] = travel_heading(place)[unknown]
    return Poses(place, -log.depth_m, heading, np.radians(np.nan_to_num(log.pitch_deg)))


def vehicle_of(log: DriveLog, site: Site) -> Vehicle:
    """Return who drove: as the log says, else what drives on such a site."""
    return VEHICLES[log.robot.kind if log.robot is not None else "auv" if site.under_water else "ugv"]


def seen_from(site: Site, poses: Poses, vehicle: Vehicle, at: Sequence[int]) -> Iterator[Frame]:
    """Render what the vehicle's camera sees at some of the poses, in the site's own weather.

    Where the height of an underwater robot is not known it is taken to keep its usual distance from the bottom.
    """
    camera = clear_camera(site, vehicle)
    for k in at:
        east, south = poses.place[k]
        height = poses.height_m[k]
        if np.isnan(height):
            height = sample(site.surface_m, site.pixel_m, east, south) + vehicle.altitude_m
        yield look(camera, site, vehicle, Pose(east, south, height, poses.heading_rad[k], poses.pitch_rad[k]))
