"""What the benchmarks share: how large their inputs are, CPU time, and tables of figures."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
"""Real data, beside the project where there is any."""

_Result = TypeVar("_Result")
_Size = TypeVar("_Size")


class Skipped(Exception):
    """A section cannot run here; the message says what is missing."""


@dataclass(frozen=True)
class Effort:
    """How large the inputs are.

    Parameters
    ----------
    bank_px, slow_px, crop_px : int
        Side of the image for the fused bank and for Orfeo, for FFT and cv2.filter2D, and for scikit-image.
    raster_px : tuple of int
        Sides of the rasters that the whole command segments.
    tile_px : int
        Side of the synthetic meadow that a raster repeats.
    mosaics, composites, seeds : int
        Outex mosaics, composites of photographs, and synthetic sites per scene.
    site_px : int
        Side of a synthetic site.
    sites : int
        Real sites, at most.
    """

    bank_px: int = 2048
    slow_px: int = 1024
    crop_px: int = 160
    raster_px: tuple[int, ...] = (4096,)
    tile_px: int = 1024
    mosaics: int = 10
    composites: int = 5
    seeds: int = 5
    site_px: int = 1200
    sites: int = 20


NORMAL = Effort()
QUICK = Effort(
    bank_px=1024, slow_px=512, crop_px=136, raster_px=(2048,), mosaics=2, composites=1, seeds=1, site_px=800, sites=1
)
FULL = Effort(raster_px=(12_288, 24_576), tile_px=2048)


@dataclass(frozen=True)
class Table:
    """Figures: every row has the same columns; `notes` say how to read them."""

    title: str
    rows: Sequence[Mapping[str, object]]
    notes: Sequence[str] = field(default=())

    def text(self) -> str:
        columns = list(self.rows[0]) if self.rows else []
        lines = [columns, *([_shown(row[column]) for column in columns] for row in self.rows)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]
        body = ["  ".join(_placed(cell, w, k) for k, (cell, w) in enumerate(zip(one, widths, strict=True))).rstrip()
                for one in lines]  # fmt: skip
        return "\n".join([self.title, *(f"  {one}" for one in body), *(f"  {note}" for note in self.notes)])


def _shown(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _placed(cell: str, width: int, column: int) -> str:
    return cell.ljust(width) if column == 0 else cell.rjust(width)


def cpu_seconds(work: Callable[[], _Result], repeats: int = 1) -> tuple[float, _Result]:
    """Return the least CPU time of this process over `repeats` calls, and what the last one returned."""
    least = float("inf")
    for _ in range(repeats):
        began = time.process_time()
        result = work()
        least = min(least, time.process_time() - began)
    return least, result


def machine(names: Sequence[str]) -> dict[str, object]:
    """What the figures were measured on, with the versions of packages (None where one is not installed)."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    packages: dict[str, str | None] = {}
    for name in names:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = None
    processor = models[0] if models else platform.processor()
    return {"processor": processor, "cores": os.cpu_count(), "python": platform.python_version(), "packages": packages}


def measure(
    sections: Mapping[str, Callable[[_Size], list[Table]]], names: Sequence[str], size: _Size
) -> dict[str, object]:
    """Run the sections named, print their tables, and return everything as JSON values."""
    results: dict[str, object] = {}
    for name in names:
        began = time.monotonic()
        try:
            tables = sections[name](size)
        except Skipped as reason:
            print(f"{name}: skipped, {reason}\n", flush=True)
            results[name] = {"skipped": str(reason)}
            continue
        for table in tables:
            print(f"{table.text()}\n", flush=True)
        shown = [{"title": one.title, "rows": list(one.rows), "notes": list(one.notes)} for one in tables]
        results[name] = {"tables": shown, "seconds": time.monotonic() - began}
    return results
