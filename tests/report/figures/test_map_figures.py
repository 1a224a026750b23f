"""Layers lie where they belong on the picture, and a figure is an artifact like any other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import record
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import InputError, OutputError
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.report.figures.canvas import round_length
from hrt_cli.report.figures.layers import extent_on, place_on
from hrt_cli.report.figures.maps import draw_plan, draw_scoremap

FIXTURE = Path(__file__).parents[3] / "fixtures" / "meadow" / "ortho.tif"
GRIDS = {
    "utm": Grid(300, 400, Affine(0.1, 0, 431_000, 0, -0.1, 5_210_000), CRS.from_epsg(32632)),
    "rotated": Grid(300, 400, Affine(0.08, 0.06, 431_000, 0.06, -0.08, 5_210_000), CRS.from_epsg(32632)),
    "south up": Grid(300, 400, Affine(0.1, 0, 431_000, 0, 0.1, 5_210_000), CRS.from_epsg(32632)),
    "degrees": Grid(300, 400, Affine(1e-6, 0, 8.1, 0, -1e-6, 47), CRS.from_epsg(4326)),
    "unreferenced": Grid(300, 400, Affine.identity(), None),
}


@pytest.mark.parametrize("name", GRIDS)
def test_cells_are_placed_in_ground_metres_of_the_backdrop(name: str) -> None:
    base = GRIDS[name]
    row_m, col_m = base.pixel_m
    # The middle of a pixel of the backdrop lies at its own distance from the first corner.
    right, down = place_on(base, base, [10.5], [20.5])
    assert (down[0], right[0]) == pytest.approx((10.5 * row_m, 20.5 * col_m), rel=1e-6)
    if base.crs is not None:
        right, down = place_on(base.coarse(2.0), base, [3.5], [4.5])
        assert (down[0], right[0]) == pytest.approx((7.0, 9.0), rel=1e-5)


def test_extent_is_left_right_bottom_top() -> None:
    left, right, bottom, top = extent_on(GRIDS["utm"], GRIDS["utm"])
    assert (left, top) == (0.0, 0.0)
    assert (right, bottom) == pytest.approx((40.0, 30.0), rel=2e-3)


@pytest.mark.parametrize(("length", "shown"), [(9.9, 5), (10, 10), (21, 20), (49.9, 20), (0.7, 0.5)])
def test_scale_bars_are_round(length: float, shown: float) -> None:
    assert round_length(length) == pytest.approx(shown)


@pytest.fixture
def scoremap(tmp_path: Path) -> Path:
    score = np.full((30, 40), 0.8, np.float32)
    score[:, 20:] = np.nan
    grid = GRIDS["utm"].coarse(1.0)
    sd = np.where(np.isnan(score), np.nan, 0).astype(np.float32)
    path = tmp_path / "s.tif"
    publish_scoremap(path, Scoremap(score, sd, grid, 1.0), record("test", 1, {}, {}), tags={}, creation={})
    return path


def test_no_go_ground_looks_different(scoremap: Path, tmp_path: Path) -> None:
    assert not draw_scoremap(scoremap, tmp_path / "s.png", backdrop=None, existing=REFUSE)
    picture = cv2.imread(str(tmp_path / "s.png")).astype(int)
    rows, cols = picture.shape[:2]
    go, no_go = picture[rows // 2, cols // 4], picture[rows // 2, cols * 6 // 10]
    assert np.abs(go - no_go).max() > 60
    assert np.ptp(no_go) < 10  # grey


def test_a_figure_is_cached_and_signed(scoremap: Path, tmp_path: Path) -> None:
    plan, figure = tmp_path / "p.json", tmp_path / "p.png"
    plan_file(scoremap, plan, PlanRequest((parse_start("cell:5,5"),), parse_budget("30"), effort=0.1))
    assert not draw_plan(plan, scoremap, figure, backdrop=None, existing=REFUSE)
    before = figure.read_bytes()
    assert draw_plan(plan, scoremap, figure, backdrop=None, existing=REFUSE)
    assert not draw_plan(plan, scoremap, figure, backdrop=None, existing=Existing(force=True))
    assert figure.read_bytes() == before
    found = png_provenance(figure)
    assert found is not None
    assert {each.role for each in found.inputs} == {"plan", "scoremap"}
    figure.write_bytes(before[:-1])
    with pytest.raises(OutputError, match="--overwrite"):
        draw_plan(plan, scoremap, figure, backdrop=None, existing=REFUSE)


def test_a_backdrop_of_another_place_is_refused(scoremap: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.tif"
    grid = Grid(30, 40, Affine(1, 0, 431_000, 0, -1, 5_210_000), CRS.from_epsg(32633))
    score = np.full(grid.shape, 0.5, np.float32)
    publish_scoremap(other, Scoremap(score, score, grid, 1.0), record("test", 1, {}, {}), tags={}, creation={})
    with pytest.raises(InputError, match="reference systems"):
        draw_scoremap(other, tmp_path / "o.png", backdrop=FIXTURE, existing=REFUSE)
    assert not (tmp_path / "o.png").exists()
