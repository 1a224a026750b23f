"""Proven upper bounds on what any walk can collect.

Two relaxations, of which the smaller is taken: each cell collected in its own time slot, not before it can be
reached; and the Lagrangian relaxation of "a cell pays once", a longest walk through time and space.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel
from hrt_cli.planning.walk import Field, capacity

ROUNDING = 1e-9
"""Relative slack that keeps the bounds true under floating-point rounding."""

MAX_LAYER_CELLS = 60_000_000
"""Cells times moves above which the time-expanded relaxation does not fit memory (8 bytes each)."""

FIRST_STEP, STEP_GROWTH, STEP_SHRINK, PATIENCE = 1.0, 1.1, 0.7, 5
"""Polyak step factor; its growth with each better bound and its shrinkage after `PATIENCE` steps without."""

MEMORY = 0.8
"""Weight of the past in the running mean of visits that gives the direction (volume algorithm)."""

NOWHERE = -1e300


def bipartite(field: Field) -> bool:
    """Tell whether no cell can be reached with both even and odd numbers of moves."""
    return field.exact and not bool(np.isfinite(field.reach).all(axis=0).any())


@kernel
def _best_in_slots(value: NDArray[np.float64], release: NDArray[np.float64], first: int, last: int, stride: int,
                   gamma: float) -> float:  # fmt: skip
    """Give each slot first, first + stride, ... <= last the best released cell; cells sorted by release."""
    heap = [0.0]
    heap.pop()
    total, i = 0.0, 0
    for t in range(first, last + 1, stride):
        while i < value.size and release[i] <= t:
            heapq.heappush(heap, -value[i])
            i += 1
        if len(heap) > 0:
            total -= heapq.heappop(heap) * gamma**t
    return total


@kernel
def _best_in_windows(value: NDArray[np.float64], release: NDArray[np.float64], last: int, stride: int) -> float:
    """Pick cells whose slots are release..last - release; cells sorted by release, latest first."""
    heap = [0.0]
    heap.pop()
    total = 0.0
    for i in range(value.size):
        slots = (last - 2 * release[i]) // stride + 1
        heapq.heappush(heap, value[i])
        total += value[i]
        while len(heap) > slots:
            total -= heapq.heappop(heap)
    return total


def scheduling_bound(field: Field, gamma: float = 1.0) -> float:
    """Return the best assignment of cells to time slots, each cell not before it can be reached.

    A relaxation of the walk: at most one new cell per move, cell c no earlier than its distance from the start,
    on the parity of that distance where the reachable grid is bipartite, and early enough to get home when the
    robot must return (that deadline is dropped when gamma < 1). Greedy assignment is optimal: for release times
    alone and falling slot weights by exchange, for the nested windows of a return as a transversal matroid.

    Parameters
    ----------
    field : Field
        The reachable window.
    gamma : float
        Discount per move; 1 bounds the plain score.
    """
    moves = capacity(field) - 1
    release = np.ceil(field.reach.min(axis=0) - ROUNDING) if field.exact else _fewest_moves(field)
    usable = field.free & (field.value > 0)
    total = 0.0
    stride = 2 if bipartite(field) else 1
    for first in range(stride):
        mine = usable.copy()
        if stride == 2:
            mine[usable] = release[usable] % 2 == first
        value, when = field.value[mine], release[mine]
        last = moves - (moves - first) % stride
        if field.returns and gamma == 1.0:
            order = np.lexsort((value, -when))
            total += _best_in_windows(value[order], when[order], moves, stride)
        else:
            order = np.lexsort((-value, when))
            total += _best_in_slots(value[order], when[order], first, last, stride, gamma)
    return float(total) * (1.0 + ROUNDING)


def _fewest_moves(field: Field) -> NDArray[np.float64]:
    """Bound from below the moves to each cell where moves differ in cost: none costs more than the dearest."""
    return np.asarray(np.ceil(field.reach.min(axis=0) / field.costs.max() - ROUNDING))


@kernel
def _fill_layers(
    layers: NDArray[np.float64],
    offsets: NDArray[np.int64],
    width: int,
    start: int,
    value: NDArray[np.float64],
    price: NDArray[np.float64],
    free: NDArray[np.bool_],
    gamma: float,
) -> None:
    """Fill `layers` [moves + 1, n]: the best sum of max(gamma^t value - price, 0) of a walk that ends at a cell."""
    moves, n = layers.shape[0] - 1, layers.shape[1]
    layers[0, :] = NOWHERE
    layers[0, start] = max(value[start] - price[start], 0.0)
    reward = np.full(n, NOWHERE)
    for c in range(n):
        if free[c]:
            reward[c] = max(value[c] - price[c], 0.0)
    discount = 1.0
    lo, hi = width + 1, n - width - 1
    for t in range(1, moves + 1):
        if gamma != 1.0:
            discount *= gamma
            for c in range(n):
                if free[c]:
                    reward[c] = max(discount * value[c] - price[c], 0.0)
        before, now = layers[t - 1], layers[t]
        now[:lo] = NOWHERE
        now[hi:] = NOWHERE
        east, west, north, south = before[lo + 1 :], before[lo - 1 :], before[lo - width :], before[lo + width :]
        gain, target = reward[lo:hi], now[lo:hi]
        for c in range(hi - lo):
            a = max(east[c], west[c])
            b = max(north[c], south[c])
            target[c] = max(a, b) + gain[c]
        if offsets.size == 8:
            ne, nw = before[lo - width + 1 :], before[lo - width - 1 :]
            se, sw = before[lo + width + 1 :], before[lo + width - 1 :]
            for c in range(hi - lo):
                a = max(ne[c], nw[c])
                b = max(se[c], sw[c])
                target[c] = max(target[c], max(a, b) + gain[c])


@kernel
def _trace(
    layers: NDArray[np.float64],
    offsets: NDArray[np.int64],
    last: int,
    value: NDArray[np.float64],
    price: NDArray[np.float64],
    gamma: float,
    visits: NDArray[np.float64],
) -> None:
    """Count in `visits` how often the best walk that ends at `last` collects from each cell."""
    visits[:] = 0.0
    cell = last
    for t in range(layers.shape[0] - 1, -1, -1):
        if gamma**t * value[cell] > price[cell]:
            visits[cell] += 1.0
        if t > 0:
            best = cell - offsets[0]
            for k in range(1, offsets.size):
                if layers[t - 1, cell - offsets[k]] > layers[t - 1, best]:
                    best = cell - offsets[k]
            cell = best


def _best_end(field: Field, layers: NDArray[np.float64]) -> tuple[int, int]:
    """Return the layer and the cell where the best walk ends."""
    end = layers.shape[0] - 1
    if not field.returns:
        return end, int(np.argmax(layers[end]))
    if not field.exact and layers[end - 1, field.start] > layers[end, field.start]:
        end -= 1
    return end, field.start


def lagrangian_bound(field: Field, known: float, gamma: float = 1.0, iterations: int = 100) -> float:
    """Return the smallest Lagrangian bound met in `iterations` subgradient steps.

    For prices u >= 0, no walk collects more than sum(u) + max over walks of sum_t max(gamma^t q - u, 0) along the
    walk: "a cell pays once" is relaxed and u is what a repeated visit forgoes. The steps follow the volume
    algorithm (Barahona and Anbil 2000): Polyak's length from the best prices so far, along the running mean of
    visits, from u = max(q - tau, 0) with tau the least of the best T + 1 cells.

    Parameters
    ----------
    field : Field
        The reachable window.
    known : float
        Value of a walk that exists, the target of the steps; it does not affect validity.
    gamma : float
        Discount per move; 1 bounds the plain score.
    iterations : int
        Subgradient steps.

    Returns
    -------
    float
        The bound; inf where the relaxation would not fit memory (see `MAX_LAYER_CELLS`).
    """
    cells = capacity(field)
    if iterations < 1 or field.free.size * cells > MAX_LAYER_CELLS:
        return float("inf")
    layers = np.empty((cells, field.free.size))
    ranked = np.sort(field.value[field.free])[::-1]
    price = centre = np.maximum(field.value - ranked[min(cells, ranked.size) - 1], 0.0)
    visits = np.zeros(field.free.size)
    mean = np.zeros(0)
    best, step, stale = float("inf"), FIRST_STEP, 0
    for _ in range(iterations):
        _fill_layers(layers, field.offsets, field.width, field.start, field.value, price, field.free, gamma)
        end, last = _best_end(field, layers)
        bound = float(price.sum() + layers[end, last])
        _trace(layers[: end + 1], field.offsets, last, field.value, price, gamma, visits)
        mean = MEMORY * mean + (1.0 - MEMORY) * visits if mean.size else visits.copy()
        if bound < best:
            best, centre, stale, step = bound, price, 0, step * STEP_GROWTH
        else:
            stale += 1
            step *= STEP_SHRINK if stale % PATIENCE == 0 else 1.0
        slope = np.where(field.free & ((centre > 0.0) | (mean > 1.0)), 1.0 - mean, 0.0)
        steepness = float(slope @ slope)
        if steepness == 0.0 or best <= known:
            break
        price = np.clip(centre - step * (best - known) / steepness * slope, 0.0, field.value)
    return best * (1.0 + ROUNDING)


def upper_bound(field: Field, known: float, gamma: float = 1.0, iterations: int = 100) -> float:
    """Return the smaller of the two bounds, never below `known`, the value of a walk that exists."""
    bound = scheduling_bound(field, gamma)
    if bound > known:
        bound = min(bound, lagrangian_bound(field, known, gamma, iterations))
    return max(bound, known)
