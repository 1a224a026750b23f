"""A picture of a drive: the track by speed, the plan that it followed, and what happened on the way."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.stage import Existing
from hrt_cli.logs.kinds import files_of
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.grid import WGS84, Grid
from hrt_cli.raster.track import points_on, track_on
from hrt_cli.report.figures.canvas import begin_drawing, figure_of, map_canvas, read_backdrop, show_legend
from hrt_cli.report.figures.layers import show_ends, show_path, show_picture
from hrt_cli.report.figures.palette import EVENTS, PATH_EDGE, VALUE_RAMP

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    Floats = NDArray[np.float64]

STAGE_VERSION = 1
_FRAME = 0.08
"""Of a track without a backdrop: margin around it, in widths of it."""
_FRAME_PX = 1000
_MOST_PIECES = 20_000


def draw_drive(
    log_path: Path,
    output: Path,
    *,
    plan: Path | None = None,
    backdrop: Path | None = None,
    caption: str,
    existing: Existing,
) -> bool:
    """Draw a drive, on the orthomosaic where one is given.

    Parameters
    ----------
    log_path : Path
        A drive log of any kind.
    output : Path
        The PNG to write.
    plan : Path, optional
        The plan of one robot that was driven.
    backdrop : Path, optional
        The orthomosaic.
    caption : str
        The title.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError
        A file cannot be used, or the log or the plan has no place on the backdrop.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    inputs = files_of("log", log_path) | ({"plan": plan} if plan else {}) | ({"backdrop": backdrop} if backdrop else {})
    parameters = {"caption": caption}
    job = begin_drawing(
        "figure-drive", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    log = read_drive_log(log_path)
    behind = read_backdrop(backdrop) if backdrop else None
    base = behind.grid if behind else _frame(log)
    figure, axes = map_canvas(base, caption, unit="m" if behind is None else None)
    if behind is not None:
        show_picture(axes, behind)
    if plan is not None:
        document = read_plan(plan)
        xy = np.array(document.xy)
        rows, cols = points_on(plan, xy, document.grid.crs, base, "backdrop")
        right, down = _metres(base, rows, cols)
        show_path(axes, right, down, lw=0.9, zorder=4, label="plan")
    rows, cols = track_on(log_path, log, base, "backdrop") if behind is not None else _within(log, base)
    right, down = _metres(base, rows, cols)
    _show_track(axes, log, right, down)
    show_ends(axes, right, down)
    _show_events(axes, log, right, down)
    show_legend(axes)
    job.publish(figure, trimmed=True)
    return False


def _frame(log: DriveLog) -> Grid:
    """Return a grid around a track that no orthomosaic lies below, north up; without a CRS its units are metres."""
    x, y = _plane(log)
    pad = _FRAME * max(np.ptp(x), np.ptp(y)) or (1e-5 if log.geographic else 1.0)
    side = (max(np.ptp(x), np.ptp(y)) + 2 * pad) / _FRAME_PX
    left, top = float(x.min()) - pad, float(y.max()) + pad
    cols, rows = (max(1, int(np.ceil((np.ptp(each) + 2 * pad) / side))) for each in (x, y))
    crs = WGS84 if log.geographic else None if log.crs is None else CRS.from_user_input(log.crs)
    return Grid(rows, cols, Affine(side, 0, left, 0, -side, top), crs)


def _plane(log: DriveLog) -> tuple[Floats, Floats]:
    x = np.unwrap(log.place[:, 0], period=360.0) if log.geographic else log.place[:, 0]
    return x, log.place[:, 1]


def _within(log: DriveLog, base: Grid) -> tuple[Floats, Floats]:
    x, y = _plane(log)
    a, _, c, _, e, f = base.transform[:6]
    return (y - f) / e, (x - c) / a


def _metres(base: Grid, rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
    # Where there is no CRS, the units of the log are taken for metres, as `inspect` does.
    row_m, col_m = (abs(base.transform.e), abs(base.transform.a)) if base.crs is None else base.pixel_m
    return cols * col_m, rows * row_m


def _show_track(axes: Axes, log: DriveLog, right: Floats, down: Floats) -> None:
    """Draw the track, by speed where the log tells it, else by time; nothing joins what a break parts."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    if right.size < 2:
        return
    known = np.isfinite(log.speed_m_s).mean() > 0.5
    values = log.speed_m_s if known else log.time_s - log.time_s[0]
    step = max(1, right.size // _MOST_PIECES)
    breaks = {index // step for index in log.breaks}
    points = np.column_stack([right, down])[::step]
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    joined = np.array([index + 1 not in breaks for index in range(len(pieces))])
    middle = values[::step]
    with np.errstate(invalid="ignore"):
        middle = (middle[:-1] + middle[1:]) / 2
    ramp = LinearSegmentedColormap.from_list("value", list(VALUE_RAMP)).with_extremes(bad="#999999")
    axes.add_collection(
        LineCollection(list(pieces[joined]), colors=PATH_EDGE, linewidths=4.0, capstyle="round", zorder=5)
    )
    shown = LineCollection(list(pieces[joined]), cmap=ramp, linewidths=2.4, capstyle="round", zorder=5.1)
    shown.set_array(np.ma.masked_invalid(middle[joined]))
    top = float(np.nanmax(middle)) if np.isfinite(middle).any() else 0.0
    shown.set_clim(0.0, top or 1.0)
    axes.add_collection(shown)
    figure_of(axes).colorbar(shown, ax=axes, label="speed, m/s" if known else "time, s", shrink=0.6, pad=0.01)


def _show_events(axes: Axes, log: DriveLog, right: Floats, down: Floats) -> None:
    counts = Counter(event for _, event in log.events)
    for event, (name, marker, colour, size) in EVENTS.items():
        at = [index for index, each in log.events if each == event]
        if at:
            label = f"{counts[event]} {name}{'s' if counts[event] > 1 else ''}"
            axes.plot(
                right[at], down[at], marker, ls="none", color=colour, mec=PATH_EDGE, ms=size, mew=1.0, label=label,
                zorder=8,
            )  # fmt: skip
