from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from mission_samples import SQUARE, sample_plan, waypoint_cells
from pyproj import Transformer

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import InputError
from hrt_cli.missions.mission import MissionOptions
from hrt_cli.missions.stage import export_missions


def box_on(plan: PlanDocument, rows: tuple[float, float], cols: tuple[float, float]) -> list[tuple[float, float]]:
    """A closed ring in WGS 84 around cells of the plan's grid, counted from its start."""
    a, b, c, d, e, f = plan.grid.transform
    to_degrees = Transformer.from_crs(plan.grid.crs, "EPSG:4326", always_xy=True)
    row0, col0 = plan.start
    corners = [(rows[i], cols[j]) for i, j in ((0, 0), (0, 1), (1, 1), (1, 0), (0, 0))]
    places = [(row + row0, col + col0) for row, col in corners]
    return [to_degrees.transform(a * col + b * row + c, d * col + e * row + f) for row, col in places]


def put(path: Path, *polygons: list[list[tuple[float, float]]]) -> Path:
    path.write_text(json.dumps({"type": "MultiPolygon", "coordinates": polygons}))
    return path


@pytest.fixture
def plan(tmp_path: Path) -> tuple[PlanDocument, Path]:
    document = sample_plan(SQUARE)
    path = tmp_path / "plan.json"
    path.write_text(document.model_dump_json(exclude={"provenance"}))
    return document, path


def polygons_in(path: Path) -> list[tuple[bool, shapely.Polygon]]:
    fence = json.loads(path.read_text())["geoFence"]["polygons"]
    return [(each["inclusion"], shapely.Polygon([(lon, lat) for lat, lon in each["polygon"]])) for each in fence]


def test_the_areas_become_polygons_without_holes(plan: tuple[PlanDocument, Path], tmp_path: Path) -> None:
    document, path = plan
    outer = box_on(document, (-3, 8), (-3, 8))
    hole = box_on(document, (1.5, 3.5), (1.5, 3.5))  # inside the square that the robot drives round
    elsewhere = box_on(document, (20, 30), (20, 30))
    aoi = put(tmp_path / "aoi.geojson", [outer, hole], [elsewhere])
    ring = put(
        tmp_path / "ring.geojson", [box_on(document, (-9, 14), (-9, 14)), box_on(document, (-2, 7), (-2, 7))]
    )
    out = tmp_path / "m.plan"
    export_missions(path, out, MissionOptions(), aoi_path=aoi, keep_out_paths=[ring])
    found = polygons_in(out)
    keep_in = [shape for inclusion, shape in found if inclusion]
    assert len(keep_in) == 1, "of two areas the one that the mission lies in"
    assert keep_in[0].equals(shapely.Polygon(np.round(outer, 8)))
    keep_out = shapely.union_all([shape for inclusion, shape in found if not inclusion])
    wanted = shapely.union_all(
        [
            shapely.Polygon(hole),
            shapely.Polygon(box_on(document, (-9, 14), (-9, 14)), [box_on(document, (-2, 7), (-2, 7))]),
        ]
    )
    assert keep_out.symmetric_difference(wanted).area < 1e-3 * wanted.area  # positions are rounded to a millimetre
    line = shapely.LineString([document.lonlat[w.step] for w in document.waypoints])
    assert keep_in[0].contains(line)
    assert not keep_out.intersects(line)


def test_a_mission_that_leaves_its_area_or_enters_a_keep_out_is_refused(
    plan: tuple[PlanDocument, Path], tmp_path: Path
) -> None:
    document, path = plan
    assert waypoint_cells(document)
    out = tmp_path / "m.plan"
    small = put(tmp_path / "aoi.geojson", [box_on(document, (-1, 3), (-1, 8))])
    with pytest.raises(InputError, match=r"waypoints 2 and 3 the mission leaves the area of interest .*aoi.geojson"):
        export_missions(path, out, MissionOptions(), aoi_path=small)
    post = put(tmp_path / "post.geojson", [box_on(document, (4.49, 4.51), (2.2, 2.21))])
    with pytest.raises(InputError, match=r"waypoints 3 and 4 the mission enters the keep-out .*post.geojson"):
        export_missions(path, out, MissionOptions(), keep_out_paths=[post])
    assert not out.exists()


def test_formats_without_a_fence_say_so(plan: tuple[PlanDocument, Path], tmp_path: Path) -> None:
    document, path = plan
    aoi = put(tmp_path / "aoi.geojson", [box_on(document, (-3, 8), (-3, 8))])
    done = export_missions(path, tmp_path / "m.waypoints", MissionOptions(), aoi_path=aoi)
    assert any("no geofence" in note for note in done.notes)
    done = export_missions(path, tmp_path / "m.plan", MissionOptions(), aoi_path=aoi)
    assert not any("no geofence" in note for note in done.notes)
