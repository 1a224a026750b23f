"""GPX 1.1: one route through the waypoints, for hand-held receivers and map programs.

http://www.topografix.com/GPX/1/1/gpx.xsd fixes the order of the elements and lon < 180. There is no `time` (a
plan has no clock) and no `ele` (elevation above sea level, which a plan does not know).
"""

from __future__ import annotations

from xml.sax.saxutils import escape

from hrt_cli.missions.mission import Mission, fixed, rounded_longitude

NAMESPACE = "http://www.topografix.com/GPX/1/1"
_DEGREE_DECIMALS = 8
_NAME_DIGITS = 3


def to_text(mission: Mission) -> str:
    """Write a mission as a GPX 1.1 route of points WP001, WP002, ... in ASCII (the rest as references)."""
    digits = max(_NAME_DIGITS, len(str(len(mission.stops))))
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<gpx xmlns="{NAMESPACE}" version="1.1" creator="hrt">',
        "  <metadata>",
        f"    <name>{escape(mission.name)}</name>",
        f"    <desc>{escape(mission.description)}</desc>",
        "  </metadata>",
        "  <rte>",
        f"    <name>{escape(mission.name)}</name>",
        f"    <desc>{escape(mission.description)}</desc>",
    ]
    for number, stop in enumerate(mission.stops, start=1):
        lat = fixed(stop.position.lat_deg, _DEGREE_DECIMALS)
        lon = fixed(rounded_longitude(stop.position.lon_deg, _DEGREE_DECIMALS), _DEGREE_DECIMALS)
        lines += [
            f'    <rtept lat="{lat}" lon="{lon}">',
            f"      <name>WP{number:0{digits}d}</name>",
            f"      <desc>{stop.place}</desc>",
            "    </rtept>",
        ]
    lines += ["  </rte>", "</gpx>"]
    return ("\n".join(lines) + "\n").encode("ascii", "xmlcharrefreplace").decode("ascii")
