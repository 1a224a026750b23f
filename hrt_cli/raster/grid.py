"""Where pixels lie: on the map, on the Earth, and how many metres of ground one of them covers.

Metres always mean metres on the ground. They are taken from the CRS by the Jacobian of pixel -> longitude/latitude on
the WGS 84 ellipsoid, so degrees, feet, Mercator's stretch, rotation and non-square pixels need no special case.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio._err import CPLE_AppDefinedError, CPLE_BaseError
from rasterio.crs import CRS
from rasterio.errors import CRSError
from rasterio.warp import transform as warp_points

from hrt_cli.errors import InputError

Floats = NDArray[np.float64]

WGS84 = CRS.from_epsg(4326)
_SEMI_MAJOR_M = 6378137.0
_ECCENTRICITY_SQUARED = 0.00669437999014

MAX_SCALE_VARIATION = 0.01
"""Largest change of the ground size of a pixel across a raster that one figure may stand for."""
_MAX_SHEAR = 0.02
_MAX_ASPECT = 4.0
_SAME_GRID_PX = 0.01
_NO_PLACE = "its coordinates have no place on the Earth in its coordinate reference system"
_PLACEHOLDER_M = 10_000.0
_UTM_FALSE_EASTING = 'PARAMETER["false_easting",500000'
# The lattice phase is rounded away from fractions that occur in practice (0, 1/2, 1/4, 1/3), so that floating-point
# noise in a crop's origin never moves it to the neighbouring pixel.
_ROUNDING = 0.3819660113


@dataclass(frozen=True)
class GroundSize:
    """Ground metres of one step along the rows axis and the columns axis, and how far they can be relied on.

    Attributes
    ----------
    row_m, col_m : float
        Metres on the ground at the raster's centre.
    shear : float
        |cos| of the angle between the two axes on the ground: 0 for a right angle.
    variation : float
        Largest relative difference of the step lengths between the corners and the centre.
    """

    row_m: float
    col_m: float
    shear: float
    variation: float


@dataclass(frozen=True)
class Grid:
    """A raster's geometry: size, affine transform from (col, row) to CRS coordinates, and CRS (None: unreferenced)."""

    rows: int
    cols: int
    transform: Affine
    crs: CRS | None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.cols

    @cached_property
    def ground(self) -> GroundSize:
        """The ground size of a pixel; (1, 1) where the raster is unreferenced: then lengths are pixels.

        Raises
        ------
        ValueError
            A corner has no place on the Earth in this CRS.
        """
        if self.crs is None:
            return GroundSize(1.0, 1.0, 0.0, 0.0)
        cols = np.array([0.5, 0.0, 1.0, 0.0, 1.0]) * self.cols
        rows = np.array([0.5, 0.0, 0.0, 1.0, 1.0]) * self.rows
        along_col = self._ground_vectors(rows, cols, (0.0, 1.0))
        along_row = self._ground_vectors(rows, cols, (1.0, 0.0))
        col_m = np.hypot(*along_col)
        row_m = np.hypot(*along_row)
        shear = abs(float(np.sum(along_col[:, 0] * along_row[:, 0]))) / float(col_m[0] * row_m[0])
        variation = max(np.abs(col_m / col_m[0] - 1).max(), np.abs(row_m / row_m[0] - 1).max())
        return GroundSize(float(row_m[0]), float(col_m[0]), shear, float(variation))

    @property
    def pixel_m(self) -> tuple[float, float]:
        """Ground metres per step along the rows axis and the columns axis."""
        return self.ground.row_m, self.ground.col_m

    @cached_property
    def anchor(self) -> tuple[int, int]:
        """The origin in pixels of a lattice fixed to the CRS, shared by a raster and its crops (see `ImageSource`)."""
        if self.crs is None:
            return 0, 0
        a, b, c, d, e, f = self.transform[:6]
        col, row = ~Affine(a, b, 0.0, d, e, 0.0) @ (c, f)
        return math.floor(row + _ROUNDING), math.floor(col + _ROUNDING)

    def xy(self, rows: ArrayLike, cols: ArrayLike) -> tuple[Floats, Floats]:
        """Map coordinates of pixel positions; the centre of pixel (r, c) is at (r + 0.5, c + 0.5)."""
        row, col = np.asarray(rows, np.float64), np.asarray(cols, np.float64)
        a, b, c, d, e, f = self.transform[:6]
        return a * col + b * row + c, d * col + e * row + f

    def rowcol(self, x: float, y: float) -> tuple[float, float]:
        """Return the fractional pixel position (row, col) of a map coordinate."""
        col, row = ~self.transform @ (x, y)
        return row, col

    def lonlat(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """WGS 84 longitude (-180 to 180) and latitude in degrees of map coordinates.

        Raises
        ------
        ValueError
            The raster is unreferenced, or a point has no place on the Earth in this CRS.
        """
        if self.crs is None:
            raise ValueError("has no coordinate reference system")
        lon, lat = transform_points(self.crs, WGS84, x, y)
        # PROJ hands degrees through unchecked: metres labelled as degrees would come out as latitude 5 000 000.
        if np.abs(lat).max(initial=0.0) > 90.0 or np.abs(lon).max(initial=0.0) > 360.0:
            raise ValueError(_NO_PLACE)
        return np.where(np.abs(lon) > 180.0, wrapped_deg(lon), lon), lat

    def xy_of_lonlat(self, lon: float, lat: float) -> tuple[float, float]:
        """Map coordinates of a WGS 84 position."""
        if self.crs is None:
            raise ValueError("has no coordinate reference system")
        x, y = transform_points(WGS84, self.crs, [lon], [lat])
        return float(x[0]), float(y[0])

    def ground_length_m(self, rows: ArrayLike, cols: ArrayLike) -> Floats:
        """Ground length of each leg of a path of pixel positions, in metres."""
        row, col = np.asarray(rows, np.float64), np.asarray(cols, np.float64)
        if self.crs is None:
            return np.asarray(np.hypot(np.diff(row), np.diff(col)))
        return lonlat_length_m(*self.lonlat(*self.xy(row, col)))

    def steps_towards(self, rows: ArrayLike, cols: ArrayLike, heading_deg: ArrayLike) -> tuple[Floats, Floats]:
        """Pixels (along rows, along columns) that one metre of ground takes from positions [n] in a heading.

        Headings are clockwise from true north; without a CRS north is up.

        Raises
        ------
        ValueError
            A position has no place on the Earth in this CRS.
        """
        row, col, heading = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(a, float)) for a in (rows, cols, heading_deg))
        )
        east, north = np.sin(np.radians(heading)), np.cos(np.radians(heading))
        if self.crs is None:
            return -north, east
        e_row, n_row = self._ground_vectors(row, col, (1.0, 0.0))
        e_col, n_col = self._ground_vectors(row, col, (0.0, 1.0))
        area = e_row * n_col - n_row * e_col
        return (east * n_col - north * e_col) / area, (north * e_row - east * n_row) / area

    def coarse(self, cell_m: float) -> Grid:
        """Return the grid of square ground cells of `cell_m` metres that starts at this raster's first corner.

        A last row or column of which less than half lies on the raster is left out.
        """
        row_m, col_m = self.pixel_m
        step_row, step_col = cell_m / row_m, cell_m / col_m
        rows = max(1, math.floor(self.rows / step_row + 0.5))
        cols = max(1, math.floor(self.cols / step_col + 0.5))
        return Grid(rows, cols, self.transform @ Affine.scale(step_col, step_row), self.crs)

    @property
    def placeholder_georeference(self) -> bool:
        """Whether the coordinates are made up: a UTM raster at the zone's false origin, where no UTM zone reaches.

        OpenDroneMap writes UTM zone 30 at (0, 0) when the photographs carried no GPS (opendm/pseudogeo.py).
        """
        if self.crs is None or not self.crs.is_projected:
            return False
        # A CRS made from a PROJ string does not say that it is UTM; its false easting does.
        is_utm = _UTM_FALSE_EASTING in self.crs.to_wkt()
        return is_utm and abs(self.transform.c) < _PLACEHOLDER_M and abs(self.transform.f) < _PLACEHOLDER_M

    def crs_text(self) -> str | None:
        """Return the CRS as an authority code if it has one, else as WKT; None if unreferenced."""
        if self.crs is None:
            return None
        code = self.crs.to_epsg(confidence_threshold=100)
        return f"EPSG:{code}" if code else str(self.crs.to_wkt())

    def _ground_vectors(self, rows: Floats, cols: Floats, step: tuple[float, float]) -> Floats:
        """East and north metres [2, n] of one pixel step at each position, by central differences over 8 pixels."""
        half = 4.0
        dr, dc = step[0] * half, step[1] * half
        lon0, lat0 = self.lonlat(*self.xy(rows - dr, cols - dc))
        lon1, lat1 = self.lonlat(*self.xy(rows + dr, cols + dc))
        east, north = metres_per_degree((lat0 + lat1) / 2)
        return np.stack([wrapped_deg(lon1 - lon0) * east, (lat1 - lat0) * north]) / (2 * half)


