"""What `hrt segment` costs: CPU seconds, wall seconds and peak memory per raster size and number of workers.

    python benchmarks/segment_cost.py [--side 6144 12288] [--workers 1 2]

The raster is a synthetic meadow tiled to the size asked for, RGB, deflate, 512-pixel blocks. Each run is a process of
its own, after one run on a small raster that compiles the kernels.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.windows import Window

from hrt_cli.world.synth import SiteSpec, make_site

TILE_PX = 1024


def write_raster(path: Path, side: int, tile: np.ndarray) -> None:
    profile = {
        "driver": "GTiff", "width": side, "height": side, "count": 3, "dtype": "uint8", "crs": "EPSG:32632",
        "transform": Affine(0.05, 0, 431000, 0, -0.05, 5210000), "tiled": True, "blockxsize": 512, "blockysize": 512,
        "compress": "deflate", "interleave": "pixel", "photometric": "RGB",
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as raster:
        for row in range(0, side, TILE_PX):
            for col in range(0, side, TILE_PX):
                height, width = min(TILE_PX, side - row), min(TILE_PX, side - col)
                raster.write(tile[:, :height, :width], window=Window(col, row, width, height))


def run(ortho: Path, out: Path, workers: int) -> tuple[float, float, float]:
    """Return wall seconds, CPU seconds and peak memory in MB of one segmentation."""
    command = [sys.executable, "-m", "hrt_cli.main", "segment", str(ortho), "-o", str(out), "-K", "5", "--force", "-q"]
    began = time.monotonic()
    process = subprocess.Popen([*command, "--workers", str(workers)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"segment failed with status {status}")
    return time.monotonic() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, nargs="+", default=[2048, 6144])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    given = parser.parse_args()
    site = make_site(SiteSpec("meadow", (TILE_PX * 0.05, TILE_PX * 0.05), 0.05, 1))
    tile = np.moveaxis(site.rgb, -1, 0)
    with tempfile.TemporaryDirectory() as folder:
        ortho, out = Path(folder) / "ortho.tif", Path(folder) / "classes.tif"
        write_raster(ortho, TILE_PX, tile)
        run(ortho, out, 1)
        print(f"{'side px':>8} {'workers':>7} {'wall s':>7} {'cpu s':>7} {'Mpx/cpu-s':>9} {'peak MB':>8}")
        for side in given.side:
            write_raster(ortho, side, tile)
            for workers in given.workers:
                wall, cpu, peak = run(ortho, out, workers)
                print(f"{side:8} {workers:7} {wall:7.1f} {cpu:7.1f} {side * side / 1e6 / cpu:9.1f} {peak:8.0f}")


if __name__ == "__main__":
    main()
