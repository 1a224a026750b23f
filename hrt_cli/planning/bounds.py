"""Proven upper bounds on what walks can collect, within the budget and within every number of first moves.

Three relaxations, of which the smallest is taken: each cell collected in its own time slot, not before it can be
reached; the Lagrangian relaxation of "a cell pays once", a longest walk through time and space; and the Lagrangian
relaxation of the budget, a prize-collecting path over rich regions (`tours`).
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel
from hrt_cli.planning.tours import Cut
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
def _fill_slots(
    value: NDArray[np.float64], release: NDArray[np.float64], slots: NDArray[np.int64], first: int, stride: int,
    taken: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add to `taken[t]` the best released cells of `slots[t]` slots, t = first, first + stride, ...

    Cells are sorted by release, the rich first among equals.
    """
    heap = [0.0]
    heap.pop()
    i = 0
    for t in range(first, slots.size, stride):
        while i < value.size and release[i] <= t:
            heapq.heappush(heap, -value[i])
            i += 1
        for _ in range(slots[t]):
            if len(heap) > 0:
                taken[t] -= heapq.heappop(heap)


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


def scheduling_profile(fields: Sequence[Field], joint: Field) -> NDArray[np.float64]:
    """Return what the first 0..T moves collect at most when each cell only needs a time slot of its own.

    A relaxation of the walk: at most one new cell per move and robot, cell c no earlier than the nearest robot can
    reach it, on the parity of that distance where one robot moves on a bipartite grid. Taking the best released
    cell in each slot is optimal for every horizon at once, by exchange.

    Returns
    -------
    ndarray, float64 [T + 1]
    """
    moves = max(capacity(field) for field in fields) - 1
    slots = sum((np.arange(moves + 1) < capacity(field)).astype(np.int64) for field in fields)
    release = np.min([_release(field) for field in fields], axis=0)
    usable = joint.free & (joint.value > 0)
    taken = np.zeros(moves + 1)
    stride = 2 if len(fields) == 1 and bipartite(joint) else 1
    for first in range(stride):
        mine = usable.copy()
        if stride == 2:
            mine[usable] = release[usable] % 2 == first
        order = np.lexsort((-joint.value[mine], release[mine]))
        _fill_slots(joint.value[mine][order], release[mine][order], slots, first, stride, taken)
    return np.asarray(taken.cumsum())


def _closed_bound(field: Field) -> float:
    """Return the scheduling bound of one robot with a given end, the time to get there counted.

    Where the walk is closed the windows are nested and the greedy choice is optimal (a transversal matroid); else
    the slots are counted back from the end, as they are from the start.
    """
    if field.end != field.start:
        turned = field._replace(start=field.end, end=field.start, reach=field.home, home=field.reach)
        return float(scheduling_profile([turned], turned)[-1])
    moves = capacity(field) - 1
    release = _release(field)
    usable = field.free & (field.value > 0)
    total = 0.0
    stride = 2 if bipartite(field) else 1
    for first in range(stride):
        mine = usable.copy()
        if stride == 2:
            mine[usable] = release[usable] % 2 == first
        order = np.lexsort((field.value[mine], -release[mine]))
        total += _best_in_windows(field.value[mine][order], release[mine][order], moves, stride)
    return total


def scheduling_bound(field: Field, gamma: float = 1.0) -> float:
    """Return the scheduling bound on the score of one robot's walks, discounted by `gamma` per move."""
    bound = discounted_sum(scheduling_profile([field], field), gamma)
    if field.end >= 0 and gamma == 1.0:
        bound = min(bound, _closed_bound(field))
    return bound * (1.0 + ROUNDING)


def discounted_sum(profile: NDArray[np.float64], gamma: float) -> float:
    """Return the bound on the discounted score that bounds on the first 0..T moves give.

    sum_t gamma^t x_t = sum_n (gamma^n - gamma^(n+1)) X_n + gamma^T X_T with X_n what the first n moves collect.
    """
    weight = gamma ** np.arange(profile.size)
    weight[:-1] -= weight[1:]
    return float(weight @ profile)


