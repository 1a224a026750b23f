"""The simulated robot: how fast it is simulated, long courses with and without sight, and walls to plan around.

    python benchmarks/driving.py speed                  times real time
    python benchmarks/driving.py courses [SITE...]      a kilometre by the expert and by pursuit; default: sample sites
    python benchmarks/driving.py walls [--cases 40]     a robot before a wall that it knows nothing of

SITE is a folder with ortho.tif and dsm.tif, and perhaps truth.tif and world.json.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from scipy import ndimage

from hrt_cli.artifacts.provenance import record
from hrt_cli.drivability.feedback import FeedbackSettings
from hrt_cli.drivability.feedback_stage import learn_scores
from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.driving.course import Course
from hrt_cli.driving.simulator import Drive, Setting, first_heading, simulate
from hrt_cli.driving.stage import DriveRequest, drive_file, local_planner
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.logs.read import read_drive_log
from hrt_cli.planning.request import PlanRequest, Spending, parse_start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.cog import Layout, publishing_cog
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window
from hrt_cli.world.site import Site, load_site
from hrt_cli.world.stage import synthesize
from hrt_cli.world.synth import SiteSpec

COURSE_M = 1100.0
ROOM_M = 0.6
"""Least clearance of the ground that courses lead to, and over which all of it can be reached."""
SPEED_M_S = 1.0
MOST_LEGS = 12


@contextmanager
def sample_sites() -> Iterator[list[Path]]:
    with tempfile.TemporaryDirectory() as name:
        folders = []
        for scene in ("meadow", "wildfire", "reef"):
            folders.append(Path(name) / scene)
            synthesize(folders[-1], SiteSpec(scene, (60.0, 60.0), 0.1, 1))
        yield folders


def course_on(site: Site, seed: int) -> Course:
    """Return straight legs between random places that can be reached from one another, `COURSE_M` in all."""
    free = site.seen & ndimage.binary_erosion(site.seen, iterations=math.ceil(ROOM_M / site.pixel_m))
    if site.under_water:
        free &= site.surface_m < -2.0
    else:
        free &= (site.clearance_m > ROOM_M) & (site.speed_factor > 0.3)
    pieces, _ = ndimage.label(free)
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    cells = np.argwhere(pieces == largest)
    rng = np.random.default_rng(seed)
    points = [cells[rng.integers(len(cells))]]
    length = 0.0
    while length < COURSE_M:
        points.append(cells[rng.integers(len(cells))])
        length += float(np.hypot(*(points[-1] - points[-2]))) * site.pixel_m
    return Course((np.array(points)[:, ::-1] + 0.5) * site.pixel_m)


def drive_course(site: Site, course: Course, local: str, seed: int) -> tuple[Drive, float]:
    """Drive a course; return the drive and the seconds that its simulation took."""
    vehicle = AUV if site.under_water else UGV
    cruise = 0.5 * SPEED_M_S if site.under_water else SPEED_M_S
    setting = Setting(site, vehicle, course, cruise, math.inf, first_heading(course), seed)
    planner = local_planner(local, setting)
    began = time.perf_counter()
    return simulate(setting, planner), time.perf_counter() - began


def distance_m(drive: Drive) -> float:
    return float((0.5 * (drive.records[1:, 6] + drive.records[:-1, 6]) * np.diff(drive.records[:, 0])).sum())


def courses(folders: list[Path], seeds: int) -> None:
    print(
        f"{'site':<18}{'seed':>5}  {'who':<9}{'end':<12}{'driven':>9}{'of course':>11}{'collisions':>11}"
        f"{'off the survey':>16}"
    )
    for folder in folders:
        site = load_site(folder)
        for seed in range(seeds):
            course = course_on(site, seed)
            for local in ("expert", "pursuit"):
                drive, _ = drive_course(site, course, local, seed)
                hits, off = (sum(each == kind for _, each in drive.events) for kind in ("collision", "intervention"))
                print(
                    f"{folder.name:<18}{seed:>5}  {local:<9}{drive.end:<12}{distance_m(drive):>7.0f} m"
                    f"{drive.along_m / course.length_m:>11.0%}{hits:>11}{off:>16}"
                )


def speed(folders: list[Path]) -> None:
    print(f"{'site':<18}{'who':<9}{'simulated':>10}{'x real time':>13}")
    for folder in folders:
        site = load_site(folder)
        for local in ("pursuit", "expert"):
            course = course_on(site, 0)
            drive_course(site, course, local, 0)  # compiles
            drives = [drive_course(site, course_on(site, seed), local, seed) for seed in range(5)]
            simulated = sum(drive.records[-1, 0] for drive, _ in drives)
            print(f"{folder.name:<18}{local:<9}{simulated:>8.0f} s{simulated / sum(s for _, s in drives):>13.0f}")


def wall_site(folder: Path, seed: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Write a field with a wall that has a gap; return where the robot starts and where it has to go, x and y."""
    side_m, pixel_m = 30.0, 0.1
    rng = np.random.default_rng(seed)
    n = round(side_m / pixel_m)
    grid = Grid(n, n, Affine(pixel_m, 0, 431_000, 0, -pixel_m, 5_210_000), CRS.from_epsg(32632))
    y, x = (np.mgrid[0:n, 0:n] + 0.5) * pixel_m
    turn = rng.uniform(-0.4, 0.4)
    across = (
        (x - side_m / 2) * math.cos(turn) + (y - side_m / 2) * math.sin(turn) + 1.5 * np.sin(y / 4 + rng.uniform(0, 6))
    )
    along = (y - side_m / 2) * math.cos(turn) - (x - side_m / 2) * math.sin(turn)
    gap = rng.uniform(-10, 10)
    wall = (np.abs(across) < rng.uniform(0.6, 1.5)) & (np.abs(along - gap) > rng.uniform(1.5, 2.5))
    classes = np.where(wall, 1, 0).astype(np.uint8)
    rgb = np.where(wall[..., None], (150, 140, 130), (90, 130, 60)) + rng.normal(0, 8, (n, n, 3))
    folder.mkdir(parents=True)
    seal = record("wall", 1, {"seed": seed}, {})
    whole = Window(0, 0, n, n)
    with publishing_cog(
        folder / "ortho.tif", grid, Layout(("red", "green", "blue"), "uint8", rgb=True), seal
    ) as writer:
        writer.write(whole, np.moveaxis(np.clip(rgb, 0, 255).astype(np.uint8), -1, 0), np.ones((n, n), bool))
    with publishing_cog(folder / "dsm.tif", grid, Layout(("height",), "float32", nodata=-9999.0), seal) as writer:
        writer.write(whole, np.full((n, n), 200, np.float32))
    with publishing_classes(folder / "truth.tif", grid, ["field", "wall"], seal, tags={}, creation={}) as writer:
        writer.write(whole, classes)
    (folder / "world.json").write_text(
        '{"format": "hrt-world", "version": 1, "classes": {"0": {"name": "field", "drivability": 0.8},'
        ' "1": {"name": "wall", "drivability": 0.0, "obstacle": true}}}'
    )
    (x0, y0), (x1, y1) = (grid.xy(rng.uniform(8, 22) / pixel_m, c / pixel_m) for c in (5.0, 25.0))
    return (float(x0), float(y0)), (float(x1), float(y1))


