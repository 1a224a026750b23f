"""A learner that is helped on: where it gets no farther the teacher drives, for a few metres.

What a learner of the first round records without help are many frames of the one thing that it stands before. The
labels are the teacher's anyhow, so who drives may change (DAgger's mixed policies: Ross, Gordon and Bagnell 2011).
"""

from __future__ import annotations

import math
from collections import deque

from hrt_cli.driving.local import Command, LocalPlanner, Pose
from hrt_cli.driving.teacher import GroundTeacher

_WAITED, _STILL_M = 30, 0.3
"""A robot that came no farther than this in so many decisions stands: turning round takes less."""
_HELPED_M, _LONGEST = 2.0, 150
"""The teacher drives so far, for so many decisions at most."""


class Rescued:
    """Steers as the learner, or where that stands as the teacher.

    Parameters
    ----------
    learner : LocalPlanner
    teacher : GroundTeacher
        Of its own.
    """

    def __init__(self, learner: LocalPlanner, teacher: GroundTeacher) -> None:
        self._learner, self._teacher = learner, teacher
        self._places: deque[tuple[float, float]] = deque(maxlen=_WAITED)
        self._from, self._left = (0.0, 0.0), 0
        self.name = learner.name

    @property
    def along_m(self) -> float:
        """See `LocalPlanner`."""
        return self._learner.along_m

    def decide(self, known: Pose, true: Pose) -> Command | None:
        """See `LocalPlanner`."""
        here = (true.east_m, true.south_m)
        wanted = self._learner.decide(known, true)
        self._teacher.follow(known)
        self._places.append(here)
        if self._left > 0:
            self._left = 0 if math.dist(here, self._from) > _HELPED_M else self._left - 1
            if self._left == 0:
                self._places.clear()
        elif len(self._places) == _WAITED and max(math.dist(here, each) for each in self._places) < _STILL_M:
            self._from, self._left = here, _LONGEST
        return (self._teacher.steer(true) or wanted) if self._left > 0 else wanted
