"""`hrt segment` from file to file: what is fitted, applied, grown, cut up and told of it."""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from conftest import patchwork
from numpy.typing import NDArray
from raster_files import PIXEL_M, PLACE, UTM33, write_raster
from scipy.ndimage import distance_transform_cdt

from hrt_cli import main as shell
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import OutputError
from hrt_cli.texture.segment import NODATA, SegmentSpec, halo_px
from hrt_cli.texture.stage import Wanted, Work, read_model, segment_file

U8 = NDArray[np.uint8]
ROWS, COLS = 700, 600
FINE = ("--wavelengths", f"{4 * PIXEL_M},{8 * PIXEL_M}")
"""Short wavelengths, so that little of a small raster is near its rim."""


def site(rows: int = ROWS, cols: int = COLS, seed: int = 0) -> U8:
    """Four textures, [3, rows, cols]; black, which stands for nodata, in a disc and along a ragged edge."""
    pixels = np.moveaxis(np.maximum(patchwork(rows, cols, seed), 1), -1, 0).copy()
    y, x = np.mgrid[:rows, :cols]
    pixels[:, (np.hypot(y - rows / 3, x - cols / 2) < 40) | (x < 12 + 8 * np.sin(y / 20))] = 0
    return pixels


def at(row: int, col: int) -> Affine:
    return PLACE @ Affine.translation(col, row)


