"""Benchmark of the terrain camera: what a frame costs, beside a ray-march of every pixel in NumPy.

    python benchmarks/camera.py [--quick] [--json FILE] [SITE ...]

A SITE is a folder with ortho.tif and dsm.tif; without one, sites of `hrt synth` are made in a temporary folder.
docs/benchmarks.md says how to read the figures.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tables import Table, cpu_seconds, machine, measure

from hrt_cli.world.camera import Camera, Frame, Lens, Weather
from hrt_cli.world.site import Site, load_site
from hrt_cli.world.stage import synthesize
from hrt_cli.world.synth import SiteSpec

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Size:
    """How much is measured: poses of each kind, poses of the plain march, side of a synthetic site in metres."""

    poses: int = 200
    plain_poses: int = 3
    site_m: float = 60.0


PACKAGES = ("numpy", "numba", "opencv-python-headless")
NORMAL, QUICK = Size(), Size(20, 1, 30.0)
SCENES = ("meadow", "wildfire", "reef")
KINDS = {"rover": (0.8, -10.0), "from 5 m": (5.0, -30.0), "down": (1.5, -60.0)}
"""Height above the ground in metres and pitch in degrees."""

Pose = tuple[float, float, float, float, float, float]


def draw_poses(camera: Camera, count: int, height_m: float, pitch_deg: float) -> list[Pose]:
    """Poses over what was surveyed and is clear of obstacles; headings drawn evenly, roll of 3 degrees (sd)."""
    site, rng = camera.site, np.random.default_rng(0)
    rows, cols = np.nonzero(site.seen & (site.clearance_m > 0.5))
    poses = []
    for at in rng.integers(0, len(rows), count):
        east, south = (float(cols[at]) + 0.5) * site.pixel_m, (float(rows[at]) + 0.5) * site.pixel_m
        height = camera.ground_m(east, south) + height_m
        roll = float(rng.normal(0.0, math.radians(3.0)))
        poses.append((east, south, height, float(rng.uniform(0.0, 2 * math.pi)), math.radians(pitch_deg), roll))
    return poses


def bilinear(values: NDArray[np.generic], x: F64, y: F64) -> F64:
    """Interpolate an array [rows, cols] or [rows, cols, bands] at places in pixels, clamped to it."""
    rows, cols = values.shape[:2]
    x, y = np.clip(x, 0, cols - 1.001), np.clip(y, 0, rows - 1.001)
    col, row = x.astype(np.intp), y.astype(np.intp)
    fx, fy = x - col, y - row
    if values.ndim == 3:
        fx, fy = fx[..., None], fy[..., None]
    top = values[row, col] * (1 - fx) + values[row, col + 1] * fx
    low = values[row + 1, col] * (1 - fx) + values[row + 1, col + 1] * fx
    return np.asarray(top * (1 - fy) + low * fy)


def pixel_rays(lens: Lens, heading: float, pitch: float, roll: float) -> F64:
    """Unit rays (east, south, up) of all pixels, [height, width, 3]."""
    y, x = np.mgrid[: lens.height, : lens.width] + 0.5
    right, down = (x - lens.width / 2) / lens.focal_px, (y - lens.height / 2) / lens.focal_px
    right, down = right * math.cos(roll) - down * math.sin(roll), right * math.sin(roll) + down * math.cos(roll)
    ahead, up = math.cos(pitch) + down * math.sin(pitch), math.sin(pitch) - down * math.cos(pitch)
    east = ahead * math.sin(heading) + right * math.cos(heading)
    south = right * math.sin(heading) - ahead * math.cos(heading)
    rays = np.stack([east, south, up], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def plain_view(site: Site, lens: Lens, weather: Weather, reach_m: float, pose: Pose) -> tuple[NDArray[np.uint8], F64]:
    """The same picture without any table: all rays step outwards together until they are under the surface."""
    east, south, height, *angles = pose
    rays = pixel_rays(lens, *angles)
    flat = np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-6)
    before = np.zeros(flat.shape)
    found = np.full(flat.shape, np.inf)
    while True:
        going = np.isinf(found) & (before * flat < reach_m)
        if not going.any():
            break
        ray, last = rays[going], before[going]
        now = last + np.maximum(site.pixel_m, 1.5 / lens.focal_px * last)
        x, y = (east + now * ray[:, 0]) / site.pixel_m - 0.5, (south + now * ray[:, 1]) / site.pixel_m - 0.5
        under = height + now * ray[:, 2] <= bilinear(site.surface_m, x, y)
        found[going] = np.where(under, now, np.inf)
        before[going] = now
    seen = np.isfinite(found)
    distance = np.where(seen, found, 0.0)
    x = (east + distance * rays[..., 0]) / site.pixel_m - 0.5
    y = (south + distance * rays[..., 1]) / site.pixel_m - 0.5
    through = np.exp(-distance[..., None] * np.array(weather.haze_per_m))
    colour = bilinear(site.rgb, x, y) * through + np.array(weather.veil) * (1 - through)
    colour[~seen] = weather.sky_horizon
    return np.clip(np.rint(colour), 0, 255).astype(np.uint8), found


def agreement(frame: Frame, found: F64) -> float:
    """Share of the pixels on which both put the surface, within 5 %, of those that the plain march puts in reach."""
    near = np.isfinite(found) & (found < 40.0)
    return float(np.mean(np.abs(frame.range_m[near] / found[near] - 1.0) < 0.05))


def measure_site(path: Path, size: Size) -> list[Table]:
    site = load_site(path)
    camera = Camera(site)
    rows = []
    for kind, (height_m, pitch_deg) in KINDS.items():
        poses = draw_poses(camera, size.poses, height_m, pitch_deg)
        camera.view(*poses[0])
        spent = np.array([cpu_seconds(lambda pose=pose: camera.view(*pose), 5)[0] for pose in poses]) * 1e3
        plain, agree = [], []
        for pose in poses[: size.plain_poses]:
            seconds, (_, found) = cpu_seconds(
                lambda pose=pose: plain_view(site, camera.lens, camera.weather, camera.reach_m, pose)
            )
            plain.append(seconds * 1e3)
            agree.append(agreement(camera.view(*pose), found))
        ratio = float(np.median(plain) / np.median(spent[: size.plain_poses]))
        rows.append({
            "view": kind, "ms a frame": float(np.median(spent)), "95 of 100 below": float(np.percentile(spent, 95)),
            "NumPy ms": float(np.median(plain)), "hrt is faster by": ratio, "same distance": float(np.mean(agree)),
        })  # fmt: skip
    lens = camera.lens
    note = f"{lens.width} x {lens.height} pixels, {size.poses} poses, of each the least of five; CPU time"
    return [Table(f"{path.name}: {site.grid.cols} x {site.grid.rows} map pixels of {site.pixel_m:.3f} m", rows, [note])]


def synthetic(folder: Path, size_m: float) -> list[Path]:
    """Make one site of each scene."""
    for scene in SCENES:
        synthesize(folder / scene, SiteSpec(scene, (size_m, size_m)))
    return [folder / scene for scene in SCENES]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", nargs="*", type=Path, metavar="SITE", help="a folder; synthetic sites by default")
    parser.add_argument("--quick", action="store_const", dest="size", const=QUICK, help="few poses, small sites")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    given = parser.parse_args(arguments)
    size = given.size or NORMAL
    with tempfile.TemporaryDirectory() as folder:
        sites = {path.name: partial(measure_site, path) for path in given.sites or synthetic(Path(folder), size.site_m)}
        sections = measure(sites, list(sites), size)
    if given.json:
        given.json.write_text(
            json.dumps({"machine": machine(PACKAGES), "sections": sections}, indent=2) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
