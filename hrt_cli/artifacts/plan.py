"""The plan artifact (`plan.json`): the walk on the scoremap's grid, as cells, coordinates and waypoints."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.jsonio import Document, parse_strict, read_model, read_text
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.errors import InputError

Cell = tuple[int, int]
Point = tuple[float, float]


class Waypoint(Document):
    """A point where the robot turns, or the start or end.

    `step` counts moves from the start, `cell` is (row, col), `x, y` are in the plan's CRS, `lon, lat` are WGS 84
    degrees (None where the scoremap is not georeferenced).
    """

    index: int = Field(ge=0)
    step: int = Field(ge=0)
    cell: Cell
    x: float
    y: float
    lon: float | None = Field(default=None, ge=-180, le=180)
    lat: float | None = Field(default=None, ge=-90, le=90)


class Budget(Document):
    """The budget as it was given (`value`, `unit`), and what of it the plan could use: cells of travel."""

    value: float = Field(gt=0)
    unit: Literal["steps", "m", "min"]
    cells: float = Field(ge=0)


class Grid(Document):
    """The scoremap's grid: affine `transform` (a, b, c, d, e, f) from (col, row) to CRS coordinates.

    `crs` is an authority code or WKT, None where the scoremap is not georeferenced; `cell_size_m` is on the ground.
    `georeference` says whether the coordinates can be trusted: "fake" is a placeholder that some photogrammetry
    programs write when the photographs carried no GPS.
    """

    rows: int = Field(gt=0)
    cols: int = Field(gt=0)
    transform: tuple[float, float, float, float, float, float]
    crs: str | None
    cell_size_m: float = Field(gt=0)
    georeference: Literal["real", "fake", "none"]


class _Planned(Document):
    """What the plan of one robot and that of a team say alike; the terms are defined in `docs/method.md`."""

    format: str
    version: Literal[1] = 1
    method: str
    seed: int
    objective: Literal["total", "discounted"]
    gamma: float = Field(gt=0, le=1)
    connectivity: Literal[4, 8]
    score: float = Field(ge=0)
    discounted_score: float = Field(ge=0)
    upper_bound: float = Field(ge=0)
    gap: float = Field(ge=0, le=1)
    discounted_upper_bound: float | None = Field(default=None, ge=0)
    discounted_gap: float | None = Field(default=None, ge=0, le=1)
    steps: int = Field(ge=0)
    length_m: float = Field(ge=0)
    time_s: float = Field(ge=0)
    provenance: Provenance | None = None


class PlanDocument(_Planned):
    """A plan.

    `end` is the cell where the walk had to end, None where it was free to choose. `collected` cells pay nothing and
    `blocked` ones may not be entered, for what an earlier drive did there.
    """

    format: Literal["hrt-plan"] = "hrt-plan"
    return_home: bool
    budget: Budget
    grid: Grid
    start: Cell
    end: Cell | None = None
    collected: list[Cell] = Field(default_factory=list)
    blocked: list[Cell] = Field(default_factory=list)
    speed_m_s: float = Field(gt=0)
    waypoints: list[Waypoint] = Field(min_length=1)
    cells: list[Cell] = Field(min_length=1)
    xy: list[Point]
    lonlat: list[Point] | None

    @model_validator(mode="after")
    def _agree(self) -> PlanDocument:
        if len(self.cells) != self.steps + 1 or len(self.xy) != len(self.cells):
            raise ValueError(f"{self.steps} steps need {self.steps + 1} cells and coordinates")
        if self.lonlat is not None and len(self.lonlat) != len(self.cells):
            raise ValueError("lonlat and cells differ in length")
        if self.cells[0] != self.start:
            raise ValueError("the first cell is not the start")
        if self.end is not None and self.cells[-1] != self.end:
            raise ValueError("the last cell is not the end")
        reach = 1 if self.connectivity == 4 else 2
        for (r0, c0), (r1, c1) in zip(self.cells, self.cells[1:], strict=False):
            if max(abs(r1 - r0), abs(c1 - c0)) != 1 or abs(r1 - r0) + abs(c1 - c0) > reach:
                raise ValueError(f"cells ({r0}, {c0}) and ({r1}, {c1}) are not neighbours")
        if any(not (0 <= r < self.grid.rows and 0 <= c < self.grid.cols) for r, c in self.cells):
            raise ValueError("a cell lies outside the grid")
        return self


class TeamMember(Document):
    """One robot of a team: its own plan's file, beside the team's, and what it adds to the team's score."""

    plan: str
    start: Cell
    end: Cell | None
    score: float = Field(ge=0)
    steps: int = Field(ge=0)
    length_m: float = Field(ge=0)
    time_s: float = Field(ge=0)
    waypoints: int = Field(ge=1)


class TeamPlanDocument(_Planned):
    """The plan of a team. Each cell pays once, to the robot that comes first; scores and bounds are of all together.

    `time_s` is that of the robot that drives longest.
    """

    format: Literal["hrt-team-plan"] = "hrt-team-plan"
    robots: list[TeamMember] = Field(min_length=2)


def read_plan(path: Path) -> PlanDocument:
    """Read the plan of one robot.

    Raises
    ------
    InputError
        The file is no plan, is damaged, was edited after it was made, or is the plan of a team.
    """
    team = team_members(path)
    if team:
        raise InputError(path, f"is the plan of a team: take the plans of its robots, {', '.join(map(str, team))}")
    plan = read_model(path, PlanDocument)
    json_provenance(path)
    return plan


def team_members(path: Path) -> list[Path]:
    """Return the files of a team's plans, an empty list where `path` is not the plan of a team."""
    found = parse_strict(path, read_text(path))
    if not isinstance(found, dict) or found.get("format") != "hrt-team-plan":
        return []
    return [path.with_name(member.plan) for member in read_model(path, TeamPlanDocument).robots]


def robot_path(team_path: Path, robot: int) -> Path:
    """Return where what belongs to one robot of a team stands: `plan-1.json` beside `plan.json`."""
    return team_path.with_name(f"{team_path.stem}-{robot + 1}{team_path.suffix}")
