"""From a plan to a mission: what every mission format needs, checked once, before any format is written.

A mission is what a robot will do unattended, so a plan whose coordinates are unknown, made up or at odds with
its own walk is refused here rather than exported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError

Vehicle = Literal["rover", "boat", "submarine"]
Firmware = Literal["ardupilot", "px4"]

MIN_SPEED_M_S = 0.01
MAX_SPEED_M_S = 50.0
MAX_ALTITUDE_M = 12_000.0  # deeper than the deepest trench, higher than the highest road
MAX_HOLD_S = 65_535  # ArduPilot keeps the hold in an unsigned 16-bit number of whole seconds
MAX_RADIUS_M = 1_000.0
MAX_ITEM_COUNT = 65_535  # MAVLink numbers mission items with 16 bits
SAME_PLACE_DEG = 1e-7  # 1.1 cm on the equator: the resolution of MAVLink's integer coordinates


class Position(NamedTuple):
    """A place: WGS 84 latitude and longitude in degrees, altitude in metres above home (negative: below)."""

    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass(frozen=True)
class MissionOptions:
    """What a mission needs beyond the plan.

    Attributes
    ----------
    name : str
        Title in the formats that have one.
    vehicle : {"rover", "boat", "submarine"}
        What drives the mission.
    firmware : {"ardupilot", "px4"}
        The autopilot that will run it.
    speed_m_s : float, optional
        Ground speed in 0.01..50; the plan's where None.
    altitude_m : float
        Altitude of every waypoint above home; negative is depth and needs a submarine, which has no other.
    hold_s : int
        Whole seconds to stay at each waypoint, 0..65535.
    waypoint_radius_m : float
        Distance at which a waypoint counts as reached, 0..1000; 0 leaves it to the autopilot's own setting
        (ArduPilot always uses its own, WP_RADIUS).
    max_items : int, optional
        Most mission items the autopilot stores, home included; the firmware's usual limit where None.

    Raises
    ------
    ArgumentError
        A value is out of its range.
    """

    name: str = "hrt plan"
    vehicle: Vehicle = "rover"
    firmware: Firmware = "ardupilot"
    speed_m_s: float | None = None
    altitude_m: float = 0.0
    hold_s: int = 0
    waypoint_radius_m: float = 0.0
    max_items: int | None = None

    def __post_init__(self) -> None:
        _require_choice("vehicle", self.vehicle, get_args(Vehicle))
        _require_choice("firmware", self.firmware, get_args(Firmware))
        if self.speed_m_s is not None:
            _require_speed(self.speed_m_s)
        lowest_m, highest_m = (-MAX_ALTITUDE_M, 0.0) if self.vehicle == "submarine" else (0.0, MAX_ALTITUDE_M)
        if not lowest_m <= self.altitude_m <= highest_m:
            raise ArgumentError(
                f"altitude {self.altitude_m:g} m does not suit a {self.vehicle}, which takes {lowest_m:g} to"
                f" {highest_m:g} m above home (negative is depth, for a submarine)"
            )
        if not 0 <= self.hold_s <= MAX_HOLD_S or self.hold_s != int(self.hold_s):
            raise ArgumentError(f"hold {self.hold_s:g} s is not a whole number of seconds in 0..{MAX_HOLD_S}")
        if not 0 <= self.waypoint_radius_m <= MAX_RADIUS_M:
            raise ArgumentError(f"waypoint radius {self.waypoint_radius_m:g} m is not in 0..{MAX_RADIUS_M:g} m")
        if self.max_items is not None and not 1 <= self.max_items <= MAX_ITEM_COUNT:
            raise ArgumentError(f"item limit {self.max_items} is not in 1..{MAX_ITEM_COUNT}")


@dataclass(frozen=True)
class Mission:
    """A checked plan with the options applied: the one argument of every format's `to_text`.

    `home` is the plan's start at altitude 0; `points` are the plan's waypoints, start included; `lonlat` is
    the whole walk; `time_s` is the plan's time at the mission's speed, with the holds.
    """

    plan: PlanDocument
    options: MissionOptions
    name: str
    home: Position
    points: tuple[Position, ...]
    lonlat: tuple[tuple[float, float], ...]
    speed_m_s: float
    time_s: float

    @property
    def description(self) -> str:
        """One line of figures for people, for the formats that have room for one."""
        plan = self.plan
        figures = [
            f"{plan.length_m:.1f} m in {plan.steps} steps",
            f"{len(self.points)} waypoints",
            f"{self.speed_m_s:g} m/s",
            f"{self.time_s:.0f} s",
            f"score {plan.score:.6g} of at most {plan.upper_bound:.6g}",
            f"method {printable(plan.method)}",
        ]
        if self.options.altitude_m:
            figures.insert(2, f"altitude {self.options.altitude_m:g} m above home")
        return ", ".join(figures)


def mission_of(plan: PlanDocument, options: MissionOptions) -> Mission:
    """Build the mission that drives a plan.

    Parameters
    ----------
    plan : PlanDocument
        A plan on a georeferenced scoremap.
    options : MissionOptions
        Vehicle, speed, altitude and limits.

    Raises
    ------
    ArgumentError
        The plan has no georeference or only a placeholder, its waypoints do not follow its walk, it claims to
        return home and does not, or its speed is not one a vehicle can be given.
    """
    lonlat = _require_georeference(plan)
    _require_waypoints_on_walk(plan, lonlat)
    if plan.return_home and (plan.cells[-1] != plan.start or lonlat[-1] != lonlat[0]):
        raise ArgumentError(
            f"plan says that it returns home, but ends in cell {plan.cells[-1]}, {lonlat[-1]},"
            f" not where it starts: {plan.start}, {lonlat[0]}"
        )
    speed_m_s = plan.speed_m_s if options.speed_m_s is None else options.speed_m_s
    _require_speed(speed_m_s)
    time_s = plan.time_s * plan.speed_m_s / speed_m_s + options.hold_s * len(plan.waypoints)
    if not math.isfinite(time_s):
        raise ArgumentError(f"plan's time of {plan.time_s:g} s is no time a mission can take")
    points = tuple(Position(lat, lon, options.altitude_m) for lon, lat in (lonlat[w.step] for w in plan.waypoints))
    return Mission(
        plan=plan,
        options=options,
        name=printable(options.name),
        home=points[0]._replace(alt_m=0.0),
        points=points,
        lonlat=lonlat,
        speed_m_s=speed_m_s,
        time_s=time_s,
    )


def printable(text: str) -> str:
    """Replace by `?` what is not printable: controls and lone surrogates, which XML 1.0 cannot hold."""
    return "".join(character if character.isprintable() else "?" for character in text)


def fixed(value: float, decimals: int) -> str:
    """Write a number with a fixed count of decimals, never as a negative zero."""
    return f"{rounded(value, decimals):.{decimals}f}"


def rounded(value: float, decimals: int) -> float:
    """Round to a count of decimals, never to a negative zero."""
    return round(value, decimals) + 0.0


def rounded_longitude(lon_deg: float, decimals: int) -> float:
    """Round a longitude into [-180, 180): the meridian 180 is written as -180."""
    value = rounded(lon_deg, decimals)
    return -180.0 if value >= 180.0 else value


def _require_georeference(plan: PlanDocument) -> tuple[tuple[float, float], ...]:
    if plan.grid.georeference == "fake":
        raise ArgumentError(
            "plan has only a placeholder georeference: its photographs carried no GPS, so the coordinates in"
            " the orthomosaic are made up; georeference it with ground control points and plan again"
        )
    if plan.grid.georeference == "none" or plan.grid.crs is None or plan.lonlat is None:
        raise ArgumentError(
            "plan has no georeference: its scoremap carries no CRS, so no cell has a longitude and latitude;"
            " plan on a scoremap made from a georeferenced orthomosaic"
        )
    for lon_deg, lat_deg in plan.lonlat:
        if not (-180 <= lon_deg <= 180 and -90 <= lat_deg <= 90):
            raise ArgumentError(f"plan has coordinates that are no longitude and latitude: {lon_deg}, {lat_deg}")
    return tuple(plan.lonlat)


def _require_waypoints_on_walk(plan: PlanDocument, lonlat: tuple[tuple[float, float], ...]) -> None:
    """Refuse waypoints that the straight lines of an autopilot would not lead along the walk."""
    steps = [waypoint.step for waypoint in plan.waypoints]
    if steps[0] != 0 or steps[-1] != plan.steps or any(b <= a for a, b in pairwise(steps)):
        raise ArgumentError("plan's waypoints do not lead from its first cell to its last")
    for index, waypoint in enumerate(plan.waypoints):
        lon_deg, lat_deg = lonlat[waypoint.step]
        if waypoint.index != index or waypoint.cell != plan.cells[waypoint.step]:
            raise ArgumentError(f"plan's waypoint {index} is not the cell of its step {waypoint.step}")
        if waypoint.lon is None or waypoint.lat is None:
            raise ArgumentError(f"plan has no georeference: its waypoint {index} has no longitude and latitude")
        if abs(waypoint.lon - lon_deg) > SAME_PLACE_DEG or abs(waypoint.lat - lat_deg) > SAME_PLACE_DEG:
            raise ArgumentError(f"plan's waypoint {index} is not where its step {waypoint.step} is")
    for first, last in pairwise(steps):
        legs = pairwise(plan.cells[first : last + 1])
        if len({(r1 - r0, c1 - c0) for (r0, c0), (r1, c1) in legs}) > 1:
            raise ArgumentError(f"plan turns between steps {first} and {last}, where it has no waypoint")


def _require_choice(what: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ArgumentError(f"{what} {value!r} is not one of {', '.join(choices)}")


def _require_speed(speed_m_s: float) -> None:
    if not MIN_SPEED_M_S <= speed_m_s <= MAX_SPEED_M_S:
        raise ArgumentError(f"speed {speed_m_s:g} m/s is not in {MIN_SPEED_M_S:g}..{MAX_SPEED_M_S:g} m/s")
