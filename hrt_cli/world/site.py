"""A site to drive in: a survey, with the truth of it where that is known, on one grid of square ground pixels.

Inside a site places are `east_m`, `south_m`: metres along the columns and the rows of its grid from the outer corner
of its first pixel. Headings are angles in radians from the direction of falling rows ("up" in the picture), growing
to the right: in a raster with north up they are compass headings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.artifacts.world import TrueClass, WorldDocument, read_world
from hrt_cli.errors import InputError
from hrt_cli.raster.align import field_on, part_of, warp_onto, window_on
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import VOID, in_metres, open_heights
from hrt_cli.raster.image import open_orthomosaic
from hrt_cli.world.terrain import bare_ground, clearance, fill, rise, slope

UNKNOWN = 255
"""Class id of a pixel whose class is not known."""

FINEST_M = 0.05
MOST_PX = 36_000_000
"""Of a site; what is larger is simulated on larger pixels."""

TALL_M = 0.30
"""What stands higher than this above the ground is an obstacle to a ground vehicle."""
STEP_M, STEP_REACH_M = 0.30, 0.30
"""Neither does it climb a step of this height within this distance."""
SLIPS_FROM, STEEPEST = math.tan(math.radians(25.0)), math.tan(math.radians(35.0))
"""Rise over run up to which a ground vehicle holds its speed, and at which it no longer gets on."""

_ORTHOS = ("ortho.tif", "ortho.vrt")
_TRUTHS = ("truth.tif", "classes.tif")


@dataclass(frozen=True)
class Site:
    """A site to drive in; every array has the grid's shape.

    Attributes
    ----------
    grid : Grid
        Square ground pixels of `pixel_m`, never mirrored.
    pixel_m : float
    rgb : uint8 [rows, cols, 3]
        The orthomosaic, its gaps filled smoothly.
    surface_m : float32 [rows, cols]
        Heights of the surface in metres, gaps filled with ground.
    ground_m : float32 [rows, cols]
        Heights of the bare ground, at most `surface_m`.
    seen : bool [rows, cols]
        Where the survey has colours and heights.
    classes : uint8 [rows, cols]
        True class ids, `UNKNOWN` where none is known.
    speed_factor : float32 [rows, cols]
        Achieved over commanded speed of a ground vehicle in [0, 1]: drivability of the class, times slope.
    obstacle : bool [rows, cols]
        What a ground vehicle collides with: obstacle classes, and what stands tall on the ground.
    clearance_m : float32 [rows, cols]
        Distance to the nearest obstacle.
    names : dict of int to str
        Names of the classes.
    target : int or None
        Id of the class that the survey looks for.
    under_water : bool
        Whether the site is a sea bottom; heights are then below a surface at 0.
    """

    grid: Grid
    pixel_m: float
    rgb: NDArray[np.uint8]
    surface_m: NDArray[np.float32]
    ground_m: NDArray[np.float32]
    seen: NDArray[np.bool_]
    classes: NDArray[np.uint8]
    speed_factor: NDArray[np.float32]
    obstacle: NDArray[np.bool_]
    clearance_m: NDArray[np.float32]
    names: dict[int, str]
    target: int | None
    under_water: bool

    def pixel(self, east_m: float, south_m: float) -> tuple[int, int]:
        """Return the row and column of a place, which may lie outside."""
        return math.floor(south_m / self.pixel_m), math.floor(east_m / self.pixel_m)

    def is_seen(self, east_m: float, south_m: float) -> bool:
        """Whether a place lies in the surveyed area."""
        row, col = self.pixel(east_m, south_m)
        return 0 <= row < self.grid.rows and 0 <= col < self.grid.cols and bool(self.seen[row, col])

    def map_xy(self, places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the map coordinates of places [n, 2]."""
        return self.grid.xy(places[..., 1] / self.pixel_m, places[..., 0] / self.pixel_m)

    @property
    def up_bearing_rad(self) -> float:
        """True bearing of the picture's up direction at its centre: what a heading of 0 is on a compass."""
        row, col = self.grid.rows / 2, self.grid.cols / 2
        lon, lat = self.grid.lonlat(*self.grid.xy([row + 0.5, row - 0.5], [col, col]))
        east = math.cos(math.radians(float(lat.mean()))) * float(lon[1] - lon[0])
        return math.atan2(east, float(lat[1] - lat[0]))


def site_files(folder: Path) -> dict[str, Path]:
    """Return the files of a site by role: `ortho` and `dsm`, and where there are any `truth` and `world`.

    Raises
    ------
    InputError
        One that is needed is absent, or a class raster has no table beside it.
    """
    if not folder.is_dir():
        raise InputError(folder, "no such folder" if not folder.exists() else "is a file; a world is a folder")
    files = {}
    for role, names in (("ortho", _ORTHOS), ("dsm", ("dsm.tif",)), ("truth", _TRUTHS), ("world", ("world.json",))):
        found = [folder / name for name in names if (folder / name).is_file()]
        if found:
            files[role] = found[0]
    for role in ("ortho", "dsm"):
        if role not in files:
            raise InputError(folder, f"holds no {role}.tif", "a world needs ortho.tif and dsm.tif")
    if ("truth" in files) != ("world" in files):
        has, lacks = ("truth", "world.json") if "truth" in files else ("world", "truth.tif")
        raise InputError(
            folder, f"holds {files[has].name} but no {lacks}", "the classes and their true drivability go together"
        )
    return files


