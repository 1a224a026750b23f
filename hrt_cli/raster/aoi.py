"""Areas drawn on the map (an area of interest, a keep-out): from a file of polygons to pixels, legs and fences."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from rasterio.crs import CRS

from hrt_cli.errors import InputError
from hrt_cli.raster.geojson import read_geojson
from hrt_cli.raster.grid import WGS84, Floats, Grid, transform_points
from hrt_cli.raster.kml import read_kml
from hrt_cli.raster.pixel_area import BEND_PX, PixelArea
from hrt_cli.raster.polygons import rings_of

_MAX_HALVINGS = 24
_OUTLINE_POINTS = 17
_FIRST_EDGES = 64
_BEND_DEG = 1e-7
"""1.1 cm: the resolution of the positions that autopilots keep."""
_BEND_UNITS = 1e-3
"""Of a leg in the file's CRS, mostly metres."""
_TURN_DEG = 360.0
_QUARTERS = (0.25, 0.75)

Place = Callable[[Floats], Floats]
"""Where points [n, 2] come to lie elsewhere."""


@dataclass(frozen=True)
class Aoi:
    """Polygons on the map.

    Attributes
    ----------
    path : Path
        The file that they come from.
    crs : CRS
        That of the coordinates, x or longitude first.
    shape : shapely Polygon or MultiPolygon
        All the polygons of the file in one.
    notes : tuple of str
        What of the file was passed over.
    """

    path: Path
    crs: CRS
    shape: Any
    notes: tuple[str, ...] = ()

    def on(self, grid: Grid) -> PixelArea:
        """Place the area on a georeferenced grid, which it may miss.

        Edges that are straight in the file's coordinates are followed to a hundredth of a pixel: each is halved
        until its middle lies there. What lies far outside the grid is cut off first.

        Raises
        ------
        InputError
            The grid has no CRS, or a position has no place in it.
        """
        try:
            box = self._surroundings(grid)
            # Short edges to begin with: of a long one that bends both ways the middle may lie on the straight line.
            near = shapely.segmentize(self._turned(box.bounds).intersection(box), box.length / _FIRST_EDGES)
            crs = _crs_of(grid)
            centre_x = float(grid.xy(grid.rows / 2, grid.cols / 2)[0])

            def place(points: Floats) -> Floats:
                x, y = _placed(self.crs, crs, points, centre_x).T
                col, row = ~grid.transform @ (x, y)
                return np.stack([row, col], axis=1)

            return PixelArea.of_rings(grid, [_followed(ring, place, BEND_PX)[0] for ring in rings_of(near)])
        except ValueError as error:
            raise InputError(self.path, f"cannot be placed on the raster, which {error}") from error

    def require_on(self, grid: Grid, raster: str | os.PathLike[str]) -> PixelArea:
        """Place the area as `on`, and refuse it where it misses the grid (`raster` is for the message).

        Raises
        ------
        InputError
            As `on`, and where no part of the area lies on the grid.
        """
        area = self.on(grid)
        if area.misses_grid:
            raise InputError(self.path, f"lies outside {os.fspath(raster)}", self.why_it_misses(grid))
        return area

    def why_it_misses(self, grid: Grid) -> str:
        """Return what to suspect where the area misses a grid; an empty string where there is nothing."""
        swapped = shapely.transform(self.shape, lambda points: points[:, ::-1])
        exchanged = self.crs.is_geographic and swapped.intersects(self._surroundings(grid))
        return "longitude and latitude seem to be exchanged: longitude comes first" if exchanged else ""

    def meets(self, line: ArrayLike, crs: CRS = WGS84) -> NDArray[np.bool_]:
        """Return which legs of a line touch the area, be it in one point of its edge.

        Parameters
        ----------
        line : float64 [n, 2]
            Positions, x or longitude first; the legs between them are straight in these coordinates. One position
            alone is a leg that stays where it is.
        crs : CRS
            That of the positions.

        Returns
        -------
        met : bool [max(n - 1, 1)]

        Raises
        ------
        InputError
            A position has no place in the CRS of the file.
        """
        pieces, starts, shape = self._legs(line, crs)
        return np.asarray(np.logical_or.reduceat(shapely.intersects(shape, pieces), starts))

    def holds(self, line: ArrayLike, crs: CRS = WGS84) -> NDArray[np.bool_]:
        """Return which legs of a line lie wholly in the area, its edge included; arguments and errors as `meets`."""
        pieces, starts, shape = self._legs(line, crs)
        return np.asarray(np.logical_and.reduceat(shapely.covers(shape, pieces), starts))

    def lonlat_polygons(self) -> list[tuple[Floats, list[Floats]]]:
        """Return the outer ring and the holes of each polygon in WGS 84 degrees, longitude first, as fences need them.

        Rings are float64 [n, 2] and closed. Positions are added where edges that are straight in the file's CRS would
        leave the line between their ends by more than 1e-7 degrees.

        Raises
        ------
        InputError
            A position has no place on the Earth.
        """
        parts = (rings_of(part) for part in shapely.get_parts(self.shape))
        return [(self._lonlat(outer), [self._lonlat(hole) for hole in holes]) for outer, *holes in parts]

    def _lonlat(self, ring: Floats) -> Floats:
        if self.crs == WGS84:
            return ring
        try:
            first_lon = _placed(self.crs, WGS84, ring[:1])[0, 0]
            lonlat, _ = _followed(ring, lambda p: _placed(self.crs, WGS84, p, first_lon), _BEND_DEG, _QUARTERS)
        except ValueError as error:
            raise InputError(self.path, f"cannot be placed on the Earth: {error}") from error
        return np.stack([_near(lonlat[:, 0], 0.0), lonlat[:, 1]], axis=1)

    def _legs(self, line: ArrayLike, crs: CRS) -> tuple[Any, NDArray[np.int64], Any]:
        """Return the pieces that follow the legs in the file's CRS, each leg's first, and the area to compare with."""
        points = np.array(line, np.float64).reshape(-1, 2)
        if len(points) == 1:
            points = np.repeat(points, 2, axis=0)
        if crs.is_geographic:
            points[:, 0] = np.unwrap(points[:, 0], period=_TURN_DEG)
        try:
            first_x = _placed(crs, self.crs, points[:1])[0, 0]
            bend = _BEND_DEG if self.crs.is_geographic else _BEND_UNITS
            placed, leg = _followed(points, lambda p: _placed(crs, self.crs, p, first_x), bend, _QUARTERS)
        except ValueError as error:
            raise InputError(self.path, f"cannot be compared with a line: {error}") from error
        pieces = shapely.linestrings(np.stack([placed[:-1], placed[1:]], axis=1))
        low, high = placed.min(axis=0), placed.max(axis=0)
        shape = self._turned((low[0], low[1], high[0], high[1]))
        shapely.prepare(shape)
        return pieces, np.searchsorted(leg[:-1], np.arange(len(points) - 1)), shape

    def _surroundings(self, grid: Grid) -> Any:
        """Return a box in the file's CRS that holds the grid and as much again on each side."""
        down, along = np.linspace(0, grid.rows, _OUTLINE_POINTS), np.linspace(0, grid.cols, _OUTLINE_POINTS)
        x, y = transform_points(_crs_of(grid), self.crs, *grid.xy(*map(np.ravel, np.meshgrid(down, along))))
        if self.crs.is_geographic:
            x = _near(x, x[0])
        width, height = np.ptp(x), np.ptp(y)
        low, high = x.min() - width, x.max() + width
        if self.crs.is_geographic and high - low > _TURN_DEG:
            low, high = (low + high - _TURN_DEG) / 2, (low + high + _TURN_DEG) / 2
        return shapely.box(low, y.min() - height, high, y.max() + height)

    def _turned(self, bounds: tuple[float, float, float, float]) -> Any:
        """Return the area, and where bounds in the file's CRS reach past the antimeridian what lies there of it."""
        if not self.crs.is_geographic or (bounds[0] >= -_TURN_DEG / 2 and bounds[2] <= _TURN_DEG / 2):
            return self.shape
        turns = np.array([[-_TURN_DEG, 0.0], [0.0, 0.0], [_TURN_DEG, 0.0]])
        return shapely.union_all([shapely.transform(self.shape, turn.__add__) for turn in turns])


