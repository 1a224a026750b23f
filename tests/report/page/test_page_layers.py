"""What a page carries of a raster is what the raster holds, where it holds it."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from affine import Affine
from raster_files import write_raster
from rasterio.crs import CRS

from hrt_cli.artifacts.provenance import record
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.grid import Grid, transform_points
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.raster.windows import Window
from hrt_cli.report.page.frame import Frame, frame_about
from hrt_cli.report.page.layers import (
    class_layer,
    heat_layer,
    picture_layer,
    relief_layer,
    score_layers,
    thinned,
)
from hrt_cli.report.page.pictures import levels, packed

UTM32 = CRS.from_epsg(32632)


def unpacked(text: str, dtype: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype)


def frame_of(grid: Grid) -> Frame:
    lon, lat = grid.lonlat(*grid.xy([0, grid.rows], [0, grid.cols]))
    return frame_about(lon.tolist(), lat.tolist())


def grid_of(rows: int, cols: int, side: float = 1.0) -> Grid:
    return Grid(rows, cols, Affine(side, 0, 431_000, 0, -side, 5_210_000), UTM32)


def write_classes(path: Path, values: np.ndarray, grid: Grid, names: list[str]) -> None:
    with publishing_classes(path, grid, names, record("test", 1, {}, {}), tags={}, creation={}) as writer:
        writer.write(Window(0, 0, *grid.shape), values[None])


def readback(layer: dict[str, Any]) -> np.ndarray:
    value = unpacked(layer["data"], "<u2").reshape(layer["rows"], layer["cols"]).astype(float)
    value[value == 0] = np.nan
    return layer["low"] + (value - 1) / 65534 * (layer["high"] - layer["low"])


def test_levels_keep_values_to_the_65534th_part_and_nan_apart() -> None:
    values = np.array([[0.0, 0.25, np.nan], [1.0, 3.0, 2.9999]], np.float32)
    found = levels(values, 0.0, 3.0)
    assert found[0, 2] == 0
    assert (found[~np.isnan(values)] > 0).all()
    back = (found.astype(float) - 1) / 65534 * 3.0
    np.testing.assert_allclose(back[found > 0], values[found > 0], atol=3.0 / 65534)
    assert (unpacked(packed(found), "<u2").reshape(2, 3) == found).all()


def test_classes_are_carried_pixel_for_pixel_with_their_names_and_shares(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    grid, path = grid_of(40, 56, 0.5), tmp_path / "classes.tif"
    values = rng.choice(np.array([0, 1, 3, 255], np.uint8), grid.shape)
    write_classes(path, values, grid, ["grass", "rock", "", "sand"])
    layer = class_layer(path, frame_of(grid), 2048)
    assert (unpacked(layer["data"], "u1").reshape(grid.shape) == values).all()
    assert [(entry["id"], entry["label"]) for entry in layer["legend"]] == [(0, "grass"), (1, "rock"), (3, "sand")]
    valid = values[values != 255]
    assert [entry["share"] for entry in layer["legend"]] == [float(np.mean(valid == k)) for k in (0, 1, 3)]


def test_scores_no_go_and_sd_are_carried_cell_for_cell(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    grid, path = grid_of(20, 30), tmp_path / "scoremap.tif"
    score = rng.random(grid.shape).astype(np.float32)
    score[3:6, 7:20] = np.nan
    sd = np.where(np.isnan(score), np.nan, 0.1 * score).astype(np.float32)
    publish_scoremap(path, Scoremap(score, sd, grid, 1.0), record("test", 1, {}, {}), tags={}, creation={})
    layers = score_layers(path, frame_of(grid))
    np.testing.assert_allclose(readback(layers["score"]), score, atol=2e-5)
    np.testing.assert_allclose(readback(layers["sd"]), sd, atol=2e-6)
    closed = unpacked(layers["no_go"]["data"], "u1").reshape(grid.shape)
    assert ((closed == 0) == np.isnan(score)).all()


def test_a_layer_lies_where_its_raster_does(tmp_path: Path) -> None:
    grid = Grid(50, 80, Affine.translation(431_000, 5_210_000) @ Affine.rotation(20) @ Affine.scale(1, -1), UTM32)
    path = tmp_path / "turned.tif"
    write_raster(
        path,
        np.random.default_rng(1).integers(0, 255, (3, 50, 80), np.uint8),
        transform=grid.transform,
        crs="EPSG:32632",
    )
    frame = frame_of(grid)
    layer = picture_layer(path, frame, 2048)
    a, b, c, d, e, f = layer["affine"]
    for row, col in ((0, 0), (50, 80), (13, 60)):
        east, north = frame.of_cells(grid, [row], [col])
        assert abs(a * col + b * row + c - east[0]) < 0.05
        assert abs(d * col + e * row + f - north[0]) < 0.05


def test_a_bent_raster_is_resampled_north_up(tmp_path: Path) -> None:
    bent = Grid(1000, 1000, Affine(2e-4, 0, 8.0, 0, -2e-4, 60.0), CRS.from_epsg(4326))
    values = np.random.default_rng(6).integers(0, 200, bent.shape, np.uint8)
    path = tmp_path / "classes.tif"
    write_classes(path, values, bent, [str(k) for k in range(200)])
    frame = frame_of(bent)
    layer = class_layer(path, frame, 2048)
    a, b, c, d, e, f = layer["affine"]
    assert abs(b) + abs(d) < 1e-6 * abs(a)
    ids = unpacked(layer["data"], "u1").reshape(layer["rows"], layer["cols"])
    # From the middles of the layer's pixels near its corners back to the raster: the very pixel that lies there.
    right = total = 0
    for row in (*range(2, 12), *range(layer["rows"] - 12, layer["rows"] - 2)):
        for col in (*range(4, 14), *range(layer["cols"] - 14, layer["cols"] - 4)):
            east, north = a * (col + 0.5) + c, e * (row + 0.5) + f
            lon, lat = transform_points(frame.crs, bent.crs, [east], [north])  # type: ignore[arg-type]
            there_row, there_col = (int(np.floor(each)) for each in bent.rowcol(float(lon[0]), float(lat[0])))
            if 0 <= there_row < 1000 and 0 <= there_col < 1000:
                total += 1
                right += ids[row, col] == values[there_row, there_col]
    assert total > 200
    assert right == total


@pytest.mark.parametrize(("rows", "cols", "most"), [(100, 37, 40), (4, 4, 256), (1000, 999, 256), (7, 300, 100)])
def test_thinning_keeps_the_place(rows: int, cols: int, most: int) -> None:
    grid = grid_of(rows, cols)
    step, found = thinned(grid, most)
    assert max(found.shape) <= most
    assert found.xy([1], [1]) == grid.xy([step], [step])
    assert (found.rows - 1) * step < rows <= found.rows * step


def test_a_picture_is_thinned_and_what_is_not_valid_is_clear(tmp_path: Path) -> None:
    rgb = np.full((3, 90, 120), 200, np.uint8)
    rgb[:, :, ::2] = 90
    alpha = np.full((1, 90, 120), 255, np.uint8)
    alpha[:, :, :40] = 0
    path = tmp_path / "ortho.tif"
    grid = grid_of(90, 120)
    write_raster(
        path, np.concatenate([rgb, alpha]), transform=grid.transform, crs="EPSG:32632", photometric="RGB", alpha="YES"
    )
    layer = picture_layer(path, frame_of(grid), 40)
    assert (layer["rows"], layer["cols"]) == (30, 40)
    data = np.frombuffer(base64.b64decode(layer["href"].split(",")[1]), np.uint8)
    rgba = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert (rgba[:, :12, 3] == 0).all()
    assert (rgba[:, 15:, 3] == 255).all()


def test_what_is_thinned_out_is_the_mean_of_what_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hrt_cli.report.page.layers._STRIP_PX", 300)  # several strips
    grid = grid_of(70, 51)
    height = np.random.default_rng(5).uniform(100, 200, grid.shape).astype(np.float32)
    height[10:25, 5:20] = -9999  # a void that nothing declares
    write_raster(tmp_path / "dsm.tif", height[None], transform=grid.transform, crs="EPSG:32632")
    layer = relief_layer(tmp_path / "dsm.tif", frame_of(grid), 16)
    assert (layer["rows"], layer["cols"]) == (14, 11)
    found = readback(layer)
    for row, col in ((0, 0), (13, 10), (3, 2), (4, 1), (5, 9)):
        square = height[5 * row : 5 * row + 5, 5 * col : 5 * col + 5]
        known = square[square > 0]
        if known.size:
            assert found[row, col] == pytest.approx(float(known.mean()), abs=2e-3)
        else:
            assert np.isnan(found[row, col])


def test_heat_is_in_degrees_and_heights_in_metres(tmp_path: Path) -> None:
    grid = grid_of(30, 30)
    kelvin = np.random.default_rng(2).uniform(285, 330, grid.shape).astype(np.float32)
    write_raster(tmp_path / "thermal.tif", kelvin[None], transform=grid.transform, crs="EPSG:32632")
    layer = heat_layer(tmp_path / "thermal.tif", frame_of(grid), 2048)
    assert "°C" in layer["label"]
    np.testing.assert_allclose(readback(layer), kelvin - 273.15, atol=2e-3)
    slope = np.arange(30, dtype=np.float32)[None, :].repeat(30, axis=0) * 0.5 + 400
    write_raster(tmp_path / "dsm.tif", slope[None], transform=grid.transform, crs="EPSG:32632")
    relief = relief_layer(tmp_path / "dsm.tif", frame_of(grid), 2048)
    np.testing.assert_allclose(readback(relief), slope, atol=2e-3)
    data = np.frombuffer(base64.b64decode(relief["href"].split(",")[1]), np.uint8)
    shade = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)[5:-5, 5:-5, 0].astype(float)
    # A plane that rises to the east by 1 in 2, lit from the north-west at 45 degrees: Lambert's law by hand.
    normal = np.array([-0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0)
    sun = np.array([-np.sqrt(0.5) * np.sqrt(0.5), np.sqrt(0.5) * np.sqrt(0.5), np.sqrt(0.5)])
    assert abs(shade.mean() - 255 * float(normal @ sun)) < 4
