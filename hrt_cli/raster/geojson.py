"""Polygons in GeoJSON (RFC 7946), and in the form of its first specification (2008) that names a CRS."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.errors import InputError
from hrt_cli.raster.grid import WGS84
from hrt_cli.raster.polygons import Drawn, PolygonChecker

_CRS84 = re.compile(r"(urn:ogc:def:crs:)?OGC:[0-9.]*:?CRS84", re.IGNORECASE)
_EPSG = re.compile(r"(?:urn:ogc:def:crs:)?EPSG:(?:[0-9.]*:)?([0-9]{4,6})", re.IGNORECASE)
_TO_PLACE = "give degrees, longitude first, or name the CRS in a crs member"


def read_geojson(path: Path) -> Drawn:
    """Read a Polygon, a MultiPolygon, a Feature or a FeatureCollection of them.

    Coordinates are WGS 84 longitude and latitude (RFC 7946), or of the CRS that a `crs` member names, as GDAL and
    QGIS write it after GeoJSON's first specification (2008).

    Raises
    ------
    InputError
        The file is no strict JSON, is no GeoJSON polygon, names a CRS that is not known, or holds rings that are none
        (see `PolygonChecker`).
    """
    document = parse_strict(path, read_text(path))
    if not isinstance(document, dict):
        raise InputError(path, "is not GeoJSON: the document is no object")
    crs = _crs(path, document)
    check = PolygonChecker(path, crs.is_geographic, _TO_PLACE)
    return Drawn(crs, [check.polygon(rings) for rings in _polygons(path, document)])


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
