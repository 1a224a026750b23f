"""KML 2.2: the driven line and its waypoints, for Google Earth, QGIS and the programs of surveyors.

https://schemas.opengis.net/kml/2.2.0/ogckml22.xsd fixes the order of the elements. Line and points lie on the ground
(`clampToGround`), for a plan knows no height above the sea: altitude, depth or height above the bottom stand in the
points' data. A line across the meridian 180 is cut there.
"""

from __future__ import annotations

from itertools import chain
from xml.sax.saxutils import escape

from hrt_cli.missions.antimeridian import LonLat, cut_at_180
from hrt_cli.missions.mission import Mission, Stop, fixed, rounded, rounded_longitude

NAMESPACE = "http://www.opengis.net/kml/2.2"
_DEGREE_DECIMALS = 8
_METRE_DECIMALS = 3
_NAME_DIGITS = 3


def to_text(mission: Mission) -> str:
    """Write a mission as a KML 2.2 document in ASCII (the rest as references): the line, then WP001, WP002, ..."""
    digits = max(_NAME_DIGITS, len(str(len(mission.stops))))
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<kml xmlns="{NAMESPACE}">',
        "  <Document>",
        f"    <name>{escape(mission.name)}</name>",
        f"    <description>{escape(mission.description)}</description>",
        *_line(mission),
        *chain.from_iterable(
            _waypoint(mission, stop, f"WP{number:0{digits}d}") for number, stop in enumerate(mission.stops, start=1)
        ),
        "  </Document>",
        "</kml>",
    ]
    return ("\n".join(lines) + "\n").encode("ascii", "xmlcharrefreplace").decode("ascii")


def _line(mission: Mission) -> list[str]:
    """Return the placemark of the driven line; none where there is but one waypoint."""
    if len(mission.stops) == 1:
        return []
    parts = cut_at_180([_lonlat(stop) for stop in mission.stops], _DEGREE_DECIMALS)
    geometry = chain.from_iterable(_line_string(part) for part in parts)
    if len(parts) > 1:
        geometry = chain(["      <MultiGeometry>"], (f"  {line}" for line in geometry), ["      </MultiGeometry>"])
    return [
        "    <Placemark>",
        "      <name>path</name>",
        f"      <description>{escape(mission.description)}</description>",
        *_data({"speed_m_s": fixed(mission.speed_m_s, _METRE_DECIMALS), "vehicle": mission.options.vehicle}),
        *geometry,
        "    </Placemark>",
    ]


def _line_string(points: list[LonLat]) -> list[str]:
    return [
        "      <LineString>",
        "        <tessellate>1</tessellate>",
        "        <altitudeMode>clampToGround</altitudeMode>",
        f"        <coordinates>{' '.join(_coordinates(*point) for point in points)}</coordinates>",
        "      </LineString>",
    ]


def _waypoint(mission: Mission, stop: Stop, name: str) -> list[str]:
    data = {}
    if stop.cell is not None:
        data = {"step": str(stop.step), "row": str(stop.cell[0]), "col": str(stop.cell[1])}
    data |= {"speed_m_s": fixed(mission.speed_m_s, _METRE_DECIMALS), "hold_s": str(int(mission.options.hold_s))}
    height = "above_bottom_m" if mission.options.above_bottom_m is not None else "altitude_m"
    data[height] = fixed(stop.position.alt_m, _METRE_DECIMALS)
    return [
        "    <Placemark>",
        f"      <name>{name}</name>",
        f"      <description>{stop.place}</description>",
        *_data(data),
        "      <Point>",
        "        <altitudeMode>clampToGround</altitudeMode>",
        f"        <coordinates>{_coordinates(*_lonlat(stop))}</coordinates>",
        "      </Point>",
        "    </Placemark>",
    ]


def _data(values: dict[str, str]) -> list[str]:
    lines = (f'        <Data name="{name}"><value>{value}</value></Data>' for name, value in values.items())
    return ["      <ExtendedData>", *lines, "      </ExtendedData>"]


def _coordinates(lon_deg: float, lat_deg: float) -> str:
    return f"{fixed(lon_deg, _DEGREE_DECIMALS)},{fixed(lat_deg, _DEGREE_DECIMALS)}"


def _lonlat(stop: Stop) -> LonLat:
    position = stop.position
    return rounded_longitude(position.lon_deg, _DEGREE_DECIMALS), rounded(position.lat_deg, _DEGREE_DECIMALS)
