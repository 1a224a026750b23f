"""Class rasters and drive logs for the tests of `hrt feedback`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform

from hrt_cli.artifacts.provenance import record
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window

UTM33 = "EPSG:32633"
# At 15 degrees east and this northing a UTM metre is 1 / 0.9996 m of ground.
ORIGIN = (500_000.0, 5_000_000.0)
PIXEL = 0.1 * 0.9996
"""Pixels of a tenth of a metre of ground."""


def put_classes(
    path: Path, values: np.ndarray, *, names: int | None = None, crs: str = UTM33, place: Affine | None = None
) -> Path:
    """Publish a class raster as `hrt segment` does."""
    place = place or Affine(PIXEL, 0, ORIGIN[0], 0, -PIXEL, ORIGIN[1])
    count = int(values[values < 255].max()) + 1 if names is None else names
    grid = Grid(*values.shape, place, CRS.from_string(crs))
    labels = [f"class {k}" for k in range(count)]
    with publishing_classes(path, grid, labels, record("test", 1, {}, {}), tags={}, creation={}) as writer:
        writer.write(Window(0, 0, *values.shape), values.astype(np.uint8))
    return path


def halves(rows: int = 100, cols: int = 400, at: int = 200) -> np.ndarray:
    """Return class 0 to the left of a column and class 1 from it on: 10 m by 40 m, cut at 20 m."""
    return np.where(np.arange(cols) < at, 0, 1) * np.ones((rows, 1), int)


def xy(east_m: float, south_m: float) -> dict[str, float]:
    """Return map coordinates of ground metres from the raster's upper left corner."""
    return {"x": ORIGIN[0] + east_m * 0.9996, "y": ORIGIN[1] - south_m * 0.9996}


def put_log(path: Path, records: Iterable[dict[str, Any]], crs: str | None = UTM33, **header: Any) -> Path:
    first = {"format": "hrt-drive-log", "version": 1, "crs": crs, **header}
    path.write_text("".join(json.dumps(each) + "\n" for each in (first, *records)))
    return path


def eastward(
    seconds: float, *, east_m: float = 2.0, speed: float = 1.0, step_s: float = 1.0, t0: float = 0.0, **more: Any
) -> list[dict[str, Any]]:
    """Return a drive to the east along the middle of the raster."""
    times = np.arange(round(seconds / step_s) + 1) * step_s
    return [{"t": t0 + float(t), **xy(east_m + speed * float(t), 5.0), **more} for t in times]


def in_degrees(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return records placed by longitude and latitude."""
    out = []
    for each in records:
        (lon,), (lat,) = transform(UTM33, "EPSG:4326", [each["x"]], [each["y"]])
        out.append({key: value for key, value in each.items() if key not in "xy"} | {"lon": lon, "lat": lat})
    return out
