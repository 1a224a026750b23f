"""The ground that a page's map shows: metres east and north of a middle point, with true north up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio.crs import CRS

from hrt_cli.raster.grid import WGS84, Grid, transform_points

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]

_DEGREE = 3
"""Of the polynomial from metres to degrees: within a millimetre on sites of a few kilometres."""
_FIT_POINTS = 9
_APART = 0.5
"""Boxes further apart than this share of the larger one's size are of different sites."""


@dataclass(frozen=True)
class Frame:
    """A frame of ground metres about `lon`, `lat`; both None where the site has no place on the Earth.

    The projection is the transverse Mercator one on the meridian of the middle (scale 1 there), so that north is true
    north and a metre is a metre on the ground, whatever CRSs the files have (Snyder, Map Projections, 1987, section 8).
    """

    lon: float | None = None
    lat: float | None = None

    @cached_property
    def crs(self) -> CRS | None:
        """The frame as a CRS."""
        if self.lon is None:
            return None
        return CRS.from_string(f"+proj=tmerc +lat_0={self.lat!r} +lon_0={self.lon!r} +k=1 +ellps=WGS84 +units=m")

    def of_lonlat(self, lon: ArrayLike, lat: ArrayLike) -> tuple[Floats, Floats]:
        """Return east and north [n] of WGS 84 positions.

        Raises
        ------
        ValueError
            The frame has no place on the Earth, or a point none in the frame.
        """
        return self.of_points(lon, lat, WGS84)

    def of_points(self, x: ArrayLike, y: ArrayLike, crs: CRS) -> tuple[Floats, Floats]:
        """Return east and north [n] of points in a CRS; raises as `of_lonlat`."""
        if self.crs is None:
            raise ValueError("has no place on a map without georeference")
        return transform_points(crs, self.crs, x, y)

    def of_cells(self, grid: Grid, rows: ArrayLike, cols: ArrayLike) -> tuple[Floats, Floats]:
        """Return east and north [n] of fractional pixel positions; without georeference, metres from the first corner.

        Raises
        ------
        ValueError
            A position has no place on the Earth.
        """
        row, col = np.asarray(rows, np.float64), np.asarray(cols, np.float64)
        if self.crs is None or grid.crs is None:
            side = side_of(grid)
            return col * side, -row * side
        return self.of_points(*grid.xy(row, col), grid.crs)

    def affine_of(self, grid: Grid) -> tuple[Affine, float]:
        """Return the affine transform from (col, row) to (east, north) that fits best, and its largest error in pixels.

        Raises
        ------
        ValueError
            See `of_cells`.
        """
        row, col = (each.ravel() for each in _lattice(grid.shape))
        east, north = self.of_cells(grid, row, col)
        design = np.stack([col, row, np.ones_like(col)], axis=1)
        fit, *_ = np.linalg.lstsq(design, np.stack([east, north], axis=1), rcond=None)
        error = np.hypot(*(design @ fit - np.stack([east, north], axis=1)).T).max()
        (a, d), (b, e), (c, f) = fit.tolist()
        side = float(np.sqrt(abs(a * e - b * d)))
        return Affine(a, b, c, d, e, f), float(error) / side

    def box_of(self, grid: Grid) -> Box:
        """Return west, south, east and north of a raster, in metres; raises as `of_cells`."""
        row, col = (each.ravel() for each in _lattice(grid.shape))
        east, north = self.of_cells(grid, row, col)
        return float(east.min()), float(north.min()), float(east.max()), float(north.max())

    def degrees_over(self, box: Box) -> dict[str, object] | None:
        """Return polynomials from (east, north) to degrees over a box, for a page to tell where a point is.

        With u = (east - middle) / scale and v likewise, a degree is the sum over k of `lon[k]` u^i v^j, where `powers`
        lists the (i, j). None without georeference.
        """
        if self.crs is None or self.lon is None:
            return None
        west, south, east, north = box
        scale = max(east - west, north - south, 1.0) / 2
        middle = (west + east) / 2, (south + north) / 2
        u, v = (each.ravel() for each in np.meshgrid(*[np.linspace(-1.2, 1.2, _FIT_POINTS)] * 2))
        lon, lat = transform_points(self.crs, WGS84, middle[0] + scale * u, middle[1] + scale * v)
        lon = self.lon + (lon - self.lon + 180.0) % 360.0 - 180.0  # across the meridian 180 it goes on
        powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
        design = np.stack([u**i * v**j for i, j in powers], axis=1)
        fit, *_ = np.linalg.lstsq(design, np.stack([lon, lat], axis=1), rcond=None)
        return {
            "middle": list(middle),
            "scale": scale,
            "powers": [list(each) for each in powers],
            "lon": fit[:, 0].tolist(),
            "lat": fit[:, 1].tolist(),
        }


def side_of(grid: Grid) -> float:
    """Return the side of a pixel: in metres where it has a CRS, be that a placeholder, else in the grid's own unit."""
    if grid.crs is not None:
        return float(np.sqrt(grid.pixel_m[0] * grid.pixel_m[1]))
    return float(np.hypot(grid.transform.a, grid.transform.d))


def frame_about(lon: Sequence[float], lat: Sequence[float]) -> Frame:
    """Return the frame about the middle of some positions, the short way round the meridian 180."""
    first = lon[0]
    turned = [first + (each - first + 180.0) % 360.0 - 180.0 for each in lon]
    middle = (min(turned) + max(turned)) / 2
    return Frame(round((middle + 180.0) % 360.0 - 180.0, 7), round((min(lat) + max(lat)) / 2, 7))


def together(boxes: Sequence[Box]) -> list[list[int]]:
    """Group boxes (west, south, east, north) that overlap or lie close to one another; return the indices.

    Longitudes are taken as they are: two halves of a site beside the meridian 180 come out as two sites.
    """
    groups: list[list[int]] = []
    for index in range(len(boxes)):
        near = [group for group in groups if any(_close(boxes[index], boxes[other]) for other in group)]
        groups = [group for group in groups if group not in near]
        groups.append(sorted([index, *(other for group in near for other in group)]))
    return sorted(groups)


def _close(one: Box, other: Box) -> bool:
    size = max(one[2] - one[0], one[3] - one[1], other[2] - other[0], other[3] - other[1])
    across = max(one[0], other[0]) - min(one[2], other[2])
    along = max(one[1], other[1]) - min(one[3], other[3])
    return max(across, along) <= _APART * size


def _lattice(shape: tuple[int, int]) -> tuple[Floats, Floats]:
    rows, cols = np.meshgrid(*(np.linspace(0.0, side, 5) for side in shape), indexing="ij")
    return rows, cols
