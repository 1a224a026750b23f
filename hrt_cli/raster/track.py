"""A drive log, a plan, or other points, on the pixels of a raster."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import InputError
from hrt_cli.raster.grid import WGS84, Grid, transform_points

Floats = NDArray[np.float64]


def track_on(path: Path, log: DriveLog, grid: Grid, what: str) -> tuple[Floats, Floats]:
    """Return fractional rows and columns [n] of the places of a log (see `points_on`); its own frame is refused."""
    if log.own_frame is not None:
        raise no_place_on_a_map(path, log.own_frame)
    return points_on(path, log.place, WGS84.to_string() if log.geographic else log.crs, grid, what)


def plan_grid(path: Path, plan: PlanDocument) -> Grid:
    """Return the grid that a plan, of which `path` is the file, was made on.

    Raises
    ------
    InputError
        It names a CRS that is not known.
    """
    try:
        crs = None if plan.grid.crs is None else CRS.from_user_input(plan.grid.crs)
    except CRSError as error:
        raise InputError(path, f"names a coordinate reference system that is not known: {error}") from error
    return Grid(plan.grid.rows, plan.grid.cols, Affine(*plan.grid.transform), crs)


def no_place_on_a_map(path: Path, own_frame: str) -> InputError:
    """Return the refusal of a log whose places are in the robot's own frame."""
    problem = f"its places are in the robot's own frame {own_frame}, which is not on the map"
    return InputError(path, problem, "record a GPS (NavSatFix) as well")


def points_on(path: Path, points: Floats, crs: str | None, grid: Grid, what: str) -> tuple[Floats, Floats]:
    """Return fractional rows and columns [n] of points on a raster.

    Parameters
    ----------
    path : Path
        The file that they come from, for the message.
    points : float64 [n, 2]
        x and y (longitude and latitude) in `crs`; where that is None, in the raster's own.
    what : str
        What the raster is, for the message: `scoremap`, `class raster`.

    Raises
    ------
    InputError
        The raster has no CRS and the points need one, or they have no place in it.
    """
    x, y = points[:, 0], points[:, 1]
    if crs is not None:
        if grid.crs is None:
            raise InputError(path, f"has geographic places, and the {what} no georeference")
        try:
            x, y = transform_points(CRS.from_user_input(crs), grid.crs, x, y)
        except (CRSError, ValueError) as error:
            raise InputError(path, f"cannot be laid on the {what}: {error}") from error
    inverse = ~grid.transform
    cols, rows = inverse.a * x + inverse.b * y + inverse.c, inverse.d * x + inverse.e * y + inverse.f
    if not (np.isfinite(rows).all() and np.isfinite(cols).all()):
        raise InputError(path, f"has places that are nowhere in the {what}'s coordinate reference system")
    return rows, cols