def read_aoi(path: Path) -> Aoi:
    """Read an area: the polygons of a GeoJSON file, or by its name of a KML or KMZ file, taken together.

    Raises
    ------
    InputError
        See `read_geojson` and `read_kml`; or the file holds no polygon.
    """
    drawn = read_kml(path) if path.suffix.lower() in (".kml", ".kmz") else read_geojson(path)
    if not drawn.polygons:
        raise InputError(path, "holds no polygon")
    return Aoi(path, drawn.crs, shapely.union_all(drawn.polygons), drawn.notes)


def _placed(source: CRS, target: CRS, points: Floats, about_x: float | None = None) -> Floats:
    """Transform points [n, 2]; of longitudes take the turn about `about_x`."""
    x, y = transform_points(source, target, points[:, 0], points[:, 1])
    if about_x is not None and target.is_geographic:
        x = _near(x, about_x)
    return np.stack([x, y], axis=1)


def _near(lon_deg: Floats, about_deg: float) -> Floats:
    """Return longitudes at most half a turn from another."""
    return np.asarray(lon_deg - _TURN_DEG * np.round((lon_deg - about_deg) / _TURN_DEG))


def _followed(
    ends: Floats, place: Place, bend: float, probes: tuple[float, ...] = ()
) -> tuple[Floats, NDArray[np.int64]]:
    """Place a line [n, 2] elsewhere, with as many positions [m, 2] as it needs to be followed to within `bend`.

    An edge is halved until its middle, and what lies at the shares `probes` of it, comes to lie on the straight line.

    Returns
    -------
    placed : float64 [m, 2]
    edge : int64 [m]
        The edge of `ends` that begins at, or holds, each position.
    """
    placed, edge = place(ends), np.arange(len(ends))
    for _ in range(_MAX_HALVINGS):
        middles = (ends[:-1] + ends[1:]) / 2
        placed_middles = place(middles)
        bends = np.abs(placed_middles - (placed[:-1] + placed[1:]) / 2).max(axis=1)
        for share in probes:
            off = place(ends[:-1] + share * (ends[1:] - ends[:-1])) - placed[:-1] - share * (placed[1:] - placed[:-1])
            bends = np.maximum(bends, np.abs(off).max(axis=1))
        bent = np.flatnonzero(bends > bend)
        if not len(bent):
            break
        ends = np.insert(ends, bent + 1, middles[bent], axis=0)
        placed = np.insert(placed, bent + 1, placed_middles[bent], axis=0)
        edge = np.insert(edge, bent + 1, edge[bent])
    return placed, edge


def _crs_of(grid: Grid) -> CRS:
    if grid.crs is None:
        raise ValueError("has no coordinate reference system")
    return grid.crs
