"""Nav2 (ROS 2): the waypoints as a GPS waypoint file, or a folder with all that its servers load.

The folder holds `gps_waypoints.yaml` (the waypoint follower's tutorial), `path.yaml` (a nav_msgs/Path), `datum.yaml`
and `navsat_transform.yaml` (where the frame `map` lies, and the parameters that make robot_localization agree), and
`route.geojson` (a graph for the route server); with the scoremap also its maps, see `nav2_maps`.
"""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import Any

from hrt_cli.errors import ArgumentError
from hrt_cli.missions.heading import local_yaws_rad, true_yaws_rad
from hrt_cli.missions.mission import Mission, fixed, printable, rounded, rounded_longitude
from hrt_cli.missions.nav2_maps import map_files
from hrt_cli.raster.scoremap import Scoremap

MAP_FRAME = "map"
_DEGREE_DECIMALS = 9
_METRE_DECIMALS = 4
_RADIAN_DECIMALS = 9
_SAME_PLACE_M = 0.01


def to_text(mission: Mission) -> str:
    """Write a mission as GPS waypoints in YAML, as nav2_gps_waypoint_follower_demo reads them.

    Raises
    ------
    ArgumentError
        The mission keeps a height above the bottom, for which Nav2 has no place.
    """
    if mission.options.above_bottom_m is not None:
        raise ArgumentError("Nav2 keeps no height above the bottom: give --depth in place of --above-bottom")
    lines = [
        *_about(mission, "Waypoints for Nav2's FollowGPSWaypoints. yaw: radians, counter-clockwise from true east."),
    ]
    if mission.options.hold_s:
        milliseconds = int(mission.options.hold_s) * 1000
        lines.append(
            f"# The wait is a parameter of waypoint_follower: wait_at_waypoint.waypoint_pause_duration: {milliseconds}"
        )
    lines.append("waypoints:")
    for point, yaw in zip(mission.points, true_yaws_rad(mission), strict=True):
        lines += [
            f"- latitude: {fixed(point.lat_deg, _DEGREE_DECIMALS)}",
            f"  longitude: {fixed(rounded_longitude(point.lon_deg, _DEGREE_DECIMALS), _DEGREE_DECIMALS)}",
            f"  yaw: {fixed(yaw, _RADIAN_DECIMALS)}",
        ]
    return "\n".join(lines) + "\n"


def to_files(mission: Mission, scoremap: Scoremap | None) -> dict[str, bytes]:
    """Return the files of a Nav2 folder by name.

    There is no route graph of a single waypoint, and there are no maps without a scoremap.

    Raises
    ------
    ArgumentError
        As `to_text`.
    """
    texts = {
        "gps_waypoints.yaml": to_text(mission),
        "path.yaml": _path(mission),
        "datum.yaml": _datum(mission),
        "navsat_transform.yaml": _navsat_transform(mission),
    }
    graph = _route(mission)
    if graph is not None:
        texts["route.geojson"] = graph
    files = {name: text.encode("ascii") for name, text in texts.items()}
    if scoremap is not None:
        files |= map_files(scoremap, mission.frame, mission.plan.blocked)
    return files


def _about(mission: Mission, what: str) -> list[str]:
    """Comments that head a file."""
    lines = [what, f"{mission.name}: {printable(mission.description)}"]
    return [f"# {line}".encode("ascii", "replace").decode("ascii") for line in lines]


def _path(mission: Mission) -> str:
    header = f"{{stamp: {{sec: 0, nanosec: 0}}, frame_id: {MAP_FRAME}}}"
    lines = [
        *_about(mission, "A nav_msgs/msg/Path in the frame whose origin datum.yaml gives; metres."),
        f"header: {header}",
        "poses:",
    ]
    for (x, y), point, yaw in zip(mission.xy, mission.points, local_yaws_rad(mission), strict=True):
        x_m, y_m, z_m = (fixed(metres, _METRE_DECIMALS) for metres in (x, y, point.alt_m))
        sine, cosine = (fixed(part, _RADIAN_DECIMALS) for part in (math.sin(yaw / 2), math.cos(yaw / 2)))
        lines += [
            f"- header: {header}",
            "  pose:",
            f"    position: {{x: {x_m}, y: {y_m}, z: {z_m}}}",
            f"    orientation: {{x: 0.0, y: 0.0, z: {sine}, w: {cosine}}}",
        ]
    return "\n".join(lines) + "\n"


