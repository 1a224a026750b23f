"""What each turn would cost: for every angle that a robot may steer by, the way to its goal from where that leads.

One turn and then the best way on, as in AggreVaTe (Ross and Bagnell 2014, arXiv:1406.5979). It says more than what the
expert does: that left is as good as right, how bad it is to go on, and all that for every angle of every frame.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrt_cli.driving.field import CostMap, kernel
from hrt_cli.driving.local import Pose, careful
from hrt_cli.driving.vehicle import Vehicle

ANGLES = np.linspace(-1.0, 1.0, 15)
"""Of the turns, in units of yaw."""
WORST_S = 99.0
_TURN_M = 1.2
"""How far a robot that went straight would come in the time of a turn."""
_STEP_S = 0.1
_CONTACT_S = 6.0
"""What it costs to drive where the robot may not be, and for each second that is left of the turn then."""
_WAY_ON_M, _BEARINGS = 0.5, 24
"""How far off, and in how many directions, the way on is looked for."""
_TURN_WEIGHT = 0.6
"""Of the time in which the robot turns to its way on; it does so while it drives."""


def turn_costs(costs: CostMap, to_go: NDArray[np.float32], vehicle: Vehicle, cruise_m_s: float, pose: Pose
               ) -> NDArray[np.float64]:  # fmt: skip
    """Return what the way to the goal costs after each turn, float64 [15] in seconds beyond the best of them.

    A turn is kept up for the time in which the robot would drive 1.2 m. At most `WORST_S`.

    Parameters
    ----------
    costs : CostMap
    to_go : float32 [rows, cols]
        `field.ways_to` the goal, filled about the robot.
    vehicle : Vehicle
    cruise_m_s : float
    pose : Pose
        As it is.
    """
    commands = [careful(vehicle, yaw) for yaw in ANGLES.tolist()]
    speeds = np.array([cruise_m_s * command.speed for command in commands])
    rates = ANGLES * vehicle.yaw_rate_rad_s
    found = np.empty(ANGLES.size)
    _turn_costs(
        costs.cost, to_go, costs.cell_m, pose.east_m, pose.south_m, pose.heading_rad, speeds, rates, cruise_m_s,
        vehicle.yaw_rate_rad_s, _TURN_M / cruise_m_s, found,
    )  # fmt: skip
    return np.asarray(np.minimum(found - found.min(), WORST_S))


@kernel
def _turn_costs(
    cost: NDArray[np.float32],
    to_go: NDArray[np.float32],
    cell_m: float,
    east_m: float,
    south_m: float,
    heading_rad: float,
    speeds: NDArray[np.float64],
    rates: NDArray[np.float64],
    cruise_m_s: float,
    turn_rate: float,
    turn_s: float,
    found: NDArray[np.float64],
) -> None:
    far = _between(to_go, cell_m, east_m, south_m, 100.0) / cruise_m_s + _CONTACT_S
    for j in range(speeds.size):
        east, south, heading = east_m, south_m, heading_rad
        spent, time, out = 0.0, 0.0, False
        while time < turn_s - 1e-9:
            heading += rates[j] * _STEP_S
            east += speeds[j] * _STEP_S * math.sin(heading)
            south -= speeds[j] * _STEP_S * math.cos(heading)
            time += _STEP_S
            dear = _cost_at(cost, cell_m, east, south)
            if not np.isfinite(dear):
                if out:  # it leaves where it may be
                    spent = far + (turn_s - time) * _CONTACT_S
                    break
                spent += _CONTACT_S * _STEP_S  # it was never there: it may be on its way there
                continue
            out = True
            # A metre costs as much as `dear` metres of free way; standing costs time.
            spent += _STEP_S * (1.0 + (dear - 1.0) * speeds[j] / cruise_m_s)
        else:
            bearing = _way_on(to_go, cell_m, east, south, far)
            turn = abs((bearing - heading + math.pi) % (2.0 * math.pi) - math.pi)
            spent += _between(to_go, cell_m, east, south, far * cruise_m_s) / cruise_m_s
            spent += _TURN_WEIGHT * turn / turn_rate
        found[j] = spent


@kernel
def _cost_at(cost: NDArray[np.float32], cell_m: float, east_m: float, south_m: float) -> float:
    r, c = math.floor(south_m / cell_m), math.floor(east_m / cell_m)
    if r < 0 or c < 0 or r >= cost.shape[0] or c >= cost.shape[1]:
        return math.inf
    return float(min(cost[r, c], 50.0)) if np.isfinite(cost[r, c]) else math.inf


@kernel
def _between(to_go: NDArray[np.float32], cell_m: float, east_m: float, south_m: float, otherwise: float) -> float:
    """Return what is to go from a place: bilinear between the cells from which it is known."""
    x, y = east_m / cell_m - 0.5, south_m / cell_m - 0.5
    c0, r0 = math.floor(x), math.floor(y)
    total, weight = 0.0, 0.0
    for r in range(r0, r0 + 2):
        for c in range(c0, c0 + 2):
            if 0 <= r < to_go.shape[0] and 0 <= c < to_go.shape[1] and np.isfinite(to_go[r, c]):
                share = (1.0 - abs(x - c)) * (1.0 - abs(y - r)) + 1e-9
                total += share * to_go[r, c]
                weight += share
    return total / weight if weight > 1e-6 else otherwise


@kernel
def _way_on(to_go: NDArray[np.float32], cell_m: float, east_m: float, south_m: float, otherwise: float) -> float:
    """Return the bearing in which least is to go, a little way off: of a parabola through the best three looked at."""
    left = np.empty(_BEARINGS)
    for k in range(_BEARINGS):
        bearing = k * 2.0 * math.pi / _BEARINGS
        east, south = east_m + _WAY_ON_M * math.sin(bearing), south_m - _WAY_ON_M * math.cos(bearing)
        left[k] = _between(to_go, cell_m, east, south, otherwise)
    best = int(left.argmin())
    before, after = left[best - 1] - left[best], left[(best + 1) % _BEARINGS] - left[best]
    aside = 0.5 * (before - after) / (before + after) if before + after > 1e-9 else 0.0
    return (best + aside) * 2.0 * math.pi / _BEARINGS
