"""Areas drawn on the map (an area of interest, a keep-out): from GeoJSON polygons to pixels of a grid.

A pixel belongs to an area where its centre lies inside. That is decided by counting, pixel row by pixel row, the
edges left of the centre (even-odd rule: Foley, van Dam, Feiner, Hughes, Computer Graphics, 1990, section 3.6), with
every crossing computed in coordinates of the whole grid: a pixel's answer does not depend on the window it is asked
for in, which a rasteriser that works in the window's own coordinates does not promise.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.errors import InputError
from hrt_cli.raster.grid import WGS84, Floats, Grid, transform_points
from hrt_cli.raster.windows import Window

MAX_POSITIONS = 1_000_000
_BEND_PX = 0.01
"""How far, in pixels, an edge may lie from where the straight line of the file would come to in the raster's CRS."""
_MAX_HALVINGS = 24
_MAX_COORDINATE = 1e9
_OUTLINE_POINTS = 17
_FIRST_EDGES = 64
_CRS84 = re.compile(r"(urn:ogc:def:crs:)?OGC:[0-9.]*:?CRS84", re.IGNORECASE)
_EPSG = re.compile(r"(?:urn:ogc:def:crs:)?EPSG:(?:[0-9.]*:)?([0-9]{4,6})", re.IGNORECASE)
_TO_REPAIR = "repair it with Fix Geometries in QGIS"


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
    """

    path: Path
    crs: CRS
    shape: Any

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
            near = shapely.segmentize(self.shape.intersection(box), box.length / _FIRST_EDGES)
            return PixelArea(grid, _edges([self._pixels(grid, ring) for ring in _rings(near)]))
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
        if area.bounds.height and area.bounds.width:
            return area
        swapped = shapely.transform(self.shape, lambda points: points[:, ::-1])
        exchanged = self.crs.is_geographic and swapped.intersects(self._surroundings(grid))
        remedy = "longitude and latitude seem to be exchanged: GeoJSON gives longitude first" if exchanged else ""
        raise InputError(self.path, f"lies outside {os.fspath(raster)}", remedy)

    def _surroundings(self, grid: Grid) -> Any:
        """Return a box in the file's CRS that holds the grid and as much again on each side."""
        down, along = np.linspace(0, grid.rows, _OUTLINE_POINTS), np.linspace(0, grid.cols, _OUTLINE_POINTS)
        x, y = transform_points(_crs_of(grid), self.crs, *grid.xy(*map(np.ravel, np.meshgrid(down, along))))
        width, height = np.ptp(x), np.ptp(y)
        return shapely.box(x.min() - width, y.min() - height, x.max() + width, y.max() + height)

    def _pixels(self, grid: Grid, ring: Floats) -> Floats:
        """Return a closed ring [n, 2] of the file's coordinates as pixel positions (row, col) [m, 2]."""
        ends, placed = ring, self._rowcol(grid, ring)
        for _ in range(_MAX_HALVINGS):
            middles = (ends[:-1] + ends[1:]) / 2
            placed_middles = self._rowcol(grid, middles)
            bend = np.abs(placed_middles - (placed[:-1] + placed[1:]) / 2).max(axis=1)
            bent = np.flatnonzero(bend > _BEND_PX)
            if not len(bent):
                break
            ends = np.insert(ends, bent + 1, middles[bent], axis=0)
            placed = np.insert(placed, bent + 1, placed_middles[bent], axis=0)
        return placed

    def _rowcol(self, grid: Grid, points: Floats) -> Floats:
        x, y = transform_points(self.crs, _crs_of(grid), points[:, 0], points[:, 1])
        col, row = ~grid.transform @ (x, y)
        return np.stack([row, col], axis=1)


