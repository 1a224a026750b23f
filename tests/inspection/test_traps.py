from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from mapping_files import MOST, NOT_ALPHA, SIDE, heights, model, odm, pix4d_mosaic, pixels, seen, tag
from raster_files import PLACE, patches, write_raster, write_sparse

from hrt_cli.inspection.rasters import inspect_raster

FEET = Affine(0.3, 0, 980_000, 0, -0.3, 200_000)
"""In New York's State Plane, US survey feet."""
DEGREES = Affine(1e-6, 0, 15, 0, -1e-6, 45.15)


def notes(path: Path, **options: Any) -> str:
    return "\n".join(inspect_raster(path, **options).notes)


def test_a_plain_orthomosaic_has_no_trap(tmp_path: Path) -> None:
    assert notes(write_raster(tmp_path / "a.tif", patches())) == ""
    assert notes(odm(tmp_path / "odm_orthophoto.tif")) == ""
    assert notes(pix4d_mosaic(tmp_path / "site_transparent_mosaic_group1.tif", transparent=True)) == ""


def test_a_made_up_place(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches(), crs="EPSG:32630", transform=Affine(0.1, 0, 0, 0, -0.1, 0))
    assert "missions cannot be exported from it" in notes(path)


class TestAlpha:
    def test_a_real_one(self, tmp_path: Path) -> None:
        assert "its alpha band is float32: GDAL and what is built on it" in notes(odm(tmp_path / "a.tif", "float32"))

    def test_255_of_65535(self, tmp_path: Path) -> None:
        assert "its alpha is at most 255 of 65535" in notes(odm(tmp_path / "a.tif", "uint16"))
        assert "its alpha is" not in notes(odm(tmp_path / "b.tif", "uint16", opaque=65535))

    def test_a_changed_range(self, tmp_path: Path) -> None:
        assert "its alpha is at most 1 of 255, as after warping" in notes(odm(tmp_path / "a.tif", opaque=1))

    def test_a_gradual_one(self, tmp_path: Path) -> None:
        alpha = np.where(seen(), np.arange(SIDE) + 30, 0)[np.newaxis].astype(np.uint8)
        path = write_raster(tmp_path / "a.tif", np.concatenate([pixels(), alpha]))
        assert "of its pixels are partly transparent" in notes(path)

    @pytest.mark.parametrize("dtype", MOST)
    def test_one_that_is_not_declared(self, tmp_path: Path, dtype: str) -> None:
        path = odm(tmp_path / "a.tif", dtype, colours=NOT_ALPHA)
        found = notes(path)
        assert "its band 4 holds nothing but 0 and 255, like an alpha band" in found
        assert "gdal_edit.py -colorinterp_4 alpha" in found

    def test_a_fourth_band_of_many_values_is_a_colour(self, tmp_path: Path) -> None:
        found = notes(write_raster(tmp_path / "a.tif", np.concatenate([patches(), patches()[:1]]), colours=NOT_ALPHA))
        assert "like an alpha band" not in found
        assert "band 4 is not declared as alpha and is not used" in found

    def test_nor_is_one_of_three_values_an_alpha_band(self, tmp_path: Path) -> None:
        steps = np.repeat(np.array([0, 128, 255], np.uint8), 32) * np.ones((1, 96, 1), np.uint8)
        found = notes(write_raster(tmp_path / "a.tif", np.concatenate([patches(), steps]), colours=NOT_ALPHA))
        assert "like an alpha band" not in found

    def test_opaque_pixels_without_texture(self, tmp_path: Path) -> None:
        path = odm(tmp_path / "a.tif", "float32")
        assert "no texture" not in notes(path)
        with rasterio.open(path, "r+") as dataset:
            bands = dataset.read()
            bands[:3, 90:100, 50:90] = MOST["float32"]
            dataset.write(bands)
        assert "are 4294967295 in all bands, OpenDroneMap's mark for no texture" in notes(path)


class TestMargins:
    def test_pix4ds_mosaic_without_transparency(self, tmp_path: Path) -> None:
        path = pix4d_mosaic(tmp_path / "site_mosaic_group1.tif", transparent=False)
        assert "--nodata 0 leaves it out; better take its *_transparent_mosaic_*.tif" in notes(path)
        pix4d_mosaic(tmp_path / "site_transparent_mosaic_group1.tif", transparent=True)
        assert "better take site_transparent_mosaic_group1.tif, which lies beside it" in notes(path)
        assert "transparency" not in notes(path, nodata=0)

    def test_nodata_that_lossy_compression_blurred(self, tmp_path: Path) -> None:
        shown = np.where(seen(), pixels(), 0).astype(np.uint8)
        jpeg = {"compress": "jpeg", "photometric": "ycbcr", "tiled": True, "blockxsize": 64, "blockysize": 64}
        path = write_raster(tmp_path / "a.tif", shown, nodata=0, **jpeg)
        assert "its margin is not exactly its nodata value 0 everywhere" in notes(path)
        assert "margin" not in notes(write_raster(tmp_path / "b.tif", shown, mask=seen(), **jpeg))


