"""A surface model on the cells of a scoremap: how steep and how rough the ground of each cell is.

What stops a robot is smaller than a cell: a step of 0.35 m, averaged over cells of a metre, is a mild slope. So the
heights are laid on a lattice as fine as the robot's wheelbase, slope and ruggedness are taken there, and a cell has
those of the worst place in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.drivability.relief import eased, gradient, greatest_in_cells, ruggedness, slope
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.align import MAX_PX, field_on, window_or_none
from hrt_cli.raster.gate import Raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import VOID, in_metres
from hrt_cli.raster.windows import Window, blocks

Values = NDArray[np.float32]

LATTICE_M = 0.25
"""Points are so far apart, so that three of them span a robot: over that a step of 0.35 m is a slope of 35 degrees."""
SHOWN_M = 0.5
"""Of a surface model with larger pixels a note says what it cannot show."""

_HALO = 2
"""Points beyond the cells that their windows reach: one for the slope, one more for the ruggedness."""
_BLOCK_POINTS = 1024
_BLOCK_PX = 4096
_ABOUT = 1.02
"""Pixels of 0.25 m in the map's own metres may be this much larger on the ground."""
_FEW_PX = 4
"""Along a point of fewer pixels, shares of whole ones would put its height beside its place."""


@dataclass(frozen=True)
class Relief:
    """A surface model, and from where on its ground is no-go.

    Attributes
    ----------
    path : Path
        A raster of heights, of any CRS, extent and resolution.
    slope_limit_deg : float
        Slope in degrees.
    rugosity_limit : float
        Vector Ruggedness Measure, 0 to 1. 0.1 is rubble whose faces are tilted by 26 degrees every way (1 - cos 26°).
    """

    path: Path
    slope_limit_deg: float = 35.0
    rugosity_limit: float = 0.1

    def __post_init__(self) -> None:
        if not (0 < self.slope_limit_deg <= 90 and 0 < self.rugosity_limit <= 1):
            raise ArgumentError(
                "a slope limit is from 0 to 90 degrees, a limit of the ruggedness from 0 to 1, both above 0"
            )

    @property
    def parameters(self) -> dict[str, Any]:
        """What goes into the fingerprint beside the raster's bytes."""
        return {"slope_limit_deg": self.slope_limit_deg, "rugosity_limit": self.rugosity_limit}


@dataclass(frozen=True)
class Ground:
    """What a surface model says of the cells of a map.

    Attributes
    ----------
    slope_deg : float32 [rows, cols]
        The steepest slope in each cell, degrees; NaN where no height is known.
    rugosity : float32 [rows, cols]
        Its greatest Vector Ruggedness Measure, 0 to 1; NaN likewise.
    """

    slope_deg: Values
    rugosity: Values

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells of which the slope is known."""
        return np.isfinite(self.slope_deg)

    def ease(self, relief: Relief) -> NDArray[np.float64]:
        """Return by what each cell's score counts: 0 at or beyond a limit; what is not known counts as level."""
        slope_deg, rugosity = (np.nan_to_num(values, nan=0.0) for values in (self.slope_deg, self.rugosity))
        return eased(slope_deg, rugosity, relief.slope_limit_deg, relief.rugosity_limit)


def ground_of(raster: Raster, grid: Grid, cell_m: float, progress: Progress = silent) -> Ground:
    """Return slope and ruggedness on the cells of a map.

    Parameters
    ----------
    raster : Raster
        Of `open_heights`.
    grid : Grid
        The cells.
    cell_m : float
        Their side in metres on the ground.

    Raises
    ------
    InputError
        It lies wholly beside the cells, or is too fine for cells as large.
    """
    if window_or_none(raster.path, raster.grid, grid) is None:
        raise InputError(raster.path, "does not cover the place: it lies wholly beside the class raster")
    pixel_m = max(raster.grid.pixel_m)
    if (cell_m / min(raster.grid.pixel_m)) ** 2 > MAX_PX / 4:
        raise InputError(raster.path, f"has pixels of {pixel_m:g} m, too fine for cells of {cell_m:g} m", "resample it")
    per_cell, per_point = _lattice(cell_m, pixel_m)
    side = max(1, min(_BLOCK_POINTS // per_cell, int(_BLOCK_PX * pixel_m / cell_m))) * per_point
    found = Ground(np.full(grid.shape, np.nan, np.float32), np.full(grid.shape, np.nan, np.float32))
    for block in blocks(grid.shape, side):
        steep, rough = _block(raster, grid, block, per_point / per_cell)
        for values, onto in ((steep, found.slope_deg), (rough, found.rugosity)):
            in_cells = greatest_in_cells(values, per_cell)
            spread = in_cells.repeat(per_point, axis=0).repeat(per_point, axis=1)
            onto[block.slices] = spread[: block.height, : block.width]
        progress(block.row * grid.cols + block.height * (block.col + block.width), grid.rows * grid.cols)
    return found


def _lattice(cell_m: float, pixel_m: float) -> tuple[int, int]:
    """Return how many points of the lattice lie along a cell, and how many cells along a point; one of them is 1.

    Points are `LATTICE_M` apart, a little more where a cell is no multiple of that, and not closer than pixels.
    """
    per_cell = max(1, math.floor(cell_m / max(LATTICE_M, pixel_m) * _ABOUT))
    return per_cell, max(1, round(LATTICE_M / cell_m))


def _block(raster: Raster, grid: Grid, block: Window, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return slope and ruggedness at the points, `step` cells apart, of a block of cells; NaN beside the model."""
    rows, cols = (math.ceil(side / step - 1e-9) for side in (block.height, block.width))
    shift = Affine.translation(block.col - _HALO * step, block.row - _HALO * step)
    part = Grid(rows + 2 * _HALO, cols + 2 * _HALO, grid.transform @ shift @ Affine.scale(step), grid.crs)
    if window_or_none(raster.path, raster.grid, part) is None:
        return np.full((rows, cols), np.nan), np.full((rows, cols), np.nan)
    row_m, col_m = (side * step for side in grid.pixel_m)
    heights = _heights(raster, part, max(row_m, col_m))
    heights = in_metres(raster, heights)
    by_row, by_col = gradient(heights, row_m, col_m)
    inside = slice(_HALO, -_HALO), slice(_HALO, -_HALO)
    return slope(by_row, by_col)[inside], ruggedness(by_row, by_col)[inside]


def _heights(raster: Raster, part: Grid, step_m: float) -> NDArray[np.float64]:
    """Return the mean height about each point of a lattice, in the raster's unit; NaN where none is known.

    Of many pixels to a point, that is their mean by area; of few, the mean of heights interpolated at a finer lattice;
    of less than one, the interpolated height. The last two leave a plane a plane.
    """
    finer = math.ceil(step_m / max(raster.grid.pixel_m) / _ABOUT)
    if finer > _FEW_PX:
        return field_on(raster, part, "average", void=VOID).astype(np.float64)
    finer = max(1, finer)
    fine = Grid(part.rows * finer, part.cols * finer, part.transform @ Affine.scale(1 / finer), part.crs)
    points = field_on(raster, fine, "bilinear", void=VOID).astype(np.float64)
    about = points.reshape(part.rows, finer, part.cols, finer)
    known = np.isfinite(about)
    count = known.sum(axis=(1, 3))
    total = np.where(known, about, 0.0).sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
