"""How a robot moves over a site: compiled steps of a vehicle on the ground and of one in the water.

A state is float64 [6]: east_m, south_m, height_m (of the AUV's middle; of the ground under the UGV), heading_rad,
pitch_rad, speed_m_s over ground.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

State = NDArray[np.float64]
Layer = NDArray[np.float32]

EAST, SOUTH, HEIGHT, HEADING, PITCH, SPEED = range(6)

FREE, CONTACT, RIM = 0, 1, 2
"""What a step met: nothing, an obstacle, the edge of the surveyed area."""

kernel: Any = njit(cache=True, nogil=True)


@kernel
def sample(layer: Layer, pixel_m: float, east_m: float, south_m: float) -> float:
    """Interpolate a layer [rows, cols] between pixel centres; beyond the rim its last values go on."""
    rows, cols = layer.shape
    y = min(max(south_m / pixel_m - 0.5, 0.0), rows - 1.0)
    x = min(max(east_m / pixel_m - 0.5, 0.0), cols - 1.0)
    r, c = min(int(y), max(rows - 2, 0)), min(int(x), max(cols - 2, 0))
    fy, fx = y - r, x - c
    r1, c1 = min(r + 1, rows - 1), min(c + 1, cols - 1)
    top = layer[r, c] + fx * (layer[r, c1] - layer[r, c])
    bottom = layer[r1, c] + fx * (layer[r1, c1] - layer[r1, c])
    return float(top + fy * (bottom - top))


@kernel
def is_seen(seen: NDArray[np.bool_], pixel_m: float, east_m: float, south_m: float) -> bool:
    """Whether a place lies on a pixel that is `seen`."""
    r, c = math.floor(south_m / pixel_m), math.floor(east_m / pixel_m)
    return bool(0 <= r < seen.shape[0] and 0 <= c < seen.shape[1] and seen[r, c])


@kernel
def grip(factor: Layer, pixel_m: float, state: State, radius_m: float) -> float:
    """Mean speed factor under the middle and the four wheels."""
    total = sample(factor, pixel_m, state[0], state[1])
    reach = 0.7 * radius_m
    for k in range(4):
        angle = state[3] + math.pi / 4 + k * math.pi / 2
        total += sample(factor, pixel_m, state[0] + reach * math.sin(angle), state[1] - reach * math.cos(angle))
    return float(total / 5.0)


@kernel
def roll_on(
    state: State,
    speed_m_s: float,
    yaw_rate_rad_s: float,
    slip: float,
    steps: int,
    dt_s: float,
    radius_m: float,
    clearance_m: Layer,
    factor: Layer,
    ground_m: Layer,
    seen: NDArray[np.bool_],
    pixel_m: float,
) -> int:
    """Move a ground vehicle by `steps` of `dt_s`, in place; return the worst that it met.

    It gets on at the commanded speed times the ground's factor times `slip`. What it touches stops it: no step ends
    nearer to an obstacle than its radius, unless it leads away from it.
    """
    met = FREE
    for _ in range(steps):
        state[3] += yaw_rate_rad_s * dt_s
        speed = speed_m_s * min(1.0, max(0.0, grip(factor, pixel_m, state, radius_m) * slip))
        east = state[0] + speed * dt_s * math.sin(state[3])
        south = state[1] - speed * dt_s * math.cos(state[3])
        room = sample(clearance_m, pixel_m, east, south)
        if not is_seen(seen, pixel_m, east, south):
            met, speed = max(met, RIM), 0.0
        elif room < radius_m and room < sample(clearance_m, pixel_m, state[0], state[1]):
            met, speed = max(met, CONTACT), 0.0
        else:
            state[0], state[1] = east, south
        state[5] = speed
    state[2] = sample(ground_m, pixel_m, state[0], state[1])
    return met


@kernel
def swim_on(
    state: State,
    speed_m_s: float,
    yaw_rate_rad_s: float,
    pitch_rate_rad_s: float,
    current_east_m_s: float,
    current_south_m_s: float,
    steps: int,
    dt_s: float,
    radius_m: float,
    pitch_limit_rad: float,
    surface_m: Layer,
    seen: NDArray[np.bool_],
    pixel_m: float,
) -> int:
    """Move an underwater vehicle by `steps` of `dt_s`, in place; return the worst that it met.

    The current carries it along. The bottom stops it as an obstacle does; it stays under the surface, which is at 0.
    """
    met = FREE
    for _ in range(steps):
        state[3] += yaw_rate_rad_s * dt_s
        state[4] = min(pitch_limit_rad, max(-pitch_limit_rad, state[4] + pitch_rate_rad_s * dt_s))
        flat = speed_m_s * math.cos(state[4])
        east = state[0] + (flat * math.sin(state[3]) + current_east_m_s) * dt_s
        south = state[1] + (-flat * math.cos(state[3]) + current_south_m_s) * dt_s
        height = min(state[2] + speed_m_s * math.sin(state[4]) * dt_s, -radius_m)
        before = bottom_clearance(surface_m, pixel_m, state[0], state[1], state[2], 2.0 * radius_m)
        room = bottom_clearance(surface_m, pixel_m, east, south, height, 2.0 * radius_m)
        if not is_seen(seen, pixel_m, east, south):
            met = max(met, RIM)
            state[5] = 0.0
        elif room < radius_m and room < before:
            met = max(met, CONTACT)
            state[5] = 0.0
            state[2] = min(state[2] + 0.3 * dt_s, -radius_m)  # it floats up
        else:
            state[5] = math.sqrt((east - state[0]) ** 2 + (south - state[1]) ** 2 + (height - state[2]) ** 2) / dt_s
            state[0], state[1], state[2] = east, south, height
    return met


@kernel
def bottom_clearance(
    surface_m: Layer, pixel_m: float, east_m: float, south_m: float, height_m: float, reach_m: float
) -> float:
    """Return the distance from a point in the water to the nearest pixel of the bottom, at most `reach_m`; < 0 inside.

    A pixel counts as a post that reaches up to its height.
    """
    under = sample(surface_m, pixel_m, east_m, south_m)
    if height_m <= under:
        return float(height_m - under)
    rows, cols = surface_m.shape
    span = int(reach_m / pixel_m) + 1
    r0, c0 = int(south_m / pixel_m), int(east_m / pixel_m)
    nearest = reach_m * reach_m
    for r in range(max(r0 - span, 0), min(r0 + span + 1, rows)):
        dy = (r + 0.5) * pixel_m - south_m
        for c in range(max(c0 - span, 0), min(c0 + span + 1, cols)):
            dx = (c + 0.5) * pixel_m - east_m
            dz = max(height_m - surface_m[r, c], 0.0)
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
    return math.sqrt(nearest)
