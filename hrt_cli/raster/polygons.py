"""Polygons that were read from a file: checked ring by ring, whatever the format, and cut so that none has a hole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from rasterio.crs import CRS

from hrt_cli.errors import InputError

MAX_POSITIONS = 1_000_000
_MAX_COORDINATE = 1e9
_TO_REPAIR = "repair it with Fix Geometries in QGIS"


@dataclass(frozen=True)
class Drawn:
    """What a file of polygons holds.

    Attributes
    ----------
    crs : CRS
        That of the coordinates, x or longitude first.
    polygons : list of shapely Polygon
        Valid ones.
    notes : tuple of str
        What of the file was passed over.
    """

    crs: CRS
    polygons: list[Any]
    notes: tuple[str, ...] = ()


@dataclass
class PolygonChecker:
    """Turns the rings of one file into valid polygons.

    Attributes
    ----------
    path : Path
        The file, for messages.
    geographic : bool
        Positions are longitude and latitude in degrees.
    to_place : str
        What to do about positions that are not.
    positions : int
        How many were seen so far.
    """

    path: Path
    geographic: bool
    to_place: str
    positions: int = 0

    def polygon(self, rings: Any) -> Any:
        """Return the polygon of an outer ring and of holes, each a list of positions of two numbers or more.

        Raises
        ------
        InputError
            A position is no pair of numbers or out of range, a ring is open or crosses itself, a hole lies outside,
            or there are more than `MAX_POSITIONS` positions in the file.
        """
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
                self.path, f"the position {str(position)[:60]} is no longitude and latitude", self.to_place
            )
        if not (abs(x) <= _MAX_COORDINATE and abs(y) <= _MAX_COORDINATE):
            raise InputError(self.path, "holds a position too far away to lie on the Earth")
        return float(x), float(y)


def without_holes(polygon: Any) -> list[Any]:
    """Cut a polygon with holes into polygons without, that together cover the same ground and do not overlap.

    Each cut is along x = c through the middle of a hole, so that the hole opens to both sides; a fence of
    QGroundControl has no other way to tell of holes. A polygon without holes is returned as it is.

    Parameters
    ----------
    polygon : shapely Polygon
        A valid one.

    Returns
    -------
    pieces : list of shapely Polygon
        From left to right where they were cut.
    """
    pieces, left = [], [polygon]
    while left:
        part = left.pop()
        if not len(part.interiors):
            pieces.append(part)
            continue
        # The median hole: of many holes about half lie on either side, and what is cut gets smaller fast.
        middles = sorted((hole.bounds[0] + hole.bounds[2]) / 2 for hole in part.interiors)
        left += reversed(_halves(part, middles[len(middles) // 2]))
    return pieces


def _halves(polygon: Any, x: float) -> list[Any]:
    """Return what lies left of `x`, then what lies right of it."""
    low_x, low_y, high_x, high_y = polygon.bounds
    halves = (shapely.box(low_x, low_y, x, high_y), shapely.box(x, low_y, high_x, high_y))
    parts = [part for half in halves for part in shapely.get_parts(polygon.intersection(half))]
    return [part for part in parts if isinstance(part, shapely.Polygon) and part.area > 0]


def rings_of(shape: Any) -> Sequence[Any]:
    """Return the outer and inner rings, float64 [n, 2] each and closed, of all polygons in a shapely geometry."""
    return [
        np.asarray(shapely.get_coordinates(ring))
        for part in shapely.get_parts(shape)
        if isinstance(part, shapely.Polygon)
        for ring in (part.exterior, *part.interiors)
        if len(ring.coords)
    ]
