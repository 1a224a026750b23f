"""What an earlier drive leaves for the next plan: cells that paid, budget spent, its place, where it got stuck."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.logs.read import log_notes, read_drive_log
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap
from hrt_cli.raster.track import track_on

_SAMPLES_PER_CELL = 20
_MOST_SAMPLES = 50_000_000
_NEAR_CELLS = 3
"""A standstill so near to an earlier one is taken to have met the same thing."""


@dataclass(frozen=True)
class Driven:
    """An earlier drive, on the cells of a scoremap.

    Attributes
    ----------
    cells : ndarray, int64 [n, 2]
        Row and column of every cell that the track goes through on the map, in order, neighbours or not.
    stands : (int, int)
        The cell where the robot stands.
    blocked : list of (int, int)
        The cells that may not be entered for where it got stuck.
    length_m, time_s : float
        What the drive took.
    legs : list of ndarray, int64 [k, 2]
        The same cells with those off the map, none twice in a row; from one leg to the next nobody drove.
    notes : list of str
        What the user ought to know of it.
    """

    cells: NDArray[np.int64]
    stands: tuple[int, int]
    blocked: list[tuple[int, int]]
    length_m: float
    time_s: float
    legs: list[NDArray[np.int64]]
    notes: list[str]

    def spent(self, unit: Literal["steps", "m", "min"], connectivity: int) -> float:
        """Return what the drive took of a budget in `unit`; steps between 4- or 8-neighbours."""
        if unit == "m":
            return self.length_m
        if unit == "min":
            return self.time_s / 60.0
        jumps = np.concatenate([np.abs(np.diff(leg, axis=0)) for leg in self.legs])
        return float(jumps.max(axis=1, initial=0).sum() if connectivity == 8 else jumps.sum())


def mark_driven(
    score: NDArray[np.floating],
    collected: Iterable[tuple[int, int]],
    blocked: Iterable[tuple[int, int]],
    stands: Iterable[tuple[int, int]],
) -> NDArray[np.floating]:
    """Return scores [rows, cols] on which cells that were collected pay nothing and blocked ones are no-go.

    Where an earlier drive left a robot it stands, whatever the ground, and may leave.
    """
    marked = score.copy()
    for cell in collected:
        if not np.isnan(marked[cell]):
            marked[cell] = 0.0
    for cell in blocked:
        marked[cell] = np.nan
    for cell in stands:
        marked[cell] = np.nan_to_num(marked[cell])
    return marked


def read_drives(paths: Sequence[Path], scoremap: Scoremap) -> Driven:
    """Read the logs of one robot's successive drives and lay them on the cells of a scoremap, as one drive.

    What lies between two drives is left out. Where the last one ends in a cell that is no-go by now, the robot is
    taken to go back on its own track to the last cell that may be entered; if there is none it stands where it ended.

    Raises
    ------
    InputError
        A log cannot be read, its places cannot be laid on the map, or it lies or ends off the map.
    """
    drives = [_laid(path, scoremap) for path in paths]
    cells = np.concatenate([each.cells for each in drives])
    standstills = [cell for each in drives for cell in each.blocked]
    stands, notes = drives[-1].stands, [note for each in drives for note in each.notes]
    if np.isnan(scoremap.score[stands]):
        go = cells[~np.isnan(scoremap.score[cells[:, 0], cells[:, 1]])]
        ended = stands
        if len(go):
            stands = (int(go[-1, 0]), int(go[-1, 1]))
            way_off = f"has to go back to {stands[0]},{stands[1]}, where the plan starts"
        else:
            way_off = "has been on no other ground, and the plan starts there"
        notes.append(f"{paths[-1]}: ends in cell {ended[0]},{ended[1]}, which is no-go: the robot {way_off}")
    return Driven(
        cells=cells,
        stands=stands,
        blocked=_blocked(standstills, cells, stands, scoremap.grid.shape),
        length_m=math.fsum(each.length_m for each in drives),
        time_s=math.fsum(each.time_s for each in drives),
        legs=[leg for each in drives for leg in each.legs],
        notes=notes,
    )


def _blocked(
    standstills: list[tuple[int, int]], driven: NDArray[np.int64], stands: tuple[int, int], shape: tuple[int, int]
) -> list[tuple[int, int]]:
    """Return the cells that standstills block: the cell of each and, the more of them came about it, the wider.

    What stops a robot is often larger than a cell. Where it has been stopped k times before within `_NEAR_CELLS`,
    everything within k cells is blocked, but for what it drove through and where it stands.
    """
    free = {(int(row), int(col)) for row, col in driven} - set(standstills) | {stands}
    blocked: dict[tuple[int, int], None] = {}
    for number, (row, col) in enumerate(standstills):
        near = sum(math.hypot(row - r, col - c) <= _NEAR_CELLS for r, c in standstills[:number])
        reach = min(near, _NEAR_CELLS)
        for r in range(max(row - reach, 0), min(row + reach + 1, shape[0])):
            for c in range(max(col - reach, 0), min(col + reach + 1, shape[1])):
                if math.hypot(r - row, c - col) <= reach and (r, c) not in free:
                    blocked[r, c] = None
    return list(blocked)


def driven_cells(path: Path, scoremap: Scoremap) -> NDArray[np.int64]:
    """Return the cells of a scoremap that a drive went through, int64 [n, 2], in order; it may end off the map.

    Raises
    ------
    InputError
        The log cannot be read, its places cannot be laid on the map, or it lies wholly off it.
    """
    log = read_drive_log(path)
    return _on_map(_legs(path, log, *_places(path, log, scoremap)), scoremap)


def _places(path: Path, log: DriveLog, scoremap: Scoremap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    grid = scoremap.grid
    rows, cols = track_on(path, log, grid, "scoremap")
    if not ((rows >= 0) & (rows < grid.rows) & (cols >= 0) & (cols < grid.cols)).any():
        raise InputError(path, f"lies wholly off the scoremap of {grid.rows} x {grid.cols} cells")
    return rows, cols


def _legs(path: Path, log: DriveLog, rows: NDArray[np.float64], cols: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    ends = [0, *log.breaks, rows.size]
    return [_cells(path, rows[a:b], cols[a:b]) for a, b in itertools.pairwise(ends)]


def _on_map(legs: list[NDArray[np.int64]], scoremap: Scoremap) -> NDArray[np.int64]:
    cells = np.concatenate(legs)
    return cells[((cells >= 0) & (cells < np.array(scoremap.grid.shape))).all(axis=1)]


def _laid(path: Path, scoremap: Scoremap) -> Driven:
    """Lay one log on the cells; `blocked` are the cells of its standstills as they came, some perhaps off the map."""
    log = read_drive_log(path)
    grid = scoremap.grid
    rows, cols = _places(path, log, scoremap)
    stands = (int(np.floor(rows[-1])), int(np.floor(cols[-1])))
    if not _is_on(grid, stands):
        raise InputError(path, f"ends off the scoremap, at row {stands[0]}, column {stands[1]}")
    legs = _legs(path, log, rows, cols)
    ways_m = grid.ground_length_m(rows, cols) * (scoremap.cell_size_m if grid.crs is None else 1.0)
    driven = np.ones(ways_m.size, np.bool_)
    driven[np.array(log.breaks, np.int64) - 1] = False
    blocked = [_stuck_cell(log, grid, rows, cols, index, stands) for index, event in log.events if event == "stuck"]
    return Driven(
        cells=_on_map(legs, scoremap),
        stands=stands,
        blocked=blocked,
        length_m=float(ways_m[driven].sum()),
        time_s=float(log.time_s[-1] - log.time_s[0]),
        legs=legs,
        notes=log_notes(path, log),
    )


def _is_on(grid: Grid, cell: tuple[int, int]) -> bool:
    return 0 <= cell[0] < grid.rows and 0 <= cell[1] < grid.cols


def _cells(path: Path, rows: NDArray[np.float64], cols: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cells that straight lines between the places go through, int64 [k, 2], none twice in a row."""
    steps = np.maximum(1, np.ceil(np.hypot(np.diff(rows), np.diff(cols)) * _SAMPLES_PER_CELL)).astype(np.int64)
    if steps.sum() > _MOST_SAMPLES:
        raise InputError(path, f"is longer than {_MOST_SAMPLES // _SAMPLES_PER_CELL} cells of the scoremap")
    at = np.repeat(np.arange(steps.size), steps)
    part = (np.arange(at.size) - np.repeat(np.cumsum(steps) - steps, steps)) / np.repeat(steps, steps)
    row = np.append(rows[at] + part * np.diff(rows)[at], rows[-1])
    col = np.append(cols[at] + part * np.diff(cols)[at], cols[-1])
    cells = np.floor(np.stack([row, col], axis=1)).astype(np.int64)
    changed = np.append(True, (np.diff(cells, axis=0) != 0).any(axis=1))
    return np.asarray(cells[changed])


