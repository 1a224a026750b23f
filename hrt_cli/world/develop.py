"""The terrain camera's second compiled pass: pixels look their rays up in the table of `raymarch`, and are coloured."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrt_cli.world.raymarch import F32, I64, inlined, lean

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

UNKNOWN = 255
"""Class of what is sky or outside the map."""
ALIKE = np.float32(0.12)
"""Distances of neighbouring azimuths that differ by less, relatively, are one surface."""
FADE_PX = np.float32(0.25)
"""Beyond the map, colours are averaged over this share of the distance to its rim: edge pixels draw no lines."""

# Rows of the line buffer of `develop`: azimuth and elevation in table steps, the sine of the elevation, the ray's
# direction in map pixels per metre of distance; 1/D of what is seen and of what else, its share, change of 1/D per
# elevation; where a ray ends, the level of the pyramid there, and its place in that; colour and distance of what is
# seen, and of what else.
_AZ, _EL, _SINE, _EX, _EY = 0, 1, 2, 3, 4
_NEAR, _BESIDE, _SHARE, _CHANGE = 5, 6, 7, 8
_X, _Y, _LEVEL, _U, _V = 9, 10, 11, 12, 13
_SEEN, _OTHER = 14, 18
LINE_ROWS = 22

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_QUARTER_TURN, _HALF_TURN, _TURN = np.float32(0.5 * math.pi), np.float32(math.pi), np.float32(2.0 * math.pi)
_SMALL, _FAR, _BRIM = np.float32(1e-12), np.float32(1e8), np.float32(1.001)
_C5, _C6 = np.float32(0.05265332), np.float32(-0.01172120)
_LONGEST = np.float32(6.0)
"""A pixel's footprint is taken for at most so many times as long as wide, lest the far ground blur."""


@inlined
def _arctan(a: np.float32) -> np.float32:
    """Return the arc tangent of a number in [0, 1], within 2e-6 (Hastings' polynomial)."""
    s = a * a
    tail = np.float32(0.19354346) + s * (np.float32(-0.11643287) + s * (_C5 + s * _C6))
    return a * (np.float32(0.99997726) + s * (np.float32(-0.33262347) + s * tail))


@inlined
def _rays(
    line: F32, axes: F32, i: int, height: int, focal: float, turn: F32, scales: F32, table: F32
) -> None:  # fmt: skip
    """Write where the rays of one line of pixels point."""
    width = line.shape[1]
    cy = np.float32((0.5 * height - i - 0.5) / focal)
    r0, a0, u0 = axes[2, 0] + cy * axes[1, 0], axes[2, 1] + cy * axes[1, 1], axes[2, 2] + cy * axes[1, 2]
    r1, a1, u1 = axes[0, 0], axes[0, 1], axes[0, 2]
    sine, cosine, first = turn[0], turn[1], turn[2]
    per_azimuth, per_elevation, per_m, lowest = scales[4], _ONE / scales[1], scales[2], scales[3]
    per_focal, left = np.float32(1.0 / focal), np.float32((0.5 - 0.5 * width) / focal)
    most_az, most_el = np.float32(table.shape[0] - 1.001), np.float32(table.shape[1] - 1.001)
    for j in range(width):
        cx = np.float32(j) * per_focal + left
        right, ahead, up = r0 + cx * r1, a0 + cx * a1, u0 + cx * u1
        square = right * right + ahead * ahead
        flat = np.sqrt(square)
        norm = _ONE / np.sqrt(square + up * up)
        r, a, u = abs(right), abs(ahead), abs(up)
        angle = _arctan(min(r, a) / max(max(r, a), _SMALL))
        angle = _QUARTER_TURN - angle if r > a else angle
        angle = _HALF_TURN - angle if ahead < _ZERO else angle
        angle = (-angle if right < _ZERO else angle) - first
        angle = angle + _TURN if angle < _ZERO else angle
        angle = angle - _TURN if angle >= _TURN else angle
        rise = _arctan(min(u, flat) / max(u, flat))
        rise = _QUARTER_TURN - rise if u > flat else rise
        line[_AZ, j] = min(max(angle * per_azimuth, _ZERO), most_az)
        line[_EL, j] = min(max((-rise if up < _ZERO else rise) * per_elevation - lowest, _ZERO), most_el)
        line[_SINE, j] = up * norm
        line[_EX, j] = (cosine * right + sine * ahead) * norm * per_m
        line[_EY, j] = (sine * right - cosine * ahead) * norm * per_m


