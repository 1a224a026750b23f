"""The learning curves of a steering network: loss and error by epoch, in training and on what is held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.publish import check_target
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import OutputError
from hrt_cli.report.figures.canvas import begin_drawing, plain
from hrt_cli.report.figures.palette import CONSTANT, TRAINING, VALIDATION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_VERSION = 1
_NEEDED = ("epoch", "train_loss", "train_mae", "validation_loss", "mae")


def check_training_target(output: Path, inputs: list[Path]) -> None:
    """Refuse a name for the learning curves: before the training, which may take hours.

    Raises
    ------
    OutputError
        The name does not end in `.png`; see also `hrt_cli.artifacts.publish.check_target`.
    """
    if output.suffix.lower() != ".png":
        raise OutputError(f"{output}: the learning curves are a figure; choose a name that ends in .png")
    if any(output.resolve() == path.resolve() for path in inputs):
        raise OutputError(f"{output}: the figure would overwrite another file of this run; choose another name")
    check_target(output, inputs)


def draw_training(
    model: Path,
    output: Path,
    history: Sequence[Mapping[str, Any]],
    *,
    baseline: float,
    best_epoch: int,
    caption: str,
    existing: Existing,
) -> bool:
    """Write the learning curves of a steering network as a PNG.

    Parameters
    ----------
    model : Path
        What `hrt train-steer` wrote, for the figure's provenance.
    output : Path
        The file to write.
    history : sequence of mapping
        For each epoch `epoch`, `train_loss`, `train_mae`, `validation_loss` and `mae` (of validation).
    baseline : float
        Mean absolute error on the validation frames of the best constant steering.
    best_epoch : int
        Whose weights the model holds, from 1.
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
    OutputError
        See `check_training_target` and `hrt_cli.artifacts.stage.begin`.
    """
    check_training_target(output, [model])
    inputs, parameters = {"model": model}, {"caption": caption}
    job = begin_drawing(
        "figure-training", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    columns = {name: np.array([each[name] for each in history], np.float64) for name in _NEEDED}
    job.publish(training_figure(columns, baseline, best_epoch, caption))
    return False


def training_figure(
    columns: Mapping[str, NDArray[np.float64]], baseline: float, best_epoch: int, caption: str
) -> Figure:
    """Return the figure: loss above, mean absolute error below; see `draw_training`."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    epochs = columns["epoch"]
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    loss, error = figure.subplots(2, 1, sharex=True)
    loss.set_title(caption, loc="left", fontsize=11)
    best = int(best_epoch) - 1
    marker = "o" if epochs.size < 3 else None
    lines = (
        (loss, "train_loss", TRAINING, 1.8, "training, augmented"),
        (loss, "validation_loss", VALIDATION, 2.0, "validation"),
        (error, "train_mae", TRAINING, 1.8, "training, augmented"),
        (error, "mae", VALIDATION, 2.0, "validation"),
    )
    for axes, name, colour, width, label in lines:
        axes.plot(epochs, columns[name], color=colour, lw=width, marker=marker, label=label)
    for axes, name in ((loss, "validation_loss"), (error, "mae")):
        axes.axvline(best_epoch, color="#444444", lw=0.8, ls=(0, (4, 4)), zorder=0)
        kept = f"epoch {best_epoch}, kept: {columns[name][best]:.3f}"
        axes.plot(best_epoch, columns[name][best], "o", ms=7, color=VALIDATION, mec="white", label=kept)
        plain(axes)
    error.axhline(baseline, color=CONSTANT, lw=1.5, ls=(0, (6, 3)), label=f"best constant angle: {baseline:.3f}")
    error.set_ylim(0, max(baseline, *columns["mae"], *columns["train_mae"]) * 1.1 or 1.0)
    loss.set_ylabel("loss (nats)")
    error.set_ylabel("mean absolute error of steering")
    error.set_xlabel("epoch")
    error.set_xlim(min(1.0, float(epochs[0])) - 0.02 * epochs.size, float(epochs[-1]) + max(0.3, 0.02 * epochs.size))
    error.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    for axes in (loss, error):
        axes.legend(loc="upper right", fontsize=9, facecolor="white", edgecolor="none", framealpha=0.9)
    return figure
