"""The flow on real orthomosaics: right grids out, missions that other programs read, waypoints on their cells."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import gpxpy
import numpy as np
import pytest
import rasterio
from pymavlink.mavwp import MAVWPLoader
from pyproj import Geod, Transformer
from rio_cogeo.cogeo import cog_validate

DATA = Path(__file__).parents[2].parent / "shared" / "data"
SITES = {
    "brighton": ("brighton_beach/ortho_3cm.tif", "1.0"),
    "caliterra": ("caliterra/ortho_5cm.tif", "1.0"),
    "pix4d": ("pix4d_fields/pix4d_alpha_nodata.tif", "1.0"),
    "australia": ("australia/ortho_18mm_nodata0.tif", "0.5"),
    "savanna": ("savanna/ortho_10cm.tif", "1.0"),
}
TOLERANCE_M = 0.02
WGS84 = Geod(ellps="WGS84")

pytestmark = [pytest.mark.real, pytest.mark.slow]


def hrt(*args: str | Path) -> None:
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("site", SITES)
def test_flow_on_a_real_orthomosaic(site: str, tmp_path: Path) -> None:
    name, cell_m = SITES[site]
    ortho = DATA / name
    if not ortho.exists():
        pytest.skip(f"no real data at {DATA}")
    classes, scoremap, plan_path = tmp_path / "c.tif", tmp_path / "s.tif", tmp_path / "p.json"
    hrt("segment", ortho, "-o", classes, "-K", "5", "--workers", "2")
    hrt("scoremap", classes, "-o", scoremap, "--cell", cell_m)
    hrt("plan", scoremap, "-o", plan_path, "--start", "auto", "--budget", "300")
    for suffix in ("plan", "waypoints", "gpx", "geojson"):
        hrt("export", plan_path, "-o", tmp_path / f"m.{suffix}")

    with rasterio.open(ortho) as source, rasterio.open(classes) as out, rasterio.open(scoremap) as cells:
        assert out.crs == source.crs == cells.crs
        assert out.shape == source.shape
        assert (out.nodata, out.dtypes) == (255, ("uint8",))
        assert len({out.colormap(1)[k] for k in range(5)}) == 5
        values = out.read(1)
        # Every pixel of the five classes is one that the orthomosaic has data for.
        alpha = source.colorinterp[-1] == rasterio.enums.ColorInterp.alpha
        valid = source.read(source.count) > 0 if alpha else source.dataset_mask() > 0
        assert set(np.unique(values)) <= {*range(5), 255}
        assert not ((values != 255) & ~valid).any()
        assert (values != 255).sum() > 0.95 * valid.sum()
        score = cells.read(1)
    assert cog_validate(classes)[0]
    assert cog_validate(scoremap)[0]

    plan = json.loads(plan_path.read_text())
    walk = plan["cells"]
    assert plan["steps"] == 300 == len(walk) - 1
    assert all(abs(r1 - r0) + abs(c1 - c0) == 1 for (r0, c0), (r1, c1) in itertools.pairwise(walk))
    assert all(np.isfinite(score[r, c]) for r, c in walk)
    assert plan["score"] == pytest.approx(sum(float(score[r, c]) for r, c in {tuple(cell) for cell in walk}))
    assert plan["score"] <= plan["upper_bound"] * (1 + 1e-9)

    truth = cell_centres_lonlat(scoremap, [w["cell"] for w in plan["waypoints"]])
    loader = MAVWPLoader()
    loader.load(str(tmp_path / "m.waypoints"))
    wpl = [(w.y, w.x) for w in (loader.wp(i) for i in range(1, loader.count())) if w.command == 16]
    gpx = gpxpy.parse((tmp_path / "m.gpx").read_text()).routes[0].points
    qgc = json.loads((tmp_path / "m.plan").read_text())["mission"]["items"]
    features = json.loads((tmp_path / "m.geojson").read_text())["features"]
    found = {
        "wpl": wpl,
        "gpx": [(p.longitude, p.latitude) for p in gpx],
        "qgc": [(i["params"][5], i["params"][4]) for i in qgc if i["command"] == 16],
        "geojson": [tuple(f["geometry"]["coordinates"]) for f in features if f["geometry"]["type"] == "Point"],
    }
    for form, points in found.items():
        assert len(points) == len(truth), form
        lon, lat = np.array(points).T
        off_m = WGS84.inv(truth[:, 0], truth[:, 1], lon, lat)[2]
        assert off_m.max() < TOLERANCE_M, (form, off_m.max())


def cell_centres_lonlat(scoremap: Path, cells: list[list[int]]) -> np.ndarray:
    with rasterio.open(scoremap) as raster:
        to_wgs84 = Transformer.from_crs(raster.crs, "EPSG:4326", always_xy=True)
        xy = [raster.transform @ (c + 0.5, r + 0.5) for r, c in cells]
    return np.array([to_wgs84.transform(x, y) for x, y in xy])