@dataclass(frozen=True)
class PixelArea:
    """An area in pixels of a grid.

    Attributes
    ----------
    grid : Grid
    edges : float64 [n, 4]
        Row and column of each edge's upper end, then of its lower; no edge lies along a row.
    """

    grid: Grid
    edges: Floats

    @cached_property
    def bounds(self) -> Window:
        """The smallest window of whole pixels on the grid that holds the area; empty where the area misses it."""
        if not len(self.edges):
            return Window(0, 0, 0, 0)
        rows, cols = self.edges[:, 0::2], self.edges[:, 1::2]
        top, left = math.floor(rows.min()), math.floor(cols.min())
        return Window(top, left, math.ceil(rows.max()) - top, math.ceil(cols.max()) - left).clipped(self.grid.shape)

    def mask(self, window: Window) -> NDArray[np.bool_]:
        """Return where pixel centres lie in the area [height, width]; the window may reach outside the grid."""
        # An edge crosses the rows whose centre lies at or below its upper end and above its lower end.
        first = np.maximum(np.ceil(self.edges[:, 0] - 0.5), window.row).astype(np.int64)
        last = np.minimum(np.ceil(self.edges[:, 2] - 0.5), window.row + window.height).astype(np.int64)
        met = np.flatnonzero(first < last)
        counts = (last - first)[met]
        row0, col0, row1, col1 = np.repeat(self.edges[met], counts, axis=0).T
        row = np.arange(counts.sum()) + np.repeat(first[met] - (counts.cumsum() - counts), counts)
        crossing = col0 + (row + 0.5 - row0) / (row1 - row0) * (col1 - col0)
        # The parity changes at the first pixel whose centre lies at or right of the crossing.
        change = np.clip(np.ceil(crossing - 0.5), window.col, window.col + window.width).astype(np.int64)
        odd = np.zeros((window.height, window.width + 1), np.bool_)
        np.logical_xor.at(odd, (row - window.row, change - window.col), True)
        return np.asarray(np.logical_xor.accumulate(odd[:, :-1], axis=1))


def read_aoi(path: Path) -> Aoi:
    """Read an area from GeoJSON: a Polygon, a MultiPolygon, a Feature or a FeatureCollection of them.

    Coordinates are WGS 84 longitude and latitude (RFC 7946), or of the CRS that a `crs` member names, as GDAL and
    QGIS write it after GeoJSON's first specification (2008). Several polygons are taken together.

    Raises
    ------
    InputError
        The file is no strict JSON, is no GeoJSON polygon, names a CRS that is not known, holds a position out of
        range or a ring that is open or crosses itself.
    """
    document = parse_strict(path, read_text(path))
    if not isinstance(document, dict):
        raise InputError(path, "is not GeoJSON: the document is no object")
    crs = _crs(path, document)
    check = _Checker(path, crs.is_geographic)
    polygons = [check.polygon(rings) for rings in _polygons(path, document)]
    if not polygons:
        raise InputError(path, "holds no polygon")
    return Aoi(path, crs, shapely.union_all(polygons))


@dataclass
class _Checker:
    """Turns the rings of one file into valid polygons."""

    path: Path
    geographic: bool
    positions: int = 0

    def polygon(self, rings: Any) -> Any:
        if not isinstance(rings, list) or not rings:
            raise InputError(self.path, "holds a polygon without rings")
        outer, *holes = [self._ring(ring) for ring in rings]
        polygon = shapely.Polygon(outer, holes)
        if not polygon.is_valid:
            reason = shapely.is_valid_reason(polygon).replace("[", " at ").replace("]", "")
            raise InputError(self.path, f"holds a polygon that is not valid: {reason}", _TO_REPAIR)
        return polygon

    def _ring(self, ring: Any) -> list[tuple[float, float]]:
        if not isinstance(ring, list) or len(ring) < 4:
            raise InputError(self.path, "holds a ring of fewer than four positions")
        self.positions += len(ring)
        if self.positions > MAX_POSITIONS:
            raise InputError(self.path, f"holds more than {MAX_POSITIONS} positions", "simplify it")
        points = [self._position(position) for position in ring]
        if points[0] != points[-1]:
            raise InputError(self.path, "holds a ring that is not closed: its last position is not its first")
        return points

    def _position(self, position: Any) -> tuple[float, float]:
        numbers = position if isinstance(position, list) else []
        if len(numbers) < 2 or any(isinstance(n, bool) or not isinstance(n, int | float) for n in numbers):
            raise InputError(self.path, f"holds the position {str(position)[:60]}, which is no list of numbers")
        x, y = numbers[:2]
        if self.geographic and not (-180 <= x <= 180 and -90 <= y <= 90):
            raise InputError(
                self.path,
                f"the position {str(position)[:60]} is no longitude and latitude",
                "give degrees, longitude first, or name the CRS in a crs member",
            )
        if not (abs(x) <= _MAX_COORDINATE and abs(y) <= _MAX_COORDINATE):
            raise InputError(self.path, "holds a position too far away to lie on the Earth")
        return float(x), float(y)


