"""GeoJSON (RFC 7946): the whole walk as a line with the plan's figures, and every waypoint as a point.

Coordinates are WGS 84 longitude, latitude with 7 decimals (1.1 cm, section 11.2); there is no `crs` member
(section 4), and a walk across the meridian 180 is cut there (section 3.1.9).
"""

from __future__ import annotations

import json
from typing import Any

from hrt_cli.missions.antimeridian import LonLat, cut_at_180
from hrt_cli.missions.mission import Mission, rounded, rounded_longitude

_DEGREE_DECIMALS = 7


def to_text(mission: Mission) -> str:
    """Write a mission as a GeoJSON feature collection, one feature a line: the path, then the waypoints."""
    parts = cut_at_180([_lonlat(lon_deg, lat_deg) for lon_deg, lat_deg in mission.lonlat], _DEGREE_DECIMALS)
    features = [_feature(_path_geometry(parts), _path_properties(mission)), *_waypoint_features(mission)]
    header = f'{{"type": "FeatureCollection", "bbox": {_dumps(_bbox(parts))}, "features": ['
    return header + "\n" + ",\n".join(_dumps(feature) for feature in features) + "\n]}\n"


def _path_properties(mission: Mission) -> dict[str, Any]:
    plan = mission.plan
    return {
        "kind": "path",
        "name": mission.name,
        "method": plan.method,
        "seed": plan.seed,
        "objective": plan.objective,
        "gamma": plan.gamma,
        "connectivity": plan.connectivity,
        "return_home": plan.return_home,
        "budget_value": plan.budget.value,
        "budget_unit": plan.budget.unit,
        "cell_size_m": plan.grid.cell_size_m,
        "steps": plan.steps,
        "waypoints": len(mission.stops),
        "score": plan.score,
        "discounted_score": plan.discounted_score,
        "upper_bound": plan.upper_bound,
        "gap": plan.gap,
        "length_m": mission.length_m,
        "vehicle": mission.options.vehicle,
        "altitude_m": None if mission.options.above_bottom_m is not None else mission.options.altitude_m,
        "above_bottom_m": mission.options.above_bottom_m,
        "tolerance_m": mission.options.tolerance_m,
        "speed_m_s": mission.speed_m_s,
        "time_s": mission.time_s,
    }


def _waypoint_features(mission: Mission) -> list[dict[str, Any]]:
    features = []
    bottom = mission.options.above_bottom_m is not None
    for index, (point, step, cell) in enumerate(mission.stops):
        row, col = (None, None) if cell is None else cell
        properties = {"kind": "waypoint", "index": index, "step": step, "row": row, "col": col}
        properties |= {"above_bottom_m" if bottom else "altitude_m": point.alt_m}
        geometry = {"type": "Point", "coordinates": _lonlat(point.lon_deg, point.lat_deg)}
        features.append(_feature(geometry, properties))
    return features


def _path_geometry(parts: list[list[LonLat]]) -> dict[str, Any]:
    """Return the line; its parts where it crosses the meridian 180; the point where a walk has no move."""
    if len(parts) > 1:
        return {"type": "MultiLineString", "coordinates": parts}
    if len(parts[0]) == 1:
        return {"type": "Point", "coordinates": parts[0][0]}
    return {"type": "LineString", "coordinates": parts[0]}


def _bbox(parts: list[list[LonLat]]) -> list[float]:
    """West, south, east, north; west > east across the meridian 180 (section 5.2)."""
    lons = [lon for part in parts for lon, _ in part]
    lats = [lat for part in parts for _, lat in part]
    if len(parts) > 1:
        return [
            min(lon for lon in lons if lon > 0),
            min(lats),
            max(lon for lon in lons if lon < 0),
            max(lats),
        ]
    return [min(lons), min(lats), max(lons), max(lats)]


def _lonlat(lon_deg: float, lat_deg: float) -> LonLat:
    return rounded_longitude(lon_deg, _DEGREE_DECIMALS), rounded(lat_deg, _DEGREE_DECIMALS)


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _dumps(value: Any) -> str:
    return json.dumps(value, allow_nan=False)
