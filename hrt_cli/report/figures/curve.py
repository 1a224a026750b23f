"""The learning curve of a training: how good its rollouts were at each iteration, as a picture or as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.carriers import json_provenance, publish_json, read_stamped_npz
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.publish import check_target
from hrt_cli.artifacts.stage import Existing, begin
from hrt_cli.errors import InputError, OutputError
from hrt_cli.report.figures.canvas import Drawing, plain
from hrt_cli.report.figures.palette import LEARNT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_VERSION = 1
_SMOOTHED = 20
"""A smoothed value is the mean over a twentieth of the iterations, and over three at least."""
_UNITS = ((1e9, "billion"), (1e6, "million"), (1e3, "thousand"), (1.0, ""))
_READERS = {".png": png_provenance, ".json": json_provenance}


def check_curve_target(output: Path, inputs: list[Path]) -> None:
    """Refuse a name for a learning curve: before the training, which may take hours.

    Raises
    ------
    OutputError
        The name ends neither in `.png` nor in `.json`; see also `hrt_cli.artifacts.publish.check_target`.
    """
    if output.suffix.lower() not in _READERS:
        raise OutputError(f"{output}: a learning curve is a .png (a figure) or a .json (its numbers)")
    check_target(output, inputs)


def draw_curve(policy_path: Path, output: Path, *, steps: int, last: int, caption: str, existing: Existing) -> bool:
    """Write the learning curve in a trained policy as a PNG or, where the name ends in `.json`, as JSON.

    Parameters
    ----------
    policy_path : Path
        What `hrt train-plan` wrote; its array `learning_curve`, float64 [iterations], is the mean share of the best
        cells of the map that a rollout collected.
    output : Path
        The file to write.
    steps : int
        Rollout steps of the whole training, for the second axis.
    last : int
        Iterations at the end whose mean is what the training reached.
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
        The policy cannot be read, or has no learning curve.
    OutputError
        See `check_curve_target` and `hrt_cli.artifacts.stage.begin`.
    """
    check_curve_target(output, [policy_path])
    as_json = output.suffix.lower() == ".json"
    parameters = {"steps": steps, "last": last} | ({} if as_json else {"caption": caption})
    job = begin(
        "curve-json" if as_json else "figure-curve",
        STAGE_VERSION,
        inputs={"policy": policy_path},
        parameters=parameters,
        outputs={output: _READERS[output.suffix.lower()]},
        existing=existing,
    )
    if job.up_to_date:
        return True
    arrays, _ = read_stamped_npz(policy_path)
    curve = arrays.get("learning_curve", np.zeros(0))
    if curve.ndim != 1 or curve.size == 0 or curve.dtype != np.float64 or not np.isfinite(curve).all():
        raise InputError(policy_path, "has no learning curve")
    if as_json:
        numbers = {"iterations": curve.size, "steps": steps, "final_share": float(curve[-last:].mean())}
        publish_json(output, {**numbers, "learning_curve": curve.tolist()}, job.provenance)
    else:
        Drawing(output, job.provenance, up_to_date=False).publish(_figure(curve, steps, last, caption))
    return False


def smoothed(curve: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Return the means over windows of 2 `half` + 1 values, float64 [n].

    At the end the mean is over what there is of the window; at the start, where a training rises fast, over as much
    of it on either side.
    """
    totals = np.append(0.0, curve.cumsum())
    at = np.arange(curve.size)
    reach = np.minimum(at, half)
    first, last = at - reach, np.minimum(at + reach + 1, curve.size)
    return np.asarray((totals[last] - totals[first]) / (last - first))


def _figure(curve: NDArray[np.float64], steps: int, last: int, caption: str) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, PercentFormatter

    n = curve.size
    at = np.arange(1, n + 1)
    final = float(curve[-last:].mean())
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(caption, loc="left", fontsize=11)
    axes.plot(at, curve, color=LEARNT, lw=0.8, alpha=0.3, marker="o" if n < 3 else None, label="each iteration")
    half = max(1, n // (2 * _SMOOTHED))
    if n >= 3:
        axes.plot(at, smoothed(curve, half), color=LEARNT, lw=2.0, label=f"mean of {2 * half + 1} iterations")
    reached = f"{final:.1%} at the end" + (f" (mean of the last {last})" if last > 1 else "")
    axes.axhline(final, color="#444444", lw=0.8, ls=(0, (4, 4)), label=reached, zorder=0)
    axes.set_xlim(0, n * 1.02)
    axes.set_ylim(0, max(0.05, float(curve.max()) * 1.08))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes.set_xlabel("iteration")
    axes.set_ylabel("share of the best cells that a rollout collects")
    plain(axes)
    unit, word = next((unit, word) for unit, word in _UNITS if steps >= unit or unit == 1.0)
    scale = steps / n / unit
    # matplotlib passes arrays, whatever its stubs allow.
    there: Any = (lambda x: x * scale, lambda x: x / scale)
    above = axes.secondary_xaxis("top", functions=there)
    above.set_zorder(3)
    above.set_xlabel(f"{word} rollout steps".strip(), fontsize=9)
    above.tick_params(labelsize=9)
    axes.legend(loc="lower right", fontsize=9, frameon=False)
    return figure