def _polygons(path: Path, document: dict[str, Any]) -> Iterator[Any]:
    """Yield the rings of each polygon of a GeoJSON object."""
    kind = document.get("type")
    if kind == "FeatureCollection":
        for feature in _list(path, document, "features"):
            if not isinstance(feature, dict) or feature.get("type") != "Feature":
                raise InputError(path, "holds a feature that is none")
            yield from _polygons(path, feature)
    elif kind == "Feature":
        geometry = document.get("geometry")
        if not isinstance(geometry, dict) or geometry.get("type") in ("Feature", "FeatureCollection"):
            raise InputError(path, "holds a feature without geometry")
        yield from _polygons(path, geometry)
    elif kind == "MultiPolygon":
        yield from _list(path, document, "coordinates")
    elif kind == "Polygon":
        yield _list(path, document, "coordinates")
    elif isinstance(kind, str):
        raise InputError(path, f"holds a {kind[:40]}; an area is made of Polygons and MultiPolygons")
    else:
        raise InputError(path, "is not GeoJSON: an object has no type")


def _list(path: Path, document: dict[str, Any], key: str) -> list[Any]:
    found = document.get(key)
    if not isinstance(found, list):
        raise InputError(path, f"is not GeoJSON: a {document['type']} has no list of {key}")
    return found


def _crs(path: Path, document: dict[str, Any]) -> CRS:
    """Return WGS 84, or what the `crs` member of the 2008 specification names."""
    if "crs" not in document:
        return WGS84
    member = document["crs"]
    properties = member.get("properties") if isinstance(member, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if isinstance(name, str) and _CRS84.fullmatch(name):
        return WGS84
    code = _EPSG.fullmatch(name) if isinstance(name, str) else None
    try:
        if code:
            return CRS.from_epsg(int(code[1]))
    except CRSError:
        pass
    described = repr(name)[:60] if name is not None else "none"
    raise InputError(path, f"its crs member names {described}, no CRS that is known", "export it in EPSG:4326")


def _crs_of(grid: Grid) -> CRS:
    if grid.crs is None:
        raise ValueError("has no coordinate reference system")
    return grid.crs


def _rings(shape: Any) -> Iterator[Floats]:
    """Yield the outer and inner rings [n, 2] of all polygons in a geometry."""
    for part in shapely.get_parts(shape):
        if isinstance(part, shapely.Polygon):
            for ring in (part.exterior, *part.interiors):
                if len(ring.coords):
                    yield shapely.get_coordinates(ring)


def _edges(rings: list[Floats]) -> Floats:
    """Return the edges of closed rings as in `PixelArea`."""
    legs = [np.concatenate([ring[:-1], ring[1:]], axis=1) for ring in rings]
    edges = np.concatenate(legs) if legs else np.zeros((0, 4))
    edges = edges[edges[:, 0] != edges[:, 2]]
    downward = edges[:, 0] < edges[:, 2]
    return np.asarray(np.where(downward[:, None], edges, edges[:, [2, 3, 0, 1]]))
