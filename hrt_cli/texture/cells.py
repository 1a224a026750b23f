"""The measures of all cells of a raster, in a nameless temporary file: what every later step works on."""

from __future__ import annotations

import itertools
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.progress import Progress, silent
from hrt_cli.raster.windows import ImageSource, Window
from hrt_cli.texture.lattice import CellGrid
from hrt_cli.texture.measure import Gauge, Part
from hrt_cli.texture.settings import FeatureSettings

F32 = NDArray[np.float32]

ROWS_PX = 1024
_MAX_ROWS_PX = 4096


@dataclass
class _Rows:
    """Rows of cells being gathered, and how many columns of them are still missing."""

    cells: F32
    missing: int


class Cells:
    """What was measured of a raster. Reads and writes are safe from several threads.

    The file has no name, so nothing is left of it whatever ends the process; it holds about 0.6 byte a pixel with the
    features of a site.

    Attributes
    ----------
    settings : FeatureSettings
    pixel_m : (float, float)
    shape, anchor : (int, int)
        Of the raster; see `ImageSource`.
    gauge : Gauge
    grid : CellGrid
        All cells of the raster.
    """

    def __init__(
        self,
        settings: FeatureSettings,
        pixel_m: tuple[float, float],
        shape: tuple[int, int],
        anchor: tuple[int, int],
        folder: Path | None = None,
    ) -> None:
        self.settings, self.pixel_m, self.shape, self.anchor = settings, pixel_m, shape, anchor
        self.gauge = Gauge(settings, pixel_m)
        self.grid = CellGrid.covering(Window(0, 0, *shape), anchor, self.gauge.step_px)
        self.valid_pixels = 0
        self._lock = threading.Lock()
        self._gathered: dict[tuple[int, int, int], _Rows] = {}
        self._record = 4 * self.gauge.channels
        self._line = self.grid.cols * self._record
        self._mask_line = -(-shape[1] // 8)
        self._mask_start = self.grid.rows * self._line
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`
        # What is never written reads as zero: cells without data, pixels with data.
        self._file.truncate(self._mask_start + shape[0] * self._mask_line)

    def close(self) -> None:
        """Give the file up."""
        self._file.close()

    def put(self, part: Part) -> None:
        """Keep what a sweep found."""
        self._put_cells(part)
        with self._lock:
            self.valid_pixels += part.valid_pixels
        if part.invalid is not None:
            for row, bits in enumerate(part.invalid, start=part.window.row):
                self._write(bits, self._mask_start + row * self._mask_line + part.window.col // 8)

    def _put_cells(self, part: Part) -> None:
        """Gather parts until they make whole rows of what is swept at once: longer pieces of the file."""
        first, last = part.columns or (self.grid.col, self.grid.col + self.grid.cols)
        place, left = (part.grid.row, part.grid.rows, first), part.grid.col - first
        with self._lock:
            if place not in self._gathered:
                whole = np.empty((part.grid.rows, last - first, self.gauge.channels), np.float32)
                self._gathered[place] = _Rows(whole, last - first)
            gathered = self._gathered[place]
        gathered.cells[:, left : left + part.grid.cols] = part.cells
        with self._lock:
            gathered.missing -= part.grid.cols
            complete = gathered.missing == 0
            if complete:
                del self._gathered[place]
        if complete:
            self._write_rows(gathered.cells, part.grid.row - self.grid.row, first - self.grid.col)

    def _write_rows(self, cells: F32, row: int, col: int) -> None:
        if cells.shape[1] == self.grid.cols:
            self._write(cells, row * self._line)
            return
        for number, line in enumerate(cells, start=row):
            self._write(line, number * self._line + col * self._record)

    def require_whole(self) -> None:
        """Make sure that no rows were left half gathered; a fault of the program if they were."""
        if self._gathered:
            raise RuntimeError(f"of the rows {sorted(self._gathered)} some columns were never measured")

    def read(self, grid: CellGrid) -> F32:
        """Return the measures of a rectangle of cells [channels, rows, cols]; zero outside the raster."""
        out = np.zeros((grid.rows, grid.cols, self.gauge.channels), np.float32)
        top, left = grid.row - self.grid.row, grid.col - self.grid.col
        begin = max(left, 0)
        end = max(min(left + grid.cols, self.grid.cols), begin)
        for row in range(max(top, 0), min(top + grid.rows, self.grid.rows)):
            self._read(out[row - top, begin - left : end - left], row * self._line + begin * self._record)
        return np.ascontiguousarray(out.transpose(2, 0, 1))

    def read_valid(self, window: Window) -> NDArray[np.bool_]:
        """Return which pixels of a window inside the raster hold data [height, width]."""
        if self.valid_pixels == self.shape[0] * self.shape[1]:
            return np.ones((window.height, window.width), np.bool_)
        first, last = window.col // 8, -(-(window.col + window.width) // 8)
        bits = np.empty((window.height, last - first), np.uint8)
        for row, line in enumerate(bits, start=window.row):
            self._read(line, self._mask_start + row * self._mask_line + first)
        skip = window.col - 8 * first
        return np.asarray(np.unpackbits(bits, axis=1)[:, skip : skip + window.width] == 0)

    def _write(self, values: NDArray[np.generic], offset: int) -> None:
        if values.size == 0:
            return
        data = np.ascontiguousarray(values).data.cast("B")
        while data:
            written = os.pwrite(self._file.fileno(), data, offset)
            data, offset = data[written:], offset + written

    def _read(self, out: NDArray[Any], offset: int) -> None:
        """Fill a contiguous array from the file."""
        if out.size == 0:
            return
        view = out.data.cast("B")
        while view:
            got = os.preadv(self._file.fileno(), [view], offset)
            view, offset = view[got:], offset + got


Filler = Callable[[Cells, int, Progress], None]
"""What fills cells otherwise than by threads of this process: `(cells, rows_px, progress)`."""


@contextmanager
def measured(
    source: ImageSource,
    settings: FeatureSettings,
    *,
    pixel_m: tuple[float, float] | None = None,
    rows_px: int = ROWS_PX,
    workers: int = 1,
    filler: Filler | None = None,
    folder: Path | None = None,
    progress: Progress = silent,
) -> Iterator[Cells]:
    """Measure all of a raster and yield its cells.

    Parameters
    ----------
    source : ImageSource
    settings : FeatureSettings
    pixel_m : (float, float), optional
        What to take the pixels for, if not for what the source says.
    rows_px : int
        Rows of pixels read at once; the measures do not depend on it.
    workers : int
        Threads; each sweeps its share of the rows.
    filler : Filler, optional
        Who measures, if not threads here.
    folder : Path, optional
        Where the temporary file lies; by default where the system keeps such.
    progress : Progress
        Counts cells.

    Raises
    ------
    ArgumentError
        The image is too coarse or too fine for the wavelengths.
    OSError
        There is no room for the temporary file.
    """
    cells = Cells(settings, pixel_m or source.pixel_m, source.shape, source.anchor, folder)
    try:
        if filler is None:
            _sweep_all(source, cells, rows_px, workers, progress)
        else:
            filler(cells, rows_px, progress)
        cells.require_whole()
        yield cells
    finally:
        cells.close()


def _sweep_all(source: ImageSource, cells: Cells, rows_px: int, workers: int, progress: Progress) -> None:
    wanted, done = cells.grid.rows * cells.grid.cols, 0
    stopped = threading.Event()
    lock = threading.Lock()

    def sweep(rows: tuple[int, int]) -> None:
        nonlocal done
        for part in cells.gauge.sweep(source, rows, rows_px):
            if stopped.is_set():
                return
            cells.put(part)
            with lock:
                done += part.grid.rows * part.grid.cols
                progress(done, wanted)

    shares = row_shares(cells.grid, workers)
    if len(shares) == 1:
        sweep(shares[0])
        return
    with ThreadPoolExecutor(len(shares)) as pool:
        try:
            for future in as_completed([pool.submit(sweep, rows) for rows in shares]):
                future.result()
        finally:
            stopped.set()


def rows_at_once(wanted_px: int, block_rows: int) -> int:
    """Return how many rows to read at once so that no block of the file is decoded twice, near `wanted_px`."""
    blocks = max(1, min(round(wanted_px / block_rows), _MAX_ROWS_PX // block_rows))
    return min(blocks * block_rows, _MAX_ROWS_PX)


def row_shares(grid: CellGrid, count: int) -> list[tuple[int, int]]:
    """Cut the rows of a grid into `count` even ranges (first, last exclusive), counted on the lattice."""
    count = max(1, min(count, grid.rows))
    edges = [grid.row + grid.rows * k // count for k in range(count + 1)]
    return list(itertools.pairwise(edges))