@pytest.fixture(scope="module")
def ortho(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_raster(
        tmp_path_factory.mktemp("site") / "ortho.tif", site(), nodata=0, tiled=True, blockxsize=256, blockysize=256
    )


@pytest.fixture(scope="module")
def fitted(ortho: Path) -> tuple[Path, Path]:
    """The classes and the model of the whole site."""
    output, model = ortho.with_name("classes.tif"), ortho.with_name("model.npz")
    spec = SegmentSpec(4, wavelengths_m=(4 * PIXEL_M, 8 * PIXEL_M))
    segment_file([ortho], output, Wanted(spec, model_out=model))
    return output, model


def classes_of(path: Path) -> U8:
    with rasterio.open(path) as dataset:
        return np.asarray(dataset.read(1))


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Program:
    """`hrt`, run in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def fails(self, *args: object) -> tuple[int, str]:
        """Exit code and the last line on stderr."""
        self.capsys.readouterr()
        code = shell._run([str(one) for one in args])
        lines = self.capsys.readouterr().err.splitlines()
        return code, lines[-1] if lines else ""

    def __call__(self, *args: object) -> dict[str, Any]:
        """The JSON result of a run that succeeds."""
        self.capsys.readouterr()
        code = shell._run([str(one) for one in args] + ["--json"])
        out, err = self.capsys.readouterr()
        assert code == 0, err
        result: dict[str, Any] = json.loads(out)
        return result


@pytest.fixture
def hrt(capsys: pytest.CaptureFixture[str]) -> Program:
    return Program(capsys)


def lasting(result: dict[str, Any]) -> dict[str, Any]:
    """What a result says of the output, without what it says of the run."""
    return {
        name: value
        for name, value in result.items()
        if name not in ("seconds", "megapixels_per_second", "up_to_date", "output")
    }


class TestNumberOfClasses:
    def test_auto_takes_the_number_of_the_highest_ratio(
        self, hrt: Program, ortho: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("hrt_cli.texture.cluster._CONSIDERED_PATCHES", 800)
        output = tmp_path / "c.tif"
        found = hrt("segment", ortho, "-o", output, "-K", "auto")
        ratios = {int(k): value for k, value in found["variance_ratios"].items()}
        assert list(ratios) == list(range(2, 13))
        assert found["classes"] == max(ratios, key=lambda k: ratios[k])
        assert len(found["class_table"]) == len(found["class_fractions"]) == found["classes"]
        assert set(np.unique(classes_of(output))) == {*range(found["classes"]), NODATA}
        assert (found["novel_share"], found["new_classes"]) == (None, 0)
        again = hrt("segment", ortho, "-o", output, "-K", "auto")
        assert again["up_to_date"]
        assert lasting(again) == lasting(found)
        asked = hrt("segment", ortho, "-o", tmp_path / "d.tif", "-K", found["classes"])
        assert asked["variance_ratios"] == {}
        assert np.array_equal(classes_of(tmp_path / "d.tif"), classes_of(output))

    @pytest.mark.parametrize("number", ["1", "256", "-3", "4.0", "many", "AUTO"])
    def test_others_are_no_number_of_classes(self, hrt: Program, ortho: Path, tmp_path: Path, number: str) -> None:
        code, line = hrt.fails("segment", ortho, "-o", tmp_path / "c.tif", "-K", number)
        assert code == 2
        assert "neither a number from 2 to 255 nor auto" in line


class TestModel:
    def test_a_model_gives_the_classes_of_its_fit(
        self, hrt: Program, ortho: Path, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        classes, model = fitted
        applied = hrt("segment", ortho, "-o", tmp_path / "c.tif", "--model", model)
        assert np.array_equal(classes_of(tmp_path / "c.tif"), classes_of(classes))
        assert applied["novel_share"] <= 0.002
        assert applied["new_classes"] == 0
        assert applied["notes"] == []
        assert applied["variance_ratios"] == {}
        again = hrt("segment", ortho, "-o", tmp_path / "c.tif", "--model", model)
        assert again["up_to_date"]
        assert lasting(again) == lasting(applied)

    def test_what_is_new_is_told_and_grown(
        self, hrt: Program, ortho: Path, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        model = fitted[1]
        pixels = site(seed=1)
        # Snow lies on a third of the site.
        snow = np.random.default_rng(0).normal(235, 4, (3, 240, COLS))
        pixels[:, 460:] = np.clip(snow, 1, 255)
        survey = write_raster(tmp_path / "later.tif", pixels, nodata=0)
        plain = hrt("segment", survey, "-o", tmp_path / "plain.tif", "--model", model)
        assert plain["classes"] == 4
        assert plain["new_classes"] == 0
        assert 0.2 < plain["novel_share"] < 0.5
        (note,) = plain["notes"]
        assert "unlike every class" in note
        assert "--grow" in note
        arguments = ("--model", model, "--grow", "--model-out", tmp_path / "grown.npz")
        grown = hrt("segment", survey, "-o", tmp_path / "grown.tif", *arguments)
        assert grown["novel_share"] == plain["novel_share"]
        assert grown["new_classes"] >= 1
        assert grown["classes"] == 4 + grown["new_classes"] == len(grown["class_table"])
        (note,) = grown["notes"]
        assert f"{grown['new_classes']} classes are new" in note
        code, line = hrt.fails("segment", survey, "-o", tmp_path / "plain.tif", "--model", model, "--grow")
        assert code == 1
        assert "was not made by this run" in line
        before, after = classes_of(tmp_path / "plain.tif"), classes_of(tmp_path / "grown.tif")
        assert (after[480:] >= 4).mean() > 0.95
        assert (after[:440] == before[:440]).mean() > 0.98
        again = hrt("segment", survey, "-o", tmp_path / "grown.tif", *arguments)
        assert again["up_to_date"]
        assert lasting(again) == lasting(grown)
        old, new = read_model(model), read_model(tmp_path / "grown.npz")
        assert new.classes == grown["classes"]
        assert np.array_equal(new.centroids[:4], old.centroids)
        assert np.array_equal(new.transform, old.transform)
        kept = hrt("segment", survey, "-o", tmp_path / "kept.tif", "--model", tmp_path / "grown.npz")
        assert np.array_equal(classes_of(tmp_path / "kept.tif"), after)
        assert kept["novel_share"] < 0.05
        assert lasting(kept)["class_table"] == lasting(grown)["class_table"]

    def test_where_nothing_is_new_the_model_stays_as_it_was(
        self, hrt: Program, ortho: Path, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        arguments = ("--model", fitted[1], "--grow", "--model-out", tmp_path / "m.npz")
        found = hrt("segment", ortho, "-o", tmp_path / "c.tif", *arguments)
        assert (found["new_classes"], found["classes"], found["notes"]) == (0, 4, [])
        same, old = read_model(tmp_path / "m.npz").to_arrays(), read_model(fitted[1]).to_arrays()
        assert all(np.array_equal(same[name], old[name]) for name in old)
        assert np.array_equal(classes_of(tmp_path / "c.tif"), classes_of(fitted[0]))

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ((), "give either --classes"),
            (("-K", "4", "--model", "m.npz"), "give either --classes"),
            (("-K", "4", "--grow"), "--grow adds classes to a model"),
            (("--model", "m.npz", "--model-out", "n.npz"), "--model-out keeps a model"),
        ],
    )
    def test_options_that_do_not_go_together(
        self, hrt: Program, ortho: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
    ) -> None:
        code, line = hrt.fails("segment", ortho, "-o", tmp_path / "c.tif", *arguments)
        assert code == 2
        assert message in line
        assert list(tmp_path.iterdir()) == []

    def test_one_file_is_not_two_outputs(self, hrt: Program, ortho: Path, tmp_path: Path) -> None:
        arguments = ("-o", tmp_path / "c.tif", "--model-out", tmp_path / "x" / ".." / "c.tif")
        code, line = hrt.fails("segment", ortho, "-K", "4", *arguments)
        assert code == 1
        assert "named for two outputs" in line

    def test_the_model_grown_from_is_not_written_over(
        self, hrt: Program, ortho: Path, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        model = fitted[1]
        before = sha256(model)
        arguments = ("--model", model, "--grow", "--model-out", model, "--overwrite")
        code, line = hrt.fails("segment", ortho, "-o", tmp_path / "c.tif", *arguments)
        assert code == 1
        assert "the output is also an input" in line
        assert sha256(model) == before


def band_noise(rng: np.random.Generator, rows: int, cols: int, wavelength_px: float, upright: bool) -> NDArray[Any]:
    """Noise of one octave about a wavelength, of all directions or of waves along the columns axis; sd 1."""
    fy, fx = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(cols)[None]
    octaves = np.log2(np.maximum(np.hypot(fy, fx), 1e-9) * wavelength_px)
    weight = np.exp(-0.5 * (octaves / 0.3) ** 2)
    if upright:
        weight = weight * (np.abs(fy) < 0.2 * np.abs(fx))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=(rows, cols))) * weight).real
    return np.asarray(noise / noise.std())


def scaled_site(path: Path, times: int) -> Path:
    """Grey: waves of 8 pixels across, noise of 8 pixels, faint noise of 5 pixels; or of so many times as many."""
    rng = np.random.default_rng(times)
    strips = [
        30 * band_noise(rng, 400, 300, 8 * times, True),
        30 * band_noise(rng, 400, 300, 8 * times, False),
        5 * band_noise(rng, 400, 300, 5 * times, False),
    ]
    grey = np.clip(120 + np.concatenate(strips, axis=1), 1, 255).astype(np.uint8)
    return write_raster(path, np.stack([grey] * 3))


@pytest.mark.parametrize("invariant", [True, False])
def test_a_texture_seen_larger_is_the_same_when_asked(hrt: Program, tmp_path: Path, invariant: bool) -> None:
    model = tmp_path / "m.npz"
    flag = ("--scale-invariant",) if invariant else ()
    near, far = (scaled_site(tmp_path / f"{times}.tif", times) for times in (1, 2))
    hrt("segment", near, "-o", tmp_path / "a.tif", "-K", 3, "--features", "texture", "--model-out", model, *flag)
    hrt("segment", far, "-o", tmp_path / "b.tif", "--model", model)
    assert read_model(model).settings.scale_invariant == invariant
    middle = np.r_[40:260, 340:560, 640:860]
    one, other = (classes_of(tmp_path / name)[40:-40, middle] for name in ("a.tif", "b.tif"))
    strips = [one[:, at : at + 220] for at in (0, 220, 440)]
    assert sorted(int(np.bincount(strip.ravel()).argmax()) for strip in strips) == [0, 1, 2]
    same = (one == other).mean()
    assert same > 0.9 if invariant else same < 0.75


class TestCutting:
    def test_the_file_does_not_depend_on_blocks_and_workers(self, ortho: Path, tmp_path: Path) -> None:
        spec = SegmentSpec(5)
        shas = set()
        for block_px in (256, 512, 1024):
            for workers in (1, 2):
                output = tmp_path / f"{block_px}-{workers}" / "c.tif"
                output.parent.mkdir()
                work = Work(block_px, workers)
                segment_file([ortho], output, Wanted(spec, model_out=output.with_name("m.npz")), work=work)
                shas.add((sha256(output), sha256(output.with_name("m.npz"))))
        assert len(shas) == 1

    @pytest.mark.parametrize("as_folder", [True, False])
    def test_tiles_give_the_classes_of_the_whole(
        self, hrt: Program, fitted: tuple[Path, Path], tmp_path: Path, as_folder: bool
    ) -> None:
        folder, pixels = tmp_path / "tiles", site()
        folder.mkdir()
        for i, (top, bottom) in enumerate([(0, 333), (333, ROWS)]):
            for j, (left, right) in enumerate([(0, 250), (240, 411), (411, COLS)]):
                write_raster(
                    folder / f"{i}{j}.tif", pixels[:, top:bottom, left:right], transform=at(top, left), nodata=0
                )
        given = [folder] if as_folder else sorted(folder.iterdir())
        expected = classes_of(fitted[0])
        hrt("segment", *given, "-o", tmp_path / "a.tif", "--model", fitted[1])
        assert np.array_equal(classes_of(tmp_path / "a.tif"), expected)
        hrt("segment", *given, "-o", tmp_path / "b.tif", "-K", 4, *FINE, "--workers", 2, "--block", 256)
        assert np.array_equal(classes_of(tmp_path / "b.tif"), expected)

    def test_a_crop_has_the_classes_of_the_whole_away_from_its_rim(
        self, hrt: Program, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        top, left = 101, 67
        crop = write_raster(tmp_path / "crop.tif", site()[:, top:, left:], transform=at(top, left), nodata=0)
        hrt("segment", crop, "-o", tmp_path / "c.tif", "--model", fitted[1])
        rows, cols = halo_px(read_model(fitted[1]).settings, (PIXEL_M, PIXEL_M))
        assert 0 < rows < 300
        part, whole = classes_of(tmp_path / "c.tif"), classes_of(fitted[0])[top:, left:]
        # The scale of UTM at the middle of the crop is another one in the ninth digit; the model's counts.
        assert part[rows:, cols:].size > 50_000
        assert np.array_equal(part[rows:, cols:], whole[rows:, cols:])
        assert (part == whole).mean() > 0.97

    def test_an_area_of_interest_masks_before_anything_is_measured(
        self, hrt: Program, ortho: Path, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        corners = [(20.2, 30.7), (10.1, 580.3), (690.4, 560.6), (650.3, 25.2), (20.2, 30.7)]
        ring = [list(PLACE @ (col, row)) for row, col in corners]
        crs = {"type": "name", "properties": {"name": UTM33}}
        area = tmp_path / "area.geojson"
        area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring], "crs": crs}))
        found = hrt("segment", ortho, "-o", tmp_path / "c.tif", "--model", fitted[1], "--aoi", area)
        clipped = classes_of(tmp_path / "c.tif")
        with rasterio.open(tmp_path / "c.tif") as dataset:
            column, row = ~PLACE @ (dataset.transform.c, dataset.transform.f)
        whole = classes_of(fitted[0])[round(row) :, round(column) :][: clipped.shape[0], : clipped.shape[1]]
        y, x = np.mgrid[: clipped.shape[0], : clipped.shape[1]]
        y, x = y + round(row) + 0.5, x + round(column) + 0.5
        inside = np.ones(clipped.shape, bool)
        for (r0, c0), (r1, c1) in itertools.pairwise(corners):
            inside &= (c1 - c0) * (y - r0) > (r1 - r0) * (x - c0)
        assert inside.any()
        assert (clipped[~inside] == NODATA).all()
        assert np.array_equal(clipped[inside] == NODATA, whole[inside] == NODATA)
        assert found["valid_pixels"] == (inside & (whole != NODATA)).sum()
        reach = max(halo_px(read_model(fitted[1]).settings, (PIXEL_M, PIXEL_M)))
        deep = distance_transform_cdt(np.pad(inside, 1), "chessboard")[1:-1, 1:-1] > reach
        assert deep.mean() > 0.05
        assert np.array_equal(clipped[deep], whole[deep])
        # Near the rim what lies outside no longer counts.
        assert 0.97 < (clipped[inside] == whole[inside]).mean() < 1


class TestRefusals:
    def test_a_full_disk_is_told_and_changes_nothing(
        self, ortho: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        output = tmp_path / "c.tif"
        output.write_bytes(b"what was there")

        def full(*args: object) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "pwrite", full)
        with pytest.raises(OutputError, match=r"c\.tif: No space left on device; nothing was changed"):
            segment_file([ortho], output, Wanted(SegmentSpec(3)), work=Work(workers=2), existing=Existing(True))
        assert output.read_bytes() == b"what was there"
        assert list(tmp_path.iterdir()) == [output]

    def test_a_folder_without_room_for_the_cells_is_told(
        self, ortho: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def refuse(**options: object) -> None:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

        monkeypatch.setattr("tempfile.TemporaryFile", refuse)
        with pytest.raises(OutputError, match="cannot be written: Permission denied"):
            segment_file([ortho], tmp_path / "c.tif", Wanted(SegmentSpec(3)))

    def test_a_model_for_coarser_ground_is_refused_by_the_name_of_the_raster(
        self, hrt: Program, fitted: tuple[Path, Path], tmp_path: Path
    ) -> None:
        coarse = write_raster(tmp_path / "coarse.tif", site(200, 200), transform=PLACE @ Affine.scale(2), nodata=0)
        code, line = hrt.fails("segment", coarse, "-o", tmp_path / "c.tif", "--model", fitted[1])
        assert code == 1
        assert line.startswith(f"Error: {coarse}: the texture wavelength 0.4 m is 2 pixels")
        assert not (tmp_path / "c.tif").exists()

    def test_a_wanted_without_either_is_a_mistake_of_the_caller(self, ortho: Path, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="either a specification or a model"):
            segment_file([ortho], tmp_path / "c.tif", Wanted())
