"""The cheapest way to a place over the ground as it is: Dijkstra's search on a grid, outwards from the place."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from hrt_cli.world.site import Site
from hrt_cli.world.terrain import clearance

kernel: Any = njit(cache=True, nogil=True)

Cell = tuple[int, int]
"""Row and column."""

CELL_M = 0.2
_SLOWEST = 0.08
"""Ground slower than this share of the commanded speed is not entered."""
_LEAST_SPARE_M = 0.02
"""Beyond its radius, a robot keeps so far from obstacles and the rim of the survey."""
_COMFORT_M = 0.8
"""Nearer to an obstacle than its radius and this, a robot pays for it: up to `_FEAR` times the way."""
_FEAR = 6.0
_DEAREST = 50.0
"""What a metre of a way counts at most."""
_SPARE_DEPTH_M = 0.4
"""Water over an AUV's own height that it wants."""


@dataclass(frozen=True)
class CostMap:
    """What a metre of way costs, in seconds at 1 m/s, on cells of `cell_m`; infinite where the robot may not be.

    `cost` is float32 [rows, cols].
    """

    cost: NDArray[np.float32]
    cell_m: float

    def cell(self, east_m: float, south_m: float) -> Cell:
        """Return the cell of a place, the nearest one on the map."""
        rows, cols = self.cost.shape
        return (
            min(max(int(south_m / self.cell_m), 0), rows - 1),
            min(max(int(east_m / self.cell_m), 0), cols - 1),
        )

    def middle(self, cell: Cell) -> tuple[float, float]:
        """Return the middle of a cell, east_m and south_m."""
        return (cell[1] + 0.5) * self.cell_m, (cell[0] + 0.5) * self.cell_m

    def nearest_passable(self, east_m: float, south_m: float, reach_m: float) -> Cell | None:
        """Return the cell of a place, or where the robot may not be there the nearest in which it may."""
        row, col = self.cell(east_m, south_m)
        if math.isfinite(float(self.cost[row, col])):
            return row, col
        reach = math.ceil(reach_m / self.cell_m)
        r0, c0 = max(row - reach, 0), max(col - reach, 0)
        near = np.argwhere(np.isfinite(self.cost[r0 : row + reach + 1, c0 : col + reach + 1])) + np.array((r0, c0))
        away_m = np.hypot(*((near[:, ::-1] + 0.5) * self.cell_m - (east_m, south_m)).T)
        if away_m.min(initial=math.inf) > reach_m:
            return None
        found = near[int(away_m.argmin())]
        return int(found[0]), int(found[1])

    def passable(self, east_m: float, south_m: float) -> bool:
        """Whether the robot may be at a place."""
        return math.isfinite(float(self.cost[self.cell(east_m, south_m)]))


def cost_map(site: Site, radius_m: float) -> CostMap:
    """Return the cost of driving on a site for a robot that knows all of it."""
    return _costs(site, radius_m, site.clearance_m, site.speed_factor)


def water_map(site: Site, radius_m: float) -> CostMap:
    """Return the cost of swimming over a site: the same everywhere but where it is too shallow for the robot."""
    shallow = site.surface_m > -(2.0 * radius_m + _SPARE_DEPTH_M)
    return _costs(site, radius_m, clearance(shallow, site.pixel_m), np.ones_like(site.speed_factor))


def _costs(site: Site, radius_m: float, clearance_m: NDArray[np.float32], factor: NDArray[np.float32]) -> CostMap:
    step = _pixels_a_cell(site)
    room = _blocks(np.minimum(clearance_m, 99.0), step).min(axis=(1, 3))
    speed = _blocks(factor, step).mean(axis=(1, 3))
    rim = _blocks(rim_distance(site), step).min(axis=(1, 3))
    spare = np.minimum(room, rim) - radius_m
    near = np.clip(1.0 - spare / _COMFORT_M, 0.0, 1.0)
    cost = (1.0 + _FEAR * near * near) / np.maximum(speed, _SLOWEST)
    cost[(spare < _LEAST_SPARE_M) | (speed < _SLOWEST)] = np.inf
    return CostMap(np.ascontiguousarray(cost, np.float32), step * site.pixel_m)


