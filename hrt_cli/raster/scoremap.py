"""The scoremap: expected score per grid cell (band 1), its standard deviation (band 2), NaN where no robot may go."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.artifacts.carriers import read_stamped_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.errors import InputError
from hrt_cli.raster.cog import Layout, publishing_cog, tagged_provenance
from hrt_cli.raster.gate import Raster, is_nodata, open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.style import score_qml
from hrt_cli.raster.windows import Window

MAX_CELLS = 16_000_000
_SQUARE = 0.01
_NPZ_KEYS = {"score", "sd", "cell_size_m", "no_go"}


@dataclass(frozen=True)
class Scoremap:
    """Scores on a grid of square cells.

    Attributes
    ----------
    score : float32 [rows, cols]
        Expected score of each cell, >= 0; NaN = no-go.
    sd : float32 [rows, cols]
        Its standard deviation; NaN where the score is.
    grid : Grid
        Where the cells lie (no CRS if the scoremap came as NPZ).
    cell_size_m : float
        Side of a cell in metres on the ground.
    drivability : bool
        The score tells how drivable a cell is, and nothing else. A file whose provenance says otherwise (its scores are
        weighed by interest, or raised by what is not known) has False.
    """

    score: NDArray[np.float32]
    sd: NDArray[np.float32]
    grid: Grid
    cell_size_m: float
    drivability: bool = True


def read_scoremap(path: Path) -> Scoremap:
    """Read a scoremap, `.tif` or `.npz`.

    Raises
    ------
    InputError
        The file is damaged, is not georeferenced (`.tif`), has cells that are not square on the ground, holds a
        negative or infinite score or standard deviation, or has no cell that may be entered.
    """
    found = _read_npz(path) if path.suffix.lower() == ".npz" else _read_tif(path)
    score = found.score
    for name, values in (("score", score), ("standard deviation", found.sd)):
        wrong = np.isinf(values) | (values < 0)
        if wrong.any():
            row, col = np.argwhere(wrong)[0]
            kind = "an infinite" if np.isinf(values[row, col]) else "a negative"
            raise InputError(path, f"holds {kind} {name} ({values[row, col]:g} at cell {row},{col})")
    if np.isnan(score).all():
        raise InputError(path, "has no cell that may be entered: all are no-go")
    return found


def publish_scoremap(
    target: Path,
    scoremap: Scoremap,
    provenance: Provenance,
    *,
    tags: dict[str, Any],
    creation: dict[str, str],
) -> None:
    """Publish a scoremap as a two-band float32 Cloud Optimised GeoTIFF with its QGIS style."""
    top = float(np.nanmax(scoremap.score)) if np.isfinite(scoremap.score).any() else 1.0
    layout = Layout(
        bands=("score", "sd"),
        dtype="float32",
        nodata=float("nan"),
        resampling="average",
        tags={"cell_size_m": scoremap.cell_size_m, **tags},
        style=score_qml(max(top, 1e-6)),
        creation=creation,
    )
    grid = scoremap.grid
    with publishing_cog(target, grid, layout, provenance) as writer:
        writer.write(Window(0, 0, grid.rows, grid.cols), np.stack([scoremap.score, scoremap.sd]))


def _read_tif(path: Path) -> Scoremap:
    with open_raster(path) as raster:
        grid = raster.grid
        drivability = _is_drivability(tagged_provenance(raster))
        _check_size(path, grid.rows, grid.cols)
        if np.dtype(raster.dtypes[0]).kind != "f" or raster.count > 2:
            raise InputError(path, "is not a scoremap: it needs a real-valued score band, and at most an sd band")
        row_m, col_m = grid.pixel_m
        if abs(row_m / col_m - 1) > _SQUARE:
            raise InputError(path, f"its cells are {col_m:.3f} x {row_m:.3f} m; a plan needs square ones")
        window = Window(0, 0, grid.rows, grid.cols)
        score, *rest = (_values(raster, band, window) for band in range(1, raster.count + 1))
        if raster.has_mask:
            score[~raster.read_mask(window)] = np.nan
        if rest and raster.colours[1] == ColorInterp.alpha:
            score[~(rest.pop() > 0)] = np.nan
    sd = rest[0] if rest else np.zeros_like(score)
    sd[np.isnan(score)] = np.nan
    return Scoremap(score, sd, grid, float(np.sqrt(row_m * col_m)), drivability)


def _is_drivability(provenance: Provenance | None) -> bool:
    """Say whether the scores of a scoremap made so tell of drivability alone, as far as is known."""
    made = {} if provenance is None else provenance.parameters
    return not (made.get("interest") or made.get("explore"))


def _values(raster: Raster, band: int, window: Window) -> NDArray[np.float32]:
    """Read a band as float32 with NaN for nodata; an infinity that is not declared as nodata stays one."""
    values = raster.read_bands([band], window)[0]
    nodata = raster.nodata[band - 1]
    undeclared = np.isinf(values) & (values != nodata)
    empty = is_nodata(values, nodata) & ~undeclared
    real = _float32(values)
    real[empty] = np.nan
    return real


def _read_npz(path: Path) -> Scoremap:
    arrays, provenance = read_stamped_npz(path)
    unknown = set(arrays) - _NPZ_KEYS
    if unknown or "score" not in arrays:
        wrong = f"unknown array {sorted(unknown)[0]!r}" if unknown else "no array 'score'"
        raise InputError(path, f"is not a scoremap: {wrong} (score, and optionally sd, cell_size_m, no_go)")
    score = _float32(_plane(path, "score", arrays["score"], None))
    _check_size(path, *score.shape)
    if "no_go" in arrays:
        score[_plane(path, "no_go", arrays["no_go"], score.shape).astype(bool)] = np.nan
    sd = np.zeros_like(score)
    if "sd" in arrays:
        sd = _float32(_plane(path, "sd", arrays["sd"], score.shape))
    sd[np.isnan(score)] = np.nan
    cell = arrays.get("cell_size_m", np.array(1.0))
    if cell.size != 1 or cell.dtype.kind not in "uif" or not (np.isfinite(cell).all() and float(cell.item()) > 0):
        raise InputError(path, "cell_size_m is not a positive length in metres")
    cell_m = float(cell.item())
    grid = Grid(score.shape[0], score.shape[1], Affine(cell_m, 0, 0, 0, -cell_m, 0), None)
    return Scoremap(score, sd, grid, cell_m, _is_drivability(provenance))


def _plane(path: Path, name: str, array: NDArray[Any], shape: tuple[int, ...] | None) -> NDArray[Any]:
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "uifb":
        raise InputError(path, f"{name} is not a [rows, cols] array of numbers")
    if shape is not None and array.shape != shape:
        raise InputError(path, f"{name} has shape {array.shape}, score has {shape}")
    return array


def _float32(values: NDArray[Any]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # what is too large becomes infinite, and that is refused
        return values.astype(np.float32)


def _check_size(path: Path, rows: int, cols: int) -> None:
    if rows * cols > MAX_CELLS:
        raise InputError(
            path, f"has {rows} x {cols} cells, more than the {MAX_CELLS} that are planned on", "coarser cells"
        )
