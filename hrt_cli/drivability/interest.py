"""How much each cell is worth a visit: any raster of what the mission looks for becomes an interest from 0 to 1."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.align import Rule, field_on
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.thermal import Asked

Scores = NDArray[np.float32]

_AS_LARGE = 1 + 1e-3


@dataclass(frozen=True)
class Interest:
    """What the mission looks for, and how much that counts.

    Attributes
    ----------
    path : Path
        A raster of one band, in any unit, CRS and resolution.
    limits : (float, float) or None
        The values that count 0 and 1. None: the median and the maximum of the cells that may be entered.
    cell : {"max", "mean"}
        How a cell's value is made of the pixels in it.
    weight : float
        How much of the score depends on the interest, 0 to 1.
    units : {"celsius", "kelvin", "centikelvin", "auto"} or None
        What its temperatures are in: they, and `limits`, are then degrees Celsius. None: its values are taken as they
        are.
    radius_m : float or None
        From how far a cell is sampled, metres. None: from within only.
    """

    path: Path
    limits: tuple[float, float] | None = None
    cell: Literal["max", "mean"] = "max"
    weight: float = 1.0
    units: Asked | None = None
    radius_m: float | None = None

    def __post_init__(self) -> None:
        if self.radius_m is not None and not 0 < self.radius_m < math.inf:
            raise ArgumentError(f"--interest-radius {self.radius_m:g} must be more than 0")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            low, high = self.limits
            raise ArgumentError(f"--interest-range {low:g},{high:g}: the first value must be below the second")

    @property
    def parameters(self) -> dict[str, Any]:
        """What goes into the fingerprint beside the raster's bytes."""
        limits = None if self.limits is None else list(self.limits)
        found: dict[str, Any] = {"range": limits, "cell": self.cell, "weight": self.weight}
        if self.units is not None:
            found["units"] = self.units
        if self.radius_m is not None:
            found["radius_m"] = self.radius_m
        return found


@contextmanager
def open_interest(path: Path) -> Iterator[Raster]:
    """Open a raster of interest through the gate.

    Raises
    ------
    InputError
        As `open_raster`, and where it has several bands of which none is the one meant.
    """
    with open_raster(path) as raster:
        alpha = raster.count == 2 and raster.colours[1] == ColorInterp.alpha
        if raster.count != 1 and not alpha:
            raise InputError(
                path, f"has {raster.count} bands; a raster of interest has one", "take one with gdal_translate -b"
            )
        yield raster


def values_on(raster: Raster, grid: Grid, cell: Literal["max", "mean"]) -> Scores:
    """Return the value of each cell, in the raster's own unit: float32 [rows, cols], NaN where it has no data.

    Between pixels larger than a cell values are interpolated.

    Raises
    ------
    InputError
        The raster does not reach the grid.
    """
    rule: Rule = "max" if cell == "max" else "average"
    if max(raster.grid.pixel_m) > max(grid.pixel_m) * _AS_LARGE:
        rule = "bilinear"
    return field_on(raster, grid, rule)


def degree(
    interest: Interest, values: NDArray[np.floating], go: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float, float]:
    """Map the cells' values linearly to 0 (at the lower limit and below) to 1 (at the upper one and above).

    Parameters
    ----------
    values : [rows, cols]
        NaN where there is no data: there the interest is 0.
    go : bool [rows, cols]
        Cells that may be entered, or with a sensor's radius those within it.

    Returns
    -------
    degree : float64 [rows, cols]
    low, high : float
        The limits.

    Raises
    ------
    InputError
        There is no such cell with data, or with an interest above 0, or all are of full interest; or the limits are to
        be found, and the values are all the same.
    """
    place = "that may be entered" if interest.radius_m is None else "within reach"
    found = values[go & np.isfinite(values)]
    if not found.size:
        raise InputError(interest.path, f"holds no value in any cell {place}")
    most = float(found.max())
    low, high = interest.limits or (float(np.median(found)), most)
    if interest.limits is None and not low < high:
        what = "is the same in all cells" if float(found.min()) == most else "is highest in half of the cells"
        raise InputError(interest.path, f"{what} {place} ({most:g})", "say --interest-range LOW,HIGH")
    if not most > low:
        raise InputError(
            interest.path, f"is nowhere above {low:g} where the robot may go (at most {most:g}): nothing to plan for"
        )
    least = float(found.min())
    if least >= high and found.size == np.count_nonzero(go):
        raise InputError(
            interest.path,
            f"reaches {high:g} in every cell {place} ({least:g} to {most:g}), so that it says nothing",
            "is it in another unit? See --interest-range and --thermal-units",
        )
    share = (values.astype(np.float64) - low) / (high - low)
    return np.where(np.isfinite(values), np.clip(share, 0.0, 1.0), 0.0), low, high


def weighed(score: Scores, degree: NDArray[np.float64], weight: float) -> Scores:
    """Return scores (or standard deviations) [rows, cols] times (1 - weight) + weight * degree; NaN stays NaN."""
    return (score * ((1.0 - weight) + weight * degree)).astype(np.float32)
