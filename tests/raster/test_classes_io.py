from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from raster_files import PLACE, UTM33, write_raster
from rasterio.crs import CRS

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.raster.classes import open_classes, publishing_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window

WHOLE = Window(0, 0, 20, 30)


def ids(dtype: str = "uint8") -> np.ndarray:
    return np.random.default_rng(0).integers(0, 6, (20, 30)).astype(dtype)


def read(path: Path) -> np.ndarray:
    with open_classes(path) as classes:
        return classes.read(WHOLE)


def test_what_is_published_is_read(tmp_path: Path) -> None:
    values = ids()
    values[4] = 255
    names = ["grass", "sand", "é", "", "a b", 'say "5"']
    grid = Grid(20, 30, PLACE, CRS.from_string(UTM33))
    path = tmp_path / "classes.tif"
    with publishing_classes(path, grid, names, record("t", 1, {}, {}), tags={"k": [1]}, creation={}) as writer:
        writer.write(WHOLE, values)
    with open_classes(path) as classes:
        assert classes.names == names
        assert classes.grid == grid
        found = classes.read(Window(2, 3, 10, 20))
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, values[2:12, 3:23])


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "int32", "uint32", "int64"])
def test_any_whole_type_will_do(tmp_path: Path, dtype: str) -> None:
    found = read(write_raster(tmp_path / "a.tif", ids(dtype)))
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, ids())


@pytest.mark.parametrize(
    ("dtype", "nodata"), [("uint8", 255), ("uint8", 0), ("int16", -1), ("int32", -9999), ("uint16", 65535)]
)
def test_the_declared_value_is_nodata(tmp_path: Path, dtype: str, nodata: int) -> None:
    values = ids(dtype)
    values[4] = nodata
    found = read(write_raster(tmp_path / "a.tif", values, nodata=nodata))
    np.testing.assert_array_equal(found == 255, values == nodata)
    np.testing.assert_array_equal(found[found != 255], values[values != nodata])


def test_255_is_nodata_where_nothing_is_declared(tmp_path: Path) -> None:
    values = ids()
    values[4] = 255
    np.testing.assert_array_equal(read(write_raster(tmp_path / "a.tif", values)), values)


def test_a_mask_is_nodata_whatever_it_hides(tmp_path: Path) -> None:
    values, mask = ids("int16"), np.ones((20, 30), bool)
    mask[4] = False
    values[4] = -77
    found = read(write_raster(tmp_path / "a.tif", values, mask=mask))
    np.testing.assert_array_equal(found == 255, ~mask)


@pytest.mark.parametrize(
    ("dtype", "value", "nodata"),
    [
        ("int16", -1, None),
        ("int8", -1, None),
        ("int16", -1, -9999),
        ("int16", 255, None),
        ("uint16", 300, None),
        ("uint8", 255, 0),
        ("uint16", 65535, 255),
    ],
)
def test_what_is_no_class_id_is_refused(tmp_path: Path, dtype: str, value: int, nodata: int | None) -> None:
    values = ids(dtype)
    values[7, 8] = value
    path = write_raster(tmp_path / "a.tif", values, nodata=nodata)
    with pytest.raises(InputError, match=rf"holds the value {value}, which is no class id"):
        read(path)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_real_numbers_are_refused(tmp_path: Path, dtype: str) -> None:
    with pytest.raises(InputError, match=f"type {dtype}; class ids are whole numbers"):
        read(write_raster(tmp_path / "a.tif", ids(dtype)))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_more_than_one_band_is_refused(tmp_path: Path, count: int) -> None:
    with pytest.raises(InputError, match=f"has {count} bands; a class raster has one"):
        read(write_raster(tmp_path / "a.tif", np.stack([ids()] * count)))


def test_no_crs_is_refused_unless_it_is_asked_for(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", ids(), crs=None, transform=None)
    with pytest.raises(InputError, match="no coordinate reference system"):
        read(path)
    with open_classes(path, unreferenced=True) as classes:
        assert classes.grid.transform == Affine.identity()
        np.testing.assert_array_equal(classes.read(WHOLE), ids())


def test_a_foreign_raster_has_no_names(tmp_path: Path) -> None:
    with open_classes(write_raster(tmp_path / "a.tif", ids())) as classes:
        assert classes.names == []


@pytest.mark.parametrize("text", ["[", "5", '{"0": "grass"}', "[1, 2]", "null", "[" * 100_000])
def test_damaged_names_are_refused(tmp_path: Path, text: str) -> None:
    path = write_raster(tmp_path / "a.tif", ids())
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(ns="HRT", NAMES=text)
    with pytest.raises(InputError, match=re.escape(f"{path}: its class names are damaged")):
        read(path)


def test_damage_is_named(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", ids(), compress="deflate")
    stored = path.read_bytes()
    with rasterio.open(path) as dataset:
        offset = int(dataset.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))
    path.write_bytes(stored[:offset] + bytes(40) + stored[offset + 40 :])
    with pytest.raises(InputError, match="damaged or cut short"):
        read(path)
