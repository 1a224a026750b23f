from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import CancelledError
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from conftest import patchwork
from raster_files import PIXEL_M, PLACE, UTM33, write_raster

from hrt_cli.errors import ArgumentError, ClusterError, HrtError, InputError
from hrt_cli.raster.image import open_orthomosaic
from hrt_cli.texture import distributed as room
from hrt_cli.texture.cells import Cells, measured
from hrt_cli.texture.distributed import Recipe, sweep_on, sweep_rows
from hrt_cli.texture.measure import Gauge
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.stage import Wanted, Work, segment_file

distributed = pytest.importorskip("distributed", reason="the dask extra is not installed")

SPEC = SegmentSpec(4, wavelengths_m=(4 * PIXEL_M, 8 * PIXEL_M))
NOTHING: dict[str, Any] = {"bands": (), "nodata": None, "unreferenced": False, "aoi": None}


@pytest.fixture(scope="module")
def ortho(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pixels = np.moveaxis(np.maximum(patchwork(640, 300), 1), -1, 0).copy()
    pixels[:, 200:260, 100:180] = 0
    path = tmp_path_factory.mktemp("site") / "ortho.tif"
    return write_raster(path, pixels, nodata=0, tiled=True, blockxsize=64, blockysize=64)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes."""
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**options) as started:
        yield started


def recipe_of(path: Path, **options: Any) -> Recipe:
    with open_orthomosaic([path], **{**NOTHING, **options}) as image:
        return Recipe.of(image, [path], **{**NOTHING, **options})


class TestRecipe:
    def test_a_worker_sees_the_image_that_this_process_does(self, tmp_path: Path) -> None:
        pixels = (np.moveaxis(patchwork(200, 220), -1, 0).astype(np.uint16) + 1) * 100
        path = write_raster(tmp_path / "deep.tif", np.concatenate([pixels, pixels[:1]]), nodata=0)
        ring = [list(PLACE @ corner) for corner in [(5, 6), (190, 20), (150, 180), (5, 6)]]
        aoi = tmp_path / "area.geojson"
        crs = f'{{"type": "name", "properties": {{"name": "{UTM33}"}}}}'
        aoi.write_text(f'{{"type": "Polygon", "coordinates": [{ring}], "crs": {crs}}}')
        options: dict[str, Any] = {"bands": (4, 2, 3), "nodata": 12_300.0, "unreferenced": False, "aoi": aoi}
        with open_orthomosaic([path], **options) as image:
            recipe = Recipe.of(image, [path], **options)
            assert image.stretch is not None
            gauge = Gauge(SPEC.settings(image.pixel_m), image.pixel_m)
            grid = gauge.grid(image)
            rows = (grid.row + 3, grid.row + 11)
            expected = list(gauge.sweep(image, rows, 64))
        assert pickle.loads(pickle.dumps(recipe)) == recipe
        found = sweep_rows(recipe, gauge.settings, gauge.pixel_m, rows, 64)
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert (one.grid, one.window) == (other.grid, other.window)
            assert np.array_equal(one.cells, other.cells)
            assert one.valid_pixels == other.valid_pixels
            assert (one.invalid is None) == (other.invalid is None)
            assert one.invalid is None or np.array_equal(one.invalid, other.invalid)
        assert any(part.valid_pixels for part in found)

    def test_paths_are_absolute(self, ortho: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(ortho.parent)
        recipe = recipe_of(Path(ortho.name))
        monkeypatch.chdir("/")
        with recipe.open() as image:
            assert image.shape == (640, 300)

    def test_another_version_is_refused(self, ortho: Path) -> None:
        recipe = replace(recipe_of(ortho), version="0.0.1")
        with pytest.raises(ClusterError, match=r"a worker runs hrt .*, this is 0\.0\.1"), recipe.open():
            pass

    @pytest.mark.parametrize("change", ["longer", "gone"])
    def test_another_file_by_the_name_is_refused(self, tmp_path: Path, change: str) -> None:
        path = write_raster(tmp_path / "a.tif", np.moveaxis(patchwork(90, 90), -1, 0))
        recipe = recipe_of(path)
        if change == "gone":
            path.unlink()
        else:
            path.write_bytes(path.read_bytes() + b"\0")
        with pytest.raises(InputError, match=r"a\.tif: is not the same file for a worker .*share"), recipe.open():
            pass

    def test_every_file_behind_the_image_is_looked_at(self, tmp_path: Path) -> None:
        for name, col in (("a.tif", 0), ("b.tif", 90)):
            place = PLACE @ Affine.translation(col, 0)
            write_raster(tmp_path / name, np.moveaxis(patchwork(90, 90), -1, 0), transform=place)
        recipe = recipe_of(tmp_path)
        assert set(recipe.sizes) == {(tmp_path / name).resolve() for name in ("a.tif", "b.tif")}


@pytest.mark.parametrize(
    "error", [InputError("a.tif", "is odd", "look at it"), InputError("a.tif", "is odd"), ArgumentError("no")]
)
def test_refusals_survive_the_way_from_a_worker(error: HrtError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def cells_of(ortho: Path) -> Cells:
    with open_orthomosaic([ortho]) as image:
        return Cells(SPEC.settings(image.pixel_m), image.pixel_m, image.shape, image.anchor)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "foo://x:1"])
def test_where_no_scheduler_answers_one_line_says_so(
    ortho: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setattr(room, "CONNECT_S", 0.3)
    fill = sweep_on(address, recipe_of(ortho))
    with pytest.raises(HrtError, match=f"^--dask {address}: no Dask scheduler answers there$"):
        fill(cells_of(ortho), 64, lambda done, total: None)


def test_a_missing_package_is_named(ortho: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(HrtError, match=r"pip install 'hrt\[dask\]'"):
        sweep_on("tcp://127.0.0.1:9", recipe_of(ortho))


class Future:
    """A task that failed."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def result(self) -> None:
        raise self.error


def test_what_ends_a_cluster_is_a_refusal() -> None:
    ends = [
        (distributed.KilledWorker("sweep_rows-1", None, 3), "give them memory"),
        (CancelledError("sweep_rows-1"), "scheduler went away"),
    ]
    for error, message in ends:
        with pytest.raises(HrtError, match=message):
            room._result(Future(error))


@pytest.mark.slow
class TestCluster:
    def test_a_worker_that_is_killed_changes_nothing(self, ortho: Path, tmp_path: Path, cluster: Any) -> None:
        local, spread = tmp_path / "local", tmp_path / "spread"
        for folder in (local, spread):
            folder.mkdir()
        segment_file([ortho], local / "c.tif", Wanted(SPEC, model_out=local / "m.npz"))
        seen: list[tuple[int, int]] = []

        def kill(done: int, total: int) -> None:
            seen.append((done, total))
            if len(seen) == 1:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)

        work = Work(block_px=64, dask=cluster.scheduler_address)
        segment_file([ortho], spread / "c.tif", Wanted(SPEC, model_out=spread / "m.npz"), work=work, progress=kill)
        # More tasks than are in flight at first, all of them done once.
        assert seen[:5] == [(done, 5) for done in range(1, 6)]
        for name in ("c.tif", "c.qml", "m.npz"):
            assert (local / name).read_bytes() == (spread / name).read_bytes()

    def test_cells_are_those_of_this_process(self, ortho: Path, cluster: Any) -> None:
        with open_orthomosaic([ortho]) as image:
            settings = SPEC.settings(image.pixel_m)
            with measured(image, settings) as here:
                expected, valid_pixels = here.read(here.grid), here.valid_pixels
            filler = sweep_on(cluster.scheduler_address, recipe_of(ortho))
            with measured(image, settings, rows_px=50, filler=filler) as there:
                assert np.array_equal(there.read(there.grid), expected)
                assert there.valid_pixels == valid_pixels

    def test_what_a_worker_refuses_reaches_the_user(self, ortho: Path, tmp_path: Path, cluster: Any) -> None:
        path = tmp_path / "a.tif"
        path.write_bytes(ortho.read_bytes())
        stale = replace(recipe_of(path), sizes={path: 17})
        with pytest.raises(InputError, match=r"a\.tif: is not the same file for a worker"):
            sweep_on(cluster.scheduler_address, stale)(cells_of(path), 64, lambda done, total: None)
        old = replace(recipe_of(path), version="0.0.1")
        with pytest.raises(ClusterError, match=r"this is 0\.0\.1"):
            sweep_on(cluster.scheduler_address, old)(cells_of(path), 64, lambda done, total: None)


@pytest.mark.slow
def test_a_scheduler_without_workers_is_refused(ortho: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "CONNECT_S", 1)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as idle,
        pytest.raises(HrtError, match="the scheduler has no worker"),
    ):
        sweep_on(idle.scheduler_address, recipe_of(ortho))(cells_of(ortho), 64, lambda done, total: None)
