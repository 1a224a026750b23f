"""A planner that is pushed off its way now and then, so that what it does to get back can be learnt from.

Noise injected into an expert's driving (Laskey, Lee, Fox, Dragan and Goldberg 2017, arXiv:1703.09327) shows a learner
states that the expert alone would never come to.
"""

from __future__ import annotations

import numpy as np

from hrt_cli.driving.local import Command, LocalPlanner, Pose

_SHORTEST, _LONGEST = 6, 18
"""Decisions that a push lasts."""
_LEAST_YAW = 0.5
_PITCH_SD = 0.5
_SLOWEST = 0.4


class Disturbed:
    """Steers as another planner, but for pushes to the left or the right (for an AUV, up or down, too).

    Parameters
    ----------
    inner : LocalPlanner
    share : float
        Of the time that it is pushed, in [0, 1).
    seed : int
    """

    def __init__(self, inner: LocalPlanner, share: float, seed: int) -> None:
        self._inner, self._rng = inner, np.random.default_rng([seed, 0xD1])
        mean = 0.5 * (_SHORTEST + _LONGEST)
        self._chance = share / (mean * (1.0 - share))
        self._left, self._push = 0, Command(0.0)
        self.name = inner.name

    @property
    def along_m(self) -> float:
        """See `LocalPlanner`."""
        return self._inner.along_m

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`."""
        command = self._inner.decide(known, true)
        if command is None:
            return None
        if self._left == 0 and self._rng.random() < self._chance:
            self._left = int(self._rng.integers(_SHORTEST, _LONGEST + 1))
            yaw = float(self._rng.choice((-1.0, 1.0)) * self._rng.uniform(_LEAST_YAW, 1.0))
            self._push = Command(yaw, float(np.clip(self._rng.normal(0.0, _PITCH_SD), -1.0, 1.0)))
        if self._left == 0:
            return command
        self._left -= 1
        return Command(self._push.yaw, self._push.pitch, max(_SLOWEST, command.speed))
