"""The geofence of a mission: the area that the robot must not leave, and those that it must not enter.

Autopilots take polygons without holes. A hole in the area of interest becomes a keep-out; a keep-out with holes is cut
into pieces without. ArduPilot keeps a vehicle inside all inclusion polygons at once, so of several areas only the one
that the mission lies in is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.aoi import Aoi
from hrt_cli.raster.polygons import without_holes

Ring = tuple[tuple[float, float], ...]
"""Corners of a polygon as WGS 84 longitude and latitude in degrees, the first not repeated."""


@dataclass(frozen=True)
class Fence:
    """Polygons without holes: those to stay in, and those to stay out of."""

    keep_in: tuple[Ring, ...] = ()
    keep_out: tuple[Ring, ...] = ()


NO_FENCE = Fence()


def fence_of(lonlat: Sequence[tuple[float, float]], aoi: Aoi | None, keep_outs: Sequence[Aoi]) -> Fence:
    """Check every leg of a mission against the areas, and return them as a geofence.

    Parameters
    ----------
    lonlat : sequence of (float, float)
        The waypoints, WGS 84 degrees.
    aoi : Aoi or None
        The area of interest.
    keep_outs : sequence of Aoi

    Raises
    ------
    ArgumentError
        A leg leaves the area of interest or meets a keep-out.
    """
    line = np.array(lonlat)
    for area, wrong, what in [
        *(((aoi, ~aoi.holds(line), "leaves the area of interest"),) if aoi else ()),
        *((each, each.meets(line), "enters the keep-out") for each in keep_outs),
    ]:
        if wrong.any():
            leg = int(np.flatnonzero(wrong)[0]) + 1
            raise ArgumentError(
                f"between its waypoints {leg} and {leg + 1} the mission {what} {area.path}: make the scoremap with it,"
                " and plan again"
            )
    keep_in: list[Ring] = []
    keep_out: list[Ring] = []
    for outer, holes in aoi.lonlat_polygons() if aoi else ():
        if shapely.Polygon(outer).covers(shapely.Point(line[0])):
            keep_in.append(_ring(outer))
            keep_out += map(_ring, holes)
    for area in keep_outs:
        for outer, holes in area.lonlat_polygons():
            for piece in without_holes(shapely.Polygon(outer, holes)):
                keep_out.append(_ring(shapely.get_coordinates(piece.exterior)))
    return Fence(tuple(keep_in), tuple(keep_out))


def _ring(corners: object) -> Ring:
    lonlat = np.asarray(corners, np.float64)
    return tuple((float(lon), float(lat)) for lon, lat in lonlat[:-1])
