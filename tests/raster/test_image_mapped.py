"""Orthomosaics as mapping programs write them: what is data must be exactly what their alpha band says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from mapping_files import MOST, NOT_ALPHA, SCALE, SIDE, as_cog, odm, pix4d_mosaic, pixels, seen
from numpy.typing import NDArray
from raster_files import PLACE, RGB, RGBA, UTM33, patches, write_raster

from hrt_cli.errors import InputError
from hrt_cli.raster.image import open_image, open_orthomosaic
from hrt_cli.raster.windows import Window

SHARED = Path(__file__).parents[3] / "shared" / "data"
real = [pytest.mark.real, pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data is absent")]

LAYOUTS = {
    "tiles": {},
    "strips": {"tiled": False, "blockxsize": None, "blockysize": None, "compress": None, "predictor": 1},
    "band by band": {"interleave": "band"},
    "lzw": {"compress": "lzw"},
}


def read(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_], list[str]]:
    with open_image(path) as image:
        return *image.read(Window(0, 0, *image.shape)), image.notes


def is_as_seen(path: Path) -> None:
    """Check mask and colours of an orthomosaic that `pixels` went into."""
    rgb, valid, _ = read(path)
    np.testing.assert_array_equal(valid, seen())
    np.testing.assert_array_equal(rgb[valid], np.moveaxis(pixels(), 0, -1)[seen()])


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", MOST)
def test_the_mask_is_the_alpha_band_in_every_type_and_layout(tmp_path: Path, dtype: str, layout: str) -> None:
    options = {name: value for name, value in LAYOUTS[layout].items() if value is not None}
    path = odm(tmp_path / "odm_orthophoto.tif", dtype, **options)
    is_as_seen(path)
    with open_image(path) as image:
        assert image.valid_share == pytest.approx(seen().mean())
        if dtype != "uint8":
            assert image.stretch is not None
            assert (image.stretch.low, image.stretch.high) == (0, pytest.approx(255 * SCALE[dtype]))


@pytest.mark.parametrize(("dtype", "opaque"), [("uint8", 1), ("uint16", 65535), ("uint16", 1), ("float32", 65535.0)])
def test_the_mask_is_the_alpha_band_whatever_range_warping_gave_it(tmp_path: Path, dtype: str, opaque: float) -> None:
    is_as_seen(odm(tmp_path / "a.tif", dtype, opaque=opaque))


@pytest.mark.parametrize("dtype", MOST)
def test_partly_transparent_pixels_are_data(tmp_path: Path, dtype: str) -> None:
    path = odm(tmp_path / "a.tif", dtype)
    with rasterio.open(path, "r+") as dataset:
        alpha = dataset.read(4)
        alpha[::3] = (alpha[::3] * 0.01).astype(dtype)  # 2 of 255, but 0 stays 0
        dataset.write(alpha, 4)
    is_as_seen(path)


@pytest.mark.parametrize("dtype", MOST)
def test_a_cog_is_read_like_the_original(tmp_path: Path, dtype: str) -> None:
    is_as_seen(as_cog(odm(tmp_path / "a.tif", dtype), tmp_path / "cog.tif"))


@pytest.mark.parametrize("dtype", MOST)
def test_alpha_declared_after_the_pixels_were_written_still_counts(tmp_path: Path, dtype: str) -> None:
    path = odm(tmp_path / "a.tif", dtype, colours=None)
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = RGBA
    is_as_seen(path)


@pytest.mark.parametrize("outside", [np.nan, -1.0, 0.0])
def test_a_real_alpha_band_may_hold_what_is_no_number(tmp_path: Path, outside: float) -> None:
    bands = np.concatenate([pixels() / 255, np.where(seen(), 255, outside)[np.newaxis]]).astype(np.float32)
    is_as_seen(write_raster(tmp_path / "a.tif", bands, colours=RGBA))


def test_real_values_without_texture_are_no_data_even_where_they_are_opaque(tmp_path: Path) -> None:
    path = odm(tmp_path / "a.tif", "float32")
    hole = (slice(80, 110), slice(60, 100))
    with rasterio.open(path, "r+") as dataset:
        bands = dataset.read()
        bands[:3, *hole] = MOST["float32"]
        bands[0, 130:140, 60:80] = MOST["float32"]  # one band alone is a measurement, if an odd one
        dataset.write(bands)
    expected = seen()
    expected[hole] = False
    _, valid, notes = read(path)
    np.testing.assert_array_equal(valid, expected)
    assert "e+09" not in notes[0]


def test_untextured_pixels_of_an_alpha_band_that_is_not_declared_do_not_spoil_the_stretch(tmp_path: Path) -> None:
    _, valid, notes = read(odm(tmp_path / "a.tif", "float32", colours=NOT_ALPHA))
    np.testing.assert_array_equal(valid, seen())
    assert notes[0].startswith("bands 1, 2, 3 are taken as colour; band 4 is not declared as alpha")
    assert notes[1] == "its float32 values are stretched to 8 bits: 0 to 0, 1 to 255"


def test_whole_numbers_without_texture_are_told_of_where_nothing_masks_them(tmp_path: Path) -> None:
    path = odm(tmp_path / "a.tif", "uint16", colours=NOT_ALPHA)
    *_, valid, notes = read(path)
    assert valid.all()
    share = 1 - (seen() & (pixels() < 255).any(axis=0)).mean()
    assert any(f"{share:.0%} of its valid pixels are 65535 in all bands" in note for note in notes)
    with open_image(path, nodata=65535) as image:
        assert not image.read(Window(0, 0, 5, 5))[1].any()
        assert not any("65535 in all bands" in note for note in image.notes)


class TestLossy:
    """Compression with loss leaves ripples of alpha about the step from 0 to 255."""

    @pytest.fixture
    def black(self, tmp_path: Path) -> Path:
        """Return an orthomosaic that is black, not white, where nothing was seen: ripples show as dark fringes."""
        bands = np.where(seen(), np.concatenate([patches(SIDE, SIDE), np.full((1, SIDE, SIDE), 255, np.uint8)]), 0)
        return write_raster(tmp_path / "plain.tif", bands.astype(np.uint8), colours=RGBA)

    def check(self, path: Path) -> None:
        with rasterio.open(path) as dataset:
            assert ((dataset.read(4) > 0) != seen()).sum() > 100
        _, valid, notes = read(path)
        assert (valid != seen()).sum() <= 3
        assert notes == ["its alpha band is compressed with loss: pixels count as data where it is more than 127"]

    def test_jpeg_in_a_geotiff(self, tmp_path: Path, black: Path) -> None:
        rasterio.shutil.copy(black, tmp_path / "a.tif", driver="GTiff", COMPRESS="JPEG", INTERLEAVE="PIXEL")
        self.check(tmp_path / "a.tif")

    def test_jpeg_2000(self, tmp_path: Path, black: Path) -> None:
        rasterio.shutil.copy(black, tmp_path / "a.jp2", driver="JP2OpenJPEG", QUALITY="12")
        self.check(tmp_path / "a.jp2")

    def test_a_vrt_of_it(self, tmp_path: Path, black: Path) -> None:
        rasterio.shutil.copy(black, tmp_path / "a.tif", driver="GTiff", COMPRESS="JPEG", INTERLEAVE="PIXEL")
        self.check(vrt(tmp_path / "a.vrt", ["Byte"] * 4, ["a.tif"] * 4))

    def test_lossless_kinds_keep_every_trace_of_alpha(self, tmp_path: Path, black: Path) -> None:
        rasterio.shutil.copy(black, tmp_path / "a.jp2", driver="JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES")
        rasterio.shutil.copy(black, tmp_path / "a.tif", driver="GTiff", COMPRESS="WEBP")
        for name in ("a.jp2", "a.tif"):
            _, valid, notes = read(tmp_path / name)
            np.testing.assert_array_equal(valid, seen())
            assert notes == []


def vrt(path: Path, types: list[str], sources: list[str]) -> Path:
    """Write a VRT of bands that may differ in type."""
    bands = "".join(
        f'<VRTRasterBand dataType="{dtype}" band="{band}"><ColorInterp>{colour}</ColorInterp><SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{source}</SourceFilename><SourceBand>{band}</SourceBand></SimpleSource>'
        "</VRTRasterBand>"
        for band, (dtype, source, colour) in enumerate(
            zip(types, sources, ("Red", "Green", "Blue", "Alpha"), strict=True), start=1
        )
    )
    place = ",".join(map(str, PLACE.to_gdal()))
    path.write_text(
        f'<VRTDataset rasterXSize="{SIDE}" rasterYSize="{SIDE}"><SRS>{UTM33}</SRS>'
        f"<GeoTransform>{place}</GeoTransform>{bands}</VRTDataset>"
    )
    return path


class TestTypesThatDiffer:
    def test_alpha_may_be_of_another_type_than_the_colours(self, tmp_path: Path) -> None:
        odm(tmp_path / "real.tif", "float32")
        odm(tmp_path / "bytes.tif", "uint8")
        is_as_seen(vrt(tmp_path / "a.vrt", ["Float32"] * 3 + ["Byte"], ["real.tif"] * 3 + ["bytes.tif"]))
        is_as_seen(vrt(tmp_path / "b.vrt", ["Byte"] * 3 + ["Float32"], ["bytes.tif"] * 3 + ["real.tif"]))

    def test_colours_may_not(self, tmp_path: Path) -> None:
        odm(tmp_path / "real.tif", "float32")
        odm(tmp_path / "bytes.tif", "uint8")
        path = vrt(tmp_path / "a.vrt", ["Float32", "Byte", "Byte", "Byte"], ["real.tif"] + ["bytes.tif"] * 3)
        with pytest.raises(InputError, match=r"a\.vrt: its colour bands are of different types"):
            read(path)


class TestMargins:
    def notes(self, path: Path, **options: float) -> list[str]:
        with open_image(path, **options) as image:
            return image.notes

    def test_black_corners_that_nothing_masks_are_told_of(self, tmp_path: Path) -> None:
        path = pix4d_mosaic(tmp_path / "site_mosaic_group1.tif", transparent=False)
        (note,) = self.notes(path)
        assert re.search(r"corners are black \(0 of 255\).*--nodata 0 leaves them out", note)
        assert self.notes(path, nodata=0) == []
        np.testing.assert_array_equal(open_and_read(path, nodata=0), seen())

    def test_white_corners_too(self, tmp_path: Path) -> None:
        bands = np.where(seen(), np.minimum(pixels(), 254), 255).astype(np.uint8)
        (note,) = self.notes(write_raster(tmp_path / "a.tif", bands))
        assert re.search(r"corners are white \(255 of 255\).*--nodata 255", note)

    def test_blurred_ones_are_not_promised_to_go_away(self, tmp_path: Path) -> None:
        bands = np.where(seen(), patches(SIDE, SIDE), 3).astype(np.uint8)
        path = write_raster(
            tmp_path / "a.tif", bands, compress="jpeg", photometric="ycbcr", tiled=True, blockxsize=64, blockysize=64
        )
        (note,) = self.notes(path)
        assert "nearly black" in note
        assert "nearblack -setmask" in note

    @pytest.mark.parametrize("masked", ["alpha", "mask", "nodata", "nothing to mask"])
    def test_there_is_nothing_to_tell_where_they_are_masked(self, tmp_path: Path, masked: str) -> None:
        if masked == "alpha":
            path = pix4d_mosaic(tmp_path / "a.tif", transparent=True)
        elif masked == "mask":
            path = write_raster(tmp_path / "a.tif", np.where(seen(), pixels(), 0).astype(np.uint8), mask=seen())
        elif masked == "nodata":
            path = write_raster(tmp_path / "a.tif", np.where(seen(), pixels(), 0).astype(np.uint8), nodata=0)
        else:
            path = write_raster(tmp_path / "a.tif", patches())
        assert self.notes(path) == []

    def test_black_in_one_band_is_a_colour(self, tmp_path: Path) -> None:
        bands = patches()
        bands[0] = 0
        assert self.notes(write_raster(tmp_path / "a.tif", bands, colours=RGB)) == []


def open_and_read(path: Path, **options: float) -> NDArray[np.bool_]:
    with open_image(path, **options) as image:
        return image.read(Window(0, 0, *image.shape))[1]


def test_tiles_of_real_values_are_masked_like_the_whole(tmp_path: Path) -> None:
    half = SIDE // 2
    shown = np.where(seen(), pixels() / 255, MOST["float32"])
    whole = np.concatenate([shown, np.where(seen(), 255, 0)[np.newaxis]]).astype(np.float32)
    for index, tile in enumerate((whole[:, :, :half], whole[:, :, half:])):
        place = PLACE @ PLACE.translation(index * half, 0)
        write_raster(tmp_path / f"tile{index}.tif", tile, transform=place, colours=RGBA)
    with open_orthomosaic([tmp_path]) as image:
        rgb, valid = image.read(Window(0, 0, SIDE, SIDE))
    np.testing.assert_array_equal(valid, seen())
    np.testing.assert_array_equal(rgb[valid], np.moveaxis(pixels(), 0, -1)[seen()])


class TestReal:
    pytestmark = real

    def test_a_mosaic_of_pix4d_is_masked_by_its_alpha_band(self) -> None:
        path = SHARED / "pix4d_fields" / "pix4d_alpha_nodata.tif"
        rgb, valid, notes = read(path)
        with rasterio.open(path) as dataset:
            bands = dataset.read()
        np.testing.assert_array_equal(valid, bands[3] > 0)
        np.testing.assert_array_equal(rgb[valid], np.moveaxis(bands[:3], 0, -1)[valid])
        assert notes == []

    @pytest.mark.parametrize("path", sorted(SHARED.glob("*/ortho*.tif")), ids=lambda path: path.parent.name)
    def test_other_orthomosaics_are_masked_as_gdal_masks_them(self, path: Path) -> None:
        _, valid, notes = read(path)
        with rasterio.open(path) as dataset:
            np.testing.assert_array_equal(valid, dataset.dataset_mask() > 0)
        assert notes == []
