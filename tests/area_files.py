"""Areas drawn at random about a small map, as the files that people draw them in, and the classes of the map."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from affine import Affine
from hypothesis import assume
from hypothesis import strategies as st
from pyproj import Transformer
from raster_files import write_raster

from hrt_cli.raster.grid import Grid

LON, LAT = 15.2, 47.1
LOCAL = f"+proj=laea +lat_0={LAT} +lon_0={LON} +datum=WGS84"
"""The projection of the tests: metres from the middle of the map."""
SIDE_PX, PIXEL_M = 72, 0.25
HALF_M = SIDE_PX * PIXEL_M / 2
GRIDS = {"utm": ("EPSG:32633", 0, 1.0), "turned": ("EPSG:32633", 31, 1.0), "mercator": ("EPSG:3857", 200, 1.469),
         "degrees": ("EPSG:4326", 0, 0.0)}  # fmt: skip


@functools.cache
def between(source: str, target: str) -> Transformer:
    return Transformer.from_crs(source, target, always_xy=True)


def moved(shape: Any, source: str, target: str) -> Any:
    transformer = between(source, target)
    return shapely.transform(shape, lambda p: np.stack(transformer.transform(p[:, 0], p[:, 1]), axis=1))


def classes_on(folder: Path, grid: str, seed: int = 0) -> Path:
    """Write classes of pixels of about 25 cm about the middle of the local projection."""
    crs, turn, scale = GRIDS[grid]
    x, y = between(LOCAL, crs).transform(0, 0)
    size = (PIXEL_M * scale, -PIXEL_M * scale) if scale else (PIXEL_M / 75_980, -PIXEL_M / 111_180)
    middle = Affine.translation(-SIDE_PX / 2, -SIDE_PX / 2)
    place = Affine.translation(x, y) @ Affine.rotation(turn) @ Affine.scale(*size) @ middle
    rng = np.random.default_rng(seed)
    values = np.kron(rng.integers(0, 3, (SIDE_PX // 8, SIDE_PX // 8)), np.ones((8, 8))).astype(np.uint8)
    return write_raster(folder / f"{grid}.tif", values, crs=crs, transform=place, nodata=255)


def as_geojson(shape: Any, crs: str) -> str:
    document = {
        "type": "FeatureCollection",
        "features": [{"type": "Feature", "geometry": shapely.geometry.mapping(shape)}],
    }
    if crs != "EPSG:4326":
        document["crs"] = {"type": "name", "properties": {"name": crs}}
    return json.dumps(document)


def as_kml(shape: Any) -> str:
    def ring(each: Any) -> str:
        points = " ".join(f"{x!r},{y!r}" for x, y in shapely.get_coordinates(each).tolist())
        return f"<LinearRing><coordinates>{points}</coordinates></LinearRing>"

    polygons = (
        f"<Polygon><outerBoundaryIs>{ring(part.exterior)}</outerBoundaryIs>"
        + "".join(f"<innerBoundaryIs>{ring(hole)}</innerBoundaryIs>" for hole in part.interiors)
        + "</Polygon>"
        for part in shapely.get_parts(shape)
    )
    body = f"<Placemark><MultiGeometry>{''.join(polygons)}</MultiGeometry></Placemark>"
    return f'<kml xmlns="http://www.opengis.net/kml/2.2">{body}</kml>'


def drawn(folder: Path, name: str, shape: Any, form: str = "EPSG:4326") -> Path:
    """Write polygons of the local projection as KML, or as GeoJSON in a CRS."""
    path = folder / (f"{name}.kml" if form == "kml" else f"{name}.geojson")
    crs = "EPSG:4326" if form == "kml" else form
    there = moved(shape, LOCAL, crs)
    path.write_text(as_kml(there) if form == "kml" else as_geojson(there, crs))
    return path


def crs_of(grid: Grid) -> str:
    text = grid.crs_text()
    assert text is not None
    return text


@st.composite
def polygons(draw: st.DrawFn, largest_m: float) -> Any:
    """Draw polygons with holes in metres about the middle, from a few centimetres to beyond the map."""
    parts = []
    for _ in range(draw(st.integers(1, 3))):
        x, y = draw(st.floats(-HALF_M, HALF_M)), draw(st.floats(-HALF_M, HALF_M))
        count = draw(st.integers(3, 8))
        radii = np.array(draw(st.lists(st.floats(0.3, 1), min_size=count, max_size=count)))
        size = draw(st.sampled_from([0.05, largest_m / 4, largest_m]))
        angles = np.arange(count) / count * 2 * np.pi
        shape = shapely.Polygon([x, y] + (radii * size)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))
        if draw(st.booleans()):
            shape = shape.difference(shapely.Point(x, y).buffer(size * draw(st.floats(0.1, 0.8)), quad_segs=4))
        parts.append(shape)
    # Rings that touch in one point may cross once they lie in another CRS.
    shape = shapely.union_all(parts).buffer(-1e-3, join_style="mitre")
    assume(not shape.is_empty)
    return shape


FORMS = st.sampled_from(["kml", "EPSG:4326", "EPSG:32633", "EPSG:3857"])
