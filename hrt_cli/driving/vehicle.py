"""The robots: a ground vehicle that turns on the spot, and an underwater vehicle that flies over the bottom."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Kind = Literal["ugv", "auv"]


@dataclass(frozen=True)
class Vehicle:
    """Limits and mountings of a robot.

    Attributes
    ----------
    kind : 'ugv' or 'auv'
    radius_m : float
        Of the circle (for the AUV the ball) that it fits into.
    yaw_rate_rad_s, pitch_rate_rad_s : float
        Fastest turn to the side, and up or down.
    pitch_limit_rad : float
        Steepest climb or dive.
    ramp_m_s2 : float
        How fast the commanded speed may change.
    lens_height_m : float
        Of the camera over the ground, or over the AUV's middle.
    lens_pitch_rad : float
        Of the camera in the robot's frame, nose up.
    lens_hfov_deg : float
        Its horizontal field of view.
    lookahead_m : float
        How far ahead on its path it aims (pure pursuit: Coulter 1992).
    altitude_m : float
        Height over the bottom that the AUV keeps.
    cruise_m_s : float
        Its speed where no plan says another.
    """

    kind: Kind
    radius_m: float
    yaw_rate_rad_s: float
    pitch_rate_rad_s: float
    pitch_limit_rad: float
    ramp_m_s2: float
    lens_height_m: float
    lens_pitch_rad: float
    lens_hfov_deg: float
    lookahead_m: float
    altitude_m: float
    cruise_m_s: float


UGV = Vehicle(
    kind="ugv",
    radius_m=0.35,
    yaw_rate_rad_s=1.4,
    pitch_rate_rad_s=0.0,
    pitch_limit_rad=0.0,
    ramp_m_s2=1.5,
    lens_height_m=0.8,
    lens_pitch_rad=math.radians(-10.0),
    lens_hfov_deg=100.0,
    lookahead_m=0.7,
    altitude_m=0.0,
    cruise_m_s=1.0,
)
"""A skid-steered robot of the size of a Clearpath Jackal or a small Husky."""

AUV = Vehicle(
    kind="auv",
    radius_m=0.30,
    yaw_rate_rad_s=0.8,
    pitch_rate_rad_s=0.6,
    pitch_limit_rad=math.radians(50.0),
    ramp_m_s2=0.4,
    lens_height_m=0.0,
    lens_pitch_rad=math.radians(-35.0),
    lens_hfov_deg=75.0,
    lookahead_m=1.4,
    altitude_m=0.9,
    cruise_m_s=0.5,
)
"""A robot of the size of an Aqua, which swims with six flippers and turns in its own length."""

VEHICLES: dict[str, Vehicle] = {"ugv": UGV, "auv": AUV}
