"""The scoremap as Nav2's maps: a picture of the score, and the masks of the keepout and the speed filter.

Every map is a PGM beside a YAML file of mode `raw`, in which map_server takes a pixel of 0..100 as it is and any other
as unknown (nav2_map_server, map_io.cpp; the image's top row lies at the largest y, `origin` is the corner of its lower
left pixel). Cells are square and axes those of the local frame: a scoremap that has them is written as it is, any other
is resampled by its nearest cell, in half its cell size: then, however the grids lie to each other, the pixel at the
middle of each cell has its centre in that cell, so that no waypoint is kept out.

- `scoremap`: 100 is the best score, unknown is no-go. A picture, not a costmap, in which 100 would be an obstacle.
- `keepout_mask`: 100 (lethal) is no-go or off the map; what is open weighs from 0 (best) to 99, as Nav2's weighted
  areas do. The filter does nothing beyond its mask, so that a ring of cells about the map is lethal too.
- `speed_mask`: what is taken off the top speed, in percent, as the masks of Nav2's own tutorial have it (base 100,
  multiplier -1). 0 is no limit; so would a limit of 0 be, so that 90 is the most that is taken off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from hrt_cli.artifacts.plan import Cell
from hrt_cli.missions.local import LocalFrame
from hrt_cli.missions.mission import fixed
from hrt_cli.raster.gather import places
from hrt_cli.raster.grid import Grid, transform_points
from hrt_cli.raster.scoremap import Scoremap

Bytes = NDArray[np.uint8]

_UNKNOWN = 255
_LETHAL = 100
_HEAVIEST = 99
_SLOWEST = 10
_DRIFT_CELLS = 0.1
"""How far a grid may leave the frame's axes or squares from end to end, for its cells to be taken as they are."""
_METRE_DECIMALS = 6
_EDGE_POINTS = 33
_STRIP_PX = 2**22
_PIXELS_A_CELL = 2


def graded(scoremap: Scoremap) -> bool:
    """Say whether the scores tell how drivable cells are, and nothing else: only then do masks grade by them."""
    return scoremap.drivability


def map_files(scoremap: Scoremap, frame: LocalFrame, blocked: Sequence[Cell] = ()) -> dict[str, bytes]:
    """Return the maps' files by name.

    Parameters
    ----------
    scoremap : Scoremap
        With a CRS.
    frame : LocalFrame
        Whose axes and origin the maps have.
    blocked : sequence of (row, col)
        Cells that may not be entered though the scoremap says so: lethal too.
    """
    unit = max(1.0, float(np.nanmax(scoremap.score)))
    percent = np.full(scoremap.score.shape, _UNKNOWN, np.uint8)
    go = np.isfinite(scoremap.score)
    percent[go] = np.rint(100.0 * scoremap.score[go] / unit)
    if blocked:
        percent[tuple(np.array(blocked).T)] = _UNKNOWN
    percent, grid = _in_frame(percent, scoremap, frame)
    go = percent != _UNKNOWN
    notes = [f"The score of the cells, a picture: 100 is a score of {unit:g}, unknown is no-go. Not a costmap."]
    files = _map_files("scoremap", percent, grid, notes)
    grade = graded(scoremap)
    weight = np.minimum(_LETHAL - percent, _HEAVIEST) if grade else np.zeros_like(percent)
    keepout = np.pad(np.where(go, weight, np.uint8(_LETHAL)), 1, constant_values=_LETHAL)
    files |= _map_files("keepout_mask", keepout, _ringed(grid), _keepout_notes(grade))
    if grade:
        slower = 100 - np.where(go, np.maximum(percent, _SLOWEST), np.uint8(_SLOWEST))
        notes = [
            f"For the speed filter: percent taken off the top speed, {100 - _SLOWEST} at most (where none may go).",
            "As in Nav2's own tutorial: base 100, multiplier -1 (filter_info.yaml).",
        ]
        files |= _map_files("speed_mask", slower, grid, notes)
    return files | {"filter_info.yaml": _filter_info(grade).encode("ascii")}


def _keepout_notes(grade: bool) -> list[str]:
    weights = "what is open weighs the more (1 to 99) the less drivable it is" if grade else "what is open weighs 0"
    notes = [f"For the keepout filter: 100 is no-go, off the map, and a ring about it; {weights}."]
    if not grade:
        notes.append(
            "The scores hold interest or exploration, not drivability alone: so no weights, and no speed mask."
        )
    return notes


