"""What was measured at other times, at the records of a log: unknown where nothing is near in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrt_cli.raster.grid import wrapped_deg

Floats = NDArray[np.float64]

MEASURED_S = 2.0
"""Two measurements farther apart tell nothing of the time between them."""
COMMAND_S = 1.0
"""A command older than this is not known to hold still: most robots stop by then."""


def interpolated(when: Floats, time_s: Floats, values: Floats, *, angle: bool = False) -> Floats:
    """Return values [m] measured at `time_s` [m] at the times `when` [n], straight between neighbours.

    NaN before the first, after the last, and between two more than `MEASURED_S` apart. NaN values count as not
    measured. Angles, in degrees, go the shorter way round and come back from -180 to 180.
    """
    known = np.isfinite(values)
    order = np.argsort(time_s[known], kind="stable")
    time, value = time_s[known][order], values[known][order]
    if not time.size:
        return np.full(when.size, np.nan)
    if angle:
        value = np.unwrap(value, period=360.0)
    found = np.interp(when, time, value, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(time, when, side="left"), 0, time.size - 1)
    before = np.clip(np.searchsorted(time, when, side="right") - 1, 0, time.size - 1)
    found[time[after] - time[before] > MEASURED_S] = np.nan
    return wrapped_deg(found) if angle else np.asarray(found)


def held(when: Floats, time_s: Floats, values: Floats) -> Floats:
    """Return at times `when` [n] the last of values [m] given at `time_s` [m]; NaN where older than `COMMAND_S`."""
    if not time_s.size:
        return np.full(when.size, np.nan)
    order = np.argsort(time_s, kind="stable")
    time, value = time_s[order], values[order]
    last = np.searchsorted(time, when, side="right") - 1
    known = (last >= 0) & (when - time[np.maximum(last, 0)] <= COMMAND_S)
    return np.where(known, value[np.maximum(last, 0)], np.nan)
