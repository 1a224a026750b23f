"""The sweep over the pixels on a Dask cluster: every worker opens the orthomosaic itself and sends back cells."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hrt_cli
from hrt_cli.errors import ClusterError, InputError
from hrt_cli.progress import Progress
from hrt_cli.raster.image import Image, Stretch
from hrt_cli.raster.mosaic import open_layer
from hrt_cli.texture.cells import Cells, row_shares
from hrt_cli.texture.measure import Gauge, Part
from hrt_cli.texture.settings import FeatureSettings

CONNECT_S = 30
"""How long to wait for the scheduler and for a first worker."""
_STRIPS_PER_TASK = 2
_TASKS_PER_THREAD = 2
"""Tasks in flight for every thread of the cluster, so that results do not pile up on it."""
_RETRIES = 3


@dataclass(frozen=True)
class Recipe:
    """How a worker opens the orthomosaic just as this process has.

    Attributes
    ----------
    paths : tuple of Path
        Absolute; the workers must find the same files there.
    bands, nodata, unreferenced, aoi
        As in `open_orthomosaic`.
    stretch : Stretch or None
        What was found from the whole raster.
    sizes : dict of Path to int
        Bytes of every file behind it, so that a stale copy is noticed.
    version : str
        Of hrt.
    """

    paths: tuple[Path, ...]
    bands: tuple[int, ...]
    nodata: float | None
    unreferenced: bool
    aoi: Path | None
    stretch: Stretch | None
    sizes: dict[Path, int]
    version: str = hrt_cli.__version__

    @classmethod
    def of(
        cls,
        image: Image,
        paths: list[Path],
        bands: tuple[int, ...],
        nodata: float | None,
        unreferenced: bool,
        aoi: Path | None,
    ) -> Recipe:
        """Return the recipe of an image that was opened with these arguments."""
        files = {path.resolve() for path in image.sources().values()}
        return cls(
            paths=tuple(path.resolve() for path in paths),
            bands=bands,
            nodata=nodata,
            unreferenced=unreferenced,
            aoi=aoi.resolve() if aoi else None,
            stretch=image.stretch,
            sizes={path: path.stat().st_size for path in sorted(files)},
        )

    @contextmanager
    def open(self) -> Iterator[Image]:
        """Open the orthomosaic without looking at its values again.

        Raises
        ------
        InputError
            A file is absent here, or is not the one that the recipe is for.
        ClusterError
            This is another version of hrt.
        """
        if self.version != hrt_cli.__version__:
            raise ClusterError(f"a worker runs hrt {hrt_cli.__version__}, this is {self.version}: install one version")
        for path, size in self.sizes.items():
            if not path.is_file() or path.stat().st_size != size:
                raise InputError(path, "is not the same file for a worker", "put it on a file system that all share")
        with open_layer(self.paths, bands=self.bands, nodata=self.nodata, unreferenced=self.unreferenced) as raster:
            image = Image(raster)
            image.stretch = self.stretch
            if self.aoi is not None:
                image.clip(self.aoi)
            yield image


def sweep_rows(
    recipe: Recipe, settings: FeatureSettings, pixel_m: tuple[float, float], rows: tuple[int, int], rows_px: int
) -> list[Part]:
    """Measure a range of rows of cells: what runs on a worker."""
    with recipe.open() as image:
        return list(Gauge(settings, pixel_m).sweep(image, rows, rows_px))


def sweep_on(address: str, recipe: Recipe) -> Callable[[Cells, int, Progress], None]:
    """Return what fills `Cells` from a cluster, for `hrt_cli.texture.cells.measured`.

    A worker that dies loses only what it was at: the scheduler gives its tasks to others. The measures are those of a
    run on one machine, to the bit, where the processors are of one kind.

    Parameters
    ----------
    address : str
        Of the scheduler, such as tcp://10.0.0.1:8786.
    recipe : Recipe

    Raises
    ------
    ClusterError
        The `dask` extra is not installed.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ClusterError("--dask needs more packages: pip install 'hrt[dask]'") from error
    # What goes wrong on the cluster reaches the user as one line, not as the log of its heartbeats.
    # Dask gives the client's logger a level of its own.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)

    def fill(cells: Cells, rows_px: int, progress: Progress) -> None:
        try:
            client = Client(address, timeout=CONNECT_S, set_as_default=False)
        # An assertion is what Dask fails with where its event loop is slow to start.
        except (OSError, ValueError, AssertionError) as error:
            raise ClusterError(f"--dask {address}: no Dask scheduler answers there") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=CONNECT_S)
            except TimeoutError as error:
                raise ClusterError(f"--dask {address}: the scheduler has no worker") from error
            _gather(client, recipe, cells, rows_px, progress)

    return fill


def _gather(client: Any, recipe: Recipe, cells: Cells, rows_px: int, progress: Progress) -> None:
    from distributed import as_completed

    step = cells.grid.step_px
    shares = row_shares(cells.grid, -(-cells.grid.rows * step // (_STRIPS_PER_TASK * rows_px)))
    threads = sum(client.nthreads().values())

    def submit(rows: tuple[int, int]) -> Any:
        return client.submit(
            sweep_rows, recipe, cells.settings, cells.pixel_m, rows, rows_px, pure=False, retries=_RETRIES
        )

    waiting = iter(shares)
    first = [submit(rows) for rows in itertools.islice(waiting, _TASKS_PER_THREAD * threads)]
    running = as_completed(first, loop=client.loop)
    for done, future in enumerate(running, start=1):
        for part in _result(future):
            cells.put(part)
        future.release()
        progress(done, len(shares))
        for rows in itertools.islice(waiting, 1):
            running.add(submit(rows))


def _result(future: Any) -> list[Part]:
    from concurrent.futures import CancelledError

    from distributed import KilledWorker

    try:
        parts: list[Part] = future.result()
    except KilledWorker as error:
        raise ClusterError("--dask: workers died at the same task again and again: give them memory") from error
    except CancelledError as error:
        raise ClusterError("--dask: the scheduler went away while it was at work; start it and run again") from error
    return parts
