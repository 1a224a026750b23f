"""A picture of drives: how close the robot came to obstacles, and how much of its view the target covered."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.png import png_provenance, publish_png
from hrt_cli.artifacts.stage import Existing, begin
from hrt_cli.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STAGE_VERSION = 2
_COLOUR, _MEAN_COLOUR = "#0072b2", "#d55e00"
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
    job = begin(
        "figure-drives",
        STAGE_VERSION,
        inputs=inputs,
        parameters={"caption": caption},
        outputs={output: png_provenance},
        existing=existing,
    )
    if job.up_to_date:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    figure.suptitle("\n".join(textwrap.wrap(caption, _CAPTION_CHARS)), x=0.01, ha="left", fontsize=10)
    panels = figure.subplots(1, 2 if view else 1, squeeze=False)[0]
    _histogram(panels[0], clearance_m, weight_s)
    if view:
        _curve(panels[1], np.array(view))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    publish_png(output, buffer.getvalue(), job.provenance)


def _histogram(axes: Axes, clearance_m: NDArray[np.float64], weight_s: NDArray[np.float64]) -> None:
    top = max(float(clearance_m.max()), _BIN_M)
    weight = weight_s / weight_s.sum() if weight_s.sum() > 0 else np.full(clearance_m.size, 1 / clearance_m.size)
    axes.hist(
        clearance_m, bins=np.arange(0.0, top + 1.5 * _BIN_M, _BIN_M).tolist(), weights=100 * weight, color=_COLOUR
    )
    mean = float((clearance_m * weight).sum())
    axes.axvline(mean, color=_MEAN_COLOUR, lw=1.6, label=f"mean {mean:.2f} m")
    axes.set_xlabel("distance to the nearest obstacle, m")
    axes.set_ylabel("share of the time, %")
    axes.legend(frameon=False, fontsize=9)
    _plain(axes)


def _curve(axes: Axes, view: NDArray[np.float64]) -> None:
    gone, share = view[:, 0], 100 * view[:, 1]
    axes.plot(gone, share, color=_COLOUR, lw=0.7, alpha=0.4, label="each frame")
    near = np.abs(gone[:, None] - gone[None, :]) <= _SMOOTHED_M / 2
    axes.plot(gone, near @ share / near.sum(axis=1), color=_COLOUR, lw=2.0, label=f"mean over {_SMOOTHED_M:.0f} m")
    axes.axhline(share.mean(), color=_MEAN_COLOUR, lw=1.6, label=f"mean {share.mean():.0f} %")
    axes.set_xlabel("driven, m")
    axes.set_ylabel("target, % of the picture")
    axes.set_ylim(0, max(5.0, min(105.0, 1.1 * float(share.max()))))
    axes.legend(frameon=False, fontsize=9)
    _plain(axes)


def _plain(axes: Axes) -> None:
    axes.grid(color="#e0e0e0", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
