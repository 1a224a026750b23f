"""What the whole of `hrt segment` costs, beside decoding alone and beside scikit-image and scikit-learn."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from process_cost import Cost, process_cost
from rasterio.windows import Window
from tables import Effort, Table, cpu_seconds
from texture_plain import amplitudes, plain_classes

from hrt_cli.raster.windows import blocks
from hrt_cli.world.synth import SiteSpec, make_site

PIXEL_M = 0.05
CLASSES = 5
WORKERS = (1, 2)
START_UP_PX = 512
DECODE_BLOCK_PX = 1024

U8 = NDArray[np.uint8]


def write_raster(path: Path, side: int, tile: U8) -> float:
    """Write `tile` [3, rows, cols] over and over, RGB, deflate; return bytes in memory per byte on disk.

    Blocks are compressed one by one, so the repetition makes nothing smaller.
    """
    profile = {
        "driver": "GTiff", "width": side, "height": side, "count": 3, "dtype": "uint8", "crs": "EPSG:32632",
        "transform": Affine(PIXEL_M, 0, 431000, 0, -PIXEL_M, 5210000), "tiled": True, "blockxsize": 512,
        "blockysize": 512, "compress": "deflate", "interleave": "pixel", "photometric": "RGB",
    }  # fmt: skip
    tile_px = tile.shape[1]
    with rasterio.open(path, "w", **profile) as raster:
        for one in blocks((side, side), tile_px):
            raster.write(tile[:, : one.height, : one.width], window=Window(one.col, one.row, one.width, one.height))
    return 3 * side * side / path.stat().st_size


def segment_cost(ortho: Path, out: Path, workers: int) -> Cost:
    """Run `hrt segment` as a process of its own."""
    hrt = [sys.executable, "-m", "hrt_cli.main"]
    options = ["-o", str(out), "-K", str(CLASSES), "--workers", str(workers), "--force", "-q"]
    return process_cost([*hrt, "segment", str(ortho), *options])


def decode(path: Path) -> None:
    with rasterio.open(path) as raster:
        for one in blocks(raster.shape, DECODE_BLOCK_PX):
            raster.read([1, 2, 3], window=Window(one.col, one.row, one.width, one.height))


def plain_cost(tile: U8, side: int) -> float:
    """CPU seconds of scikit-image and scikit-learn on a crop."""
    grey = (tile[:, :side, :side].mean(axis=0) / 255).astype(np.float32)
    return cpu_seconds(lambda: plain_classes(amplitudes(grey), CLASSES))[0]


def _row(what: str, side: int, workers: int | None, cost: Cost, over_start_s: float | None) -> dict[str, object]:
    pixels = side * side / 1e6
    return {
        "what": what,
        "side px": side,
        "workers": workers,
        "wall s": cost.wall_s,
        "cpu s": cost.cpu_s,
        "Mpx/cpu-s": pixels / cost.cpu_s,
        "less start-up": pixels / over_start_s if over_start_s else None,
        "peak MB": cost.peak_mb,
    }


def speed_command(effort: Effort) -> list[Table]:
    """`hrt segment` on rasters of several sizes, decoding alone, and the plain program scaled from a crop."""
    metres = effort.tile_px * PIXEL_M
    tile = np.ascontiguousarray(np.moveaxis(make_site(SiteSpec("meadow", (metres, metres), PIXEL_M, 1)).rgb, -1, 0))
    rows = []
    alone: dict[int, Cost] = {}
    with tempfile.TemporaryDirectory() as folder:
        ortho, out = Path(folder) / "ortho.tif", Path(folder) / "classes.tif"
        write_raster(ortho, START_UP_PX, tile)
        segment_cost(ortho, out, 1)  # compiles the kernels, where that was not done before
        start = segment_cost(ortho, out, 1)
        rows.append(_row("hrt segment, start-up", START_UP_PX, 1, start, None))
        for side in effort.raster_px:
            ratio = write_raster(ortho, side, tile)
            for workers in WORKERS:
                cost = segment_cost(ortho, out, workers)
                rows.append(_row("hrt segment", side, workers, cost, max(cost.cpu_s - start.cpu_s, 1e-3)))
                if workers == 1:
                    alone[side] = cost
            rows.append(_row("decoding alone", side, None, Cost(cpu_seconds(lambda: decode(ortho))[0]), None))
    plain = _row("scikit-image + scikit-learn", effort.crop_px, None, Cost(plain_cost(tile, effort.crop_px)), None)
    speed = side * side / 1e6 / alone[side].cpu_s
    notes = [
        f"RGB, deflate, 512 px blocks, a synthetic meadow of {effort.tile_px} px repeated: "
        f"{ratio:.2f} bytes in memory per byte on disk.",
        f"At {side} px, start-up included, hrt segment is {speed / plain['Mpx/cpu-s']:,.0f} times as fast as "
        "scikit-image + scikit-learn.",
    ]
    if len(alone) > 1:
        notes.append(_growth(min(alone), max(alone), alone))
    return [Table("The whole command", [*rows, plain], notes)]


def _growth(small: int, large: int, alone: dict[int, Cost]) -> str:
    """Say what more pixels cost one worker."""
    speed = (large**2 - small**2) / 1e6 / (alone[large].cpu_s - alone[small].cpu_s)
    growth = alone[large].peak_mb / alone[small].peak_mb - 1
    return (
        f"From {small} to {large} px, one worker: {speed:.3g} Mpx per CPU second for what is added, "
        f"peak memory {growth:+.1%}."
    )
