"""Pixels gathered by the cell that they lie in, however two grids lie to each other.

GDAL's warper makes a cell's average, maximum or mode of the box between the images of two opposite corners. Of a cell
turned by 45 degrees that is a sliver; it also holds pixels that the cell only touches, and cells just before the first
row and column of a raster, which touch nothing of it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.raster.grid import Floats, Grid, transform_points
from hrt_cli.raster.windows import blocks

Values = NDArray[np.float32]

_STRIP_PX = 2**22
_BLOCK_PX = 2048
_NODE_PX = 64.0
"""Between two CRSs, positions are exact every so many pixels and linear between: 1e-5 of a pixel of 0.1 m."""
_SAMPLES = 64
_PARALLEL_PX = 0.01
"""Grids are parallel if no row or column of one leaves that of the other by more, from end to end."""
_TOUCH = 1e-6
"""Share of a cell below which a pixel only touches it."""
_DIGITS = (10, 10, 6, 10, 10, 6)
"""Digits that count of a transform between pixels: of its steps, and of its places."""


def places(grid: Grid, other: Grid, rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
    """Return where the points of a lattice lie on another grid.

    Parameters
    ----------
    grid, other : Grid
        Both with a CRS.
    rows, cols : float64 [n], float64 [m]
        Rising pixel positions on `grid`; the middle of a pixel is at .5.

    Returns
    -------
    rows, cols : float64 [n, m]
        Pixel positions on `other`.

    Raises
    ------
    ValueError
        A point has no place in the CRS of the other grid.
    """
    if grid.crs is None or other.crs is None or grid.crs == other.crs:
        a, b, c, d, e, f = relative(grid, other)[:6]
        return (e * rows + f)[:, None] + d * cols, (b * rows + c)[:, None] + a * cols
    back = ~other.transform
    node_rows, row_index, row_share = _nodes(rows)
    node_cols, col_index, col_share = _nodes(cols)
    shape = node_rows.size, node_cols.size
    x, y = grid.xy(*(a.ravel() for a in np.meshgrid(node_rows, node_cols, indexing="ij")))
    x, y = (a.reshape(shape) for a in transform_points(grid.crs, other.crs, x, y))
    found = []
    for nodes in (back.d * x + back.e * y + back.f, back.a * x + back.b * y + back.c):
        along = nodes[:, col_index] * (1 - col_share) + nodes[:, col_index + 1] * col_share
        found.append(along[row_index] * (1 - row_share[:, None]) + along[row_index + 1] * row_share[:, None])
    return found[0], found[1]


def relative(grid: Grid, other: Grid) -> Affine:
    """Return the transform from (col, row) of a grid to (col, row) of another in the same CRS.

    The noise that large coordinates leave in it is rounded off, so that edges which lie on edges do so exactly: a
    cell must not be thought to reach a billionth into the pixel beside it.
    """
    exact = (~other.transform @ grid.transform)[:6]
    return Affine(*(round(x, digits) for x, digits in zip(exact, _DIGITS, strict=True)))


def average(values: Values, source: Grid, target: Grid) -> Values:
    """Return the mean of the values in each cell of `target`, each by the share of the cell that its pixel covers.

    That is exact where the grids are parallel; else the shares are those of points in the cell (see `sampled`).

    Parameters
    ----------
    values : float32 [rows, cols]
        On `source`; NaN where there is none.

    Returns
    -------
    float32 [rows, cols]
        On `target`; NaN where no pixel has a value.
    """
    if source.crs != target.crs:
        return sampled(values, source, target)
    a, b, c, d, e, f = relative(target, source)[:6]
    if max(abs(b) * target.rows, abs(d) * target.cols) > _PARALLEL_PX:
        return sampled(values, source, target)
    row_edges, col_edges = (
        np.arange(side + 1) * step + at for side, step, at in ((target.rows, e, f), (target.cols, a, c))
    )
    out = np.empty(target.shape, np.float32)
    strip = max(1, int(_STRIP_PX / (abs(e) * source.cols)))
    for top in range(0, target.rows, strip):
        edges = np.clip(row_edges[top : top + strip + 1], 0, source.rows)
        first, last = math.floor(edges.min()), math.ceil(edges.max())
        part = values[first:last]
        real = ~np.isnan(part)
        total, share = (
            _between(_between(each, edges - first).T, np.clip(col_edges, 0, source.cols)).T
            for each in (np.where(real, part, 0), real)
        )
        some = np.abs(share) > _TOUCH * abs(a * e)
        out[top : top + strip] = np.where(some, total / np.where(some, share, 1), np.nan)
    return out


def greatest(values: Values, source: Grid, target: Grid) -> Values:
    """Return the largest of the values whose pixels have their middle in each cell of `target`.

    Parameters
    ----------
    values : float32 [rows, cols]
        On `source`; NaN where there is none.

    Returns
    -------
    float32 [rows, cols]
        On `target`. A cell too small for the middle of any pixel has the value of the pixel at its own middle; NaN
        where no pixel has a value.
    """
    top = np.full(target.rows * target.cols, -np.inf, np.float32)
    met = np.zeros(top.size, np.bool_)
    cols = _middles(0, source.cols)
    strip = max(1, _STRIP_PX // source.cols)
    for first in range(0, source.rows, strip):
        rows = _middles(first, min(first + strip, source.rows))
        cell, inside = _pixels_at(*places(source, target, rows, cols), target)
        met[cell] = True
        found = values[first : first + rows.size][inside]
        real = ~np.isnan(found)
        np.maximum.at(top, cell[real], found[real])
    top[np.isneginf(top)] = np.nan
    if not met.all():
        cols = _middles(0, target.cols)
        under = np.concatenate([_under(values, source, target, rows, cols) for rows in _row_strips(target)])
        top = np.where(met, top, under.ravel())
    return top.reshape(target.shape)


def sampled(values: Values, source: Grid, target: Grid, *, mode: bool = False) -> Values:
    """Return the mean (or the commonest) of the values under a lattice of points in each cell of `target`.

    The points are a third of a pixel of `source` apart, for the commonest half a one, but not less than a 64th of a
    cell.

    Parameters
    ----------
    values : float32 [rows, cols]
        On `source`; NaN where there is none.
    mode : bool
        The commonest value instead of the mean; of several the smallest.

    Returns
    -------
    float32 [rows, cols]
        On `target`; NaN where no point has a value.
    """
    each = 2 if mode else 3
    n_row, n_col = (min(_SAMPLES, max(4, math.ceil(each * step - _PARALLEL_PX))) for step in _steps(target, source))
    out = np.empty(target.shape, np.float32)
    for block in blocks(target.shape, max(1, _BLOCK_PX // max(n_row, n_col))):
        rows = block.row + (np.arange(block.height * n_row) + 0.5) / n_row
        cols = block.col + (np.arange(block.width * n_col) + 0.5) / n_col
        points = _under(values, source, target, rows, cols).reshape(block.height, n_row, block.width, n_col)
        out[block.slices] = (_commonest if mode else _mean)(points)
    return out


def _nodes(at: Floats) -> tuple[Floats, NDArray[np.intp], Floats]:
    """Return positions that enclose `at` evenly, and for each of `at` the node before it and its share of the way."""
    span = float(at[-1] - at[0]) or 1.0
    count = math.ceil(span / _NODE_PX) + 1
    step = span / (count - 1)
    along = (at - at[0]) / step
    index = np.clip(along.astype(np.intp), 0, count - 2)
    return at[0] + step * np.arange(count), index, along - index


def _between(values: NDArray[Any], edges: Floats) -> Floats:
    """Sum values [rows, cols] between successive edges, rising or falling positions along the rows: [edges - 1, cols].

    Between falling ones the sum is negative, and the share too by which it is divided.
    """
    sums = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=sums[1:])
    index = np.minimum(edges.astype(np.intp), max(len(values) - 1, 0))
    after = np.minimum(index + 1, len(values))
    share = (edges - index)[:, None]
    return np.diff(sums[index] * (1 - share) + sums[after] * share, axis=0)


def _steps(grid: Grid, other: Grid) -> tuple[float, float]:
    """Return how many pixels of `other` one step along the rows, and one along the columns, of `grid` is long."""
    rows, cols = (np.array([side / 2 - 0.5, side / 2 + 0.5]) for side in grid.shape)
    row, col = places(grid, other, rows, cols)
    along_row = math.hypot(row[1, 0] - row[0, 0], col[1, 0] - col[0, 0])
    return along_row, math.hypot(row[0, 1] - row[0, 0], col[0, 1] - col[0, 0])


def _pixels_at(rows: Floats, cols: Floats, grid: Grid) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the flat index of the pixel at each position that lies on the grid, and which do."""
    inside = (rows >= 0) & (rows < grid.rows) & (cols >= 0) & (cols < grid.cols)
    return rows[inside].astype(np.intp) * grid.cols + cols[inside].astype(np.intp), inside


