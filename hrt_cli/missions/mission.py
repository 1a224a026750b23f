"""From a plan to a mission: what every mission format needs, checked once, before any format is written.

A mission is what a robot will do unattended, so a plan whose coordinates are unknown, made up or at odds with
its own walk is refused here rather than exported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

from rasterio.crs import CRS
from rasterio.errors import CRSError

from hrt_cli.artifacts.plan import Cell, PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions.fence import NO_FENCE, Fence
from hrt_cli.missions.local import FrameKind, LocalFrame
from hrt_cli.missions.simplify import Bools, passed_by, simplified, visited
from hrt_cli.raster.grid import WGS84, lonlat_length_m, transform_points, wrapped_deg

Vehicle = Literal["rover", "boat", "submarine"]
Firmware = Literal["ardupilot", "px4"]

MIN_SPEED_M_S = 0.01
MAX_SPEED_M_S = 50.0
MAX_ALTITUDE_M = 12_000.0  # deeper than the deepest trench, higher than the highest road
MAX_HOLD_S = 65_535  # ArduPilot keeps the hold in an unsigned 16-bit number of whole seconds
MAX_RADIUS_M = 1_000.0
MAX_ITEM_COUNT = 65_535  # MAVLink numbers mission items with 16 bits
MIN_SPACING_M = 0.1
_ROUNDING = 1e-6
SAME_PLACE_DEG = 1e-7  # 1.1 cm on the equator: the resolution of MAVLink's integer coordinates


class Position(NamedTuple):
    """A place: WGS 84 latitude and longitude in degrees, altitude in metres above home (negative: below).

    With `MissionOptions.above_bottom_m` the altitude is above the bottom instead.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float


class Stop(NamedTuple):
    """A waypoint: its place, and the step and the cell of the plan's walk (None for one set on a long leg)."""

    position: Position
    step: int | None
    cell: Cell | None

    @property
    def place(self) -> str:
        """Where in the plan it is, for people."""
        return "between" if self.cell is None else f"step {self.step}, row {self.cell[0]}, col {self.cell[1]}"


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
    above_bottom_m : float, optional
        Height of every waypoint above the bottom, in place of an altitude; needs a submarine.
    tolerance_m : float
        How far the plan's cells may lie from the straight line between two waypoints, 0 or more.
    spacing_m : float, optional
        Longest way between two waypoints; longer legs get waypoints in between, evenly.
    frame : {"utm", "enu"}
        Local frame of the formats in metres.
    datum : (float, float), optional
        Its origin, WGS 84 longitude and latitude; the south-west corner of the plan's grid where None.

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
    above_bottom_m: float | None = None
    tolerance_m: float = 0.0
    spacing_m: float | None = None
    frame: FrameKind = "utm"
    datum: tuple[float, float] | None = None

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
        if self.above_bottom_m is not None:
            if self.vehicle != "submarine" or self.altitude_m:
                raise ArgumentError("a height above the bottom is for a submarine, in place of an altitude or a depth")
            if not 0 < self.above_bottom_m <= MAX_ALTITUDE_M:
                raise ArgumentError(
                    f"height {self.above_bottom_m:g} m above the bottom is not in 0..{MAX_ALTITUDE_M:g}"
                )
        if not 0 <= self.tolerance_m < math.inf:
            raise ArgumentError(f"tolerance {self.tolerance_m:g} m is no length")
        if self.spacing_m is not None and not MIN_SPACING_M <= self.spacing_m < math.inf:
            raise ArgumentError(f"spacing {self.spacing_m:g} m is below {MIN_SPACING_M:g} m")
        _require_choice("local frame", self.frame, get_args(FrameKind))
        if self.datum is not None:
            LocalFrame(self.frame, *self.datum)
        if not 0 <= self.hold_s <= MAX_HOLD_S or self.hold_s != int(self.hold_s):
            raise ArgumentError(f"hold {self.hold_s:g} s is not a whole number of seconds in 0..{MAX_HOLD_S}")
        if not 0 <= self.waypoint_radius_m <= MAX_RADIUS_M:
            raise ArgumentError(f"waypoint radius {self.waypoint_radius_m:g} m is not in 0..{MAX_RADIUS_M:g} m")
        if self.max_items is not None and not 1 <= self.max_items <= MAX_ITEM_COUNT:
            raise ArgumentError(f"item limit {self.max_items} is not in 1..{MAX_ITEM_COUNT}")