def behind_wall(seed: int) -> tuple[int, bool, float]:
    """Let a robot that knows nothing go to the other side; return its legs, whether it came, and how far off it is."""
    with tempfile.TemporaryDirectory() as name:
        site = Path(name) / "site"
        start, goal = wall_site(site, seed)
        logs: list[Path] = []
        scores: Path | None = None
        away = math.inf
        for leg in range(1, MOST_LEGS + 1):
            at = Path(name) / str(leg)
            scoremap, plan, log = at.with_suffix(".tif"), at.with_suffix(".json"), at.with_suffix(".jsonl")
            make_scoremap(site / "truth.tif", scoremap, scores_path=scores, no_go_below=0.2, no_go_share=0.03)
            request = PlanRequest(
                starts=() if logs else (parse_start(f"xy:{start[0]},{start[1]}"),),
                ends=(parse_start(f"xy:{goal[0]},{goal[1]}", "--end"),),
                budget=Spending(500.0, "m"),
                effort=0.2,
                seed=seed,
            )
            plan_file(scoremap, plan, request, visited=tuple(logs))
            drive_file(plan, site, log, DriveRequest(seed=100 * seed + leg), after=logs[-1] if logs else None)
            logs.append(log)
            found = read_drive_log(log)
            away = float(np.hypot(*(found.place[-1] - np.array(goal))))
            if found.end != "stuck":
                break
            scores = at.with_name(f"{leg}-scores.json")
            learn_scores(logs, site / "truth.tif", scores, FeedbackSettings())
        return len(logs), away < 1.5, away


def walls(cases: int, workers: int) -> None:
    with ProcessPoolExecutor(workers) as pool:
        found = list(pool.map(behind_wall, range(cases)))
    came = sum(there for _, there, _ in found)
    stopped = [legs for legs, _, _ in found if legs > 1]
    print(f"{came} of {cases} robots came to the other side ({came / cases:.0%})")
    print(f"{len(stopped)} were stopped by the wall, {np.mean([n - 1 for n in stopped]):.1f} times each on average")
    for seed, (legs, there, away) in enumerate(found):
        if not there:
            print(f"  case {seed}: {legs} legs, ended {away:.1f} m away")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("section", choices=["speed", "courses", "walls"])
    parser.add_argument("sites", nargs="*", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.section == "walls":
        walls(given.cases, given.workers)
    elif given.sites:
        courses(given.sites, given.seeds) if given.section == "courses" else speed(given.sites)
    else:
        with sample_sites() as folders:
            courses(folders, given.seeds) if given.section == "courses" else speed(folders)


if __name__ == "__main__":
    main()
