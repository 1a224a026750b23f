"""A picture of drives: how close the robot came to obstacles, and how much of its view the target covered."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import ArgumentError
from hrt_cli.report.figures.canvas import begin_drawing, plain, show_caption
from hrt_cli.report.figures.palette import ACCENT, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STAGE_VERSION = 2
_BIN_M = 0.1
_CAPTION_CHARS = 130
_SMOOTHED_M = 20.0


def draw_drives(
    inputs: dict[str, Path],
    output: Path,
    clearance_m: NDArray[np.float64],
    weight_s: NDArray[np.float64],
    view: Sequence[tuple[float, float]],
    *,
    caption: str,
    existing: Existing,
) -> None:
    """Draw the clearance histogram and the target-in-view curve as a PNG.

    Parameters
    ----------
    inputs : dict of str to Path
        The files that the figures come from by role: logs, and those of the world.
    output : Path
    clearance_m, weight_s : float64 [n]
        Clearances, and the time that each stands for.
    view : sequence of (float, float)
        Metres driven, and the share of the picture that the target covers.
    caption : str
    existing : Existing

    Raises
    ------
    ArgumentError
        There is neither: no world was given.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    if not clearance_m.size:
        raise ArgumentError(f"{output}: there is nothing to draw without a --world")
    parameters = {"caption": caption}
    job = begin_drawing(
        "figure-drives", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    show_caption(figure, caption, _CAPTION_CHARS, size=10)
    panels = figure.subplots(1, 2 if view else 1, squeeze=False)[0]
    _histogram(panels[0], clearance_m, weight_s)
    if view:
        _curve(panels[1], np.array(view))
    job.publish(figure)


def _histogram(axes: Axes, clearance_m: NDArray[np.float64], weight_s: NDArray[np.float64]) -> None:
    top = max(float(clearance_m.max()), _BIN_M)
    weight = weight_s / weight_s.sum() if weight_s.sum() > 0 else np.full(clearance_m.size, 1 / clearance_m.size)
    axes.hist(clearance_m, bins=np.arange(0.0, top + 1.5 * _BIN_M, _BIN_M).tolist(), weights=100 * weight, color=SERIES)
    mean = float((clearance_m * weight).sum())
    axes.axvline(mean, color=ACCENT, lw=1.6, label=f"mean {mean:.2f} m")
    axes.set_xlabel("distance to the nearest obstacle, m")
    axes.set_ylabel("share of the time, %")
    axes.legend(frameon=False, fontsize=9)
    plain(axes)


def _curve(axes: Axes, view: NDArray[np.float64]) -> None:
    gone, share = view[:, 0], 100 * view[:, 1]
    axes.plot(gone, share, color=SERIES, lw=0.7, alpha=0.4, label="each frame")
    near = np.abs(gone[:, None] - gone[None, :]) <= _SMOOTHED_M / 2
    axes.plot(gone, near @ share / near.sum(axis=1), color=SERIES, lw=2.0, label=f"mean over {_SMOOTHED_M:.0f} m")
    axes.axhline(share.mean(), color=ACCENT, lw=1.6, label=f"mean {share.mean():.0f} %")
    axes.set_xlabel("driven, m")
    axes.set_ylabel("target, % of the picture")
    axes.set_ylim(0, max(5.0, min(105.0, 1.1 * float(share.max()))))
    axes.legend(frameon=False, fontsize=9)
    plain(axes)