class TestThermal:
    @pytest.mark.parametrize(
        ("values", "guess"),
        [
            (heights(base=20), "perhaps temperatures in degrees Celsius"),
            (heights(), "temperatures in Kelvin, "),
            ((heights() * 100).astype(np.uint16), "temperatures in centi-Kelvin, "),
            (heights(base=5000), "the unit of its temperatures is not known"),
        ],
    )
    def test_the_unit_is_guessed_and_said_to_be_a_guess(self, tmp_path: Path, values: np.ndarray, guess: str) -> None:
        assert guess in notes(write_raster(tmp_path / "thermal.tif", values))

    def test_a_declared_one_needs_no_guess(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "thermal.tif", heights(base=20))
        with rasterio.open(path, "r+") as dataset:
            dataset.set_band_unit(1, "degC")
        assert "unit" not in notes(path)

    def test_pix4d_balances_its_mosaics(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "site_transparent_mosaic_thermal_ir.tif", heights(base=20))
        assert "balances the colours of its mosaics" in notes(tag(path, TIFFTAG_SOFTWARE="pix4dmapper"))
        path = write_raster(tmp_path / "site_index_thermal_ir.tif", heights(base=20))
        assert "balances" not in notes(tag(path, TIFFTAG_SOFTWARE="pix4dmapper"))

    def test_eight_bits_are_a_picture_of_it(self, tmp_path: Path) -> None:
        assert "a picture of temperatures, not temperatures" in notes(write_raster(tmp_path / "thermal.tif", patches()))


class TestModels:
    @pytest.mark.parametrize("value", [-9999.0, -10000.0, -32767.0])
    def test_nodata_that_nothing_declares(self, tmp_path: Path, value: float) -> None:
        values = heights()
        values[:30] = value
        found = notes(write_raster(tmp_path / "dsm.tif", values))
        assert f"is {value:g}, which nothing declares as nodata" in found
        assert "nothing declares" not in notes(write_raster(tmp_path / "b_dsm.tif", values, nodata=value))
        assert "nothing declares" in notes(write_raster(tmp_path / "c_dsm.tif", values, nodata=-1))

    def test_coarse_pixels(self, tmp_path: Path) -> None:
        assert "its pixels are 0.5 m: obstacles and steps" in notes(model(tmp_path / "dsm.tif", step=5))
        assert "obstacles" not in notes(model(tmp_path / "a_dsm.tif", step=2))

    def test_feet(self, tmp_path: Path) -> None:
        found = notes(write_raster(tmp_path / "dsm.tif", heights(), crs="EPSG:2263", transform=FEET))
        assert "its coordinates are in US survey foot; hrt measures on the ground, where a pixel is 0.09144 x" in found
        assert "its heights may be in US survey foot too; hrt takes them for metres" in found

    def test_a_vertical_part_of_the_crs(self, tmp_path: Path) -> None:
        found = notes(write_raster(tmp_path / "dsm.tif", heights(), crs="EPSG:2263+6360", transform=FEET))
        assert "its CRS is a compound one" in found
        assert "its heights are in US survey foot: hrt makes metres of them" in found
        found = notes(write_raster(tmp_path / "b_dsm.tif", heights(), crs="EPSG:32633+5773"))
        assert "compound" in found
        assert "foot" not in found

    def test_a_scale_that_is_not_applied(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "dsm.tif", (heights() * 100).astype(np.int32))
        with rasterio.open(path, "r+") as dataset:
            dataset.scales, dataset.offsets = (0.01,), (0.0,)
        assert "it declares a scale of 0.01 and an offset of 0, which hrt applies to the heights and the" in notes(path)


def test_degrees(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches(), crs="EPSG:4326", transform=DEGREES)
    assert "its coordinates are degrees; hrt measures on the ground, where a pixel is 0.0786" in notes(path)


def test_a_large_raster_without_overviews(tmp_path: Path) -> None:
    options = {"tiled": True, "compress": "deflate"}
    path = write_sparse(tmp_path / "a.tif", 5000, 64, **options)
    assert "it has no overviews" in notes(path)
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2])
    assert "overviews" not in notes(path)
    assert "overviews" not in notes(write_raster(tmp_path / "b.tif", patches(), transform=PLACE))