def inside_rim(site: Site, radius_m: float) -> NDArray[np.bool_]:
    """Return where a robot is wholly on the surveyed area, bool [rows, cols]: what lies in cells that are."""
    step = _pixels_a_cell(site)
    inside = _blocks(rim_distance(site), step).min(axis=(1, 3)) - radius_m >= _LEAST_SPARE_M
    return np.repeat(np.repeat(inside, step, axis=0), step, axis=1)[: site.grid.rows, : site.grid.cols]


def _pixels_a_cell(site: Site) -> int:
    return max(1, round(CELL_M / site.pixel_m))


def _blocks(layer: NDArray[Any], step: int) -> NDArray[np.float32]:
    """Return the squares of `step` pixels of a layer, [rows, step, cols, step]; beyond its rim it is 0."""
    rows, cols = -(-layer.shape[0] // step), -(-layer.shape[1] // step)
    pad = ((0, rows * step - layer.shape[0]), (0, cols * step - layer.shape[1]))
    return np.pad(layer.astype(np.float32), pad).reshape(rows, step, cols, step)


def rim_distance(site: Site) -> NDArray[np.float32]:
    """Return the distance of each pixel to what the survey did not see, the raster's edge included."""
    seen = np.pad(site.seen.astype(np.uint8), 1)
    return np.asarray(cv2.distanceTransform(seen, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * site.pixel_m)


@kernel
def ways_to(
    cost: NDArray[np.float32],
    cell_m: float,
    row: int,
    col: int,
    until_row: int,
    until_col: int,
    limit: float,
    to_go: NDArray[np.float32],
) -> float:
    """Fill `to_go` [rows, cols] with the costs of the cheapest ways to (row, col); return that of the cell asked for.

    Infinite where it was not found out: the search ends with the cell asked for, or when the cost exceeds `limit`. A
    way goes between 8 neighbours; a diagonal passes no corner that is blocked.
    """
    rows, cols = cost.shape
    to_go[:] = np.inf
    to_go[row, col] = 0.0
    heap = [(np.float32(0.0), row * cols + col)]
    while heap:
        done, at = heapq.heappop(heap)
        r, c = at // cols, at % cols
        if done > to_go[r, c]:
            continue
        if done > limit:
            break
        if r == until_row and c == until_col:
            break
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                nr, nc = r + dr, c + dc
                if (dr == 0 and dc == 0) or nr < 0 or nc < 0 or nr >= rows or nc >= cols:
                    continue
                if not np.isfinite(cost[nr, nc]) and not (nr == until_row and nc == until_col):
                    continue
                if dr != 0 and dc != 0 and not (np.isfinite(cost[r, nc]) and np.isfinite(cost[nr, c])):
                    continue
                here = min(cost[r, c], np.float32(_DEAREST))
                there = min(cost[nr, nc], np.float32(_DEAREST))
                length = cell_m * (math.sqrt(2.0) if dr != 0 and dc != 0 else 1.0)
                new = np.float32(done + 0.5 * (here + there) * length)
                if new < to_go[nr, nc]:
                    to_go[nr, nc] = new
                    heapq.heappush(heap, (new, nr * cols + nc))
    return float(to_go[until_row, until_col])


_STRAIGHT, _ALIKE = (20, 14, 8, 4, 2), 1.3
"""A march begins with straight ways, over as many cells to every side of the place as differ by this factor at most:
its first steps would be its worst."""


@kernel
def march_to(
    cost: NDArray[np.float32],
    cell_m: float,
    row: int,
    col: int,
    until_row: int,
    until_col: int,
    limit: float,
    margin: float,
    to_go: NDArray[np.float32],
) -> float:
    """Likewise by fast marching (Sethian 1996): ways lead in any direction, whatever that of the grid.

    Between 8 neighbours a way is up to 8 % too long, by the compass. See `ways_to`; this search goes on until
    the cost exceeds that of the cell asked for by more than `margin`, and some costs beyond that are known, too.
    """
    rows, cols = cost.shape
    to_go[:] = np.inf
    to_go[row, col] = 0.0
    heap = [(np.float32(0.0), row * cols + col)]
    for reach in _STRAIGHT:
        r0, r1, c0, c1 = row - reach, row + reach, col - reach, col + reach
        if r0 < 0 or c0 < 0 or r1 >= rows or c1 >= cols:
            continue
        about = cost[r0 : r1 + 1, c0 : c1 + 1]
        if about.max() > min(_ALIKE * about.min(), _DEAREST):
            continue
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                if r != row or c != col:
                    to_go[r, c] = 0.5 * (cost[row, col] + cost[r, c]) * cell_m * math.hypot(r - row, c - col)
                    heapq.heappush(heap, (to_go[r, c], r * cols + c))
        break
    last = limit
    while heap:
        done, at = heapq.heappop(heap)
        r, c = at // cols, at % cols
        if done > to_go[r, c]:
            continue
        if done > last:
            break
        if r == until_row and c == until_col:
            last = min(limit, float(done) + margin)
        for k in range(4):
            nr, nc = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
            if nr < 0 or nc < 0 or nr >= rows or nc >= cols or to_go[nr, nc] <= done:
                continue
            if not np.isfinite(cost[nr, nc]) and not (nr == until_row and nc == until_col):
                continue
            # Only what is settled, and so not above `done`, counts.
            down, right = np.inf, np.inf
            if nr > 0 and to_go[nr - 1, nc] <= done:
                down = float(to_go[nr - 1, nc])
            if nr + 1 < rows and to_go[nr + 1, nc] <= done:
                down = min(down, float(to_go[nr + 1, nc]))
            if nc > 0 and to_go[nr, nc - 1] <= done:
                right = float(to_go[nr, nc - 1])
            if nc + 1 < cols and to_go[nr, nc + 1] <= done:
                right = min(right, float(to_go[nr, nc + 1]))
            step = cell_m * float(min(cost[nr, nc], np.float32(_DEAREST)))
            if abs(down - right) < step:
                new = np.float32(0.5 * (down + right + math.sqrt(2.0 * step * step - (down - right) ** 2)))
            else:
                new = np.float32(min(down, right) + step)
            if new < to_go[nr, nc]:
                to_go[nr, nc] = new
                heapq.heappush(heap, (new, nr * cols + nc))
    asked = float(to_go[until_row, until_col])
    return asked if asked <= limit else math.inf


@kernel
def follow(to_go: NDArray[np.float32], cost: NDArray[np.float32], row: int, col: int, cells: int) -> tuple[int, int]:
    """Return the cell that is `cells` steps down the cheapest way from (row, col), as `ways_to` found it."""
    rows, cols = to_go.shape
    for _ in range(cells):
        best, br, bc = to_go[row, col], row, col
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = row + dr, col + dc
                if r < 0 or c < 0 or r >= rows or c >= cols or to_go[r, c] >= best:
                    continue
                if dr != 0 and dc != 0 and not (np.isfinite(cost[row, c]) and np.isfinite(cost[r, col])):
                    continue
                best, br, bc = to_go[r, c], r, c
        if br == row and bc == col:
            break
        row, col = br, bc
    return row, col


@kernel
def is_clear(
    cost: NDArray[np.float32],
    cell_m: float,
    east0: float,
    south0: float,
    east1: float,
    south1: float,
    dearest: float = math.inf,
) -> bool:
    """Whether the straight way between two places stays on cells that may be entered and cost at most `dearest`.

    The one that it starts in does not count.
    """
    length = math.hypot(east1 - east0, south1 - south0)
    count = int(length / (0.25 * cell_m)) + 1
    rows, cols = cost.shape
    first_r, first_c = math.floor(south0 / cell_m), math.floor(east0 / cell_m)
    for k in range(1, count + 1):
        part = k / count
        r = math.floor((south0 + part * (south1 - south0)) / cell_m)
        c = math.floor((east0 + part * (east1 - east0)) / cell_m)
        if r == first_r and c == first_c:
            continue
        if r < 0 or c < 0 or r >= rows or c >= cols or not (np.isfinite(cost[r, c]) and cost[r, c] <= dearest):
            return False
    return True