@dataclass(frozen=True)
class Mission:
    """A checked plan with the options applied: the one argument of every format's `to_text`.

    `home` is the plan's start at altitude 0; `stops` are the waypoints, start included; `lonlat` is the whole walk;
    `length_m` is that of the legs between the stops, `time_s` what they take at the mission's speed, with the holds.
    `missed` are the plan's cells that the robot does not enter, for it drives straight past them within the
    tolerance. `fence` has no polygons where no areas were given.
    """

    plan: PlanDocument
    options: MissionOptions
    name: str
    home: Position
    stops: tuple[Stop, ...]
    lonlat: tuple[tuple[float, float], ...]
    speed_m_s: float
    length_m: float
    time_s: float
    missed: tuple[Cell, ...] = ()
    fence: Fence = NO_FENCE

    @property
    def points(self) -> tuple[Position, ...]:
        """The places of the waypoints."""
        return tuple(stop.position for stop in self.stops)

    @cached_property
    def frame(self) -> LocalFrame:
        """The local frame of the formats in metres."""
        if self.options.datum is not None:
            return LocalFrame(self.options.frame, *self.options.datum)
        return LocalFrame(self.options.frame, *_corner(self.plan))

    @cached_property
    def xy(self) -> list[tuple[float, float]]:
        """The waypoints in the local frame, metres."""
        return self.frame.xy(self.waypoints_lonlat)

    @property
    def waypoints_lonlat(self) -> list[tuple[float, float]]:
        """The waypoints as longitude and latitude, degrees."""
        return [(point.lon_deg, point.lat_deg) for point in self.points]

    @cached_property
    def legs_m(self) -> list[float]:
        """The metres of ground from each waypoint to the next."""
        return [float(leg) for leg in lonlat_length_m(*zip(*self.waypoints_lonlat, strict=True))]

    @property
    def description(self) -> str:
        """One line of figures for people, for the formats that have room for one."""
        plan = self.plan
        figures = [
            f"{self.length_m:.1f} m in {plan.steps} steps",
            f"{len(self.stops)} waypoints",
            f"{self.speed_m_s:g} m/s",
            f"{self.time_s:.0f} s",
            f"score of the plan {plan.score:.6g} of at most {plan.upper_bound:.6g}",
            f"method {printable(plan.method)}",
        ]
        if self.options.tolerance_m:
            figures.insert(2, f"simplified to {self.options.tolerance_m:g} m")
        if self.options.above_bottom_m is not None:
            figures.insert(2, f"{self.options.above_bottom_m:g} m above the bottom")
        elif self.options.altitude_m:
            figures.insert(2, f"altitude {self.options.altitude_m:g} m above home")
        return ", ".join(figures)


def mission_of(plan: PlanDocument, options: MissionOptions, go: Bools | None = None) -> Mission:
    """Build the mission that drives a plan.

    Parameters
    ----------
    plan : PlanDocument
        A plan on a georeferenced scoremap.
    options : MissionOptions
        Vehicle, speed, altitude, tolerance and limits.
    go : bool [rows, cols], optional
        Which cells of the plan's grid may be entered, those of its walk among them. None: only those of its walk are
        known to be, and no straight line leads through others.

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
    steps = [waypoint.step for waypoint in plan.waypoints]
    if options.tolerance_m:
        shape = plan.grid.rows, plan.grid.cols
        tolerance = options.tolerance_m / plan.grid.cell_size_m
        steps = simplified(plan.cells, steps, tolerance, visited(plan.cells, shape) if go is None else go)
    length_m = _length_m(plan, steps) if options.tolerance_m else plan.length_m
    stops = _stops(plan, lonlat, steps, options)
    time_s = length_m / speed_m_s + options.hold_s * len(stops)
    if not math.isfinite(time_s):
        raise ArgumentError(f"plan's length of {plan.length_m:g} m is not one that a mission can take")
    return Mission(
        plan=plan,
        options=options,
        name=printable(options.name),
        home=stops[0].position._replace(alt_m=0.0),
        stops=stops,
        lonlat=lonlat,
        speed_m_s=speed_m_s,
        length_m=length_m,
        time_s=time_s,
        missed=tuple(passed_by(plan.cells, steps)),
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


def _corner(plan: PlanDocument) -> tuple[float, float]:
    """Return longitude and latitude of the corner of the plan's grid that lies farthest to the south and west."""
    a, b, c, d, e, f = plan.grid.transform
    corners = [(row, col) for row in (0, plan.grid.rows) for col in (0, plan.grid.cols)]
    xs, ys = zip(*((a * col + b * row + c, d * col + e * row + f) for row, col in corners), strict=True)
    try:
        lons, lats = transform_points(CRS.from_user_input(plan.grid.crs), WGS84, xs, ys)
    except (CRSError, ValueError) as error:
        raise ArgumentError(f"plan's grid has no place on the Earth: {error}") from error
    lon, lat = min(zip(lons, lats, strict=True), key=lambda corner: corner[0] + corner[1])
    return round(float(lon), 9), round(float(lat), 9)


def _stops(
    plan: PlanDocument, lonlat: tuple[tuple[float, float], ...], steps: list[int], options: MissionOptions
) -> tuple[Stop, ...]:
    """Return the waypoints at the steps, and on legs longer than the spacing those in between."""
    alt_m = options.altitude_m if options.above_bottom_m is None else options.above_bottom_m

    def at(lon: float, lat: float) -> Position:
        return Position(lat, lon, alt_m)

    stops = [Stop(at(*lonlat[steps[0]]), steps[0], plan.cells[steps[0]])]
    for before, step in pairwise(steps):
        parts = 1
        if options.spacing_m is not None:
            # The last bits of a length that is a whole number of spacings do not make one more.
            parts = max(1, math.ceil(_leg_m(plan, before, step) / options.spacing_m - _ROUNDING))
        (lon0, lat0), (lon1, lat1) = lonlat[before], lonlat[step]
        across = float(wrapped_deg(lon1 - lon0))
        for part in range(1, parts):
            share = part / parts
            lon = float(wrapped_deg(lon0 + share * across))
            stops.append(Stop(at(lon, lat0 + share * (lat1 - lat0)), None, None))
        stops.append(Stop(at(lon1, lat1), step, plan.cells[step]))
    return tuple(stops)


def _length_m(plan: PlanDocument, steps: list[int]) -> float:
    return math.fsum(_leg_m(plan, before, step) for before, step in pairwise(steps))


def _leg_m(plan: PlanDocument, before: int, step: int) -> float:
    """Return the metres of ground straight from one step's cell to another's."""
    (r0, c0), (r1, c1) = plan.cells[before], plan.cells[step]
    return math.hypot(r1 - r0, c1 - c0) * plan.grid.cell_size_m


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
