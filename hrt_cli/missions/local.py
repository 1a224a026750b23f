"""Metres in place of degrees: the local frames in which ROS and MOOS robots think, with the place of their origin.

`utm`: easting and northing of the UTM zone that the origin lies in, less those of the origin, as MOOS (built with
USE_UTM) has it. x points to grid east, which is off true east by the convergence of the meridians; a metre is .9996 to
1.001 m of ground. robot_localization's navsat_transform_node makes this frame of a datum whose heading is minus the
convergence: it turns UTM by the heading that it is told, plus the convergence.

`enu`: metres of ground to the true east and north of the origin, by the azimuthal equidistant projection about it
(Snyder, Map Projections, 1987, chapter 25), which within 2 km differs from the plane that touches the ellipsoid there
by less than 0.1 mm: what navsat_transform_node makes of a datum of heading 0 with `use_local_cartesian`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from rasterio.crs import CRS

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.grid import WGS84, transform_points

FrameKind = Literal["utm", "enu"]

_UTM_SOUTH, _UTM_NORTH = -80.0, 84.0


@dataclass(frozen=True)
class LocalFrame:
    """A local frame.

    Attributes
    ----------
    kind : {"utm", "enu"}
        How metres are made.
    lon_deg, lat_deg : float
        The origin (datum), WGS 84.

    Raises
    ------
    ArgumentError
        The origin is no place that UTM covers.
    """

    kind: FrameKind
    lon_deg: float
    lat_deg: float

    def __post_init__(self) -> None:
        if not (-180 <= self.lon_deg <= 180 and -90 <= self.lat_deg <= 90):
            raise ArgumentError(f"datum {self.lon_deg:g},{self.lat_deg:g} is no longitude and latitude")
        if self.kind == "utm" and not _UTM_SOUTH <= self.lat_deg <= _UTM_NORTH:
            raise ArgumentError(f"UTM does not reach latitude {self.lat_deg:g}; use the local frame enu")

    @cached_property
    def crs(self) -> CRS:
        """The map projection whose coordinates, less `origin`, are those of the frame."""
        if self.kind == "enu":
            return CRS.from_proj4(f"+proj=aeqd +lat_0={self.lat_deg!r} +lon_0={self.lon_deg!r} +datum=WGS84 +units=m")
        zone = utm_zone(self.lon_deg, self.lat_deg)
        return CRS.from_epsg((32600 if self.lat_deg >= 0 else 32700) + zone)

    @cached_property
    def origin(self) -> tuple[float, float]:
        """The projection's coordinates of the frame's origin, in metres."""
        x, y = transform_points(WGS84, self.crs, [self.lon_deg], [self.lat_deg])
        return float(x[0]), float(y[0])

    @cached_property
    def convergence_rad(self) -> float:
        """Meridian convergence at the origin: grid north's bearing from true north, clockwise; 0 for `enu`."""
        step_deg = 1e-5 if self.lat_deg < 0 else -1e-5  # towards the equator: never beyond a pole
        x, y = transform_points(WGS84, self.crs, [self.lon_deg] * 2, [self.lat_deg, self.lat_deg + step_deg])
        east, north = (float(after - before) / step_deg for before, after in (x, y))
        return -math.atan2(east, north)

    def xy(self, lonlat: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Return the places of WGS 84 positions (lon, lat) in the frame: metres east and north of its origin."""
        x, y = transform_points(WGS84, self.crs, *zip(*lonlat, strict=True))
        return [(float(px - self.origin[0]), float(py - self.origin[1])) for px, py in zip(x, y, strict=True)]


def utm_zone(lon_deg: float, lat_deg: float) -> int:
    """Return the number of the UTM zone of a place, with the exceptions of Norway and Svalbard."""
    if 56 <= lat_deg < 64 and 3 <= lon_deg < 12:
        return 32
    if 72 <= lat_deg <= 84 and 0 <= lon_deg < 42:
        return 31 if lon_deg < 9 else 33 if lon_deg < 21 else 35 if lon_deg < 33 else 37
    return min(60, math.floor((lon_deg + 180) / 6) + 1)
