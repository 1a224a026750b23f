from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ArraySource, patchwork
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hrt_cli.progress import Progress
from hrt_cli.raster.windows import Window
from hrt_cli.texture import measure
from hrt_cli.texture.cells import Cells, measured, row_shares, rows_at_once
from hrt_cli.texture.lattice import CellGrid
from hrt_cli.texture.measure import Part
from hrt_cli.texture.segment import SegmentSpec

SETTINGS = SegmentSpec(2).settings((1.0, 1.0))


def empty(shape: tuple[int, int], anchor: tuple[int, int] = (0, 0), folder: Path | None = None) -> Cells:
    return Cells(SETTINGS, (1.0, 1.0), shape, anchor, folder)


def fill(cells: Cells, values: NDArray[np.float32], valid: NDArray[np.bool_], rows: int = 1, cols: int = 1) -> None:
    """Put values and mask in `rows` x `cols` pieces, last first."""
    grid, (height, width) = cells.grid, cells.shape
    pieces = []
    for i, j in itertools.product(range(rows), range(cols)):
        r0, r1 = grid.rows * i // rows, grid.rows * (i + 1) // rows
        c0, c1 = grid.cols * j // cols, grid.cols * (j + 1) // cols
        y0, y1 = height * i // rows, height * (i + 1) // rows
        # Bits are kept in bytes: pieces start at multiples of 8, as those of a sweep do.
        x0, x1 = (width * k // cols // 8 * 8 if k < cols else width for k in (j, j + 1))
        place = CellGrid(grid.step_px, grid.row + r0, grid.col + c0, r1 - r0, c1 - c0)
        window = Window(y0, x0, y1 - y0, x1 - x0)
        pieces.append(Part.of(place, values[r0:r1, c0:c1], window, valid[window.slices]))
    for part in reversed(pieces):
        cells.put(part)


sides = st.tuples(st.integers(1, 90), st.integers(1, 90))
anchors = st.tuples(st.integers(0, 20), st.integers(0, 9999))


@settings(max_examples=60)
@given(sides, anchors, st.integers(1, 4), st.integers(1, 4), st.integers(0, 9), st.sampled_from([0.0, 0.5, 1.0]))
def test_what_is_put_is_read(
    shape: tuple[int, int], anchor: tuple[int, int], rows: int, cols: int, seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    cells = empty(shape, anchor)
    grid = cells.grid
    values = rng.normal(size=(grid.rows, grid.cols, cells.gauge.channels)).astype(np.float32)
    valid = rng.random(shape) < share
    fill(cells, values, valid, rows, cols)
    assert cells.valid_pixels == valid.sum()
    halo = 20
    padded = np.pad(values, ((halo, halo), (halo, halo), (0, 0)))
    for _ in range(5):
        row, col = (int(rng.integers(-halo, n)) for n in (grid.rows, grid.cols))
        down, on = int(rng.integers(1, grid.rows + halo - row + 1)), int(rng.integers(1, grid.cols + halo - col + 1))
        got = cells.read(CellGrid(grid.step_px, grid.row + row, grid.col + col, down, on))
        expected = padded[row + halo : row + halo + down, col + halo : col + halo + on]
        assert got.flags.c_contiguous
        assert np.array_equal(got, np.moveaxis(expected, -1, 0))
        top, left = (int(rng.integers(0, n)) for n in shape)
        window = Window(top, left, int(rng.integers(1, shape[0] - top + 1)), int(rng.integers(1, shape[1] - left + 1)))
        assert np.array_equal(cells.read_valid(window), valid[window.slices])
    cells.close()


def test_cells_never_measured_are_zero() -> None:
    cells = empty((40, 50))
    assert not cells.read(cells.grid).any()
    cells.close()


def test_reads_and_writes_in_pieces_are_carried_on(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = empty((70, 77))
    rng = np.random.default_rng(0)
    values = rng.normal(size=(cells.grid.rows, cells.grid.cols, cells.gauge.channels)).astype(np.float32)
    valid = rng.random((70, 77)) < 0.5
    write, read = os.pwrite, os.preadv
    monkeypatch.setattr(os, "pwrite", lambda file, data, at: write(file, data[:100], at))
    monkeypatch.setattr(os, "preadv", lambda file, views, at: read(file, [views[0][:7]], at))
    fill(cells, values, valid, 2, 2)
    assert np.array_equal(cells.read(cells.grid), np.moveaxis(values, -1, 0))
    assert np.array_equal(cells.read_valid(Window(0, 0, 70, 77)), valid)
    cells.close()


def test_cells_that_were_never_measured_are_not_taken_for_nothing() -> None:
    cells = empty((70, 77))
    values = np.ones((cells.grid.rows, cells.grid.cols, cells.gauge.channels), np.float32)
    valid = np.ones((70, 77), bool)
    place = CellGrid(8, cells.grid.row, cells.grid.col, 2, 3)
    cells.put(Part.of(place, values[:2, :3], Window(0, 0, 16, 24), valid[:16, :24]))
    with pytest.raises(RuntimeError, match="never measured"):
        cells.require_whole()
    rest = CellGrid(8, cells.grid.row, cells.grid.col + 3, 2, cells.grid.cols - 3)
    cells.put(Part.of(rest, values[:2, 3:], Window(0, 24, 16, 53), valid[:16, 24:]))
    cells.require_whole()
    assert (cells.read(CellGrid(8, cells.grid.row, cells.grid.col, 2, cells.grid.cols)) == 1).all()
    cells.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_stripes_of_a_wide_raster_make_one_whole(monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    rng = np.random.default_rng(2)
    source = ArraySource(patchwork(90, 400), rng.random((90, 400)) < 0.95, anchor=(3, 1005))
    whole = Window(0, 0, 90, 400)
    with measured(source, SETTINGS, rows_px=40) as cells:
        expected = cells.read(cells.grid), cells.read_valid(whole), cells.valid_pixels
    monkeypatch.setattr(measure, "_STRIPE_PX", 130)
    with measured(source, SETTINGS, rows_px=40, workers=workers) as cells:
        assert np.array_equal(cells.read(cells.grid), expected[0])
        assert np.array_equal(cells.read_valid(whole), expected[1])
        assert cells.valid_pixels == expected[2]
    assert np.array_equal(expected[1], source.valid)


def test_several_threads_may_put_and_read() -> None:
    cells = empty((320, 301))
    rng = np.random.default_rng(1)
    values = rng.normal(size=(cells.grid.rows, cells.grid.cols, cells.gauge.channels)).astype(np.float32)
    valid = rng.random((320, 301)) < 0.5

    def put_and_read(row: int) -> None:
        place = CellGrid(8, cells.grid.row + row, cells.grid.col, 1, cells.grid.cols)
        window = Window(8 * row, 0, 8, 301)
        cells.put(Part.of(place, values[row : row + 1], window, valid[window.slices]))
        assert np.array_equal(cells.read(place), np.moveaxis(values[row : row + 1], -1, 0))
        assert np.array_equal(cells.read_valid(window), valid[window.slices])

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(put_and_read, range(40)))
    assert cells.valid_pixels == valid.sum()
    cells.close()


def test_nothing_is_left_in_the_folder(tmp_path: Path) -> None:
    source = ArraySource(patchwork(100, 100))
    with measured(source, SETTINGS, folder=tmp_path) as cells:
        assert cells.read(cells.grid).any()
        # Nor is there anything while it lasts, so a process that is killed leaves nothing.
        assert list(tmp_path.iterdir()) == []

    def fail(done: int, total: int) -> None:
        raise RuntimeError

    with pytest.raises(RuntimeError), measured(source, SETTINGS, folder=tmp_path, progress=fail):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_file_is_given_up_whatever_happens() -> None:
    source = ArraySource(patchwork(100, 100))
    with pytest.raises(RuntimeError), measured(source, SETTINGS) as cells:
        raise RuntimeError
    with pytest.raises(ValueError, match="closed"):
        cells.read(cells.grid)


@pytest.mark.parametrize(("rows_px", "workers"), [(1024, 1), (64, 1), (40, 2), (64, 5), (64, 100)])
def test_all_is_measured_by_any_number_of_threads(site: ArraySource, rows_px: int, workers: int) -> None:
    settings_ = SegmentSpec(2).settings(site.pixel_m)
    seen: list[tuple[int, int]] = []
    with measured(site, settings_) as cells:
        expected = cells.read(cells.grid)
    with measured(
        site, settings_, rows_px=rows_px, workers=workers, progress=lambda *counts: seen.append(counts)
    ) as cells:
        assert np.array_equal(cells.read(cells.grid), expected)
        assert site.valid is not None
        assert cells.valid_pixels == site.valid.sum()
        assert np.array_equal(cells.read_valid(Window(0, 0, *site.shape)), site.valid)
        total = cells.grid.rows * cells.grid.cols
    done = [count for count, _ in seen]
    assert done == sorted(done)
    assert seen[-1] == (total, total)
    assert {whole for _, whole in seen} == {total}


def test_others_may_do_the_measuring(site: ArraySource) -> None:
    settings_ = SegmentSpec(2).settings(site.pixel_m)
    handed: list[Any] = []

    def filler(cells: Cells, rows_px: int, progress: Progress) -> None:
        handed.extend([rows_px, progress])
        values = np.ones((cells.grid.rows, cells.grid.cols, cells.gauge.channels), np.float32)
        fill(cells, values, np.ones(cells.shape, bool))

    progress: Callable[[int, int], None] = lambda done, total: None  # noqa: E731
    with measured(site, settings_, rows_px=96, filler=filler, progress=progress) as cells:
        assert (cells.read(cells.grid) == 1).all()
    assert handed == [96, progress]
    assert site.windows == []


@given(st.integers(-50, 50), st.integers(1, 300), st.integers(-2, 400))
def test_shares_of_the_rows_are_even_and_meet(row: int, rows: int, count: int) -> None:
    shares = row_shares(CellGrid(8, row, 3, rows, 7), count)
    assert len(shares) == max(1, min(count, rows))
    assert [a for a, _ in shares] + [row + rows] == [row] + [b for _, b in shares]
    sizes = [b - a for a, b in shares]
    assert max(sizes) - min(sizes) <= 1
    assert min(sizes) >= 1


@given(st.integers(64, 2048), st.integers(1, 9000))
def test_whole_blocks_are_read_at_once(wanted_px: int, block_rows: int) -> None:
    rows = rows_at_once(wanted_px, block_rows)
    assert 1 <= rows <= 4096
    if block_rows <= wanted_px:
        assert rows % block_rows == 0
        assert abs(rows - wanted_px) <= block_rows / 2
    elif block_rows <= 4096:
        assert rows == block_rows