def load_site(folder: Path, pixel_m: float | None = None) -> Site:
    """Load a site: one of `hrt synth`, or a folder with a real `ortho.tif` and `dsm.tif`.

    A real one may hold a class raster (`truth.tif` or `classes.tif`) and a `world.json` that gives each class its
    true drivability. Without them all ground is drivable that is neither steep nor under something tall.

    Parameters
    ----------
    folder : Path
    pixel_m : float, optional
        Side of a pixel in metres. Default: the orthomosaic's, but at least `FINEST_M`, and as large as it takes to
        stay within `MOST_PX`.

    Raises
    ------
    InputError
        A file is absent or cannot be used, the DSM lies elsewhere, or a class has no drivability.
    """
    files = site_files(folder)
    grid, pixel, rgb, coloured = _picture(files["ortho"], pixel_m)
    with open_heights(files["dsm"]) as dsm:
        heights = field_on(dsm, grid, "bilinear" if max(dsm.grid.pixel_m) > pixel else "average", void=VOID)
        surface = in_metres(dsm, heights).astype(np.float32)
    measured = np.isfinite(surface)
    if not measured.any():
        raise InputError(files["dsm"], "holds no height on the orthomosaic")
    seen = coloured & measured
    surface = fill(surface, measured)
    ground = bare_ground(surface, pixel)
    surface = np.where(measured, surface, ground)
    document, classes = _truth(files, grid)
    true = {} if document is None else document.by_id()
    obstacle = ((surface - ground > TALL_M) | (rise(surface, pixel, STEP_REACH_M) > STEP_M)) & measured
    obstacle |= _table(true, 0.0, lambda each: float(each.obstacle))[classes] > 0
    drivability = _table(true, 1.0, lambda each: each.drivability)[classes]
    factor = drivability * np.clip((STEEPEST - slope(ground, pixel)) / (STEEPEST - SLIPS_FROM), 0.0, 1.0)
    return Site(
        grid=grid,
        pixel_m=pixel,
        rgb=fill(rgb, coloured),
        surface_m=surface,
        ground_m=ground,
        seen=seen,
        classes=classes,
        speed_factor=factor.astype(np.float32),
        obstacle=obstacle,
        clearance_m=clearance(obstacle, pixel),
        names={number: each.name for number, each in true.items()},
        target=_target(document, files),
        under_water=document is not None and document.under_water,
    )


def _picture(path: Path, pixel_m: float | None) -> tuple[Grid, float, NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the site's grid, its pixel, colours, and where there are any."""
    with open_orthomosaic([path]) as image:
        source = image.raster.grid
        finest = max(source.pixel_m)
        area = source.pixel_m[0] * source.rows * source.pixel_m[1] * source.cols
        pixel = max(finest, pixel_m or max(FINEST_M, math.sqrt(area / MOST_PX)))
        grid = upright(source.coarse(pixel))
        window = window_on(path, source, grid)
        colours, valid = image.read(window)
    rgba = np.concatenate([np.moveaxis(colours, -1, 0), np.where(valid, 255, 0).astype(np.uint8)[None]])
    out = np.zeros((4, *grid.shape), np.uint8)
    warp_onto(path, rgba, part_of(source, window), out, grid, "average", src_alpha=4, dst_alpha=4)
    return grid, pixel, np.ascontiguousarray(np.moveaxis(out[:3], 0, -1)), out[3] > 127


def upright(grid: Grid) -> Grid:
    """Return the grid itself, or where its picture is mirrored (south up, or east left) the same with rows turned."""
    a, b, _, d, e, _ = grid.transform[:6]
    if a * e - b * d < 0:
        return grid
    return Grid(grid.rows, grid.cols, grid.transform @ Affine.translation(0, grid.rows) @ Affine.scale(1, -1), grid.crs)


def _truth(files: dict[str, Path], grid: Grid) -> tuple[WorldDocument | None, NDArray[np.uint8]]:
    if "world" not in files:
        return None, np.full(grid.shape, UNKNOWN, np.uint8)
    document = read_world(files["world"])
    with open_classes(files["truth"]) as truth:
        found = field_on(truth.raster, grid, "mode" if max(truth.grid.pixel_m) < 0.7 * grid.pixel_m[0] else "nearest")
    classes = np.where(np.isfinite(found), found, UNKNOWN).astype(np.uint8)
    known = document.by_id()
    for number in np.unique(classes):
        if number != UNKNOWN and int(number) not in known:
            raise InputError(files["world"], f"says nothing of class {number}, which {files['truth'].name} holds")
    return document, classes


def _table(true: dict[int, TrueClass], unknown: float, value: Callable[[TrueClass], float]) -> NDArray[np.float32]:
    table = np.full(256, unknown, np.float32)
    for number, each in true.items():
        table[number] = value(each)
    return table


def _target(document: WorldDocument | None, files: dict[str, Path]) -> int | None:
    if document is None or document.target_class is None:
        return None
    for number, each in document.by_id().items():
        if each.name == document.target_class:
            return number
    raise InputError(files["world"], f"looks for the class {document.target_class!r}, which it does not name")
