"""What Nav2 and robot_localization make of a folder: their documented rules, written anew.

nav2_map_server/src/map_io.cpp, nav2_costmap_2d/plugins/costmap_filters, nav2_route's geojson_graph_file_loader.cpp, and
robot_localization's navsat_transform.cpp.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from pyproj import CRS, Proj, Transformer

UNKNOWN = -1
LETHAL_COST, NO_INFORMATION = 254, 255
NO_LIMIT = 0.0

Files = dict[str, bytes]


@dataclass(frozen=True)
class OccupancyGrid:
    """`data` [height, width] has row 0 at the smallest y."""

    data: np.ndarray
    resolution: float
    x: float
    y: float

    def at(self, x: float, y: float) -> int | None:
        """The cell at a place of the frame, None beyond the grid (worldToMap)."""
        if x < self.x or y < self.y:
            return None
        col, row = int((x - self.x) / self.resolution), int((y - self.y) / self.resolution)
        if row >= self.data.shape[0] or col >= self.data.shape[1]:
            return None
        return int(self.data[row, col])


def load_map(files: Files, name: str) -> OccupancyGrid:
    """A map as map_server serves it."""
    document = yaml.safe_load(files[name])
    if not {"image", "resolution", "origin", "free_thresh", "occupied_thresh", "negate"} <= set(document):
        raise ValueError("a required key is absent")
    resolution, origin = float(document["resolution"]), [float(value) for value in document["origin"]]
    if len(origin) != 3:
        raise ValueError("origin has three numbers")
    grey = read_pgm(files[document["image"]])
    data = interpreted(grey, document)
    if origin[2]:
        raise ValueError("costmap filters want a yaw of 0")
    return OccupancyGrid(data[::-1], resolution, *origin[:2])


def interpreted(grey: np.ndarray, document: dict[str, Any]) -> np.ndarray:
    """Pixels as occupancy, by the mode."""
    free, occupied = float(document["free_thresh"]), float(document["occupied_thresh"])
    shade = grey / 255
    occ = shade if document["negate"] else 1 - shade
    mode = document.get("mode", "trinary")
    if mode == "raw":
        return np.where(grey <= 100, grey.astype(int), UNKNOWN)
    between = np.full(grey.shape, UNKNOWN) if mode == "trinary" else np.rint((occ - free) / (occupied - free) * 100)
    if mode not in ("trinary", "scale"):
        raise ValueError(f"no mode {mode}")
    return np.where(occ >= occupied, 100, np.where(occ <= free, 0, between)).astype(int)


def read_pgm(content: bytes) -> np.ndarray:
    magic, size, most, pixels = content.split(b"\n", 3)
    width, height = map(int, size.split())
    if (magic, most) != (b"P5", b"255") or len(pixels) != width * height:
        raise ValueError("not a whole PGM of 8 bits")
    return np.frombuffer(pixels, np.uint8).reshape(height, width)


def keepout_cost(mask: OccupancyGrid, x: float, y: float, cost: int) -> int:
    """The master costmap's cost at a place after the keepout filter."""
    data = mask.at(x, y)
    if data is None or data == UNKNOWN:
        return cost
    masked = round(data * LETHAL_COST / 100)
    return masked if masked > cost or cost == NO_INFORMATION else cost


def speed_percent(mask: OccupancyGrid, base: float, multiplier: float, x: float, y: float) -> float | None:
    """The limit in percent that the speed filter sets at a place, `NO_LIMIT`, or None where it fails."""
    data = mask.at(x, y)
    if data is None or data == UNKNOWN:
        return None
    if data == 0:
        return NO_LIMIT
    limit = data * multiplier + base
    return limit if 0 <= limit <= 100 else NO_LIMIT


def load_graph(content: bytes) -> tuple[dict[int, tuple[float, float]], list[tuple[int, int, float]]]:
    """The nodes' places as floats of 32 bits, and the edges (start, end, cost) of a route graph."""
    nodes: dict[int, tuple[float, float]] = {}
    edges = []
    seen: set[int] = set()
    for feature in json.loads(content)["features"]:
        properties, geometry = feature["properties"], feature["geometry"]
        identifier = properties["id"]
        if not isinstance(identifier, int) or identifier < 0 or identifier in seen:
            raise ValueError(f"id {identifier} is not unsigned, or not unique")
        seen.add(identifier)
        for value in properties.get("metadata", {}).values():
            if not isinstance(value, bool | int | float | str | list | dict):
                raise ValueError("metadata cannot be converted")
        if geometry["type"] == "Point":
            x, y = (float(np.float32(value)) for value in geometry["coordinates"])
            nodes[identifier] = (x, y)
            if properties.get("frame", "map") != "map":
                raise ValueError("another frame")
        elif geometry["type"] in ("LineString", "MultiLineString"):
            edges.append((properties["startid"], properties["endid"], float(properties.get("cost", 0.0))))
    if not nodes or not edges:
        raise ValueError("the graph is malformed")
    for start, end, _ in edges:
        if start not in nodes or end not in nodes:
            raise ValueError("start or end of an edge does not exist")
    return nodes, edges


def navsat_xy(parameters: dict[str, Any], lon: float, lat: float) -> tuple[float, float]:
    """Where navsat_transform_node puts a fix in its frame."""
    found = parameters["navsat_transform"]["ros__parameters"]
    if not found["wait_for_datum"]:
        raise ValueError("the datum is not used")
    lat0, lon0, heading = found["datum"]
    if not all(isinstance(value, float) for value in found["datum"]):
        raise ValueError("ROS wants three floats")
    yaw = heading + found["magnetic_declination_radians"] + found["yaw_offset"]
    if found["use_local_cartesian"]:
        plane = Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
            f" +step +proj=topocentric +ellps=WGS84 +lon_0={lon0} +lat_0={lat0} +h_0=0"
        )
        x, y, _ = plane.transform(lon, lat, 0.0)
    else:
        utm = CRS.from_epsg(geographiclib_epsg(lon0, lat0))
        to_utm = Transformer.from_crs("EPSG:4326", utm, always_xy=True)
        (east0, north0), (east, north) = to_utm.transform(lon0, lat0), to_utm.transform(lon, lat)
        x, y = east - east0, north - north0
        yaw += math.radians(Proj(utm).get_factors(lon0, lat0).meridian_convergence)
    # The inverse of the datum's pose: moved back, then turned back.
    return x * math.cos(yaw) + y * math.sin(yaw), -x * math.sin(yaw) + y * math.cos(yaw)


def geographiclib_epsg(lon: float, lat: float) -> int:
    """UTMUPS::StandardZone, by bands of latitude as its source has it."""
    band = max(-10, min(9, (math.floor(lat) + 80) // 8 - 10))
    zone = (math.floor(lon) + 186) // 6
    if band == 7 and zone == 31 and lon >= 3:
        zone = 32
    elif band == 9 and 0 <= lon < 42:
        zone = 2 * ((math.floor(lon) + 183) // 12) + 1
    return (32600 if lat >= 0 else 32700) + zone
