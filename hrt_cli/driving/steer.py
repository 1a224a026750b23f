"""The local planner that was learnt: it steers by what the camera shows and by where the goal is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrt_cli.driving.detour import Detour
from hrt_cli.driving.goal import Goal
from hrt_cli.driving.lens import camera_of, look
from hrt_cli.driving.local import Command, Pose, careful
from hrt_cli.driving.simulator import CONTROL_S, Setting
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.steering.network.predictor import Distributions, Predictor

_EVERY = 2
"""Decisions from one frame to the next: five frames a second."""
_BESIDE = 2
"""Classes on either side of the best one over which the angle is averaged."""
_STEADY = 2.0
"""By so much falls the logarithm of what is thought of an angle, by its distance from the last one that was taken."""
_SURE = 0.5
"""Share of the probability about the best class below which the network does not know where the way is free."""


class Steer:
    """Steers by a network.

    It takes the mean about the best class, not over all: where the way leads left or right of a thing, the mean of
    both leads into it. And of angles that are about as good it takes the one near the last: to change its mind in front
    of a thing leads into it, too.

    Parameters
    ----------
    predictor : Predictor
    setting : Setting
    """

    name = "steer"

    def __init__(self, predictor: Predictor, setting: Setting) -> None:
        self._predictor, self._setting = predictor, setting
        self._camera, self._goal = camera_of(setting.site, setting.vehicle, setting.seed), Goal(setting.course)
        self._detour = Detour()
        self._asked, self._yaw = 0, 0.0
        self._last: Command | None = None
        self._told_m_s = self._told_m = 0.0

    @property
    def along_m(self) -> float:
        """See `LocalPlanner`."""
        return self._goal.along_m

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`."""
        bearing = self._goal.bearing_rad(known)
        if self._asked % _EVERY == 0:
            self._last = self._command(known, true, bearing)
            self._told_m = 0.0
        self._asked += 1
        self._note_told()
        return self._last

    def _note_told(self) -> None:
        """Add up how far the robot is told to drive, which speeds up by its ramp."""
        vehicle, wanted = self._setting.vehicle, 0.0 if self._last is None else self._last.speed
        faster = self._told_m_s + vehicle.ramp_m_s2 * CONTROL_S
        self._told_m_s = min(wanted * self._setting.cruise_m_s, faster)
        self._told_m += self._told_m_s * CONTROL_S

    def _command(self, known: Pose, true: Pose, goal_rad: float) -> Command:
        seed = 2_000_003 * self._setting.seed + self._asked
        frame = look(self._camera, self._setting.site, self._setting.vehicle, true, noise_seed=seed)
        config = self._predictor.config
        picture = fitted(frame.rgb, config)
        seen = np.stack([picture, picture[:, ::-1]] if config.mirrored else [picture])

        def ask(bearing_rad: float) -> Distributions:
            goal = np.array([bearing_rad, -bearing_rad], np.float32)[: len(seen)] if config.goal else None
            return both_ways(self._predictor.probabilities(seen, goal))

        if not config.goal:
            return self._steered(ask(0.0))

        bearing = self._detour.bearing_rad(known, goal_rad, self._told_m, lambda: self._yaw_by(ask(0.0)["yaw"], None))
        if self._detour.spinning:
            return Command(math.copysign(1.0, self._yaw), 0.0, 0.0)
        if self._detour.aligning and self._setting.vehicle.kind == "auv":
            # On the ground it turns on the spot anyway; a diver would be held while it turns, and take the way for
            # blocked. Then it swims on as if it had come that way.
            self._yaw = 0.0
            return Command(math.copysign(1.0, bearing), 0.0, 0.0)
        return self._steered(ask(bearing))

    def _steered(self, found: Distributions) -> Command:
        self._yaw = self._yaw_by(found["yaw"], self._yaw)
        pitch = best_angle(found["pitch"], None)[0] if "pitch" in found else 0.0
        return careful(self._setting.vehicle, self._yaw, pitch)

    def _yaw_by(self, probability: NDArray[np.float64], last: float | None) -> float:
        angle, share = best_angle(probability, last)
        if share >= _SURE or self._setting.vehicle.kind == "auv":
            return angle
        # It looks elsewhere: turning on the spot it cannot run into anything.
        held = _held(probability, last)
        half = probability.size // 2
        return math.copysign(1.0, held[half + 1 :].sum() - held[:half].sum())


def both_ways(found: Distributions) -> Distributions:
    """Return the mean of what a network says of a picture and of its mirror image, float64 [2M + 1] by output.

    The world has no preferred side, and a network that learnt from mirrored pictures, too, errs differently in the two.

    Parameters
    ----------
    found : dict of float64 [1 or 2, 2M + 1]
        Of the picture, then, if it was asked, of the mirror image with the goal mirrored.
    """
    back = {"yaw": -1, "pitch": 1}
    return {name: np.mean([each[0], *(one[:: back[name]] for one in each[1:])], axis=0) for name, each in found.items()}


def best_angle(probability: NDArray[np.float64], last: float | None) -> tuple[float, float]:
    """Return the mean of the angles about the best class of a distribution, the steadier the better, and their share.

    Parameters
    ----------
    probability : float64 [2M + 1]
    last : float, optional
        The angle before; without it all classes are equal.
    """
    best = int(np.convolve(_held(probability, last), [0.5, 1.0, 0.5], mode="same").argmax())
    near = slice(max(best - _BESIDE, 0), best + _BESIDE + 1)
    share = float(probability[near].sum())
    return float((probability[near] * _angles(probability)[near]).sum()) / share, share


def _held(probability: NDArray[np.float64], last: float | None) -> NDArray[np.float64]:
    return probability if last is None else probability * np.exp(-_STEADY * np.abs(_angles(probability) - last))


def _angles(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linspace(-1.0, 1.0, probability.size)
