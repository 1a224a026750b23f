"""The rich regions of a map: connected cells above a level, the nearest of them merged until few are left."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel, lean_kernel
from hrt_cli.planning.walk import Field

MOST_LABELS = 300
"""Regions considered before merging; the poorer ones count as ground between, their surplus is given for free."""


@kernel
def label_regions(field: Field, level: float) -> tuple[NDArray[np.int64], int]:
    """Return the connected region of each cell above `level`, int64 [n] with -1 elsewhere, and their number."""
    label = np.full(field.free.size, -1)
    stack = np.empty(field.free.size, np.int64)
    count = 0
    for seed in range(label.size):
        if label[seed] >= 0 or not field.free[seed] or field.value[seed] <= level:
            continue
        label[seed] = count
        stack[0], top = seed, 1
        while top > 0:
            top -= 1
            cell = stack[top]
            for k in range(field.offsets.size):
                after = cell + field.offsets[k]
                if label[after] < 0 and field.free[after] and field.value[after] > level:
                    label[after] = count
                    stack[top] = after
                    top += 1
        count += 1
    return label, count


@lean_kernel
def crossing_loss(field: Field, label: NDArray[np.int64], cell: int, cost: float, price: float) -> float:
    """Return what a move of `cost` into a cell loses: price x cost - value, at least 0; into a region nothing."""
    return 0.0 if label[cell] >= 0 else max(price * cost - field.value[cell], 0.0)


@kernel
def spread(
    field: Field, costs: NDArray[np.float64], label: NDArray[np.int64], sources: NDArray[np.int64], price: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return what the cheapest way from `sources` to each cell loses at a price per move (Dijkstra 1959), and whence.

    `costs` are those of the moves, `sources` cells in rising order; the second array holds the label of the source
    that each way comes from, -1 where there is none.
    """
    loss = np.full(field.free.size, np.inf)
    origin = np.full(field.free.size, -1)
    heap = [(0.0, 0)]
    heap.pop()
    for i in range(sources.size):
        loss[sources[i]], origin[sources[i]] = 0.0, label[sources[i]]
        heap.append((0.0, sources[i]))
    while len(heap) > 0:
        so_far, cell = heapq.heappop(heap)
        if so_far > loss[cell]:
            continue
        for k in range(field.offsets.size):
            after = cell + field.offsets[k]
            if not field.free[after]:
                continue
            step = crossing_loss(field, label, after, costs[k], price)
            if so_far + step < loss[after]:
                loss[after], origin[after] = so_far + step, origin[cell]
                heapq.heappush(heap, (so_far + step, after))
    return loss, origin


@kernel
def _borders(
    field: Field, label: NDArray[np.int64], price: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of neighbouring regions and what crossing between them loses, one entry per meeting cells."""
    n = label.size
    loss, owner = spread(field, field.costs, label, np.flatnonzero(label >= 0), price)
    first = np.empty(n * field.offsets.size, np.int64)
    second = np.empty(n * field.offsets.size, np.int64)
    gap = np.empty(n * field.offsets.size)
    found = 0
    for cell in range(n):
        if not field.free[cell] or owner[cell] < 0:
            continue
        for k in range(field.offsets.size):
            after = cell + field.offsets[k]
            if field.free[after] and owner[after] > owner[cell]:
                first[found], second[found], gap[found] = owner[cell], owner[after], loss[cell] + loss[after]
                found += 1
    return first[:found], second[:found], gap[:found]


@kernel
def merge_regions(
    prize: NDArray[np.float64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    gap: NDArray[np.float64],
    most: int,
) -> NDArray[np.int64]:
    """Return the group of each region after merging until at most `most` are left, numbered from 0.

    The pair is merged whose merging gives away least: the way between them, or the smaller prize. Regions that
    nothing joins keep apart as long as there is room; beyond it they are joined to the first.
    """
    n = prize.size
    group = np.arange(n)
    worth = prize.copy()
    left = n
    while left > most:
        best, best_key = -1, np.inf
        for e in range(gap.size):
            a, b = group[first[e]], group[second[e]]
            if a != b:
                key = min(gap[e], min(worth[a], worth[b]))
                if key < best_key:
                    best, best_key = e, key
        if best >= 0:
            a, b = group[first[best]], group[second[best]]
        else:
            a, b = group[0], -1
            for i in range(n):
                if group[i] != a:
                    b = group[i]
        for i in range(n):
            if group[i] == b:
                group[i] = a
        worth[a] += worth[b]
        left -= 1
    number = np.full(n, -1)
    count = 0
    for i in range(n):
        if number[group[i]] < 0:
            number[group[i]] = count
            count += 1
    for i in range(n):
        group[i] = number[group[i]]
    return group


def find_regions(field: Field, level: float, most: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the region of each cell and the group of each region, at most `most` groups."""
    label, count = label_regions(field, level)
    inside = label >= 0
    prize = np.bincount(label[inside], weights=field.value[inside] - level, minlength=count)
    if count > MOST_LABELS:
        kept = np.sort(np.argsort(-prize, kind="stable")[:MOST_LABELS])
        number = np.full(count + 1, -1)
        number[kept] = np.arange(kept.size)
        label, prize = number[label], prize[kept]
    if prize.size == 0:
        return label, np.zeros(0, np.int64)
    first, second, gap = _borders(field, label, level)
    pair = first * prize.size + second
    order = np.lexsort((gap, pair))
    order = order[np.unique(pair[order], return_index=True)[1]]
    return label, np.asarray(merge_regions(prize, first[order], second[order], gap[order], most))
