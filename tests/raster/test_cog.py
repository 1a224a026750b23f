from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
from affine import Affine
from raster_files import PLACE, UTM33
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rio_cogeo.cogeo import cog_validate

from hrt_cli.artifacts.provenance import Provenance, record
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.raster import cog
from hrt_cli.raster.cog import Layout, cog_provenance, publishing_cog
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.style import class_colour, class_palette, class_qml, rgb_of, score_qml
from hrt_cli.raster.windows import Window, blocks

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

CLASSES = Layout(
    bands=("class",),
    dtype="uint8",
    nodata=255,
    palette=class_palette(5, 255),
    tags={"names": ["grass", 'path <&> "mud"', "x", "y", "z"]},
    style=class_qml(["grass", 'path <&> "mud"', "x", "y", "z"]),
)
SCORES = Layout(bands=("score", "sd"), dtype="float32", nodata=float("nan"), resampling="average")
PICTURE = Layout(bands=("red", "green", "blue"), dtype="uint8", rgb=True)
LAYOUTS = {"classes": CLASSES, "scores": SCORES, "picture": PICTURE}


def grid(rows: int, cols: int) -> Grid:
    return Grid(rows, cols, PLACE, CRS.from_string(UTM33))


def provenance() -> Provenance:
    return record("test", 1, {"seed": 0}, {})