@inlined
def _at_elevation(low: np.float32, high: np.float32, share: np.float32) -> tuple[np.float32, np.float32, np.float32]:
    """Return 1/D between two elevations of an azimuth, 1/D of what is behind or before it, and their difference."""
    low, joined, high = abs(low), high > _ZERO, abs(high)
    change = abs(high - low)
    mean = low + share * (high - low)
    near, far = (low, high) if share < _HALF else (high, low)
    return (mean if joined else near), (mean if joined else far), change


@inlined
def _look_up(
    table: F32, azimuth: np.float32, elevation: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return 1/D of a ray, of the surface it all but meets, that one's share of the pixel, and change per elevation.

    Interpolates within a surface; between two takes the nearer in angle.
    """
    k, b = np.uint64(np.int32(azimuth)), np.uint64(np.int32(elevation))
    fa, fe = azimuth - np.float32(k), elevation - np.float32(b)
    k1, b1 = k + np.uint64(1), b + np.uint64(1)
    left_low, left_high, right_low, right_high = table[k, b], table[k, b1], table[k1, b], table[k1, b1]
    if left_high > _ZERO and right_high > _ZERO:
        left_low, right_low = abs(left_low), abs(right_low)
        left = left_low + fe * (left_high - left_low)
        right = right_low + fe * (right_high - right_low)
        if abs(left - right) <= ALIKE * max(left, right):
            change = min(abs(left_high - left_low), abs(right_high - right_low))
            return left + fa * (right - left), _ZERO, _ZERO, change
    left, left_other, left_change = _at_elevation(left_low, left_high, fe)
    right, right_other, right_change = _at_elevation(right_low, right_high, fe)
    if abs(left - right) <= ALIKE * max(left, right):
        value = left + fa * (right - left)
        other, gap = (left_other, left_other - left) if fa < _HALF else (right_other, right_other - right)
        share = min(fe, _ONE - fe) if abs(gap) > ALIKE * value else _ZERO
        return value, other, share, min(left_change, right_change)
    if fa < _HALF:
        return left, right, fa, left_change
    return right, left, _ONE - fa, right_change


@inlined
def _colour(
    line: F32, j: int, to: int, colours: U32, levels: I64, level: np.uint64, u: np.float32, v: np.float32
) -> None:
    """Write the colour (0 to 255) of a place in a level of the pyramid to three rows of the line.

    Two channels are interpolated in one integer, each in 16 bits of it; weights are of 1/256.
    """
    col, row = np.int32(u), np.int32(v)
    below = np.uint64(levels[level, 2])
    at, one = np.uint64(levels[level, 0]) + np.uint64(row) * below + np.uint64(col), np.uint64(1)
    fx, fy = np.int32((u - np.float32(col)) * np.float32(256.0)), np.int32((v - np.float32(row)) * np.float32(256.0))
    low_right = (fx * fy + 128) >> 8
    low_left, top_right = fy - low_right, fx - low_right
    top_left = 256 - fx - low_left
    a, b = np.int64(colours[at]), np.int64(colours[at + one])
    c, d = np.int64(colours[at + below]), np.int64(colours[at + below + one])
    pair, green = 0xFF00FF, 0xFF00
    outer = top_left * (a & pair) + top_right * (b & pair) + low_left * (c & pair) + low_right * (d & pair)
    inner = top_left * (a & green) + top_right * (b & green) + low_left * (c & green) + low_right * (d & green)
    line[to, j] = np.float32(outer & 0xFFFF) * np.float32(1.0 / 256.0)
    line[to + 1, j] = np.float32(inner) * np.float32(1.0 / 65536.0)
    line[to + 2, j] = np.float32(outer >> 16) * np.float32(1.0 / 256.0)


@inlined
def _level(squared_px: np.float32) -> np.int32:
    """Return the level of the pyramid whose pixels are nearest in size to a square of so many map pixels."""
    return ((np.float32(_TWO * squared_px).view(np.int32) >> 23) - 127) >> 1


@inlined
def _find(line: F32, table: F32) -> tuple[bool, bool]:
    """Look the rays of a line up; whether any of them meets a surface, and any two."""
    mixed, nearest = False, _ZERO
    for j in range(line.shape[1]):
        inverse, other, share, change = _look_up(table, line[_AZ, j], line[_EL, j])
        line[_NEAR, j], line[_BESIDE, j], line[_SHARE, j], line[_CHANGE, j] = inverse, other, share, change
        mixed = mixed or share > _ZERO
        nearest = max(nearest, inverse)
    return bool(nearest > _ZERO), mixed


@inlined
def _reach(line: F32, which: int, to: int, levels: I64, lens: F32, scales: F32) -> None:
    """Write where the rays of a line end, their distances, and over how many map pixels to average their colours."""
    last, rows, cols = np.float32(levels.shape[0] - 1), np.float32(levels[0, 1]), np.float32(levels[0, 2])
    x0, y0, pixel_rad, per_m, per_pixel = lens[0], lens[1], scales[0], scales[2], scales[5]
    for j in range(line.shape[1]):
        inverse = line[which, j]
        distance = _ONE / max(inverse, _SMALL)
        x = min(max(x0 + line[_EX, j] * distance, -_FAR), _FAR)
        y = min(max(y0 + line[_EY, j] * distance, -_FAR), _FAR)
        outside = FADE_PX * max(max(max(-x, x - cols), max(-y, y - rows)), _ZERO)
        across = pixel_rad * distance
        along = min(max(line[_CHANGE, j] * distance * distance * per_pixel, across), _LONGEST * across)
        level = np.float32(_level(max(across * along * per_m * per_m, outside * outside)))
        level = min(max(level, _ZERO), last)
        shrink = np.int32((np.int32(127) - np.int32(level)) << 23).view(np.float32)
        line[_LEVEL, j] = level
        line[_U, j] = min(max((x + _HALF) * shrink - _HALF, _ZERO), np.floor(cols * shrink) - _BRIM)
        line[_V, j] = min(max((y + _HALF) * shrink - _HALF, _ZERO), np.floor(rows * shrink) - _BRIM)
        line[_X, j], line[_Y, j] = x, y
        line[to + 3, j] = distance if inverse > _ZERO else _ZERO


@inlined
def _paint(line: F32, to: int, colours: U32, levels: I64, sky: F32, all_of_it: bool) -> None:
    """Write the colours at which the rays of a line end, or only where two surfaces share a pixel."""
    for j in range(line.shape[1]):
        if not all_of_it and line[_SHARE, j] <= _ZERO:
            continue
        if line[to + 3, j] > _ZERO:
            _colour(line, j, to, colours, levels, np.uint64(np.int32(line[_LEVEL, j])), line[_U, j], line[_V, j])
        else:
            s = min(max(line[_SINE, j], _ZERO), _ONE)
            s = s * (_TWO - s)
            for channel in range(3):
                line[to + channel, j] = sky[0, channel] + s * (sky[1, channel] - sky[0, channel])


@inlined
def _name(line: F32, i: int, ids: U8, levels: I64, classes: U8, range_m: F32) -> None:
    """Write the classes and distances at which the rays of a line end."""
    rows, cols, below = np.float32(levels[0, 1]), np.float32(levels[0, 2]), np.uint64(levels[0, 2])
    for j in range(line.shape[1]):
        distance, x, y = line[_SEEN + 3, j], line[_X, j] + _HALF, line[_Y, j] + _HALF
        range_m[i, j] = distance if distance > _ZERO else np.float32(math.inf)
        if distance > _ZERO and x >= _ZERO and y >= _ZERO and x < cols and y < rows:
            classes[i, j] = ids[np.uint64(np.int32(y)) * below + np.uint64(np.int32(x))]
        else:
            classes[i, j] = np.uint8(UNKNOWN)


@inlined
def _only_sky(line: F32, i: int, sky: F32, classes: U8, range_m: F32) -> None:
    """Write a line on which no ray meets a surface."""
    for j in range(line.shape[1]):
        line[_SEEN + 3, j], range_m[i, j], classes[i, j] = _ZERO, np.float32(math.inf), np.uint8(UNKNOWN)
    for channel in range(3):
        low, rise = sky[0, channel], sky[1, channel] - sky[0, channel]
        for j in range(line.shape[1]):
            s = min(max(line[_SINE, j], _ZERO), _ONE)
            line[_SEEN + channel, j] = low + s * (_TWO - s) * rise


@inlined
def _through(depth: np.float32) -> np.float32:
    """Return exp(-depth) for depth >= 0, within 2e-5: a cubic's inverse, six times squared."""
    s = min(depth, np.float32(80.0)) * np.float32(1.0 / 64.0)
    t = _ONE / (_ONE + s * (_ONE + s * (_HALF + s * np.float32(1.0 / 6.0))))
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    t = t * t
    return t * t


@inlined
def _haze(line: F32, at: int, haze: F32, veil: F32) -> None:
    """Put what lies between before the colours in three rows of the line from `at` on; distances in the fourth."""
    for channel in range(3):
        thick, light = haze[channel], veil[channel]
        for j in range(line.shape[1]):
            share = _through(thick * line[at + 3, j])
            line[at + channel, j] = light + share * (line[at + channel, j] - light)


@inlined
def _mix(line: F32) -> None:
    for channel in range(3):
        for j in range(line.shape[1]):
            if line[_SHARE, j] > _ZERO:
                first, second = line[_SEEN + channel, j], line[_OTHER + channel, j]
                line[_SEEN + channel, j] = first + line[_SHARE, j] * (second - first)


@inlined
def _expose(rgb: U8, i: int, line: F32, gain: F32) -> None:
    red, green, blue, most = gain[0], gain[1], gain[2], np.float32(255.0)
    for j in range(line.shape[1]):
        rgb[i, j, 0] = np.uint8(np.int32(min(max(line[_SEEN, j] * red + _HALF, _ZERO), most)))
        rgb[i, j, 1] = np.uint8(np.int32(min(max(line[_SEEN + 1, j] * green + _HALF, _ZERO), most)))
        rgb[i, j, 2] = np.uint8(np.int32(min(max(line[_SEEN + 2, j] * blue + _HALF, _ZERO), most)))


@lean
def _add_noise(line: F32, i: int, seed: np.uint64, gain: F32, noise: float) -> None:
    """Add noise whose standard deviation is in grey levels of the picture, triangular, by a hash (SplitMix64)."""
    width = line.shape[1]
    for j in range(width):
        h = seed + np.uint64(i * width + j + 1) * np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h = h ^ (h >> np.uint64(31))
        for channel in range(3):
            two = h >> np.uint64(20 * channel)
            total = np.int64(two & np.uint64(1023)) + np.int64((two >> np.uint64(10)) & np.uint64(1023)) - 1023
            line[_SEEN + channel, j] += total * (noise / 418.0) / max(gain[channel], np.float32(1e-6))


@lean
def develop(
    rgb: U8, classes: U8, range_m: F32, line: F32, table: F32, axes: F32, turn: F32, focal: float, colours: U32,
    ids: U8, levels: I64, lens: F32, light: F32, scales: F32, seed: np.uint64, noise: float,
) -> None:  # fmt: skip
    """Look every pixel's ray up in the table and colour it.

    Parameters
    ----------
    rgb : uint8 array, [rows, cols, 3]
    classes : uint8 array, [rows, cols]
    range_m : float32 array, [rows, cols]
        The three get the frame.
    line : float32 array, [LINE_ROWS, cols]
        Workspace.
    table : float32 array
        Of `march`.
    axes : float32 array, [3, 3]
        As for `span`.
    turn : float32 array, [3]
        Sine and cosine of the heading, and the table's first azimuth relative to it.
    focal : float
        In pixels.
    colours : uint32 array
        The levels of the colours' pyramid, red in the lowest byte.
    ids : uint8 array
        The classes, of the first level.
    levels : int64 array, [levels, 3]
    lens : float32 array, [3]
    light : float32 array, [5, 3]
        Extinction (1/m), veil, sky at the horizon and at the zenith, gains.
    scales : float32 array, [6]
        Angle of a pixel and of a table elevation (rad), map pixels per metre, the first elevation in such steps,
        azimuths of the table per radian, elevations of the table per pixel.
    seed : uint64
    noise : float
        Standard deviation in grey levels; 0 for none.
    """
    haze, veil, sky, gain = light[0], light[1], light[2:4], light[4]
    height = rgb.shape[0]
    for i in range(height):
        _rays(line, axes, i, height, focal, turn, scales, table)
        seen, mixed = _find(line, table)
        if seen or mixed:
            _reach(line, _NEAR, _SEEN, levels, lens, scales)
            _name(line, i, ids, levels, classes, range_m)
            _paint(line, _SEEN, colours, levels, sky, True)
            _haze(line, _SEEN, haze, veil)
        else:
            _only_sky(line, i, sky, classes, range_m)
        if mixed:
            _reach(line, _BESIDE, _OTHER, levels, lens, scales)
            _paint(line, _OTHER, colours, levels, sky, False)
            _haze(line, _OTHER, haze, veil)
            _mix(line)
        if noise > 0.0:
            _add_noise(line, i, seed, gain, noise)
        _expose(rgb, i, line, gain)