def _release(field: Field) -> NDArray[np.float64]:
    """Return the fewest moves to each cell; bounded from below where moves differ in cost."""
    dearest = 1.0 if field.exact else field.costs.max()
    return np.asarray(np.ceil(field.reach.min(axis=0) / dearest - ROUNDING))


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


def _first_prices(field: Field, cells: int, robots: int, gamma: float) -> NDArray[np.float64]:
    """Return the prices at which the best `cells` cells, the richest first, are content with a time slot each.

    They are the duals of that assignment: max(q - tau, 0) where nothing is discounted, tau being the next cell's value.
    Every moment has a slot for each of `robots`.
    """
    ranked = np.argsort(-np.where(field.free, field.value, -1.0), kind="stable")[: cells + 1]
    ranked = ranked[field.free[ranked]]
    value = field.value[ranked]
    discount = gamma ** (np.arange(cells + 1) // robots)
    beyond = value[cells] if value.size > cells else 0.0
    value = value[:cells]
    following = np.append(value[1:], beyond)
    steps = (discount[:-1] - discount[1:])[: value.size] * following
    slot = discount[value.size] * beyond + steps[::-1].cumsum()[::-1]
    price = np.zeros(field.free.size)
    price[ranked[:cells]] = np.maximum(discount[: value.size] * value - slot, 0.0)
    return price


def _best_end(field: Field, layers: NDArray[np.float64]) -> tuple[int, int]:
    """Return the layer and the cell where the best walk ends."""
    if field.exact:
        end = layers.shape[0] - 1
        return end, field.end if field.end >= 0 else int(np.argmax(layers[end]))
    # A walk of dearer moves has fewer of them: it ends in whichever layer is best.
    ends = layers[:, field.end] if field.end >= 0 else layers.max(axis=1)
    end = int(np.argmax(ends))
    return end, field.end if field.end >= 0 else int(np.argmax(layers[end]))


def lagrangian_bound(
    fields: Sequence[Field], joint: Field, known: float, gamma: float = 1.0, iterations: int = 100
) -> tuple[float, NDArray[np.float64]]:
    """Return the smallest Lagrangian bound met in `iterations` subgradient steps, and one for every horizon.

    For prices u >= 0, no walks collect more than sum(u) + sum over robots of the maximum over walks of
    sum_t max(gamma^t q - u, 0) along the walk: "a cell pays once" is relaxed and u is what a repeated visit forgoes.
    The steps follow the volume algorithm (Barahona and Anbil 2000): Polyak's length from the best prices so far, along
    the running mean of visits, from the prices of the assignment of the best cells to time slots.

    Parameters
    ----------
    fields : sequence of Field
        One per robot, on the same window.
    joint : Field
        The window with every cell that some robot can enter.
    known : float
        (Discounted) score of walks that exist, the target of the steps; it does not affect validity.
    gamma : float
        Discount per move; 1 bounds the plain score.
    iterations : int
        Subgradient steps.

    Returns
    -------
    bound : float
        The bound; inf where the relaxation would not fit memory (see `MAX_LAYER_CELLS`).
    profile : ndarray, float64 [T + 1]
        Bounds on what the first 0..T moves of each robot collect, discounted alike.
    """
    cells = max(capacity(field) for field in fields)
    profile = np.full(cells, np.inf)
    if iterations < 1 or joint.free.size * cells > MAX_LAYER_CELLS:
        return float("inf"), profile
    # Robots that start alike have the same best walk.
    alike = Counter((field.start, field.end, field.limit) for field in fields)
    by_task = {(field.start, field.end, field.limit): field for field in fields}
    groups = [(by_task[task], count) for task, count in alike.items()]
    layers = np.empty((cells, joint.free.size))
    slots = sum(capacity(field) for field in fields)
    price = centre = _first_prices(joint, slots, len(fields), gamma)
    visits, walk = np.zeros(joint.free.size), np.zeros(joint.free.size)
    mean = np.zeros(0)
    best, step, stale = float("inf"), FIRST_STEP, 0
    for _ in range(iterations):
        bound, early = float(price.sum()), np.full(cells, price.sum())
        visits[:] = 0.0
        for field, count in groups:
            mine = layers[: capacity(field)]
            _fill_layers(mine, field.offsets, field.width, field.start, joint.value, price, field.free, gamma)
            end, last = _best_end(field, mine)
            bound += count * float(mine[end, last])
            reached = np.maximum.accumulate(mine.max(axis=1))
            early[: reached.size] += count * reached
            early[reached.size :] += count * reached[-1]
            _trace(mine[: end + 1], field.offsets, last, joint.value, price, gamma, walk)
            visits += count * walk
        profile = np.minimum(profile, early)
        mean = MEMORY * mean + (1.0 - MEMORY) * visits if mean.size else visits.copy()
        if bound < best:
            best, centre, stale, step = bound, price, 0, step * STEP_GROWTH
        else:
            stale += 1
            step *= STEP_SHRINK if stale % PATIENCE == 0 else 1.0
        slope = np.where(joint.free & ((centre > 0.0) | (mean > 1.0)), 1.0 - mean, 0.0)
        steepness = float(slope @ slope)
        if steepness == 0.0 or best <= known:
            break
        price = np.clip(centre - step * (best - known) / steepness * slope, 0.0, joint.value)
    return best * (1.0 + ROUNDING), profile * (1.0 + ROUNDING)


@dataclass(frozen=True)
class Bounds:
    """What no walk, or no team's walks together, can collect more of.

    Attributes
    ----------
    score : float
        Bound on the score.
    discounted : float or None
        Bound on the discounted score, where it was asked for.
    """

    score: float
    discounted: float | None


def prove_bounds(
    fields: Sequence[Field],
    joint: Field,
    cuts: Sequence[Cut],
    known: float,
    gamma: float | None = None,
    known_discounted: float = 0.0,
    iterations: int = 50,
) -> Bounds:
    """Return the smallest of the bounds, never below what walks that exist collect.

    Parameters
    ----------
    fields : sequence of Field
        One per robot, on the same window.
    joint : Field
        The window with every cell that some robot can enter.
    cuts : sequence of Cut
        The regions of the window, see `tours.cut_regions`.
    known, known_discounted : float
        Score and discounted score of walks that exist.
    gamma : float, optional
        Discount per move; without it the discounted score is not bounded.
    iterations : int
        Subgradient steps of the Lagrangian relaxation of "a cell pays once"; shared by the two scores, and fewer for
        teams of more than two.
    """
    slots = scheduling_profile(fields, joint)
    score = min([float(slots[-1]), *(cut.bound() for cut in cuts)]) * (1.0 + ROUNDING)
    if len(fields) == 1 and joint.end >= 0:
        score = min(score, scheduling_bound(joint))
    walks: list[NDArray[np.float64]] = []
    if gamma is not None and gamma != 1.0:
        iterations = (iterations + 1) // 2
    iterations = math.ceil(iterations * min(1.0, 2.0 / len(fields)))
    if score > known or gamma is not None:
        bound, profile = lagrangian_bound(fields, joint, known, 1.0, iterations)
        score = min(score, bound)
        walks.append(profile)
    if gamma is None or gamma == 1.0:
        return Bounds(max(score, known), None if gamma is None else max(score, known_discounted))
    profiles = [slots, *walks, *(cut.profile(slots.size - 1) for cut in cuts)]
    least = np.min(profiles, axis=0)
    least[-1] = min(float(least[-1]), score)
    # What fewer moves collect, more moves do too: the other way round a bound on more bounds fewer.
    least = np.minimum.accumulate(least[::-1])[::-1]
    discounted = discounted_sum(least, gamma) * (1.0 + ROUNDING)
    if discounted > known_discounted:
        discounted = min(discounted, lagrangian_bound(fields, joint, known_discounted, gamma, iterations)[0])
    return Bounds(max(score, known), max(discounted, known_discounted))
