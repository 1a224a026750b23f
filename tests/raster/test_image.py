from __future__ import annotations

import math
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raster_files import RGB, RGBA, patches, write_raster
from rasterio.enums import ColorInterp

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.image import Stretch, open_image
from hrt_cli.raster.windows import Window, blocks

WHOLE = Window(0, 0, 96, 96)
LEFT = np.zeros((96, 96), bool)
LEFT[:, :24] = True


def read(path: Path, **options: Any) -> tuple[np.ndarray, np.ndarray, list[str]]:
    with open_image(path, **options) as image:
        return *image.read(Window(0, 0, *image.shape)), image.notes


def as_rgb(pixels: np.ndarray) -> np.ndarray:
    return np.moveaxis(pixels, 0, -1)


def with_alpha(pixels: np.ndarray, opaque: int) -> np.ndarray:
    alpha = np.where(LEFT, 0, opaque).astype(pixels.dtype)
    return np.concatenate([pixels, alpha[np.newaxis]])


def test_a_plain_orthomosaic_is_read_as_it_is(tmp_path: Path) -> None:
    rgb, valid, notes = read(write_raster(tmp_path / "a.tif", patches()))
    np.testing.assert_array_equal(rgb, as_rgb(patches()))
    assert rgb.flags.c_contiguous
    assert valid.all()
    assert notes == []


