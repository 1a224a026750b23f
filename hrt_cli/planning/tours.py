"""The order in which to visit the rich regions of a map, and the bound that follows.

Above a price per move the map falls apart into regions worth going to. Inside them a walk may at best collect
everything, one cell a move; between them it must cross poorer ground. What remains is a prize-collecting path
over a handful of regions, which is solved exactly: it bounds every walk, and its order is a good plan's order.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.jit import kernel
from hrt_cli.planning.regions import crossing_loss, find_regions, spread
from hrt_cli.planning.walk import Field

MOST_REGIONS = 11
"""Regions told apart; what lies nearest is merged until no more are left. The exact search takes 2^n n^2."""

LEVELS = (1.0, 1.3, 0.8)
"""Where regions are cut: the value of the cell of this rank, in multiples of the cells the budget pays for."""

EARLY_LEVELS = (0.1, 0.2, 0.4, 0.6)
"""Further levels that tell what the first moves can collect, for discounted plans."""

PRICES = (0.0, 0.8, 0.3, 1.6)
"""Prices of a move that are tried: the level, and so many times further up to the mean of the regions' cells."""

SEARCHED_CELLS = 26_000_000
"""Cells that all searches for cheapest ways may go over; on large maps fewer levels and prices are tried."""


@dataclass(frozen=True)
class _Priced:
    """Paths over sets of merged regions at one price of a move.

    Attributes
    ----------
    price : float
        Price of a move.
    worth, prefix : ndarray, float64 [2^k]
        What a set pays less what the cheapest paths over it lose; `prefix` without the way to the end.
    between : ndarray, float64 [k, k]
        Loss from region to region.
    ending : list of ndarray, float64 [2^k, k]
        For each robot, the loss of the cheapest path over a set that ends in a region.
    home : list of ndarray, float64 [k]
        For each robot, the loss from a region to its end.
    parts : list of ndarray, int64 [2^k]
        What robot r takes of a set that robots 0..r share.
    """

    price: float
    worth: NDArray[np.float64]
    prefix: NDArray[np.float64]
    between: NDArray[np.float64]
    ending: list[NDArray[np.float64]]
    home: list[NDArray[np.float64]]
    parts: list[NDArray[np.int64]]


@dataclass(frozen=True)
class Cut:
    """The regions above one level, and what paths over them are worth at several prices.

    Attributes
    ----------
    label : ndarray, int64 [n]
        Region of each cell of the window before merging, -1 outside.
    group : ndarray, int64 [regions]
        Merged region that each region belongs to.
    limits : ndarray, float64 [robots]
        Budget of each robot.
    dearest : float
        Cost of the dearest move.
    priced : list
        One entry per price.
    """

    label: NDArray[np.int64]
    group: NDArray[np.int64]
    limits: NDArray[np.float64]
    dearest: float
    priced: list[_Priced]

    def bound(self) -> float:
        """Return the proven bound on the score of any walk, or of all robots' walks together."""
        return float(self._whole().min(axis=0).max())

    def _whole(self) -> NDArray[np.float64]:
        return np.stack([each.price * self.limits.sum() + each.worth for each in self.priced])

    def profile(self, moves: int) -> NDArray[np.float64]:
        """Return proven bounds, float64 [moves + 1], on what the first 0..`moves` moves of each robot collect."""
        prefix = np.stack([each.prefix for each in self.priced])
        prices = np.array([each.price for each in self.priced])[:, None]
        found = np.empty(moves + 1)
        for n in range(moves + 1):
            found[n] = (prefix + prices * np.minimum(self.limits, n * self.dearest).sum()).min(axis=0).max()
        return found

    def orders(self, moves: int | None = None) -> tuple[list[NDArray[np.int64]], float]:
        """Return the merged regions that each robot visits on the paths worth the bound, and the price of a move.

        With `moves`, on the paths worth the bound on that many moves.
        """
        whole = self._whole()
        if moves is not None:
            spent = np.minimum(self.limits, moves * self.dearest).sum()
            whole = np.stack([each.prefix + each.price * spent for each in self.priced])
        left = int(whole.min(axis=0).argmax())
        best = self.priced[int(whole[:, left].argmin())]
        orders: list[NDArray[np.int64]] = []
        for robot in range(self.limits.size - 1, -1, -1):
            others = left ^ int(best.parts[robot][left])
            orders.insert(0, _order(best, robot, left ^ others))
            left = others
        return orders, best.price


