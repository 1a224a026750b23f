"""Lines across the meridian 180: cut there, because map programs draw a jump of longitude as a line round the globe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from hrt_cli.missions.mission import rounded

LonLat = tuple[float, float]


def cut_at_180(points: Sequence[LonLat], decimals: int) -> list[list[LonLat]]:
    """Cut a line where it crosses the meridian 180: where a step is more than half the globe.

    Parameters
    ----------
    points : sequence of (lon, lat)
        At least one; degrees, longitudes < 180.
    decimals : int
        Those of the latitudes where it is cut.

    Returns
    -------
    list of list of (lon, lat)
        The parts in their order, one where it crosses nothing; where one ends at 180 the next begins at -180.
    """
    parts = [[points[0]]]
    for (lon0, lat0), (lon1, lat1) in pairwise(points):
        if abs(lon1 - lon0) > 180:
            side = math.copysign(180.0, lon0)
            share = (side - lon0) / (lon1 + 2 * side - lon0)
            lat = rounded(lat0 + share * (lat1 - lat0), decimals)
            parts[-1].append((side, lat))
            parts.append([(-side, lat)])
        parts[-1].append((lon1, lat1))
    return parts
