"""The terrain camera's first compiled pass: out over the height map along azimuths.

`march` fills a table over (azimuth, elevation) with inverse distances: 1/D of a plane is linear in the sine of the
elevation, finite straight down, and 0 for the sky, so it can be interpolated as it is. `develop` looks every pixel's
ray up in it. Both are free of allocation and of the interpreter lock, and deterministic.

Here and there places are in pixels from the centre of the first one, `x` along columns and `y` along rows; heights are
metres above the lens; a frame's axes are `right`, `ahead` (level, at its heading) and `up`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False, "error_model": "numpy"}

lean: Any = njit(**_OPTIONS)
"""Compiled once, kept on disk, without the lock and without reference counting (nothing here allocates)."""

inlined: Any = njit(**_OPTIONS, forceinline=True)
"""The same for what is called for every step or pixel: passing arrays on takes longer than using them."""

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
CHUNK = 64
"""Stations whose heights are read at once."""
OUT_SHARE = 0.2
"""A lens inside what stands on the ground is out of it where that is so high, relative to the lens."""


@lean
def span(axes: F64, focal: float, width: int, height: int) -> tuple[float, float, float, float]:
    """Return what a frame covers: first azimuth, width in azimuth, lowest and highest elevation, in radians.

    Parameters
    ----------
    axes : float64 array, [3, 3]
        The lens's right, up and forward, as (right, ahead, up).
    focal : float
        Focal length in pixels.
    width, height : int
    """
    half_x, half_y = 0.5 * width / focal, 0.5 * height / focal
    low, high = math.inf, -math.inf
    first, last = math.inf, -math.inf
    centre = math.atan2(axes[2, 0], axes[2, 1])
    for side in range(4):
        for k in range(65):
            along = k / 32.0 - 1.0
            cx = half_x * along if side < 2 else (half_x if side == 2 else -half_x)
            cy = half_y * along if side >= 2 else (half_y if side == 0 else -half_y)
            right = axes[2, 0] + cx * axes[0, 0] + cy * axes[1, 0]
            ahead = axes[2, 1] + cx * axes[0, 1] + cy * axes[1, 1]
            up = axes[2, 2] + cx * axes[0, 2] + cy * axes[1, 2]
            elevation = math.atan2(up, math.sqrt(right * right + ahead * ahead))
            low, high = min(low, elevation), max(high, elevation)
            if side < 2 and k % 64 == 0:  # a corner: the azimuths of a frame are those between its corners'
                turn = math.atan2(right, ahead) - centre
                turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
                first, last = min(first, turn), max(last, turn)
    for pole in (-1.0, 1.0):
        depth = pole * axes[2, 2]
        margin = 1.02 * depth
        if depth > 0.0 and abs(axes[0, 2]) <= half_x * margin and abs(axes[1, 2]) <= half_y * margin:
            low, high = (-0.5 * math.pi, high) if pole < 0.0 else (low, 0.5 * math.pi)
            first, last = -math.pi, math.pi
    return centre + first, last - first, low, high


@inlined
def _bilinear(values: F32, start: int, rows: int, cols: int, x: float, y: float) -> Any:
    """Interpolate one level of a pyramid at a place inside it or, beyond its rim, at the nearest one inside."""
    x = min(max(x, 0.0), cols - 1.0)
    y = min(max(y, 0.0), rows - 1.0)
    col, row = min(int(x), max(cols - 2, 0)), min(int(y), max(rows - 2, 0))
    right, down = (1 if cols > 1 else 0), (cols if rows > 1 else 0)
    at = start + row * cols + col
    fx, fy = x - col, y - row
    top = values[at] + fx * (values[at + right] - values[at])
    low = values[at + down] + fx * (values[at + down + right] - values[at + down])
    return top + fy * (low - top)


@lean
def ground_height(ground: F32, levels: I64, x: float, y: float) -> Any:
    """Return the height of the bare ground, which goes on beyond the rim as it is there."""
    return _bilinear(ground, 0, levels[0, 1], levels[0, 2], x, y)


@inlined
def _surface_height(heights: F32, ground: F32, levels: I64, level: int, x: float, y: float) -> Any:
    """Return the height of the surface from one level of its pyramid; beyond the rim that of the ground."""
    rows, cols = levels[level, 1], levels[level, 2]
    shrink = 1.0 / (1 << level)
    u, v = (x + 0.5) * shrink - 0.5, (y + 0.5) * shrink - 0.5
    if u >= 0.0 and v >= 0.0 and u < cols - 1.0 and v < rows - 1.0:
        col, row = int(u), int(v)
        at = levels[level, 0] + row * cols + col
        fx, fy = u - col, v - row
        top = _between(heights[at], heights[at + 1], fx)
        low = _between(heights[at + cols], heights[at + cols + 1], fx)
        return top + fy * (low - top)
    return ground_height(ground, levels, x, y)


@inlined
def _between(a: float, b: float, share: float) -> float:
    """Return what lies between two values."""
    return a + share * (b - a)


@lean
def _fill_beyond(table: F32, k: int, at: int, sines: F64, cosines: F64, z: float, reach_m: float, hidden: bool) -> None:
    """Let the ground at the reach of an azimuth go on level to the horizon, and the sky begin there."""
    first = at
    for b in range(at, sines.size):
        if sines[b] < 0.0:
            inverse = cosines[b] / reach_m
            if z < -1e-3:
                inverse = min(inverse, sines[b] / z)
            table[k, b] = -inverse if hidden and b == first else inverse
        else:
            table[k, b] = 0.0


@lean
def place_stations(stations: F64, level_ends: I64, levels: I64, pixel_m: float, limits: F64) -> int:
    """Lay out the stations at which every azimuth looks at the ground; return how many there are.

    Parameters
    ----------
    stations : float64 array, [3, most]
        Gets level distances in metres, from 0 on, and inverse distances to the station before. The last row is
        workspace of `march`.
    level_ends : int64 array, [levels]
        Gets the index of the first station that no longer takes each level of the pyramid.
    levels : int64 array, [levels, 3]
    pixel_m : float
    limits : float64 array, [4]
        Reach and least step in metres, step per distance, height of the lens above the ground (m).
    """
    reach_m, least_m, growth, height_m = limits[0], limits[1], limits[2], limits[3]
    level, last, texel_m = 0, levels.shape[0] - 1, pixel_m
    count, radius = 1, 0.0
    stations[0, 0], stations[1, 0] = 0.0, 0.0
    while count < stations.shape[1]:
        step = max(least_m, growth * (radius + height_m))
        radius += step
        if radius > reach_m:
            break
        while level < last and step > 2.0 * texel_m:
            level_ends[level] = count
            level += 1
            texel_m *= 2.0
        stations[0, count], stations[1, count] = radius, 1.0 / step
        count += 1
    for rest in range(level, last + 1):
        level_ends[rest] = count
    return count


@inlined
def _look_out(heights: F32, ground: F32, levels: I64, lens: F64, dx: float, dy: float, stations: F64) -> int:
    """Return the first station at which a lens inside what stands on the ground is out of it; 0 if it is not in it.

    It is out where little stands: the flank of what it is in would hide all that is below the lens.
    """
    if _surface_height(heights, ground, levels, 0, lens[0], lens[1]) < lens[2]:
        return 0
    for k in range(1, stations.shape[1]):
        x, y = lens[0] + stations[0, k] * dx, lens[1] + stations[0, k] * dy
        bare = ground_height(ground, levels, x, y)
        if _surface_height(heights, ground, levels, 0, x, y) <= bare + OUT_SHARE * max(lens[2] - bare, 0.0):
            return k
    return int(stations.shape[1])


@inlined
def _fill(table: F32, k: int, b: int, sines: F64, cosines: F64, stations: F64, at: int, z0: float, z1: float) -> int:
    """Write the elevations that meet the surface between two stations, b the first of them; return the next."""
    r0, r1 = stations[0, at - 1], stations[0, at]
    slope = (z1 - z0) * stations[1, at]
    per_sight = 1.0 / (z0 - slope * r0)
    hidden = b > 0 and z0 * cosines[b - 1] < sines[b - 1] * r0
    first, bins = b, sines.size
    while b < bins:
        sine, cosine = sines[b], cosines[b]
        if z1 * cosine < sine * r1:
            break
        table[k, b] = max((sine - slope * cosine) * per_sight, 1e-9)
        b += 1
    if hidden:
        table[k, first] = -table[k, first]
    return b


@inlined
def _profile(
    out: F64, first: int, end: int, heights: F32, start: int, cols: int, u0: float, v0: float, du: float, dv: float,
    lens_z: float, stations: F64,
) -> None:  # fmt: skip
    """Write the heights at some stations, all of which lie inside one level of the pyramid."""
    one, below = np.uint64(1), np.uint64(cols)
    for k in range(first, end):
        u, v = u0 + stations[0, k] * du, v0 + stations[0, k] * dv
        col, row = np.int32(u), np.int32(v)
        at = np.uint64(start + row * cols + col)
        fx, fy = np.float32(u - col), np.float32(v - row)
        left, low_left = heights[at], heights[at + below]
        top = left + fx * (heights[at + one] - left)
        low = low_left + fx * (heights[at + below + one] - low_left)
        out[k] = top + fy * (low - top) - lens_z


@inlined
def _heights_along(
    out: F64, first: int, end: int, level: int, heights: F32, ground: F32, levels: I64, lens: F64, dx: float,
    dy: float, stations: F64, outside: int,
) -> None:  # fmt: skip
    """Write the heights above the lens at the stations from `first` to `end`; up to `outside` those of the ground."""
    shrink = 1.0 / (1 << level)
    u0, v0 = (lens[0] + 0.5) * shrink - 0.5, (lens[1] + 0.5) * shrink - 0.5
    du, dv, cols = dx * shrink, dy * shrink, levels[level, 2]
    near, far = stations[0, first], stations[0, end - 1]
    ua, ub, va, vb = u0 + near * du, u0 + far * du, v0 + near * dv, v0 + far * dv
    inside = min(ua, ub) >= 0.0 and min(va, vb) >= 0.0
    if first >= outside and inside and max(ua, ub) < cols - 1.001 and max(va, vb) < levels[level, 1] - 1.001:
        _profile(out, first, end, heights, levels[level, 0], cols, u0, v0, du, dv, lens[2], stations)
        return
    for k in range(first, end):
        x, y = lens[0] + stations[0, k] * dx, lens[1] + stations[0, k] * dy
        if k < outside:
            out[k] = ground_height(ground, levels, x, y) - lens[2]
        else:
            out[k] = _surface_height(heights, ground, levels, level, x, y) - lens[2]


@inlined
def _march_one(
    table: F32, k: int, sines: F64, cosines: F64, heights: F32, ground: F32, levels: I64, lens: F64, ray: F64,
    stations: F64, level_ends: I64,
) -> None:  # fmt: skip
    """Fill one azimuth of the table; see `march`."""
    dx, dy = math.sin(ray[0] + k * ray[1]) * ray[2], -math.cos(ray[0] + k * ray[1]) * ray[2]
    count, bins, highest = stations.shape[1], sines.size, ray[4]
    outside = _look_out(heights, ground, levels, lens, dx, dy, stations)
    profile = stations[2]
    b, done, level = 0, 0, 0
    while done < count and b < bins:
        while done >= level_ends[level]:
            level += 1
        end = min(level_ends[level], done + CHUNK)
        _heights_along(profile, done, end, level, heights, ground, levels, lens, dx, dy, stations, outside)
        if done == 0:
            profile[0] = min(profile[0], -1e-3)
        sine, cosine = sines[b], cosines[b]
        for at in range(max(done, 1), end):
            z = profile[at]
            if z * cosine >= sine * stations[0, at]:
                b = _fill(table, k, b, sines, cosines, stations, at, profile[at - 1], z)
                if b == bins:
                    break
                sine, cosine = sines[b], cosines[b]
        done = end
        if b < bins and sines[b] > 0.0 and highest * cosines[b] < sines[b] * stations[0, done - 1]:
            break
    if b < bins:
        z = ground_height(ground, levels, lens[0] + ray[3] * dx, lens[1] + ray[3] * dy) - lens[2]
        hidden = b == 0 or profile[done - 1] * cosines[b - 1] < sines[b - 1] * stations[0, done - 1]
        _fill_beyond(table, k, b, sines, cosines, z, ray[3], hidden)


@lean
def march(
    table: F32, sines: F64, cosines: F64, heights: F32, ground: F32, levels: I64, lens: F64, ray: F64,
    stations: F64, level_ends: I64,
) -> None:  # fmt: skip
    """Fill the table of inverse distances.

    Parameters
    ----------
    table : float32 array, [azimuths, elevations]
        Gets 1/D in 1/m of the first surface in sight; negative where it begins behind what the elevation below
        shows, 0 where there is sky.
    sines, cosines : float64 array, [elevations]
        Of elevations, rising.
    heights : float32 array
        The levels of the surface's pyramid one after the other, each box-halved from the one before.
    ground : float32 array
        The bare ground, of the first level.
    levels : int64 array, [levels, 3]
        Offset, rows, columns.
    lens : float64 array, [3]
        Its place in pixels and its height.
    ray : float64 array, [5]
        First heading and step in heading (radians), pixels per metre, reach in metres, greatest height of the site
        above the lens.
    stations : float64 array
    level_ends : int64 array
        Of `place_stations`.
    """
    for k in range(table.shape[0]):
        _march_one(table, k, sines, cosines, heights, ground, levels, lens, ray, stations, level_ends)