@kernel
def cheapest_orders(
    between: NDArray[np.float64], first: NDArray[np.float64], home: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the cheapest path over each set of regions (Held and Karp 1962).

    Parameters
    ----------
    between : ndarray, float64 [k, k]
        Loss from region to region.
    first, home : ndarray, float64 [k]
        Loss from the start to each region, and from each region to where the walk must end.

    Returns
    -------
    cost : ndarray, float64 [2^k]
        Loss of the cheapest path over each set, 0 for the empty one.
    ending : ndarray, float64 [2^k, k]
        The same for paths that end in a region, without the way home.
    """
    k = first.size
    sets = 1 << k
    ending = np.full((sets, k), np.inf)
    cost = np.full(sets, np.inf)
    cost[0] = 0.0
    for i in range(k):
        ending[1 << i, i] = first[i]
    for chosen in range(1, sets):
        for i in range(k):
            so_far = ending[chosen, i]
            if so_far == np.inf:
                continue
            cost[chosen] = min(cost[chosen], so_far + home[i])
            for j in range(k):
                if not (chosen >> j) & 1:
                    reached = so_far + between[i, j]
                    if reached < ending[chosen | (1 << j), j]:
                        ending[chosen | (1 << j), j] = reached
    return cost, ending


@kernel
def share_out(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the cheapest way to split each set in two, float64 [2^k], and the part of `one`, int64 [2^k]."""
    best = np.full(one.size, np.inf)
    part = np.zeros(one.size, np.int64)
    for chosen in range(one.size):
        mine = chosen
        while True:
            cost = one[mine] + other[chosen ^ mine]
            if cost < best[chosen]:
                best[chosen], part[chosen] = cost, mine
            if mine == 0:
                break
            mine = (mine - 1) & chosen
    return best, part


@kernel
def _way_to_nearest(
    field: Field,
    source: int,
    label: NDArray[np.int64],
    wanted: NDArray[np.bool_],
    price: float,
    loss: NDArray[np.float64],
    back: NDArray[np.int64],
    stamp: NDArray[np.int64],
    mark: int,
) -> int:
    """Return the cell of a wanted region that is reached from `source` with the least loss, -1 for none.

    `back` holds the way; `loss` and `back` are valid where `stamp` is `mark`.
    """
    loss[source], back[source], stamp[source] = 0.0, -1, mark
    heap = [(0.0, source)]
    while len(heap) > 0:
        so_far, cell = heapq.heappop(heap)
        if so_far > loss[cell]:
            continue
        if label[cell] >= 0 and wanted[label[cell]]:
            return cell
        for k in range(field.offsets.size):
            after = cell + field.offsets[k]
            if not field.free[after]:
                continue
            step = crossing_loss(field, label, after, field.costs[k], price)
            if stamp[after] != mark or so_far + step < loss[after]:
                loss[after], back[after], stamp[after] = so_far + step, cell, mark
                heapq.heappush(heap, (so_far + step, after))
    return -1


@kernel
def follow(
    field: Field,
    start: int,
    label: NDArray[np.int64],
    group: NDArray[np.int64],
    order: NDArray[np.int64],
    price: float,
    most: int,
) -> NDArray[np.int64]:
    """Return the way from `start` through the regions of `order`, int64 [k] of at most `most` cells.

    Every region of a group is entered, the nearest first; ways are those that lose least at `price`.
    """
    n = field.free.size
    path = np.empty(most, np.int64)
    path[0] = start
    size, mark = 1, 0
    done = np.zeros(group.size, np.bool_)
    wanted = np.zeros(group.size, np.bool_)
    loss, back, stamp = np.empty(n), np.empty(n, np.int64), np.zeros(n, np.int64)
    if label[start] >= 0:
        done[label[start]] = True
    for i in range(order.size):
        for r in range(group.size):
            wanted[r] = group[r] == order[i] and not done[r]
        while size < most:
            mark += 1
            target = _way_to_nearest(field, path[size - 1], label, wanted, price, loss, back, stamp, mark)
            if target < 0:
                break
            length = 0
            cell = target
            while back[cell] >= 0:
                length += 1
                cell = back[cell]
            cell = target
            for j in range(length - 1, -1, -1):
                if size + j < most:
                    path[size + j] = cell
                if label[cell] >= 0:
                    done[label[cell]] = True
                    wanted[label[cell]] = False
                cell = back[cell]
            size = min(size + length, most)
    return path[:size].copy()


@kernel
def _nearest_of(loss: NDArray[np.float64], merged: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Return the least loss over the cells of each merged region."""
    least = np.full(count, np.inf)
    for cell in range(loss.size):
        if merged[cell] >= 0 and loss[cell] < least[merged[cell]]:
            least[merged[cell]] = loss[cell]
    return least


def _price(
    fields: Sequence[Field], joint: Field, label: NDArray[np.int64], group: NDArray[np.int64], price: float
) -> _Priced:
    """Bound the walks over each set of merged regions at one price of a move.

    With price p, a walk over cells D is worth at most p limit + q(start) + sum over D of (q - p)+ less p cost - q
    for every move into poorer ground: each cell pays once, and a move that collects nothing new costs its price.
    """
    count = int(group.max()) + 1 if group.size else 0
    merged = np.where(label >= 0, group[np.maximum(label, 0)], -1) if count else np.full_like(label, -1)
    surplus = np.where(joint.free, np.maximum(joint.value - price, 0.0), 0.0)
    starts = sorted({field.start for field in fields})
    surplus[starts] = 0.0
    given = float(surplus[merged < 0].sum() + joint.value[starts].sum())
    prize = np.bincount(merged[merged >= 0], weights=surplus[merged >= 0], minlength=count)
    paid = np.full(1, given)
    for i in range(count):
        paid = np.concatenate([paid, paid + prize[i]])

    def ways(source: NDArray[np.int64], costs: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(_nearest_of(spread(joint, costs, label, source, price)[0], merged, count))

    between = np.zeros((count, count))
    for i in range(count):
        between[i] = ways(np.flatnonzero(merged == i), joint.costs)
    for via in range(count):
        between = np.minimum(between, between[:, via, None] + between[None, via, :])
    total = prefix = np.where(np.arange(paid.size) == 0, 0.0, np.inf)
    ending, homes, parts = [], [], []
    for field in fields:
        first = ways(np.array([field.start]), joint.costs)
        first = (first[:, None] + between).min(axis=0) if count else first
        home = np.zeros(count)
        if field.end >= 0:
            # Seen from the end, the cell entered on each move is another one: at cost 1 neither way loses more.
            home = ways(np.array([field.end]), np.ones_like(joint.costs))
        cost, reached = cheapest_orders(between, first, home)
        free_cost = cost if field.end < 0 else cheapest_orders(between, first, np.zeros(count))[0]
        total, part = share_out(cost, total)
        prefix = share_out(free_cost, prefix)[0]
        ending.append(reached)
        homes.append(home)
        parts.append(part)
    return _Priced(price, paid - total, paid - prefix, between, ending, homes, parts)


def _order(priced: _Priced, robot: int, chosen: int) -> NDArray[np.int64]:
    """Return the regions of the set `chosen` in the order of the cheapest path of one robot."""
    ending, onward = priced.ending[robot], priced.home[robot]
    order: list[int] = []
    while chosen:
        members = [i for i in range(onward.size) if chosen >> i & 1]
        last = min(members, key=lambda i: float(ending[chosen, i] + onward[i]))
        order.append(last)
        onward = priced.between[:, last]
        chosen &= ~(1 << last)
    return np.array(order[::-1], np.int64)


def cut_regions(fields: Sequence[Field], joint: Field, early: bool = False, threads: int = 1) -> list[Cut]:
    """Return the regions above several levels and the paths over them, each with the bound that it proves.

    A relaxation with a price p >= 0 on every move (Lagrangian for the budget), under which a walk collects each
    rich region it enters as a whole, one cell a move, and loses p less the cell's value on every move between
    them: a prize-collecting path over regions, solved by dynamic programming over sets (Held and Karp 1962). The
    bound is the largest over the sets of regions of the least over the prices, each set having its own.

    Parameters
    ----------
    fields : sequence of Field
        One per robot, on the same window; a cell pays only one of them.
    joint : Field
        The window with every cell that some robot can enter.
    early : bool
        Add the levels that bound the first moves.
    threads : int
        Levels done at the same time; the answer does not depend on it.

    Returns
    -------
    list of Cut
        One per level; on large maps fewer (see `SEARCHED_CELLS`), at least one.
    """
    ranked = np.sort(joint.value[joint.free])[::-1]
    limits = np.array([field.limit for field in fields])
    ranks: tuple[float, ...] = (*LEVELS, *EARLY_LEVELS) if early else LEVELS
    searches = max(1, SEARCHED_CELLS // joint.free.size)
    most = MOST_REGIONS if searches >= MOST_REGIONS + 1 else max(2, searches // 2)
    tried = max(1, searches // (most + 2 * len(fields)))
    prices = PRICES[: min(len(PRICES), tried)]
    ranks = ranks[: min(len(ranks), max(1, tried // len(prices)))]
    smallest = float(np.finfo(np.float32).tiny)
    levels = sorted({max(float(ranked[min(int(r * limits.sum()), ranked.size - 1)]), smallest) for r in ranks})

    def price_of(job: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], float]) -> _Priced:
        (label, group), price = job
        return _price(fields, joint, label, group, price)

    with ThreadPoolExecutor(threads) as pool:
        regions = list(pool.map(lambda level: find_regions(joint, level, most), levels))
        jobs = [
            (found, level + price * _surplus(joint, found[0], level))
            for found, level in zip(regions, levels, strict=True)
            for price in prices
        ]
        priced = list(pool.map(price_of, jobs))
    dearest = float(joint.costs.max())
    return [
        Cut(label, group, limits, dearest, priced[k * len(prices) : (k + 1) * len(prices)])
        for k, (label, group) in enumerate(regions)
    ]


def _surplus(joint: Field, label: NDArray[np.int64], level: float) -> float:
    """Return by how much the mean cell of the regions is above their level; the level itself where there is none."""
    inside = label >= 0
    return float(joint.value[inside].mean()) - level if inside.any() else level