def _in_frame(percent: Bytes, scoremap: Scoremap, frame: LocalFrame) -> tuple[Bytes, Grid]:
    """Return cells on a north-up grid of square pixels in the local frame (coordinates less its origin)."""
    grid = scoremap.grid
    a, b, c, d, e, f = grid.transform[:6]
    east_m, north_m = frame.origin
    drift = max(abs(b) * grid.rows, abs(d) * grid.cols, abs(a + e) * grid.rows)
    if grid.crs == frame.crs and a > 0 > e and drift <= _DRIFT_CELLS * a:
        return percent, Grid(grid.rows, grid.cols, Affine(a, 0.0, c - east_m, 0.0, -a, f - north_m), None)
    target = _covering(grid, frame, scoremap.cell_size_m / _PIXELS_A_CELL)
    out = np.full(target.shape, _UNKNOWN, np.uint8)
    strip = max(1, _STRIP_PX // target.cols)
    along = np.arange(target.cols, dtype=np.float64) + 0.5
    for top in range(0, target.rows, strip):
        part = out[top : top + strip]
        down = np.arange(top, top + len(part), dtype=np.float64) + 0.5
        at = places(target, grid, down, along)
        rows, cols = (np.floor(where).astype(np.int64) for where in at)
        on_map = (rows >= 0) & (rows < grid.rows) & (cols >= 0) & (cols < grid.cols)
        part[on_map] = percent[rows[on_map], cols[on_map]]
    pixel_m, west, north = target.transform.a, target.transform.c, target.transform.f
    return out, Grid(
        target.rows, target.cols, Affine(pixel_m, 0.0, west - east_m, 0.0, -pixel_m, north - north_m), None
    )


def _covering(grid: Grid, frame: LocalFrame, cell_m: float) -> Grid:
    """Return the north-up grid in the frame's CRS that covers another; its cells lie on multiples from the origin."""
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    rows = np.concatenate([along, along, 0 * along, 0 * along + 1]) * grid.rows
    cols = np.concatenate([0 * along, 0 * along + 1, along, along]) * grid.cols
    x, y = grid.xy(rows, cols)
    if grid.crs is not None and grid.crs != frame.crs:
        x, y = transform_points(grid.crs, frame.crs, x, y)
    x, y = (x - frame.origin[0]) / cell_m, (y - frame.origin[1]) / cell_m
    left, right = math.floor(x.min()), math.ceil(x.max())
    bottom, top = math.floor(y.min()), math.ceil(y.max())
    west, north = frame.origin[0] + left * cell_m, frame.origin[1] + top * cell_m
    return Grid(top - bottom, right - left, Affine(cell_m, 0.0, west, 0.0, -cell_m, north), frame.crs)


def _ringed(grid: Grid) -> Grid:
    """Return a grid with one cell more on each side."""
    return Grid(grid.rows + 2, grid.cols + 2, grid.transform @ Affine.translation(-1, -1), grid.crs)


def _map_files(name: str, values: Bytes, grid: Grid, notes: list[str]) -> dict[str, bytes]:
    cell_m, west, top = grid.transform.a, grid.transform.c, grid.transform.f
    corner = ", ".join(fixed(value, _METRE_DECIMALS) for value in (west, top - grid.rows * cell_m, 0.0))
    comments = "".join(f"# {note}\n" for note in notes)
    text = f"""{comments}image: {name}.pgm
mode: raw
resolution: {cell_m:.9f}
origin: [{corner}]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
    pgm = f"P5\n{grid.cols} {grid.rows}\n255\n".encode("ascii") + np.ascontiguousarray(values).tobytes()
    return {f"{name}.yaml": text.encode("ascii"), f"{name}.pgm": pgm}


def _filter_info(grade: bool) -> str:
    filters = [
        ("keepout", 0, "KeepoutFilter", 0.0, 1.0),
        *([("speed", 1, "SpeedFilter", 100.0, -1.0)] if grade else []),
    ]
    names = ", ".join(f'"{name}_filter"' for name, *_ in filters)
    lines = [
        "# Parameters of the servers that hand the masks to the costmap filters; give yaml_filename with its folder.",
        "# A costmap takes them up by",
        f"#   filters: [{names}]",
    ]
    for name, _, plugin, _, _ in filters:
        lines += [
            f"#   {name}_filter:",
            f'#     plugin: "nav2_costmap_2d::{plugin}"',
            f'#     filter_info_topic: "{name}_costmap_filter_info"',
        ]
    for name, kind, _, base, multiplier in filters:
        lines += [
            f"{name}_filter_mask_server:",
            "  ros__parameters:",
            "    frame_id: map",
            f"    topic_name: {name}_filter_mask",
            f"    yaml_filename: {name}_mask.yaml",
            f"{name}_costmap_filter_info_server:",
            "  ros__parameters:",
            f"    type: {kind}",
            f"    filter_info_topic: {name}_costmap_filter_info",
            f"    mask_topic: {name}_filter_mask",
            f"    base: {base}",
            f"    multiplier: {multiplier}",
        ]
    return "\n".join(lines) + "\n"