def _stuck_cell(
    log: DriveLog,
    grid: Grid,
    rows: NDArray[np.float64],
    cols: NDArray[np.float64],
    index: int,
    stands: tuple[int, int],
) -> tuple[int, int]:
    """Return the cell where a robot got stuck, or where it still stands in it the next one where it was heading."""
    row, col = float(rows[index]), float(cols[index])
    cell = (math.floor(row), math.floor(col))
    along = _heading(log, grid, rows, cols, index) if cell == stands else None
    if along is not None:
        for reach in np.arange(0.1, 1.6, 0.1):
            ahead = (math.floor(row + reach * along[0]), math.floor(col + reach * along[1]))
            if ahead != cell:
                return ahead
    return cell


def _heading(
    log: DriveLog, grid: Grid, rows: NDArray[np.float64], cols: NDArray[np.float64], index: int
) -> tuple[float, float] | None:
    """Return the direction of a robot, in cells: as logged, else over its last half cell of way."""
    if np.isfinite(log.heading_deg[index]):
        step_row, step_col = grid.steps_towards(rows[index], cols[index], log.heading_deg[index])
        length = math.hypot(step_row[0], step_col[0])
        return float(step_row[0]) / length, float(step_col[0]) / length
    for before in range(index - 1, -1, -1):
        step_r, step_c = float(rows[index] - rows[before]), float(cols[index] - cols[before])
        length = math.hypot(step_r, step_c)
        if length >= 0.5:
            return step_r / length, step_c / length
    return None