def require_measurable(path: str | PathLike[str], grid: Grid) -> None:
    """Refuse a georeferenced raster on which one ground size of a pixel would be a wrong answer.

    Raises
    ------
    InputError
        The transform is degenerate or sheared, the pixels are far from square, the CRS has no place on the Earth, or
        the ground size of a pixel changes by more than `MAX_SCALE_VARIATION` across the raster.
    """
    a, b, c, d, e, f = grid.transform[:6]
    if not all(map(math.isfinite, (a, b, c, d, e, f))) or a * e - b * d == 0:
        raise InputError(path, "its geotransform is degenerate: pixels have no area")
    try:
        ground = grid.ground
    except ValueError as error:
        raise InputError(path, str(error), "check the CRS, or use gdalwarp to reproject to UTM") from error
    if not (ground.row_m > 0 and ground.col_m > 0):
        raise InputError(path, "its pixels have no size on the ground")
    if ground.shear > _MAX_SHEAR:
        raise InputError(path, "its pixels are sheared, not rectangular", "use gdalwarp to straighten it")
    if max(ground.row_m / ground.col_m, ground.col_m / ground.row_m) > _MAX_ASPECT:
        raise InputError(path, f"its pixels are {ground.col_m:.3g} x {ground.row_m:.3g} m, too far from square")
    if ground.variation > MAX_SCALE_VARIATION:
        raise InputError(
            path,
            f"a pixel's size on the ground varies by {ground.variation:.1%} across it",
            "reproject it to UTM with gdalwarp",
        )