def pixels_of(layout: Layout, rows: int, cols: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    shape = (len(layout.bands), rows, cols)
    if layout.dtype == "float32":
        values = rng.random(shape, np.float32)
        values[:, :5, :7] = np.nan
        return values
    values = rng.integers(0, 5 if layout.palette else 256, shape, np.uint8)
    if layout.palette:
        values[:, :5, :7] = 255
    return values


def publish(path: Path, name: str, rows: int = 700, cols: int = 620, block: int = 256, **tags: Any) -> np.ndarray:
    layout = LAYOUTS[name]
    pixels = pixels_of(layout, rows, cols)
    with publishing_cog(path, grid(rows, cols), layout, provenance()) as writer:
        for window in blocks((rows, cols), block):
            there = pixels[(slice(None), *window.slices)]
            writer.write(window, there, np.ones(there.shape[1:], bool) if layout.rgb else None)
        writer.tags.update(tags)
    return pixels


@pytest.mark.parametrize("name", LAYOUTS)
def test_it_is_a_cog_that_reads_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.tif"
    pixels = publish(path, name)
    valid, errors, warnings = cog_validate(path, strict=True)
    assert valid, (errors, warnings)
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(dataset.read(), pixels)
        assert dataset.overviews(1) == [2]
        assert dataset.descriptions == LAYOUTS[name].bands
        assert dataset.crs == CRS.from_string(UTM33)
        assert dataset.transform == PLACE
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


@pytest.mark.parametrize(("rows", "cols", "levels"), [(512, 512, 0), (1, 1, 0), (513, 100, 1), (1500, 1200, 2)])
def test_overviews_begin_above_one_tile(tmp_path: Path, rows: int, cols: int, levels: int) -> None:
    publish(tmp_path / "a.tif", "classes", rows, cols)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert len(dataset.overviews(1)) == levels
    assert cog_validate(tmp_path / "a.tif", strict=True)[0]


def test_overviews_of_classes_hold_no_class_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with publishing_cog(path, grid(600, 600), CLASSES, provenance()) as writer:
        writer.write(Window(0, 0, 600, 600), np.kron([[0, 4], [4, 0]], np.ones((300, 300))).astype(np.uint8))
    with rasterio.open(path, overview_level=0) as dataset:
        assert set(np.unique(dataset.read(1))) == {0, 4}


def test_palette_nodata_and_names_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    publish(path, "classes", stats={"b": [1, 2.5]})
    with rasterio.open(path) as dataset:
        assert dataset.nodata == 255
        assert dataset.colorinterp == (ColorInterp.palette,)
        assert dataset.colormap(1)[3] == (*rgb_of(class_colour(3)), 255)
        tags = dataset.tags(ns="HRT")
    assert json.loads(tags["NAMES"]) == CLASSES.tags["names"]
    assert json.loads(tags["STATS"]) == {"b": [1, 2.5]}


def test_nan_is_the_nodata_of_scores(tmp_path: Path) -> None:
    publish(tmp_path / "a.tif", "scores")
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert np.isnan(dataset.nodata)
        assert not dataset.dataset_mask()[:5, :7].any()


def test_a_picture_says_its_colours_and_its_mask(tmp_path: Path) -> None:
    pixels = pixels_of(PICTURE, 600, 600)
    valid = np.random.default_rng(1).random((600, 600)) < 0.5
    with publishing_cog(tmp_path / "a.tif", grid(600, 600), PICTURE, provenance()) as writer:
        writer.write(Window(0, 0, 600, 600), pixels, valid)
    assert not (tmp_path / "a.tif.msk").exists()
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.colorinterp == (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
        np.testing.assert_array_equal(dataset.dataset_mask() > 0, valid)


class TestStyles:
    def test_the_style_lies_beside_the_raster(self, tmp_path: Path) -> None:
        publish(tmp_path / "a.tif", "classes")
        assert (tmp_path / "a.qml").read_text(encoding="utf-8") == CLASSES.style
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a.qml", "a.tif"]

    def test_the_legend_of_classes(self) -> None:
        names = ["grass", 'path <&> "mud"', "", "é"]
        entries = ElementTree.fromstring(class_qml(names)).findall(".//paletteEntry")
        assert [e.get("label") for e in entries] == ["0 grass", '1 path <&> "mud"', "2", "3 é"]
        assert [e.get("value") for e in entries] == ["0", "1", "2", "3"]
        assert [e.get("color") for e in entries] == [class_colour(i) for i in range(4)]

    def test_the_ramp_of_scores(self) -> None:
        root = ElementTree.fromstring(score_qml(0.8))
        renderer = root.find(".//rasterrenderer")
        assert renderer is not None
        assert renderer.get("classificationMax") == "0.8"
        assert [float(i.get("value", "")) for i in root.findall(".//item")] == [0, 0.2, 0.4, 0.6, 0.8]

    def test_no_two_of_many_classes_look_the_same(self) -> None:
        colours = [class_colour(i) for i in range(255)]
        assert len(set(colours)) > 240
        assert len(set(colours[:40])) == 40
        assert all(len(c) == 7 and all(0 <= v <= 255 for v in rgb_of(c)) for c in colours)
        assert class_palette(255, 255)[255] == (0, 0, 0, 0)


class TestProvenance:
    def test_it_is_read_back_with_the_hash_of_the_content(self, tmp_path: Path) -> None:
        publish(tmp_path / "a.tif", "classes")
        found = cog_provenance(tmp_path / "a.tif")
        assert found is not None
        assert found.with_content("") == provenance()
        assert len(found.content_sha256) == 64

    def test_a_foreign_raster_has_none(self, tmp_path: Path) -> None:
        with rasterio.open(
            tmp_path / "a.tif",
            "w",
            driver="GTiff",
            width=4,
            height=4,
            count=1,
            dtype="uint8",
            crs=UTM33,
            transform=PLACE,
        ) as dataset:
            dataset.write(np.ones((1, 4, 4), np.uint8))
        assert cog_provenance(tmp_path / "a.tif") is None

    @pytest.mark.parametrize("name", LAYOUTS)
    def test_one_pixel_changed_is_noticed(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "a.tif"
        publish(path, name, 40, 50)
        with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
            band = dataset.read(dataset.count)
            band[33, 44] = 1 if band[33, 44] != 1 else 2
            dataset.write(band, dataset.count)
        with rasterio.open(path) as dataset:
            assert "PROVENANCE" in dataset.tags(ns="HRT")
        with pytest.raises(InputError, match="not what its provenance recorded"):
            cog_provenance(path)

    @pytest.mark.parametrize("change", ["transform", "nodata"])
    def test_another_meaning_of_the_pixels_is_noticed(self, tmp_path: Path, change: str) -> None:
        path = tmp_path / "a.tif"
        publish(path, "classes", 40, 50)
        with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
            if change == "transform":
                dataset.transform = dataset.transform * Affine.translation(1, 0)
            else:
                dataset.nodata = 0
        with pytest.raises(InputError, match="not what its provenance recorded"):
            cog_provenance(path)

    def test_a_mask_changed_is_noticed(self, tmp_path: Path) -> None:
        path = tmp_path / "a.tif"
        publish(path, "picture", 40, 50)
        with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
            mask = dataset.dataset_mask()
            mask[7, 7] = 0
            dataset.write_mask(mask)
        with pytest.raises(InputError, match="not what its provenance recorded"):
            cog_provenance(path)

    @pytest.mark.parametrize("text", ["{", "[]", '{"tool": "hrt"}', "NaN"])
    def test_a_record_that_is_none_is_refused(self, tmp_path: Path, text: str) -> None:
        path = tmp_path / "a.tif"
        publish(path, "classes", 40, 50)
        with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
            dataset.update_tags(ns="HRT", PROVENANCE=text)
        with pytest.raises(InputError, match=r"a\.tif: "):
            cog_provenance(path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_bytes_depend_on_nothing_but_the_content(tmp_path: Path, name: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    publish(tmp_path / "a.tif", name)
    publish(tmp_path / "elsewhere" / "another name.tif", name)
    publish(tmp_path / "b.tif", name, block=97)
    digests = {hashlib.sha256(p.read_bytes()).hexdigest() for p in tmp_path.rglob("*.tif")}
    assert len(digests) == 1


@pytest.mark.parametrize("order", ["rows", "backwards", "columns", "twice", "one missing"])
def test_the_hash_of_what_is_written_is_that_of_what_is_read(tmp_path: Path, order: str) -> None:
    rows, cols = 300, 410
    pixels = pixels_of(CLASSES, rows, cols)
    windows = list(blocks((rows, cols), 128))
    windows = {
        "rows": windows,
        "backwards": windows[::-1],
        "columns": sorted(windows, key=lambda one: one.col),
        "twice": [*windows, windows[3]],
        "one missing": windows[:-1],
    }[order]
    with publishing_cog(tmp_path / "a.tif", grid(rows, cols), CLASSES, provenance()) as writer:
        for window in windows:
            writer.write(window, pixels[(slice(None), *window.slices)])
        assert (writer.content is not None) == (order == "rows")
    found = cog_provenance(tmp_path / "a.tif")
    assert found is not None
    with rasterio.open(tmp_path / "a.tif") as raster:
        written = raster.read()
    assert np.array_equal(written[:, :256], pixels[:, :256])
    assert np.array_equal(written, pixels) == (order != "one missing")


def test_what_the_disk_lost_before_the_copy_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    overviews = cog._add_overviews

    def lossy(work: Path, *rest: Any) -> None:
        with rasterio.open(work, "r+") as raster:
            place = ((9, 10), (9, 10))
            raster.write(np.uint8(254) - raster.read(window=place), window=place)
        overviews(work, *rest)

    monkeypatch.setattr(cog, "_add_overviews", lossy)
    with pytest.raises(OutputError, match="does not read back as it was written"):
        publish(tmp_path / "a.tif", "classes")
    assert not any(tmp_path.iterdir())


def test_side_cars_of_an_older_file_are_deleted(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    for suffix in ("", ".msk", ".aux.xml", ".ovr"):
        path.with_name(path.name + suffix).write_text("old")
    (tmp_path / "ab.tif.msk").write_text("another's")
    publish(path, "classes")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.qml", "a.tif", "ab.tif.msk"]


def test_a_failure_midway_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_text("old")

    def fail() -> Iterator[None]:
        with publishing_cog(path, grid(600, 600), CLASSES, provenance()) as writer:
            writer.write(Window(0, 0, 600, 600), np.zeros((600, 600), np.uint8))
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.tif", "old")]


def test_creation_options_are_obeyed(tmp_path: Path) -> None:
    layout = Layout(bands=("class",), dtype="uint8", creation={"compress": "lzw", "blocksize": "256"})
    with publishing_cog(tmp_path / "a.tif", grid(600, 600), layout, provenance()) as writer:
        writer.write(Window(0, 0, 600, 600), np.zeros((600, 600), np.uint8))
    with open_raster(tmp_path / "a.tif") as raster:
        assert raster.compression == "lzw"
        assert raster.block_shape == (256, 256)


@pytest.mark.parametrize("name", LAYOUTS)
def test_deflate_is_the_default(tmp_path: Path, name: str) -> None:
    publish(tmp_path / "a.tif", name)
    with open_raster(tmp_path / "a.tif") as raster:
        assert raster.compression == "deflate"


@pytest.mark.parametrize("harm", ["zeros", "cut", "gone"])
def test_what_gdal_loses_without_a_word_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: str) -> None:
    copy = cog._copy_to_cog

    def lossy(work: Path, draft: Path, *rest: Any) -> None:
        copy(work, draft, *rest)
        whole = draft.read_bytes()
        middle = len(whole) * 3 // 4
        draft.write_bytes(
            {"zeros": whole[:middle] + bytes(len(whole) - middle), "cut": whole[:middle], "gone": b""}[harm]
        )

    monkeypatch.setattr(cog, "_copy_to_cog", lossy)
    path = tmp_path / "a.tif"
    path.write_text("old")
    with pytest.raises(OutputError, match=r"a\.tif: cannot be written: does not read back as it was written"):
        publish(path, "classes")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.tif", "old")]


@pytest.mark.parametrize(
    ("name", "value"),
    [("COMPRESS", "ZSTD"), ("COMPRESS", "NONE"), ("LEVEL", "9"), ("PREDICTOR", "STANDARD"), ("BIGTIFF", "YES")],
)
def test_every_way_to_store_is_lossless(tmp_path: Path, name: str, value: str) -> None:
    layout = Layout(bands=("class",), dtype="uint8", creation={name: value})
    pixels = pixels_of(CLASSES, 600, 600)
    with publishing_cog(tmp_path / "a.tif", grid(600, 600), layout, provenance()) as writer:
        writer.write(Window(0, 0, 600, 600), pixels)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        np.testing.assert_array_equal(dataset.read(), pixels)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("COMPRESS", "NOSUCH"),
        ("COMPRESS", "JPEG"),  # lossy
        ("BLOCKSIZE", "-5"),
        ("BLOCKSIZE", "x"),
        ("LEVEL", "high"),
        ("TARGET_SRS", "EPSG:3857"),  # would warp
        ("CMPRESS", "ZSTD"),
    ],
)
def test_a_creation_option_that_cannot_be_obeyed_is_refused(tmp_path: Path, name: str, value: str) -> None:
    layout = Layout(bands=("class",), dtype="uint8", creation={name: value})
    with (
        pytest.raises(ArgumentError, match=f"--co {name}"),
        publishing_cog(tmp_path / "a.tif", grid(600, 600), layout, provenance()),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_unreferenced_raster_stays_one(tmp_path: Path) -> None:
    unplaced = Grid(60, 60, Affine.identity(), None)
    with publishing_cog(tmp_path / "a.tif", unplaced, CLASSES, provenance()) as writer:
        writer.write(Window(0, 0, 60, 60), np.zeros((60, 60), np.uint8))
    assert cog_provenance(tmp_path / "a.tif") is not None
    with pytest.raises(InputError, match="no coordinate reference system"), open_raster(tmp_path / "a.tif"):
        pass


# In a mount namespace of its own: for each size a file system that small with an old output on it, and a child that
# writes there. Prints a line of JSON for each: [size, exit code, message, files left, whether the old output is there].
SWEEP = """
import json, os, subprocess, sys
from pathlib import Path
import test_cog
from hrt_cli.errors import OutputError
folder = Path(sys.argv[1])
target = folder / "out.tif"
for size in sys.argv[2:]:
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", folder], check=True)
    target.write_text("old")
    back, forth = os.pipe()
    child = os.fork()
    if child == 0:
        code = 0
        try:
            pixels = test_cog.publish(target, "classes", 1024, 1024, 100)
            with test_cog.rasterio.open(target) as dataset:
                assert (dataset.read() == pixels).all()
        except OutputError as error:
            code = 7
            os.write(forth, str(error).encode())
        except BaseException as error:
            code = 8
            os.write(forth, repr(error).encode())
        os._exit(code)
    os.close(forth)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    message = os.read(back, 10000).decode()
    os.close(back)
    left = sorted(path.name for path in folder.iterdir())
    print(json.dumps([size, code, message, left, target.read_bytes() == b"old"]), flush=True)
    subprocess.run(["umount", folder], check=True)
"""


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    unshare = shutil.which("unshare")
    folder = tmp_path / "small"
    folder.mkdir()
    trial = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder]
    if not unshare or subprocess.run([unshare, "-rm", *trial], capture_output=True, check=False).returncode:
        pytest.skip("file systems cannot be mounted here")
    publish(tmp_path / "whole.tif", "classes", 1024, 1024, 100)
    # The uncompressed working file with its overviews and the finished file lie there together.
    needed = (1024 * 1024 * 4 // 3 + (tmp_path / "whole.tif").stat().st_size) // 1024
    sizes = [8, 40, 100, *(int(needed * share) for share in np.linspace(0.3, 1.15, 12))]
    here = Path(__file__).parent
    done = subprocess.run(
        [unshare, "-rm", sys.executable, "-c", SWEEP, folder, *map(str, sizes)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (here, here.parent, here.parents[1])))},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    outcomes = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(outcomes) == len(sizes)
    failures = [outcome for outcome in outcomes if outcome[1]]
    assert 9 <= len(failures) < len(sizes)
    for _, code, message, left, kept in outcomes:
        if code == 0:
            assert left == ["out.qml", "out.tif"]
            assert not kept
        else:
            assert code == 7, message
            assert "No space left on device" in message
            assert left == ["out.tif"]
            assert kept
