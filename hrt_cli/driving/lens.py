"""Where a robot's lens is and looks: its mounting, on the slope that the robot stands on."""

from __future__ import annotations

import math

import numpy as np

from hrt_cli.driving.local import Pose
from hrt_cli.driving.motion import sample
from hrt_cli.driving.vehicle import Vehicle
from hrt_cli.world.camera import Camera, Frame, Lens
from hrt_cli.world.site import Site


def clear_camera(site: Site, vehicle: Vehicle) -> Camera:
    """Return a robot's camera, in the site's own weather."""
    return Camera(site).changed(lens=Lens(hfov_deg=vehicle.lens_hfov_deg))


def camera_of(site: Site, vehicle: Vehicle, seed: int) -> Camera:
    """Return a robot's camera, in the weather of the drive of a seed."""
    camera = clear_camera(site, vehicle)
    return camera.changed(weather=camera.weather.jittered(np.random.default_rng([seed, 0xCA])))


def look(camera: Camera, site: Site, vehicle: Vehicle, pose: Pose, *, noise_seed: int | None = None) -> Frame:
    """Return what a robot sees at a pose; on the ground its height and attitude follow from the terrain."""
    if vehicle.kind == "auv":
        height, pitch, roll = pose.height_m, pose.pitch_rad, 0.0
    else:
        height = sample(site.ground_m, site.pixel_m, pose.east_m, pose.south_m)
        pitch, roll = attitude(site, vehicle, pose)
    return camera.view(
        pose.east_m,
        pose.south_m,
        height + vehicle.lens_height_m,
        pose.heading_rad,
        pitch + vehicle.lens_pitch_rad,
        roll,
        noise_seed=noise_seed,
    )


def attitude(site: Site, vehicle: Vehicle, pose: Pose) -> tuple[float, float]:
    """Return pitch (nose up) and roll (right side down) of a ground vehicle on the ground under it, in radians."""
    reach = vehicle.radius_m
    ahead = reach * math.sin(pose.heading_rad), -reach * math.cos(pose.heading_rad)
    aside = -ahead[1], ahead[0]

    def ground(east: float, south: float) -> float:
        return float(sample(site.ground_m, site.pixel_m, pose.east_m + east, pose.south_m + south))

    pitch = math.atan2(ground(*ahead) - ground(-ahead[0], -ahead[1]), 2 * reach)
    roll = math.atan2(ground(-aside[0], -aside[1]) - ground(*aside), 2 * reach)
    return pitch, roll