def test_alpha_of_none_is_nodata_and_no_colour(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", with_alpha(patches(), 255), colours=RGBA)
    with open_image(path) as image:
        assert (image.bands, image.alpha) == ([1, 2, 3], 4)
        assert image.valid_share == pytest.approx(0.75)
    rgb, valid, notes = read(path)
    np.testing.assert_array_equal(valid, ~LEFT)
    np.testing.assert_array_equal(rgb[valid], as_rgb(patches())[~LEFT])
    assert notes == []


def test_a_trace_of_alpha_is_enough(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", with_alpha(patches(), 1), colours=RGBA)
    np.testing.assert_array_equal(read(path)[1], ~LEFT)


@pytest.mark.parametrize(("dtype", "scale"), [("uint16", 200), ("float32", 1 / 255), ("uint8", 1)])
def test_alpha_of_255_is_opaque_in_every_type(tmp_path: Path, dtype: str, scale: float) -> None:
    # OpenDroneMap fills what it did not see with the type's largest value and writes 255 as opaque.
    pixels = (patches().astype(float) * scale).astype(dtype)
    unseen = 2**32 - 1 if dtype == "float32" else np.iinfo(dtype).max
    filled = np.where(LEFT, np.array(unseen, dtype), pixels)
    path = write_raster(tmp_path / "a.tif", with_alpha(filled, 255), colours=RGBA, compress="deflate")
    rgb, valid, _ = read(path)
    np.testing.assert_array_equal(valid, ~LEFT)
    seen = rgb[valid].astype(int)
    original = as_rgb(patches())[~LEFT].astype(int)
    assert np.corrcoef(seen.ravel(), original.ravel())[0, 1] > 0.999
    assert seen.max() - seen.min() > 200


def test_an_undeclared_fourth_band_is_not_alpha(tmp_path: Path) -> None:
    colours = (*RGB, ColorInterp.undefined)
    path = write_raster(tmp_path / "a.tif", with_alpha(patches(), 255), colours=colours)
    rgb, valid, notes = read(path)
    assert valid.all()
    np.testing.assert_array_equal(rgb, as_rgb(patches()))
    assert notes == ["bands 1, 2, 3 are taken as colour; band 4 is not declared as alpha and is not used"]


def test_bands_are_taken_as_declared_or_as_asked_for(tmp_path: Path) -> None:
    bgr = (ColorInterp.blue, ColorInterp.green, ColorInterp.red)
    path = write_raster(tmp_path / "a.tif", patches(), colours=bgr, photometric="MINISBLACK")
    np.testing.assert_array_equal(read(path)[0], as_rgb(patches()[::-1]))
    np.testing.assert_array_equal(read(path, bands=(1, 3, 2))[0], as_rgb(patches()[[0, 2, 1]]))
    np.testing.assert_array_equal(read(path, bands=(2,))[0], np.repeat(patches()[1][..., None], 3, axis=2))


@pytest.mark.parametrize("bands", [(1, 2), (0, 1, 2), (1, 2, 4), (4,), (1, 2, 3, 1), (-1, 2, 3)])
def test_bands_that_are_not_there_are_refused(tmp_path: Path, bands: tuple[int, ...]) -> None:
    path = write_raster(tmp_path / "a.tif", patches())
    with pytest.raises(ArgumentError, match=r"a\.tif: --bands takes one or three of the bands 1 to 3"):
        read(path, bands=bands)


def test_one_band_is_grey(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches()[0])
    rgb, valid, notes = read(path)
    np.testing.assert_array_equal(rgb, np.repeat(patches()[0][..., None], 3, axis=2))
    assert valid.all()
    assert notes == []


def test_grey_with_alpha(tmp_path: Path) -> None:
    pixels = with_alpha(patches()[:1], 255)
    path = write_raster(tmp_path / "a.tif", pixels, colours=(ColorInterp.gray, ColorInterp.alpha))
    rgb, valid, _ = read(path)
    np.testing.assert_array_equal(valid, ~LEFT)
    np.testing.assert_array_equal(rgb[valid][:, 0], patches()[0][~LEFT])


def test_alpha_alone_is_no_image(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches()[0], colours=(ColorInterp.alpha,))
    with pytest.raises(InputError, match="alpha band but no colour"):
        read(path)


def test_a_palette_is_looked_up(tmp_path: Path) -> None:
    indices = (patches()[0] % 4).astype(np.uint8)
    palette = {0: (10, 20, 30, 255), 1: (200, 0, 0, 255), 2: (0, 200, 0, 255), 3: (9, 9, 200, 255)}
    path = write_raster(tmp_path / "a.tif", indices, palette=palette, nodata=3)
    rgb, valid, _ = read(path)
    table = np.array([palette[k][:3] for k in range(4)])
    np.testing.assert_array_equal(valid, indices != 3)
    np.testing.assert_array_equal(rgb, table[indices])


@pytest.mark.parametrize(("dtype", "index"), [(np.uint8, 200), (np.uint16, 60_000)])
def test_a_palette_reaches_as_far_as_its_type(tmp_path: Path, dtype: type, index: int) -> None:
    indices = np.where(LEFT, index, 1).astype(dtype)
    path = write_raster(tmp_path / "a.tif", indices, palette={index: (10, 20, 30, 255), 1: (200, 0, 0, 255)})
    rgb, _, notes = read(path)
    np.testing.assert_array_equal(rgb, np.where(LEFT[..., None], [10, 20, 30], [200, 0, 0]))
    assert notes == []


@pytest.mark.parametrize(
    "window", [WHOLE, Window(3, 5, 40, 7), Window(-10, 90, 30, 20), Window(90, -5, 20, 9), Window(200, 0, 5, 6)]
)
@pytest.mark.parametrize("kind", ["plain", "nodata", "alpha", "mask", "grey", "16 bits", "real"])
def test_planes_are_what_is_read_turned_round(tmp_path: Path, kind: str, window: Window) -> None:
    pixels, options = patches(), {}
    if kind == "nodata":
        pixels[:, 20:40] = 0
        options = {"nodata": 0}
    elif kind == "alpha":
        pixels, options = with_alpha(pixels, 255), {"colours": RGBA}
    elif kind == "mask":
        options = {"mask": ~LEFT}
    elif kind == "grey":
        pixels = pixels[:1]
    elif kind != "plain":
        pixels = pixels.astype(np.uint16 if kind == "16 bits" else np.float32)
    with open_image(write_raster(tmp_path / "a.tif", pixels, **options)) as image:
        planes, valid = image.read_planes(window)
        rgb, valid_too = image.read(window)
        room = (
            np.full((3, window.height + 5, window.width + 9), 77, np.uint8),
            np.ones((window.height, window.width), bool),
        )
        there = room[0][:, 2 : 2 + window.height, 4 : 4 + window.width]
        image.read_planes(window, (there, room[1]))
    assert (planes.dtype, planes.shape, valid.shape) == (np.uint8, (3, window.height, window.width), valid_too.shape)
    assert planes.flags.c_contiguous
    assert rgb.flags.c_contiguous
    np.testing.assert_array_equal(np.moveaxis(planes, 0, -1), rgb)
    np.testing.assert_array_equal(valid, valid_too)
    np.testing.assert_array_equal(room[1], valid)
    np.testing.assert_array_equal(there[:, valid], planes[:, valid])
    there[:] = 77
    assert (room[0] == 77).all()


class TestNodata:
    def test_a_pixel_is_nodata_where_every_band_is(self, tmp_path: Path) -> None:
        pixels = patches()
        pixels[:, :10] = 0  # nothing
        pixels[0, 20:30] = 0  # dark in red only
        pixels[1:, 40:50] = 0  # only red
        _, valid, _ = read(write_raster(tmp_path / "a.tif", pixels, nodata=0))
        assert not valid[:10].any()
        assert valid[10:].all()

    def test_a_value_outside_the_type_is_met_by_no_pixel(self, tmp_path: Path) -> None:
        pixels = patches()
        pixels[:, :10] = 241  # what a cast makes of -15
        path = write_raster(tmp_path / "a.tif", pixels, nodata=241)
        # rasterio writes no such thing, other programs do: the value stands as text in the tag.
        stored = path.read_bytes()
        assert stored.count(b"\x81\xa4\x02\x00\x04\x00\x00\x00241\x00") == 1
        path.write_bytes(stored.replace(b"\x04\x00\x00\x00241\x00", b"\x04\x00\x00\x00-15\x00"))
        assert read(path)[1].all()
        assert read(path, nodata=-9999)[1].all()
        assert not read(path, nodata=241)[1][:10].any()

    def test_the_users_value_stands_in_for_the_files(self, tmp_path: Path) -> None:
        pixels = patches()
        pixels[:, :10] = 0
        pixels[:, 80:] = 255
        path = write_raster(tmp_path / "a.tif", pixels, nodata=0)
        assert not read(path)[1][:10].any()
        _, valid, _ = read(path, nodata=255)
        assert valid[:80].all()
        assert not valid[80:].any()

    @pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("bands", [slice(None), slice(1, 2)])
    def test_what_is_no_number_is_no_data(self, tmp_path: Path, broken: float, bands: slice) -> None:
        pixels = patches().astype(np.float32)
        pixels[bands, :, :24] = broken
        rgb, valid, _ = read(write_raster(tmp_path / "a.tif", pixels))
        np.testing.assert_array_equal(valid, ~LEFT)
        assert rgb[valid].max() == 255

    def test_an_internal_mask(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", patches(), mask=~LEFT)
        assert not path.with_name("a.tif.msk").exists()
        np.testing.assert_array_equal(read(path)[1], ~LEFT)

    def test_a_mask_beside_the_file(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", patches(), mask=~LEFT, internal_mask=False)
        assert path.with_name("a.tif.msk").exists()
        np.testing.assert_array_equal(read(path)[1], ~LEFT)
        with open_image(path) as image:
            assert image.sources() == {"raster": path, "raster/0": path.with_name("a.tif.msk")}

    def test_a_stale_mask_that_hides_all_is_named(self, tmp_path: Path) -> None:
        old = write_raster(tmp_path / "old.tif", patches(), mask=np.zeros((96, 96), bool), internal_mask=False)
        path = write_raster(tmp_path / "a.tif", patches())
        shutil.copy(old.with_name("old.tif.msk"), path.with_name("a.tif.msk"))
        with pytest.raises(InputError, match=r"no valid pixel.*a\.tif\.msk masks all of it"):
            read(path)

    @pytest.mark.parametrize("kind", ["nodata", "alpha", "mask", "nan"])
    def test_nothing_but_nodata_is_refused(self, tmp_path: Path, kind: str) -> None:
        pixels, options = patches(), {}
        if kind == "nodata":
            pixels, options = np.zeros_like(pixels), {"nodata": 0}
        elif kind == "alpha":
            pixels, options = np.concatenate([pixels, np.zeros_like(pixels[:1])]), {"colours": RGBA}
        elif kind == "mask":
            options = {"mask": np.zeros((96, 96), bool)}
        else:
            pixels = np.full(pixels.shape, np.nan, np.float32)
        with pytest.raises(InputError, match="has no valid pixel: all is nodata"):
            read(write_raster(tmp_path / "a.tif", pixels, **options))

    def test_a_few_valid_pixels_of_a_large_raster_are_found(self, tmp_path: Path) -> None:
        pixels = np.zeros((1, 1500, 1500), np.uint8)
        pixels[0, 700:702, 900] = 7, 9  # between the windows of the probe
        with open_image(write_raster(tmp_path / "a.tif", pixels, nodata=0, compress="deflate")) as image:
            assert 0 < image.valid_share < 2e-5


class TestStretch:
    def test_twelve_bits_in_sixteen_do_not_come_out_black(self, tmp_path: Path) -> None:
        pixels = patches().astype(np.uint16) * 16
        rgb, _, notes = read(write_raster(tmp_path / "a.tif", pixels))
        low, high = np.quantile(pixels, (0.005, 0.995))
        expected = as_rgb(np.clip((pixels - low) * 255 / (high - low), 0, 255))
        assert np.abs(rgb - expected).max() <= 0.5 + 1e-4
        assert notes == [f"its uint16 values are stretched to 8 bits: {low:g} to 0, {high:g} to 255"]

    @pytest.mark.parametrize("dtype", ["float32", "float64", "int16", "int32", "uint32", "int8"])
    def test_every_type_spans_the_grey_levels(self, tmp_path: Path, dtype: str) -> None:
        scale = {"float32": 1 / 255, "float64": 1 / 255, "int16": 40, "int32": 10**6, "uint32": 10**7, "int8": 0.5}
        pixels = (patches().astype(float) * scale[dtype]).astype(dtype)
        rgb, valid, notes = read(write_raster(tmp_path / "a.tif", pixels))
        assert valid.all()
        assert (rgb.min(), rgb.max()) == (0, 255)
        assert np.corrcoef(rgb.ravel(), as_rgb(patches()).ravel())[0, 1] > 0.999
        assert dtype in notes[0]

    def test_it_is_one_for_the_whole_raster(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", patches().astype(np.uint16) * 16)
        whole, _, _ = read(path)
        with open_image(path) as image:
            for window in blocks(image.shape, 37):
                np.testing.assert_array_equal(image.read(window)[0], whole[window.slices])

    @pytest.mark.parametrize("dtype", ["uint16", "int16"])
    def test_sixteen_bits_are_looked_up_as_they_are_computed(self, dtype: str) -> None:
        limits = np.iinfo(dtype)
        values = np.arange(limits.min, limits.max + 1, dtype=dtype).reshape(256, 256)
        found = Stretch(limits.min + 700.5, limits.max - 9000.25).apply(values)
        low, high = limits.min + 700.5, limits.max - 9000.25
        expected = np.clip((values.astype(float) - low) * 255 / (high - low), 0, 255)
        assert np.abs(found - expected).max() <= 0.5 + 1e-3
        np.testing.assert_array_equal(Stretch(low, high).apply(values[::2, ::3]), found[::2, ::3])

    def test_nodata_has_no_part_in_it(self, tmp_path: Path) -> None:
        pixels = patches().astype(np.float32)
        pixels[:, :24] = -9999
        _, _, notes = read(write_raster(tmp_path / "a.tif", pixels, nodata=-9999))
        assert "-9999" not in notes[0]

    def test_few_bright_pixels_on_one_value_are_kept(self, tmp_path: Path) -> None:
        pixels = np.full((1, 96, 96), 300, np.uint16)
        pixels[0, 5, 5] = 900
        rgb, _, _ = read(write_raster(tmp_path / "a.tif", pixels))
        assert rgb[5, 5].tolist() == [255] * 3
        assert rgb[0, 0].tolist() == [0] * 3


class TestOneColour:
    @pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
    @pytest.mark.parametrize("colour", [(90, 90, 90), (10, 20, 30)])
    def test_it_is_refused(self, tmp_path: Path, dtype: str, colour: tuple[int, int, int]) -> None:
        pixels = np.ones((3, 96, 96), dtype) * np.array(colour, dtype)[:, None, None]
        pixels[:, :9] = 0
        with pytest.raises(InputError, match="all its pixels have one value"):
            read(write_raster(tmp_path / "a.tif", pixels, nodata=0))

    @pytest.mark.parametrize("dtype", ["uint8", "uint16"])
    def test_another_colour_is_looked_for_everywhere(self, tmp_path: Path, dtype: str) -> None:
        pixels = np.full((1, 1500, 1500), 90, dtype)
        pixels[0, 700:702, 900] = 7  # between the windows of the probe
        rgb, valid, _ = read(write_raster(tmp_path / "a.tif", pixels, compress="deflate"))
        assert valid.all()
        assert rgb[700, 900, 0] < rgb[0, 0, 0]


def test_what_lies_outside_is_not_valid(tmp_path: Path) -> None:
    with open_image(write_raster(tmp_path / "a.tif", patches())) as image:
        rgb, valid = image.read(Window(-10, 90, 30, 20))
        assert rgb.shape == (30, 20, 3)
        assert valid[10:, :6].all()
        assert valid.sum() == 20 * 6
        np.testing.assert_array_equal(rgb[10:, :6], as_rgb(patches())[:20, 90:])
        assert not image.read(Window(200, 200, 5, 5))[1].any()
        assert not image.read(Window(-50, -50, 5, 5))[1].any()


def test_damage_found_late_is_refused_by_name(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(1, 255, (3, 8000, 64), np.uint8)
    path = write_raster(tmp_path / "a.tif", pixels, compress="deflate", tiled=True, blockxsize=64, blockysize=64)
    whole = path.read_bytes()
    middle = len(whole) // 4  # the probe does not come there
    path.write_bytes(whole[:middle] + bytes(5000) + whole[middle + 5000 :])
    with (
        open_image(path) as image,
        pytest.raises(InputError, match=r"a\.tif: is damaged or cut short"),
    ):
        image.read(Window(1900, 0, 200, 64))


def test_threads_read_what_one_reads(tmp_path: Path) -> None:
    path = write_raster(
        tmp_path / "a.tif",
        with_alpha(patches(), 255).repeat(5, axis=1).repeat(5, axis=2),
        colours=RGBA,
        compress="deflate",
        tiled=True,
        blockxsize=64,
        blockysize=64,
    )
    with open_image(path) as image:
        windows = [w.grown(9) for w in blocks(image.shape, 50)]
        alone = [image.read(w) for w in windows]
        with ThreadPoolExecutor(4) as pool:
            together = list(pool.map(image.read, windows))
        for (rgb_a, valid_a), (rgb_b, valid_b) in zip(alone, together, strict=True):
            np.testing.assert_array_equal(rgb_a, rgb_b)
            np.testing.assert_array_equal(valid_a, valid_b)


@pytest.mark.parametrize(("rows", "cols", "max_px"), [(96, 96, 200), (1021, 300, 100), (700, 1000, 333), (5, 1200, 90)])
def test_a_thumbnail_is_every_nth_pixel(tmp_path: Path, rows: int, cols: int, max_px: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (3, rows, cols), np.uint8)
    pixels[:, :, : cols // 3] = 0
    path = write_raster(tmp_path / "a.tif", pixels, nodata=0)
    with open_image(path) as image:
        rgb, valid = image.thumbnail(max_px)
    step = max(1, math.ceil(max(rows, cols) / max_px))
    at_rows = [min(r + step // 2, rows - 1) for r in range(0, rows, step)]
    at_cols = [min(c + step // 2, cols - 1) for c in range(0, cols, step)]
    assert max(rgb.shape[:2]) <= max_px
    np.testing.assert_array_equal(rgb, as_rgb(pixels)[at_rows][:, at_cols])
    np.testing.assert_array_equal(valid, (pixels != 0).any(axis=0)[at_rows][:, at_cols])


@pytest.mark.parametrize("layout", [{}, {"tiled": True, "blockxsize": 512, "blockysize": 512}, {"blockysize": 16}])
def test_the_probe_looks_at_the_whole_width_of_any_layout(tmp_path: Path, layout: dict[str, object]) -> None:
    pixels = np.full((1, 2048, 2048), 100, np.uint16)
    pixels[:, :, 1024:] = np.linspace(3000, 4000, 1024).astype(np.uint16)
    with open_image(write_raster(tmp_path / "a.tif", pixels, **layout)) as image:
        assert image.stretch is not None
        assert image.stretch.high > 3800
    pixels[:, :, :1024] = 0
    with open_image(write_raster(tmp_path / "b.tif", pixels, nodata=0, **layout)) as image:
        assert image.valid_share == pytest.approx(0.5, abs=0.1)
