from __future__ import annotations

import itertools
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from raster_files import PLACE, RGB, RGBA, patches, write_raster, write_vrt
from rasterio.enums import ColorInterp

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.gate import DatasetPool, load_raster
from hrt_cli.raster.image import Image, open_image, open_orthomosaic
from hrt_cli.raster.windows import Window

ROWS, COLS = 150, 200
EDGES = ([0, 70, 150], [0, 50, 110, 200])


def site(dtype: str = "uint8") -> np.ndarray:
    """Return [3, ROWS, COLS] without black, which stands for nodata."""
    pixels = patches(ROWS, COLS)
    return pixels if dtype == "uint8" else (pixels.astype(float) * 100).astype(dtype)


def holed(pixels: np.ndarray) -> np.ndarray:
    """Blacken a disc across several tiles."""
    y, x = np.mgrid[:ROWS, :COLS]
    return pixels * (np.hypot(y - 70, x - 100) > 30).astype(pixels.dtype)


def at(row: int, col: int, place: Affine = PLACE) -> Affine:
    return place @ Affine.translation(col, row)


def cut_tiles(
    folder: Path, pixels: np.ndarray, overlap: int = 0, mask: np.ndarray | None = None, place: Affine = PLACE, **o: Any
) -> list[Path]:
    """Write a raster as tiles, named by row and column, that reach `overlap` pixels into their neighbours."""
    folder.mkdir(exist_ok=True)
    spans = [
        [(max(a - overlap, 0), min(b + overlap, n)) for a, b in itertools.pairwise(edges)]
        for edges, n in zip(EDGES, (ROWS, COLS), strict=True)
    ]
    paths = []
    for (i, (top, bottom)), (j, (left, right)) in itertools.product(*map(enumerate, spans)):
        there = np.s_[top:bottom, left:right]
        part = None if mask is None else mask[there]
        path = folder / f"tile-{i}-{j}.tif"
        write_raster(path, pixels[:, *there], transform=at(top, left, place), mask=part, **o)
        paths.append(path)
    return paths


def windows(count: int = 40) -> list[Window]:
    rng = np.random.default_rng(1)
    drawn = [
        Window(*map(int, rng.integers(-20, (ROWS, COLS))), *map(int, rng.integers(1, 130, 2))) for _ in range(count)
    ]
    return [Window(0, 0, ROWS, COLS), Window(60, 40, 20, 20), Window(10, 60, 30, 30), *drawn]


def require_same_pixels(one: Image, other: Image) -> None:
    assert one.shape == other.shape
    assert one.anchor == other.anchor
    assert one.grid.transform == other.grid.transform
    assert one.stretch == other.stretch
    assert one.valid_share == other.valid_share
    for window in windows():
        rgb, valid = one.read(window)
        other_rgb, other_valid = other.read(window)
        np.testing.assert_array_equal(valid, other_valid)
        np.testing.assert_array_equal(rgb[valid], other_rgb[valid])


KINDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "nodata": {"nodata": 0},
    "compressed blocks": {"nodata": 0, "compress": "deflate", "tiled": True, "blockxsize": 16, "blockysize": 32},
    "16 bits": {"dtype": "uint16", "nodata": 0},
    "real": {"dtype": "float32", "nodata": 0},
    "alpha": {"colours": RGBA},
    "mask": {},
    "grey": {},
    "turned": {"place": Affine.translation(500_000, 5_000_000) @ Affine.rotation(30) @ Affine.scale(0.1, -0.1)},
}


@pytest.mark.parametrize("overlap", [0, 9])
@pytest.mark.parametrize("kind", KINDS)
def test_tiles_read_as_the_raster_that_they_were_cut_from(tmp_path: Path, kind: str, overlap: int) -> None:
    options = dict(KINDS[kind])
    pixels = site(options.get("dtype", "uint8"))
    pixels = pixels if kind == "plain" else holed(pixels)
    mask = (pixels != 0).any(axis=0)
    if kind == "alpha":
        pixels = np.concatenate([pixels, 255 * mask[np.newaxis].astype(np.uint8)])
    if kind == "grey":
        pixels = pixels[:1]
    if kind == "mask":
        options["mask"] = mask
    tiles = cut_tiles(tmp_path / "tiles", pixels, overlap, **options)
    place = options.pop("place", PLACE)
    whole = write_raster(tmp_path / "whole.tif", pixels, transform=place, **options)
    with open_image(whole) as one, open_orthomosaic(tiles) as other:
        assert other.shape == (ROWS, COLS)
        require_same_pixels(one, other)
        (rgb, valid), (other_rgb, other_valid) = one.thumbnail(60), other.thumbnail(60)
        np.testing.assert_array_equal(valid, other_valid)
        np.testing.assert_array_equal(rgb[valid], other_rgb[valid])
        assert one.notes == other.notes


def test_a_folder_is_its_tiles_in_any_order(tmp_path: Path) -> None:
    tiles = cut_tiles(tmp_path / "tiles", holed(site()), 5, nodata=0)
    with open_orthomosaic([tmp_path / "tiles"]) as folder:
        for order in (tiles, tiles[::-1], [tiles[k] for k in (3, 0, 5, 1, 4, 2)]):
            with open_orthomosaic(order) as image:
                require_same_pixels(folder, image)
                assert image.sources() == folder.sources()


def test_tiles_cut_unlike_the_probe_give_the_same_stretch(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(1, 60_000, (1, 1600, 1700)).astype(np.uint16)
    (tmp_path / "tiles").mkdir()
    for row, col in itertools.product((0, 700), (0, 333, 1100)):
        bottom, right = {0: 700, 700: 1600}[row], {0: 333, 333: 1100, 1100: 1700}[col]
        part = pixels[:, row:bottom, col:right]
        write_raster(tmp_path / "tiles" / f"{row}-{col}.tif", part, transform=at(row, col), compress="deflate")
    blocks = {"tiled": True, "blockxsize": 512, "blockysize": 512}
    whole = write_raster(tmp_path / "whole.tif", pixels, **blocks)
    with open_image(whole) as one, open_image(tmp_path / "tiles") as other:
        assert one.stretch is not None
        assert one.stretch == other.stretch


class TestOverlap:
    def test_the_first_by_name_whose_pixel_is_valid_wins(self, tmp_path: Path) -> None:
        first, second = np.full((3, 20, 30), 50, np.uint8), np.full((3, 20, 30), 90, np.uint8)
        first[:, :, 20:25] = 0
        b = write_raster(tmp_path / "b.tif", second, transform=at(0, 10), nodata=0)
        (tmp_path / "z").mkdir()
        a = write_raster(tmp_path / "z" / "a.tif", first, transform=at(0, 0), nodata=0)
        for order in ([a, b], [b, a]):
            with open_orthomosaic(order) as image:
                rgb, valid = image.read(Window(0, 0, 20, 40))
            assert valid.all()
            assert rgb[0, :, 0].tolist() == [50] * 20 + [90] * 5 + [50] * 5 + [90] * 10

    def test_a_gap_between_tiles_is_not_valid(self, tmp_path: Path) -> None:
        write_raster(tmp_path / "a.tif", site(), transform=at(0, 0))
        write_raster(tmp_path / "b.tif", site(), transform=at(300, 250))
        with open_orthomosaic([tmp_path]) as image:
            _, valid = image.read(Window(0, 0, *image.shape))
            assert not image.read(Window(160, 210, 50, 30))[1].any()
        expected = np.zeros((450, 450), bool)
        expected[:150, :200] = expected[300:, 250:] = True
        np.testing.assert_array_equal(valid, expected)

    def test_a_tile_may_lie_up_and_left_of_the_first(self, tmp_path: Path) -> None:
        pixels = site()
        a = write_raster(tmp_path / "a.tif", pixels[:, 60:, 80:], transform=at(60, 80))
        b = write_raster(tmp_path / "b.tif", pixels[:, :70, 40:], transform=at(0, 40))
        c = write_raster(tmp_path / "c.tif", pixels[:, 30:, :90], transform=at(30, 0))
        with open_orthomosaic([a, b, c]) as image:
            assert image.grid.transform.almost_equals(PLACE, 1e-6)
            rgb, valid = image.read(Window(0, 0, *image.shape))
        assert (~valid).sum() == 30 * 40
        np.testing.assert_array_equal(rgb[valid], np.moveaxis(pixels, 0, -1)[valid])


def test_the_place_is_that_of_the_corner_tile_to_the_last_bit(tmp_path: Path) -> None:
    place = Affine(0.0371, 0, 500_000.123, 0, -0.0371, 5_000_000.456)
    for name, row, col in (("a.tif", 77, 91), ("b.tif", 0, 0)):
        write_raster(tmp_path / name, site(), transform=at(row, col, place))
    with open_image(tmp_path) as image:
        assert image.grid.transform == place


class TestFolder:
    def test_side_cars_and_previews_are_passed_over(self, tmp_path: Path) -> None:
        tiles = cut_tiles(tmp_path / "tiles", site())
        folder = tmp_path / "tiles"
        names = ("tile-0-0.tfw", "tile-0-0.tif.ovr", "log.txt", "tile-0-0.tif.aux.xml", "tile-0-1.jpg", ".hidden.tif")
        for name in names:
            (folder / name).write_bytes(b"")
        with open_image(folder) as image:
            assert image.notes == []
            assert [path for path in image.sources().values() if path.suffix == ".tif"] == tiles

    def test_what_else_lies_there_is_noted(self, tmp_path: Path) -> None:
        cut_tiles(tmp_path, site())
        for name in ("all.vrt", "preview.jpg", "model.las", "report.docx"):
            (tmp_path / name).write_bytes(b"")
        (tmp_path / "old").mkdir()
        with open_image(tmp_path) as image:
            (note,) = image.notes
        assert note == f"not used of the folder {tmp_path.name}: all.vrt, model.las, old and 2 more"

    def test_one_raster_in_a_folder_is_that_raster(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.TIF", site())
        with open_image(path) as one, open_image(tmp_path) as other:
            require_same_pixels(one, other)
            assert one.sources() == other.sources() == {"raster": path}

    def test_plain_images_that_are_placed_will_do(self, tmp_path: Path) -> None:
        for name, col in (("a.png", 0), ("b.png", COLS)):
            write_raster(tmp_path / name, site(), driver="PNG", transform=at(0, col))
        with open_image(tmp_path) as image:
            assert image.shape == (ROWS, 2 * COLS)

    @pytest.mark.parametrize(
        ("name", "remedy"), [(None, "tiles end in .tif"), ("a.txt", "tiles end in .tif"), ("a.vrt", "name .*a.vrt")]
    )
    def test_one_without_rasters_is_refused(self, tmp_path: Path, name: str | None, remedy: str) -> None:
        if name:
            (tmp_path / name).write_bytes(b"")
        with pytest.raises(InputError, match=f"is a folder without rasters .*{remedy}"), open_image(tmp_path):
            pass

    def test_a_raster_that_is_none_is_refused_by_name(self, tmp_path: Path) -> None:
        cut_tiles(tmp_path, site())
        (tmp_path / "tile-9-9.tif").write_bytes(b"not a raster")
        with pytest.raises(InputError, match=r"tile-9-9\.tif: is not a raster"), open_image(tmp_path):
            pass


OTHERS: dict[str, tuple[dict[str, Any], str]] = {
    "CRS": ({"crs": "EPSG:32634"}, "CRS is EPSG:32634, not EPSG:32633"),
    "pixel size": ({"transform": at(0, COLS) @ Affine.scale(1.00001)}, "its pixels are 0.100001 x 0.100001, not 0.1"),
    "offset": ({"transform": at(0, COLS) @ Affine.translation(0.02, 0)}, "it is 0.02 px off"),
    "rotation": ({"transform": at(0, COLS) @ Affine.rotation(0.01)}, "turned or mirrored"),
    "south up": ({"transform": at(0, COLS) @ Affine.scale(1, -1)}, "turned or mirrored"),
    "far away": ({"transform": at(40_000, 40_000)}, "lies far from the other rasters"),
    "bands": ({"pixels": site()[:1]}, "it has 1 bands, not 3"),
    "type": ({"pixels": site("uint16")}, "its pixels are uint16, not uint8"),
    "meaning": (
        {"colours": RGB[::-1], "photometric": "MINISBLACK"},
        "its bands are blue, green, red, not red, green, blue",
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_tile_that_does_not_go_with_the_others_is_refused(tmp_path: Path, name: str) -> None:
    options, problem = OTHERS[name]
    first = write_raster(tmp_path / "a.tif", site(), colours=RGB, photometric="RGB")
    options = {"pixels": site(), "transform": at(0, COLS), "photometric": "RGB", **options}
    if len(options["pixels"]) == 1:
        options.pop("photometric")
    second = write_raster(tmp_path / "b.tif", **options)
    for order in ([first, second], [second, first]):
        with pytest.raises(InputError, match=problem) as refusal, open_orthomosaic(order):
            pass
        assert Path(refusal.value.path) in (first, second)


def test_tiles_of_other_palettes_are_refused(tmp_path: Path) -> None:
    for name, red in (("a.tif", 10), ("b.tif", 20)):
        write_raster(tmp_path / name, site()[0], palette={1: (red, 0, 0, 255)})
    with pytest.raises(InputError, match="colour table differs"), open_image(tmp_path):
        pass


def test_noise_in_the_last_digits_is_none(tmp_path: Path) -> None:
    tiles = cut_tiles(tmp_path, site())
    with rasterio.open(tiles[4], "r+") as dataset:
        dataset.transform = dataset.transform @ Affine.translation(0.004, -0.004) @ Affine.scale(1 + 1e-8)
    whole = write_raster(tmp_path / "whole.tiff", site())
    with open_orthomosaic(tiles) as image, open_image(whole) as one:
        require_same_pixels(one, image)


@pytest.mark.parametrize("how", ["same", "link", "other spelling", "in a folder"])
def test_a_file_given_twice_is_refused(tmp_path: Path, how: str) -> None:
    path = write_raster(tmp_path / "a.tif", site())
    again = {"same": path, "other spelling": tmp_path / "x" / ".." / "a.tif", "in a folder": tmp_path}.get(how)
    (tmp_path / "x").mkdir()
    if again is None:
        again = tmp_path / "x" / "b.tif"
        again.symlink_to(path)
    with pytest.raises(InputError, match=r"is the same file as .*: give it once"), open_orthomosaic([path, again]):
        pass


def test_what_has_no_place_cannot_be_put_beside_another(tmp_path: Path) -> None:
    paths = [write_raster(tmp_path / name, site(), driver="PNG") for name in ("a.png", "b.png")]
    with pytest.raises(InputError, match="--unreferenced takes one"), open_orthomosaic(paths, unreferenced=True):
        pass
    with open_orthomosaic(paths[:1], unreferenced=True) as image:
        assert image.grid.crs is None


def test_none_and_what_is_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="no orthomosaic"), open_orthomosaic([]):
        pass
    path = write_raster(tmp_path / "a.tif", site())
    with pytest.raises(InputError, match=r"b\.tif: no such file"), open_orthomosaic([path, tmp_path / "b.tif"]):
        pass


def test_tiles_too_wide_for_one_pixel_size_are_refused(tmp_path: Path) -> None:
    place = Affine(0.001, 0, 10, 0, -0.001, 45)
    for name, row in (("a.tif", 0), ("b.tif", 3000)):
        write_raster(tmp_path / name, site(), crs="EPSG:4326", transform=at(row, 0, place))
    with pytest.raises(InputError, match="size on the ground varies"), open_image(tmp_path):
        pass


def test_sources_name_every_part_of_every_tile(tmp_path: Path) -> None:
    mask = np.zeros((ROWS, COLS), bool)
    mask[:, 10:] = True
    write_raster(tmp_path / "b.tif", site(), mask=mask, internal_mask=False, transform=at(0, COLS))
    inner = write_raster(tmp_path / "inner.tif", site())
    vrt = write_vrt(tmp_path / "a.vrt", "inner.tif", ROWS, COLS)
    with open_orthomosaic([tmp_path / "b.tif", vrt]) as image:
        assert image.sources() == {
            "raster/0": vrt,
            "raster/0/0": inner,
            "raster/1": tmp_path / "b.tif",
            "raster/1/0": tmp_path / "b.tif.msk",
        }


def test_many_tiles_are_read_with_few_open_and_from_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hrt_cli.raster.mosaic.MAX_OPEN", 3)
    pools: list[DatasetPool] = []

    class Watched(DatasetPool):
        def __init__(self, limit: int) -> None:
            super().__init__(limit)
            pools.append(self)

    monkeypatch.setattr("hrt_cli.raster.mosaic.DatasetPool", Watched)
    tiles = cut_tiles(tmp_path, holed(site()), 4, nodata=0)
    with open_orthomosaic(tiles) as image:
        alone = [image.read(window) for window in windows()]
        assert pools[0].open_count == 3
        with ThreadPoolExecutor(4) as executor:
            together = list(executor.map(image.read, windows()))
        assert 3 <= pools[0].open_count <= 15
        for one, other in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], other[0])
            np.testing.assert_array_equal(one[1], other[1])
    assert pools[0].open_count == 0


def test_a_pool_keeps_what_was_read_last(tmp_path: Path) -> None:
    a, b, c = (write_raster(tmp_path / name, site()) for name in ("a.tif", "b.tif", "c.tif"))
    with DatasetPool(2) as pool:
        first, second = pool.dataset(a), pool.dataset(b)
        assert pool.dataset(a) is first
        third = pool.dataset(c)
        assert second.closed
        assert not first.closed
    assert first.closed
    assert third.closed


def test_a_tile_that_goes_away_is_refused_by_name(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", site())
    other = shutil.copy(path, tmp_path / "b.tif")
    with DatasetPool(1) as pool:
        raster = load_raster(path, pool)
        pool.dataset(other)
        path.unlink()
        with pytest.raises(InputError, match=r"a\.tif: is not a raster"):
            raster.read_bands([1], Window(0, 0, 5, 5))


def test_grey_and_alpha_tiles_of_a_band_asked_for(tmp_path: Path) -> None:
    pixels = np.concatenate([site(), np.full((1, ROWS, COLS), 255, np.uint8)])
    pixels[3, :, 90:120] = 0
    tiles = cut_tiles(tmp_path, pixels, colours=(*RGB, ColorInterp.alpha))
    with open_orthomosaic(tiles, bands=(2,)) as image:
        rgb, valid = image.read(Window(0, 0, ROWS, COLS))
    np.testing.assert_array_equal(valid, pixels[3] > 0)
    np.testing.assert_array_equal(rgb[valid], pixels[1][valid][:, None].repeat(3, 1))
