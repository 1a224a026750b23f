"""One site in every kind of georeference: a metre of the plan is a metre on the ground, and missions say so."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Geod

from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.errors import InputError
from hrt_cli.missions.mission import MissionOptions
from hrt_cli.missions.stage import export_missions
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.stage import Wanted, segment_file

ORTHO = Path(__file__).parents[2] / "fixtures" / "meadow" / "ortho.tif"
DEGREE = 0.1 / 111_320
KINDS = {
    "utm": ("EPSG:32632", Affine(0.1, 0, 431_000, 0, -0.1, 5_210_000)),
    "degrees, square on the ground": (
        "EPSG:4326",
        Affine(DEGREE / np.cos(np.radians(47)), 0, 8.1, 0, -DEGREE, 47.04),
    ),
    "degrees, square in degrees": ("EPSG:4326", Affine(DEGREE, 0, 8.1, 0, -DEGREE, 47.04)),
    "US survey feet": ("EPSG:2225", Affine(0.328, 0, 6_500_000, 0, -0.328, 2_100_000)),
    "web mercator": ("EPSG:3857", Affine(0.15, 0, 901_000, 0, -0.15, 5_950_000)),
    "rotated": ("EPSG:32632", Affine(0.08, 0.06, 431_000, 0.06, -0.08, 5_210_000)),
    "south up": ("EPSG:32632", Affine(0.1, 0, 431_000, 0, 0.1, 5_210_000)),
}
BUDGET = 40


def put(path: Path, crs: str, transform: Affine) -> Path:
    with rasterio.open(ORTHO) as source:
        pixels = source.read()
    profile = {"driver": "GTiff", "count": 3, "dtype": "uint8", "photometric": "RGB"}
    with rasterio.open(
        path, "w", height=pixels.shape[1], width=pixels.shape[2], crs=crs, transform=transform, **profile
    ) as raster:
        raster.write(pixels)
    return path


def plan_on(ortho: Path, folder: Path) -> Path:
    classes, scoremap, plan = folder / "c.tif", folder / "s.tif", folder / "p.json"
    segment_file([ortho], classes, Wanted(SegmentSpec(4)))
    make_scoremap(classes, scoremap)
    request = PlanRequest((parse_start("auto"),), parse_budget(f"{BUDGET}m"), effort=0.1)
    plan_file(scoremap, plan, request)
    return plan


@pytest.mark.parametrize("kind", KINDS)
def test_a_metre_is_a_metre(kind: str, tmp_path: Path) -> None:
    path = plan_on(put(tmp_path / "ortho.tif", *KINDS[kind]), tmp_path)
    plan = json.loads(path.read_text())
    lon, lat = np.array(plan["lonlat"]).T
    legs_m = Geod(ellps="WGS84").inv(lon[:-1], lat[:-1], lon[1:], lat[1:])[2]
    assert legs_m == pytest.approx(np.ones(BUDGET), rel=1e-3)
    assert plan["length_m"] == pytest.approx(legs_m.sum(), rel=1e-3)
    assert plan["steps"] == BUDGET
    for suffix in ("plan", "waypoints", "gpx", "geojson"):
        export_missions(path, tmp_path / f"m.{suffix}", MissionOptions())


def test_a_placeholder_georeference_gives_no_mission(tmp_path: Path) -> None:
    ortho = put(tmp_path / "ortho.tif", "EPSG:32630", Affine(0.1, 0, 0, 0, -0.1, 0))
    plan = plan_on(ortho, tmp_path)
    assert json.loads(plan.read_text())["grid"]["georeference"] == "fake"
    with pytest.raises(InputError, match="placeholder"):
        export_missions(plan, tmp_path / "m.plan", MissionOptions())
    assert not (tmp_path / "m.plan").exists()
