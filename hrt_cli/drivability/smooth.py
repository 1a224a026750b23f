"""Positions of a drive against the noise of its receiver: where the robot really was, and whether it moved at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SMOOTH_S = 1.5
"""Positions count in a local line up to so many seconds away."""
DRIFT_S = 10.0
"""A robot that has gone nowhere for so long, before and after, stands: what it seems to move is noise."""
_MOST_LAGS = 500
_SPIKE = 5.0
_SPIKE_M_S = 2.0


def despiked(time_s: Floats, places: Floats, scale: Floats) -> tuple[Floats, int]:
    """Put single records that a receiver threw far off back between their neighbours.

    Such a record lies far from both neighbours, at speeds that the drive does not have, and these near each other.

    Parameters
    ----------
    time_s, places : float64 [n], [n, 2]
    scale : float64 [2]
        Metres of a unit of either column of `places`.

    Returns
    -------
    places : float64 [n, 2]
    count : int
        How many records were moved.
    """
    if time_s.size < 3:
        return places, 0
    speed = _lengths(places[1:] - places[:-1], scale) / np.maximum(np.diff(time_s), 1e-3)
    past = _lengths(places[2:] - places[:-2], scale) / np.maximum(time_s[2:] - time_s[:-2], 1e-3)
    limit = np.maximum(_SPIKE * np.maximum(past, np.median(speed)), _SPIKE_M_S)
    good = np.ones(time_s.size, np.bool_)
    good[1:-1] = np.minimum(speed[:-1], speed[1:]) <= limit
    return _at(time_s[good], places[good], time_s) if not good.all() else places, int((~good).sum())


def smoothed(time_s: Floats, places: Floats, stretch: Ints) -> Floats:
    """Return places on local lines through their neighbours in time (Cleveland 1979, of degree 1).

    The weight of a neighbour falls linearly to 0 at `SMOOTH_S`. A steady drive, and a place without a neighbour, stay
    where they are.

    Parameters
    ----------
    time_s, places : float64 [n], [n, 2]
    stretch : int64 [n]
        Neighbours of another number do not count.

    Returns
    -------
    float64 [n, 2]
    """
    s0, s1, s2 = np.ones(time_s.size), np.zeros(time_s.size), np.zeros(time_s.size)
    d0, d1 = np.zeros_like(places), np.zeros_like(places)
    for lag in range(1, min(time_s.size, _MOST_LAGS + 1)):
        here, there = slice(None, -lag), slice(lag, None)
        step = time_s[there] - time_s[here]
        weight = np.where(stretch[there] == stretch[here], np.maximum(0.0, 1.0 - step / SMOOTH_S), 0.0)
        if not weight.any():
            break
        away = places[there] - places[here]
        for at, sign in ((here, 1.0), (there, -1.0)):
            s0[at] += weight
            s1[at] += sign * weight * step
            s2[at] += weight * step**2
            d0[at] += sign * weight[:, None] * away
            d1[at] += (weight * step)[:, None] * away
    spread = s0 * s2 - s1**2
    line = spread > 1e-9 * s0**2
    spread[~line] = 1.0
    moved = np.where(line[:, None], (s2[:, None] * d0 - s1[:, None] * d1) / spread[:, None], d0 / s0[:, None])
    return np.asarray(places + moved)


def drift_speed(time_s: Floats, places_m: Floats, stretch: Ints, first: Ints, last: Ints) -> Floats:
    """Return how fast a robot gets away from where it is, for intervals of a drive, in m/s.

    It is the largest distance to its places 5 and 10 s before and after the middle of the interval, over the longest
    of these times; the window ends where the stretch does. A circle that it drives counts as moving.

    Parameters
    ----------
    time_s, places_m, stretch
        As for `smoothed`, places in metres.
    first, last : int64 [m]
        Records at which the intervals begin and end.
    """
    number = stretch[last]
    begins = time_s[np.searchsorted(stretch, number, "left")]
    # The record that ends one stretch is where the next one begins.
    begins = np.minimum(begins, time_s[first])
    ends = time_s[np.searchsorted(stretch, number, "right") - 1]
    middle = (time_s[first] + time_s[last]) / 2
    here = _at(time_s, places_m, middle)
    farthest, longest = np.zeros(first.size), np.zeros(first.size)
    for offset in (-DRIFT_S, -DRIFT_S / 2, DRIFT_S / 2, DRIFT_S):
        then = np.clip(middle + offset, begins, ends)
        away = _at(time_s, places_m, then) - here
        farthest = np.maximum(farthest, np.hypot(away[:, 0], away[:, 1]))
        longest = np.maximum(longest, np.abs(then - middle))
    return farthest / np.maximum(longest, 1e-9)


def _lengths(steps: Floats, scale: Floats) -> Floats:
    return np.asarray(np.hypot(*(steps * scale).T))


def _at(time_s: Floats, places: Floats, when: Floats) -> Floats:
    return np.stack([np.interp(when, time_s, places[:, k]) for k in (0, 1)], axis=1)
