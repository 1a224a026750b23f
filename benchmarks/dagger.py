"""A robot that learns to steer from one survey: how it drives there and elsewhere, beside behavioural cloning.

    python benchmarks/dagger.py SITE [--elsewhere SITE]... [--out DIR] [KEY=VALUE...]

SITE is a folder with ortho.tif and dsm.tif. The learning is `make -f steer.mk`, KEY=VALUE as for make, in DIR/dagger;
behavioural cloning is the same with one round and without glances, in which the expert drives, undisturbed, as many
drives as all rounds have, and as many frames are shown to the network (DIR/cloning). What was made stays in DIR, with
the CPU time that it took, and is not made again. Both then drive courses that nobody trained on: other random legs,
once as they come, and once so that three in four lead across something that has to be gone round.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from driving import distance_m

from hrt_cli.driving.local import Command, LocalPlanner, Pose
from hrt_cli.driving.roam import CROSSING, roam_course
from hrt_cli.driving.simulator import Setting, first_heading, simulate
from hrt_cli.driving.stage import local_planner
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.evaluation.drives import DRIVABLE
from hrt_cli.project import create_project
from hrt_cli.world.site import Site, load_site

FIRST_SEED = 7000
"""Of the courses: the workflow uses others."""


@dataclass
class Tally:
    """What some drives came to."""

    metres: float = 0.0
    good: int = 0
    moments: int = 0
    collisions: int = 0
    interventions: int = 0
    ends: str = ""

    def row(self) -> str:
        return (
            f"{self.metres:>8.0f} m{self.collisions:>12}{self.interventions:>16}{self.good / self.moments:>11.1%}"
            f"  {self.ends}"
        )


def learn(folder: Path, site: Path, settings: dict[str, str]) -> float:
    """Run the workflow; return the seconds of CPU time that all in the folder took, nan where a run was broken off."""
    spent = folder / "cpu_seconds.txt"
    so_far = (float(spent.read_text()) if spent.exists() else math.nan) if folder.exists() else 0.0
    create_project(folder)
    spent.unlink(missing_ok=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(
        ["make", "-C", str(folder), "-f", "steer.mk", "learning", f"world={site.resolve()}",
         *(f"{key}={value}" for key, value in settings.items())],
        check=True, env=os.environ | {"PATH": path}, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = so_far + after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    spent.write_text(f"{seconds}\n")
    return seconds


def drive(
    site: Site, who: str, model: Path | None, courses: int, metres: float, crossing: float | None = CROSSING
) -> Tally:
    tally = Tally()
    vehicle = AUV if site.under_water else UGV
    for seed in range(FIRST_SEED, FIRST_SEED + courses):
        course = roam_course(site, vehicle, metres, seed, crossing=crossing)
        setting = Setting(site, vehicle, course, vehicle.cruise_m_s, math.inf, first_heading(course), seed)
        local: LocalPlanner = local_planner(who, setting, model)

        def watch(time_s: float, known: Pose, true: Pose, command: Command) -> None:
            row, col = site.pixel(true.east_m, true.south_m)
            tally.good += bool(site.under_water or site.speed_factor[row, col] >= DRIVABLE)
            tally.moments += 1

        found = simulate(setting, local, watch=watch)
        tally.metres += distance_m(found)
        tally.collisions += sum(event == "collision" for _, event in found.events)
        tally.interventions += sum(event == "intervention" for _, event in found.events)
        tally.ends += f"{found.end} at {found.along_m / course.length_m:.0%}  "
    return tally


def frames(folder: Path) -> int:
    """Return how many frames the recordings below a folder hold."""
    return sum(len(path.read_text().splitlines()) - 1 for path in sorted(folder.rglob("labels.csv")))


def cloning(settings: dict[str, str], dagger: Path) -> dict[str, str]:
    """Return the settings under which the expert alone drives as much, and the network sees as many frames."""
    lines = [line.partition("#")[0].partition(":") for line in (dagger / "config.yaml").read_text().splitlines()]
    known = {key: value.strip() for key, _, value in lines} | settings
    rounds = int(known["steer_rounds"])
    so_far = frames(dagger / "out" / "steer" / "glances")
    shown = driven = 0
    for k, epochs in enumerate(map(int, known["steer_epochs"].split()[:rounds]), start=1):
        new = frames(dagger / "out" / "steer" / f"round-{k}")
        driven, so_far = driven + new, so_far + new
        shown += epochs * so_far
    return settings | {
        "steer_glances": "0",
        "steer_rounds": "1",
        "steer_drives": str(rounds * int(known["steer_drives"])),
        "steer_disturb": "0",
        "steer_epochs": str(max(1, round(shown / driven))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path)
    parser.add_argument("settings", nargs="*", help="KEY=VALUE, as for make")
    parser.add_argument("--elsewhere", type=Path, action="append", default=[], help="another site (repeatable)")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--courses", type=int, default=4)
    parser.add_argument("--metres", type=float, default=300.0, help="of each course")
    parser.add_argument("--no-cloning", action="store_true")
    options = parser.parse_intermixed_args()
    settings = dict(each.split("=", 1) for each in options.settings)
    out = options.out or Path(tempfile.mkdtemp())
    rounds = {}
    for name in ("dagger", "cloning")[: 1 if options.no_cloning else 2]:
        own = settings if name == "dagger" else cloning(settings, out / "dagger")
        seconds = learn(out / name, options.site, own)
        print(f"{name}: {seconds / 60:.1f} minutes of CPU time")
        models = sorted((out / name / "out" / "steer").glob("round-*/steer.safetensors"))
        rounds |= {f"{name}, round {k + 1}": model for k, model in enumerate(models)}
    who = [("expert", "expert", None), ("pursuit", "pursuit", None)]
    who += [(name, "steer", model) for name, model in rounds.items()]
    for folder in (options.site, *options.elsewhere):
        site = load_site(folder)
        for kind, crossing in (("legs as they come", None), ("three legs in four across something", CROSSING)):
            print(f"\n{folder.name}, {kind}")
            print(f"  {'':<20}{'driven':>10}{'collisions':>12}{'off the survey':>16}{'drivable':>11}")
            for name, planner, model in who:
                found = drive(site, planner, model, options.courses, options.metres, crossing)
                print(f"  {name:<20}{found.row()}", flush=True)


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
