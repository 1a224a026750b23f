"""A learner that is helped on."""

from __future__ import annotations

import math

import numpy as np
from world_files import ground_site

from hrt_cli.driving.course import Course
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.rescue import Rescued
from hrt_cli.driving.simulator import Setting, simulate
from hrt_cli.driving.teacher import teacher_of
from hrt_cli.driving.vehicle import UGV


class Blind:
    """Drives straight on to the east."""

    name, along_m = "blind", 0.0

    def decide(self, known: Pose, true: Pose) -> Command | None:
        return Command(max(-1.0, min(1.0, (math.pi / 2 - true.heading_rad) / 0.8)))


def drive(rescue: bool) -> tuple[float, str, int]:
    obstacle = np.zeros((160, 200), np.bool_)
    obstacle[72:88, 80:90] = True
    setting = Setting(
        ground_site(obstacle), UGV, Course(np.array([[2.0, 8.0], [18.0, 8.0]])), 1.0, 40.0, math.pi / 2, 0
    )
    planner = Rescued(Blind(), teacher_of(setting)) if rescue else Blind()
    east, taught = [], []

    def watch(time_s: float, known: Pose, true: Pose, command: Command) -> None:
        east.append(true.east_m)
        taught.append(command != Blind().decide(known, true))

    found = simulate(setting, planner, watch=watch)
    return max(east), found.end, sum(taught)


def test_it_is_helped_round_what_it_stands_before_and_then_drives_itself() -> None:
    reached, end, _ = drive(rescue=False)
    assert reached < 8.0
    assert end == "stuck"
    reached, _, taught = drive(rescue=True)
    assert reached > 12.0
    assert 10 < taught < 120
