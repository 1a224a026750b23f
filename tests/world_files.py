"""Small worlds to drive in, in memory and as files, and plans and logs for them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from raster_files import UTM33, write_raster
from rasterio.crs import CRS

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.plan import Budget, PlanDocument
from hrt_cli.artifacts.plan import Grid as PlanGrid
from hrt_cli.artifacts.provenance import record
from hrt_cli.planning.document import waypoints_of
from hrt_cli.raster.grid import Grid
from hrt_cli.world.site import UNKNOWN, Site
from hrt_cli.world.terrain import clearance

SCALE = 0.9996
"""Metres of UTM 33 at 15 degrees east for a metre of ground."""
ORIGIN = (500_000.0, 5_000_000.0)
GRASS = {"name": "grass", "drivability": 1.0}
WALL = {"name": "wall", "drivability": 0.0, "obstacle": True}


def place_of(pixel_m: float) -> Affine:
    """The transform of a raster of square ground pixels that begins at `ORIGIN`."""
    side = pixel_m * SCALE
    return Affine(side, 0, ORIGIN[0], 0, -side, ORIGIN[1])


def map_xy(east_m: float, south_m: float) -> tuple[float, float]:
    """Map coordinates of ground metres from the upper left corner."""
    return ORIGIN[0] + east_m * SCALE, ORIGIN[1] - south_m * SCALE


def chequers(rows: int, cols: int) -> NDArray[np.uint8]:
    """A picture [3, rows, cols] of squares of 10 pixels in two greys: one of one colour is refused."""
    row, col = np.mgrid[:rows, :cols] // 10
    return np.where((row + col) % 2, 120, 130).astype(np.uint8)[None].repeat(3, axis=0)


def ground_site(
    obstacle: NDArray[np.bool_],
    *,
    pixel_m: float = 0.1,
    factor: NDArray[Any] | float = 1.0,
    seen: NDArray[np.bool_] | None = None,
    bottom_m: NDArray[Any] | float = 0.0,
    under_water: bool = False,
) -> Site:
    """A site in memory: level ground with obstacles that stand a metre high, or a sea bottom."""
    shape = obstacle.shape
    bottom = np.broadcast_to(np.asarray(bottom_m, np.float32), shape).astype(np.float32)
    return Site(
        grid=Grid(*shape, place_of(pixel_m), CRS.from_string(UTM33)),
        pixel_m=pixel_m,
        rgb=np.full((*shape, 3), 120, np.uint8),
        surface_m=bottom + obstacle.astype(np.float32),
        ground_m=bottom,
        seen=np.ones(shape, np.bool_) if seen is None else seen,
        classes=np.full(shape, UNKNOWN, np.uint8),
        speed_factor=np.broadcast_to(np.asarray(factor, np.float32), shape).astype(np.float32),
        obstacle=obstacle,
        clearance_m=clearance(obstacle, pixel_m),
        names={},
        target=None,
        under_water=under_water,
    )


def put_world(
    folder: Path,
    surface: NDArray[Any],
    *,
    classes: NDArray[Any] | None = None,
    table: dict[str, Any] | None = None,
    rgb: NDArray[np.uint8] | None = None,
    pixel_m: float = 0.1,
    crs: str = UTM33,
    transform: Affine | None = None,
    **more: Any,
) -> Path:
    """Write a world of one grid; `more` stands in world.json. Heights that are NaN are none."""
    folder.mkdir(exist_ok=True, parents=True)
    transform = transform or place_of(pixel_m)
    picture = chequers(*surface.shape) if rgb is None else rgb
    write_raster(folder / "ortho.tif", picture, crs=crs, transform=transform)
    write_raster(folder / "dsm.tif", surface.astype(np.float32), crs=crs, transform=transform, nodata=np.nan)
    if classes is not None:
        put_truth(folder, classes, table or {"0": GRASS, "1": WALL}, crs=crs, transform=transform, **more)
    return folder


def put_truth(
    folder: Path, classes: NDArray[Any], table: dict[str, Any], *, crs: str = UTM33, transform: Affine, **more: Any
) -> None:
    write_raster(folder / "truth.tif", classes.astype(np.uint8), crs=crs, transform=transform, nodata=255)
    put_world_json(folder, table, **more)


def put_world_json(folder: Path, table: dict[str, Any], **more: Any) -> None:
    (folder / "world.json").write_text(json.dumps({"format": "hrt-world", "classes": table, **more}))


def put_plan(
    path: Path,
    xy: Iterable[tuple[float, float]],
    *,
    crs: str | None = UTM33,
    speed_m_s: float = 1.0,
    budget: tuple[float, str] = (100, "steps"),
    cell_m: float = 1.0,
) -> Path:
    """Write the plan of a robot that goes through any places; its cells are a row that says nothing."""
    xy = [(float(x), float(y)) for x, y in xy]
    cells = [(0, k) for k in range(len(xy))]
    value, unit = budget
    limit = value * 60 * speed_m_s / cell_m if unit == "min" else value
    plan = PlanDocument(
        method="test", seed=0, objective="total", gamma=0.99, connectivity=4, return_home=False,
        budget=Budget(value=value, unit=unit, cells=limit), start=(0, 0), steps=len(xy) - 1, score=0, upper_bound=0,
        discounted_score=0, gap=0, length_m=0, speed_m_s=speed_m_s, time_s=0,
        grid=PlanGrid(rows=1, cols=len(xy), transform=(1, 0, 0, 0, -1, 0), crs=crs, cell_size_m=cell_m,
                      georeference="none" if crs is None else "real"),
        waypoints=waypoints_of(cells, xy, None), cells=cells, xy=xy, lonlat=None,
    )  # fmt: skip
    publish_json(path, plan.model_dump(mode="json", exclude={"provenance"}), record("test", 1, {}, {}))
    return path


def put_drive_log(path: Path, records: Iterable[dict[str, Any]], crs: str | None = UTM33, **header: Any) -> Path:
    first = {"format": "hrt-drive-log", "version": 1, "crs": crs, **header}
    path.write_text("".join(json.dumps(each) + "\n" for each in (first, *records)))
    return path
