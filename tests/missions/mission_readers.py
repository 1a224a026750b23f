"""Readers of every mission format that are not ours: after a format's own validator, where its waypoints are."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import geojson as geojson_peer
import gpxpy
import jsonschema
import yaml
from fastkml import validator
from lxml import etree
from moos_reader import read_behaviors, read_points
from pymavlink import mavwp
from pyproj import Transformer

HERE = Path(__file__).parent
XSD = etree.XMLSchema(etree.parse(HERE / "gpx_route.xsd"))
SCHEMA = json.loads((HERE / "qgc_plan.schema.json").read_text())


def read_positions(name: str, text: str, folder: Path) -> list[tuple[float, float]]:
    """The waypoints' (lon, lat) as each format's own reader gives them, after its validator."""
    if name == "geojson":
        collection = geojson_peer.loads(text)
        assert collection.is_valid, collection.errors()
        features = json.loads(text)["features"]  # the peer rounds to 6 decimals
        return [tuple(feature["geometry"]["coordinates"]) for feature in features[1:]]
    if name == "gpx":
        XSD.assertValid(etree.fromstring(text.encode()))
        return [(p.longitude, p.latitude) for p in gpxpy.parse(text).routes[0].points]
    if name == "qgc":
        document = json.loads(text)
        jsonschema.Draft202012Validator(SCHEMA).validate(document)
        return [(i["params"][5], i["params"][4]) for i in document["mission"]["items"] if i["command"] == 16]
    if name == "kml":
        root = etree.fromstring(text.encode())
        assert validator.get_schema_parser().validate(root)
        points = root.iterfind(".//{*}Point/{*}coordinates")
        return [tuple(map(float, point.text.split(","))) for point in points]
    if name == "csv":
        return [(float(row["lon"]), float(row["lat"])) for row in csv.DictReader(io.StringIO(text), strict=True)]
    if name == "nav2":
        return [(place["longitude"], place["latitude"]) for place in yaml.safe_load(text)["waypoints"]]
    if name == "moos":
        lat, lon = (float(line.split("=")[1]) for line in text.splitlines() if "Origin" in line)
        utm = f"+proj=utm +ellps=WGS84 +zone={int((lon + 180) // 6) + 1}"
        east, north = Transformer.from_crs("EPSG:4326", utm, always_xy=True).transform(lon, lat)
        back = Transformer.from_crs(utm, "EPSG:4326", always_xy=True)
        points = read_points(read_behaviors(text)[1][0].only("points"))
        return [back.transform(x + east, y + north) for x, y in points]
    path = folder / "mission.waypoints"
    path.write_text(text)
    loader = mavwp.MAVWPLoader()
    loader.load(str(path))
    return [(loader.wp(i).y, loader.wp(i).x) for i in range(2, loader.count())]