def _middles(first: int, end: int) -> Floats:
    """Return the middles of the pixels from `first` to before `end` along an axis."""
    return np.arange(first, end, dtype=np.float64) + 0.5


def _row_strips(grid: Grid) -> list[Floats]:
    strip = max(1, _STRIP_PX // grid.cols)
    return [_middles(top, min(top + strip, grid.rows)) for top in range(0, grid.rows, strip)]


def _under(values: Values, source: Grid, target: Grid, rows: Floats, cols: Floats) -> Values:
    """Return the value of the pixel under each point of a lattice on `target`; NaN beside the source."""
    pixel, inside = _pixels_at(*places(target, source, rows, cols), source)
    out = np.full(inside.shape, np.nan, np.float32)
    out[inside] = values.ravel()[pixel]
    return out


def _mean(points: Values) -> Values:
    """Average over the points [rows, n, cols, m] of each cell that have a value."""
    real = ~np.isnan(points)
    count = real.sum(axis=(1, 3))
    total = np.where(real, points, 0).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _commonest(points: Values) -> Values:
    """Return the commonest value of the points [rows, n, cols, m] of each cell."""
    out = np.full((points.shape[0], points.shape[2]), np.nan, np.float32)
    most = np.zeros(out.shape, np.intp)
    for value in np.unique(points[~np.isnan(points)]):
        count = (points == value).sum(axis=(1, 3))
        out[count > most] = value
        most = np.maximum(most, count)
    return out