def require_same_grid(path: str | PathLike[str], grid: Grid, other_path: str | PathLike[str], other: Grid) -> None:
    """Refuse two rasters that do not lie pixel on pixel (to a hundredth of a pixel, in the same CRS).

    Raises
    ------
    InputError
        Their sizes, CRSs or transforms differ.
    """
    beside = f"does not lie on {other_path}"
    if grid.shape != other.shape:
        sizes = f"{grid.rows} x {grid.cols} pixels against {other.rows} x {other.cols}"
        raise InputError(path, f"{beside}: {sizes}")
    if (grid.crs is None) != (other.crs is None) or grid.crs != other.crs:
        raise InputError(path, f"{beside}: the coordinate reference systems differ")
    offset = _apart_px(grid, other)
    if not offset <= _SAME_GRID_PX:
        raise InputError(path, f"{beside}: the pixels are up to {offset:.2f} px apart")


def lattice_offset(grid: Grid, other: Grid) -> tuple[int, int] | None:
    """Return where the first pixel of `grid` lies on `other`, (row, col), where both are of one lattice of pixels.

    None where their CRSs differ, or their pixels do not lie on one another (to a hundredth of a pixel). Plain images
    are of one lattice only where they are of one size: what they show of each other's ground nobody knows.
    """
    if grid.crs is None or other.crs is None:
        return (0, 0) if grid.crs is other.crs and grid.shape == other.shape and _lie_alike(grid, other) else None
    if grid.crs != other.crs:
        return None
    down, right = (round(at) for at in other.rowcol(*map(float, grid.xy(0.0, 0.0))))
    moved = Grid(grid.rows, grid.cols, other.transform @ Affine.translation(right, down), other.crs)
    return (down, right) if _lie_alike(grid, moved) else None


def _lie_alike(grid: Grid, other: Grid) -> bool:
    return _apart_px(grid, other) <= _SAME_GRID_PX


def _apart_px(grid: Grid, other: Grid) -> float:
    """Return how far the corners of `grid` lie from where `other` has them, in its pixels."""
    rows = np.array([0.0, 0.0, grid.rows, grid.rows])
    cols = np.array([0.0, grid.cols, 0.0, grid.cols])
    x, y = grid.xy(rows, cols)
    placed = np.array([other.rowcol(float(px), float(py)) for px, py in zip(x, y, strict=True)])
    return float(np.abs(placed - np.stack([rows, cols], axis=1)).max())


def transform_points(source: CRS, target: CRS, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Transform points between CRSs, refusing those that have no image instead of returning infinity.

    Raises
    ------
    ValueError
        A point lies outside what the CRS can represent, or the CRS has no place on the Earth.
    """
    xs: Sequence[Any] = np.atleast_1d(np.asarray(x, np.float64)).tolist()
    ys: Sequence[Any] = np.atleast_1d(np.asarray(y, np.float64)).tolist()
    try:
        out = warp_points(source, target, xs, ys)
    except CPLE_AppDefinedError as error:
        raise ValueError(_NO_PLACE) from error
    except (CPLE_BaseError, CRSError, RuntimeError, ValueError) as error:
        raise ValueError("its coordinate reference system has no known place on the Earth") from error
    points = np.asarray(out[:2], np.float64)
    if not np.isfinite(points).all():
        raise ValueError(_NO_PLACE)
    return points[0], points[1]


def wrapped_deg(degrees: ArrayLike) -> Floats:
    """Return degrees in -180..180: a difference of longitudes as the short way round, at the meridian 180 too."""
    return np.asarray((np.asarray(degrees, np.float64) + 180.0) % 360.0 - 180.0)


def lonlat_length_m(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Floats:
    """Ground metres [n - 1] of each leg of a path of WGS 84 positions [n], for legs of up to a few kilometres."""
    lon, lat = np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64)
    east, north = metres_per_degree((lat[1:] + lat[:-1]) / 2)
    return np.asarray(np.hypot(wrapped_deg(np.diff(lon)) * east, np.diff(lat) * north))


def metres_per_degree(lat_deg: Floats) -> tuple[Floats, Floats]:
    """Ground metres per degree of longitude and of latitude on the WGS 84 ellipsoid at latitudes in degrees.

    The radii of curvature N (prime vertical) and M (meridian): Snyder, Map Projections (1987), eqs. 4-18 to 4-21.
    """
    sin2 = np.sin(np.radians(lat_deg)) ** 2
    w = np.sqrt(1 - _ECCENTRICITY_SQUARED * sin2)
    n = _SEMI_MAJOR_M / w
    m = _SEMI_MAJOR_M * (1 - _ECCENTRICITY_SQUARED) / w**3
    return np.radians(n * np.cos(np.radians(lat_deg))), np.radians(m)