def _datum(mission: Mission) -> str:
    frame = mission.frame
    east_m, north_m = (fixed(metres, _METRE_DECIMALS) for metres in frame.origin)
    crs = frame.crs.to_string() if frame.kind == "utm" else frame.crs.to_proj4()
    axes = {"utm": "grid east and grid north", "enu": "the true east and north of the origin"}[frame.kind]
    return f"""# The origin of the frame {MAP_FRAME} (WGS 84); its axes point to {axes}.
latitude: {fixed(frame.lat_deg, _DEGREE_DECIMALS)}
longitude: {fixed(frame.lon_deg, _DEGREE_DECIMALS)}
frame: {frame.kind}
# x, y are the coordinates of this CRS less the easting and the northing of the origin, in metres.
crs: "{crs}"
easting: {east_m}
northing: {north_m}
# Bearing of the y axis from true north at the origin, clockwise, in radians.
convergence: {fixed(frame.convergence_rad, _RADIAN_DECIMALS)}
"""


def _navsat_transform(mission: Mission) -> str:
    """Return parameters for robot_localization (navsat_transform.cpp).

    Its frame is turned from UTM by the datum's heading, plus declination and offset, plus the meridian convergence.
    """
    frame = mission.frame
    numbers = (frame.lat_deg, frame.lon_deg, -frame.convergence_rad)
    datum = ", ".join(fixed(number, _RADIAN_DECIMALS) for number in numbers)
    return f"""# Parameters of robot_localization's navsat_transform_node (by whatever name it runs): they put the frame
# {MAP_FRAME} where datum.yaml says. The node adds UTM's meridian convergence to the datum's heading, which is minus
# that, and declination and offset, which have to be 0 here: the datum has no compass.
navsat_transform:
  ros__parameters:
    wait_for_datum: true
    datum: [{datum}]
    use_local_cartesian: {"true" if frame.kind == "enu" else "false"}
    magnetic_declination_radians: 0.0
    yaw_offset: 0.0
    zero_altitude: true
"""


def _route(mission: Mission) -> str | None:
    """Return the graph for the route server: the distinct places of the waypoints, and the legs both ways.

    nav2_route (geojson_graph_file_loader.cpp): coordinates are metres in the frame of the node and become 32-bit
    numbers, edges are directed, metadata may not be null, and a graph has an edge at least.
    """
    places: list[tuple[float, float]] = []
    nodes: list[dict[str, Any]] = []
    at: list[int] = []
    found: dict[tuple[int, int], int] = {}
    for stop, (x, y) in zip(mission.stops, mission.xy, strict=True):
        node = _node_near(found, x, y)
        if node is None:
            node = found[_bin(x, y)] = len(places)
            places.append((rounded(x, _METRE_DECIMALS), rounded(y, _METRE_DECIMALS)))
            metadata = {} if stop.cell is None else {"step": stop.step, "row": stop.cell[0], "col": stop.cell[1]}
            properties = {"id": node, "frame": MAP_FRAME} | ({"metadata": metadata} if metadata else {})
            nodes.append(_feature("Point", list(places[node]), properties))
        at.append(node)
    edges: dict[tuple[int, int], dict[str, Any]] = {}
    for start, end in (pair for a, b in pairwise(at) if a != b for pair in ((a, b), (b, a))):
        if (start, end) not in edges:
            properties = {
                "id": len(nodes) + len(edges),
                "startid": start,
                "endid": end,
                "cost": rounded(math.dist(places[start], places[end]), _METRE_DECIMALS),
            }
            line = [[list(places[start]), list(places[end])]]
            edges[start, end] = _feature("MultiLineString", line, properties)
    if not edges:
        return None
    features = ",\n".join(json.dumps(feature, allow_nan=False) for feature in [*nodes, *edges.values()])
    return f'{{"type": "FeatureCollection", "name": "graph", "features": [\n{features}\n]}}\n'


def _bin(x: float, y: float) -> tuple[int, int]:
    return math.floor(x / _SAME_PLACE_M), math.floor(y / _SAME_PLACE_M)


def _node_near(found: dict[tuple[int, int], int], x: float, y: float) -> int | None:
    """Return the node within a centimetre or two of a place: the same waypoint, come to on another way."""
    i, j = _bin(x, y)
    return next((found[key] for di in (0, -1, 1) for dj in (0, -1, 1) if (key := (i + di, j + dj)) in found), None)


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }
