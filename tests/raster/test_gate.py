from __future__ import annotations

import math
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from raster_files import BAD_FILES, RGB, UTM33, patches, png, write_raster, write_sparse, write_vrt

from hrt_cli.errors import InputError
from hrt_cli.raster.gate import is_nodata, open_raster
from hrt_cli.raster.windows import Window

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

WHOLE = Window(0, 0, 96, 96)


def read_all(path: Path) -> None:
    with open_raster(path) as raster:
        raster.read_bands(list(range(1, raster.count + 1)), Window(0, 0, *raster.grid.shape))


PROBLEMS = {
    "absent": "no such file",
    "a folder": "is a folder",
    "empty": "is not a raster",
    "a web page": "is not a raster",
    "random bytes": "is not a raster",
    "a tiff header and no more": "is not a raster",
    "cut in the header": "is not a raster",
    "cut in the pixels": "damaged or cut short",
    "another driver": "is a PNM file, which is not read",
    "png by another name": "no coordinate reference system",
    "bomb": "declares 30 GB of pixels",
    "one huge block": "blocks of 65536 x 65536 pixels: 4.3 GB",
    "no crs": "no coordinate reference system",
    "no place": "not placed anywhere",
    "control points only": "ground control points",
    "rpcs only": "RPCs",
    "complex": "type complex64",
    "complex whole numbers": "type complex_int16",
    "metres called degrees": "no place on the Earth",
    "sheared": "sheared",
}


def test_every_bad_file_has_its_problem() -> None:
    assert set(PROBLEMS) == set(BAD_FILES)


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_bad_file_is_refused_by_name(tmp_path: Path, name: str) -> None:
    problem = PROBLEMS[name]
    path = tmp_path / "ortho é.tif"
    BAD_FILES[name](path)
    with pytest.raises(InputError, match=re.escape(problem)) as refusal:
        read_all(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


def test_a_file_that_may_not_be_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_raster(tmp_path / "a.tif", patches())

    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", denied)
    with pytest.raises(InputError, match="cannot be read: Permission denied"):
        read_all(path)


def test_a_plain_image_passes_where_asked_for(tmp_path: Path) -> None:
    png(tmp_path / "a.tif")
    with open_raster(tmp_path / "a.tif", unreferenced=True) as raster:
        assert raster.driver == "PNG"
        assert raster.grid.crs is None
        np.testing.assert_array_equal(raster.read_bands([1, 2, 3], WHOLE), patches())


def test_a_large_raster_that_is_really_there_is_no_bomb(tmp_path: Path) -> None:
    path = write_sparse(tmp_path / "a.tif", 20_000, 20_000, 3, tiled=True, blockxsize=512, blockysize=512)
    os.truncate(path, 3 * 20_000 * 20_000 // 400)  # as if its pixels were stored, well compressed
    with open_raster(path) as raster:
        assert raster.grid.shape == (20_000, 20_000)


@pytest.mark.parametrize("folder", ["ünïcode & spaces", "o'clock #1 %20", "中文"])
def test_any_path_will_do(tmp_path: Path, folder: str) -> None:
    (tmp_path / folder).mkdir()
    read_all(write_raster(tmp_path / folder / "a b.tif", patches()))


def test_a_path_that_begins_with_gdals_own_words_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_all(Path("/vsicurl/http://localhost/a.tif"))
    with pytest.raises(InputError, match="no such file"):
        read_all(Path("/vsizip/a.zip/a.tif"))


def test_what_the_file_declares_is_told(tmp_path: Path) -> None:
    path = write_raster(
        tmp_path / "a.tif",
        patches(),
        nodata=7,
        colours=RGB,
        compress="deflate",
        tiled=True,
        blockxsize=32,
        blockysize=64,
    )
    with open_raster(path) as raster:
        assert (raster.count, raster.dtypes, raster.driver) == (3, ("uint8",) * 3, "GTiff")
        assert raster.nodata == (7.0, 7.0, 7.0)
        assert raster.colours == RGB
        assert raster.block_shape == (64, 32)
        assert raster.compression == "deflate"
        assert raster.palette is None
        assert not raster.has_mask
        assert raster.notes == []
        assert raster.grid.crs_text() == UTM33
    with open_raster(path, nodata=9) as raster:
        assert raster.nodata == (9.0, 9.0, 9.0)


def test_a_made_up_place_is_noted(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches(), crs="EPSG:32630", transform=Affine(0.1, 0, 0, 0, -0.1, 0))
    with open_raster(path) as raster:
        assert raster.grid.placeholder_georeference
        assert "no GPS" in raster.notes[0]


class TestVrt:
    def test_a_good_one_is_read_and_names_its_sources(self, tmp_path: Path) -> None:
        (tmp_path / "tiles & more").mkdir()
        tile = write_raster(tmp_path / "tiles & more" / "tile.tif", patches())
        path = write_vrt(tmp_path / "a.vrt", "tiles &amp; more/tile.tif")
        with open_raster(path) as raster:
            np.testing.assert_array_equal(raster.read_bands([1, 2, 3], WHOLE), patches())
            assert {p.resolve() for p in raster.sources().values()} == {path, tile}

    def test_one_of_another_names_the_sources_of_both(self, tmp_path: Path) -> None:
        tile = write_raster(tmp_path / "tile.tif", patches())
        inner = write_vrt(tmp_path / "inner.vrt", "tile.tif")
        outer = write_vrt(tmp_path / "outer.vrt", "inner.vrt")
        with open_raster(outer) as raster:
            np.testing.assert_array_equal(raster.read_bands([1, 2, 3], WHOLE), patches())
            assert set(raster.sources().values()) == {outer, inner, tile}

    @pytest.mark.parametrize(
        "source",
        [
            "/vsicurl/http://localhost:1/a.tif",
            "/vsizip/a.zip/a.tif",
            "https://localhost:1/a.tif",
            "&#47;vsimem/a.tif",
            "<![CDATA[/x]]>",
        ],
    )
    def test_one_that_leaves_the_machine_is_refused(self, tmp_path: Path, source: str) -> None:
        path = write_vrt(tmp_path / "a.vrt", source)
        with pytest.raises(InputError, match="network or virtual file system"):
            read_all(path)

    @pytest.mark.parametrize(
        "source", ["absent.tif", "PG:host=localhost dbname=a", "WMS:a", "GTIFF_DIR:1:tile.tif", "."]
    )
    def test_one_of_what_is_no_file_is_refused(self, tmp_path: Path, source: str) -> None:
        write_raster(tmp_path / "tile.tif", patches())
        path = write_vrt(tmp_path / "a.vrt", source)
        with pytest.raises(InputError, match="which is no file on this machine"):
            read_all(path)

    def test_one_that_leaves_the_machine_by_way_of_another_is_refused(self, tmp_path: Path) -> None:
        write_vrt(tmp_path / "inner.tif", "/vsicurl/http://localhost:1/a.tif")
        with pytest.raises(InputError, match=r"inner\.tif: .*network"):
            read_all(write_vrt(tmp_path / "outer.vrt", "inner.tif"))

    def test_one_of_itself_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="inside itself"):
            read_all(write_vrt(tmp_path / "a.vrt", "a.vrt"))

    def test_one_that_runs_code_is_refused(self, tmp_path: Path) -> None:
        write_raster(tmp_path / "tile.tif", patches())
        path = write_vrt(tmp_path / "a.vrt", "tile.tif", extra="<PixelFunctionType>f</PixelFunctionType>")
        with pytest.raises(InputError, match="runs code"):
            read_all(path)


@pytest.mark.parametrize(
    ("values", "nodata", "expected"),
    [
        (np.array([0, 7, 255], np.uint8), None, [0, 0, 0]),
        (np.array([0, 7, 255], np.uint8), 7.0, [0, 1, 0]),
        (np.array([0, 7, 241], np.uint8), -9999.0, [0, 0, 0]),  # -9999 mod 256 is 241
        (np.array([0, 7, 255], np.uint8), 511.0, [0, 0, 0]),
        (np.array([0, 7, 255], np.uint8), 7.5, [0, 0, 0]),
        (np.array([0, 7, 255], np.uint8), math.nan, [0, 0, 0]),
        (np.array([0, 7, 255], np.uint8), math.inf, [0, 0, 0]),
        (np.array([-9999, 7, 0], np.int16), -9999.0, [1, 0, 0]),
        (np.array([2**64 - 1, 7], np.uint64), float(2**64), [0, 0]),
        (np.array([0, math.nan, math.inf, -math.inf], np.float32), None, [0, 1, 1, 1]),
        (np.array([0, math.nan, 5], np.float32), 0.0, [1, 1, 0]),
        (np.array([0.1, 0.2], np.float32), 0.1, [1, 0]),
        (np.array([-3.4028234663852886e38, 0], np.float32), -3.4028234663852886e38, [1, 0]),
        (np.array([1, 0], np.float32), -1.7976931348623157e308, [0, 0]),
    ],
)
def test_nodata_is_what_equals_it_in_the_bands_own_type(
    values: np.ndarray, nodata: float | None, expected: list[int]
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert is_nodata(values, nodata).tolist() == [bool(e) for e in expected]
