"""A picture of how a class raster agrees with the truth: both maps in the same colours, errors, confusion matrix."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.stage import Existing
from hrt_cli.raster.classes import NODATA, open_classes
from hrt_cli.raster.grid import Grid, require_same_grid
from hrt_cli.raster.style import class_colour, rgb_of
from hrt_cli.report.figures.canvas import begin_drawing, map_axes, show_caption, show_title, size_m, thinned
from hrt_cli.report.figures.palette import MATRIX_RAMP, RIGHT, UNMATCHED, VOID, WRONG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STAGE_VERSION = 2
PANEL_PX = 700
_GREYS = (60, 190)
_PANEL_INCHES = 5.2
_MAX_LABELLED = 16
"""Classes up to which matrix and legend are labelled: more would not be legible."""
_MAX_NAME = 16
_CAPTION_CHARS = 120
_SHOWN_SHARE = 0.005


class Table(Protocol):
    """The contingency table of two labellings and its best matching, as `hrt evaluate segment` reports them."""

    @property
    def matching(self) -> dict[int, int]: ...  # noqa: D102
    @property
    def confusion(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def class_ids(self) -> list[int]: ...  # noqa: D102
    @property
    def truth_ids(self) -> list[int]: ...  # noqa: D102


def draw_agreement(
    classes_path: Path,
    truth_path: Path,
    output: Path,
    table: Table,
    caption: str,
    *,
    unreferenced: bool = False,
    existing: Existing,
) -> bool:
    """Draw the truth, the classes in the colours of the truth they are matched to, where they differ, and how often.

    Parameters
    ----------
    classes_path, truth_path : Path
        Two class rasters on one grid.
    output : Path
        The PNG to write.
    table : Table
        What their comparison found.
    caption : str
        The title.
    unreferenced : bool
        Accept plain images.
    existing : Existing
        What to do where `output` exists.

    Returns
    -------
    bool
        Whether it was up to date.

    Raises
    ------
    InputError, OutputError
        A raster cannot be used; see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = {"classes": classes_path, "truth": truth_path}
    parameters = {"caption": caption, "unreferenced": unreferenced}
    job = begin_drawing(
        "figure-agreement", STAGE_VERSION, inputs=inputs, output=output, existing=existing, parameters=parameters
    )
    if job.up_to_date:
        return True
    with (
        open_classes(classes_path, unreferenced=unreferenced) as classes,
        open_classes(truth_path, unreferenced=unreferenced) as truth,
    ):
        require_same_grid(classes_path, classes.grid, truth_path, truth.grid)
        ids, true_ids = (thinned(each.read, each.grid.shape, PANEL_PX)[0] for each in (classes, truth))
        grid, names = truth.grid, truth.names
    figure = _figure(grid, ids, true_ids, table, names, caption)
    job.publish(figure)
    return False


def _figure(
    grid: Grid, ids: NDArray[np.uint8], true_ids: NDArray[np.uint8], table: Table, names: list[str], caption: str
) -> Figure:
    from matplotlib.figure import Figure

    width, height = size_m(grid)
    inches = float(np.clip(_PANEL_INCHES * height / width, 3.0, 8.0))
    figure = Figure(figsize=(2 * _PANEL_INCHES + 0.6, 2 * inches + 1.4), layout="constrained")
    show_caption(figure, caption, _CAPTION_CHARS)
    (truth_axes, class_axes), (error_axes, matrix_axes) = figure.subplots(2, 2)
    true_colours, colours = _colours(table)
    differing = 1 - _matched_pixels(table) / table.confusion.sum()
    size = f"{width:.3g} x {height:.3g} {'px' if grid.crs is None else 'm'}"
    for axes, picture, title in (
        (truth_axes, true_colours[true_ids], f"truth, {size}"),
        (class_axes, colours[ids], "classes, each in the colour of the truth matched to it"),
        (error_axes, _differences(ids, true_ids, table), f"where they differ: {differing:.1%}"),
    ):
        axes.imshow(picture, extent=(0.0, width, height, 0.0), interpolation="nearest")
        map_axes(axes, grid)
        show_title(axes, title, _PANEL_INCHES, size=10)
    _show_matrix(matrix_axes, table, names)
    _legend(figure, table, names, colours, true_colours)
    return figure


def _colours(table: Table) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the colours [256, 3] of the truth's ids, and those of the classes: their truth's, or a grey of their own.

    Every class that the matching left out gets its own grey, from dark to light.
    """
    truth = np.array([rgb_of(class_colour(k)) for k in range(NODATA)] + [rgb_of(VOID)], np.uint8)
    classes = np.full_like(truth, rgb_of(VOID))
    for k, true_id in table.matching.items():
        classes[k] = truth[true_id]
    rest = _unmatched(table)
    for k, grey in zip(rest, np.linspace(*_GREYS, len(rest)), strict=True):
        classes[k] = round(grey)
    return truth, classes


def _unmatched(table: Table) -> list[int]:
    return [k for k in table.class_ids if k not in table.matching]


def _matched_pixels(table: Table) -> int:
    return sum(
        int(table.confusion[table.class_ids.index(k), table.truth_ids.index(t)]) for k, t in table.matching.items()
    )


def _differences(ids: NDArray[np.uint8], true_ids: NDArray[np.uint8], table: Table) -> NDArray[np.uint8]:
    expected = np.full(NODATA + 1, NODATA, np.uint8)
    for k, true_id in table.matching.items():
        expected[k] = true_id
    picture = np.empty((*ids.shape, 3), np.uint8)
    picture[...] = rgb_of(RIGHT)
    picture[expected[ids] != true_ids] = rgb_of(WRONG)
    picture[np.isin(ids, _unmatched(table))] = rgb_of(UNMATCHED)
    picture[(ids == NODATA) | (true_ids == NODATA)] = rgb_of(VOID)
    return picture


def _show_matrix(axes: Axes, table: Table, names: list[str]) -> None:
    """Show the share of each truth (row) that is in each class (column); matched classes stand on the diagonal."""
    from matplotlib.colors import LinearSegmentedColormap

    class_of = {true_id: k for k, true_id in table.matching.items()}
    # A truth that no class is left for comes last, as do the classes that no truth is left for.
    truths = sorted(table.truth_ids, key=lambda t: t not in class_of)
    classes = [class_of[t] for t in truths if t in class_of] + _unmatched(table)
    counts = table.confusion[[table.class_ids.index(k) for k in classes]][:, [table.truth_ids.index(t) for t in truths]]
    share = (counts / counts.sum(axis=0)).T
    ramp = LinearSegmentedColormap.from_list("share", list(MATRIX_RAMP))
    axes.imshow(share, cmap=ramp, vmin=0, vmax=1, aspect="auto")
    axes.set_title("share of each truth (row) in each class (column)", loc="left", fontsize=10)
    axes.tick_params(length=0, labelsize=8)
    axes.set_xticks(range(len(classes)), [str(k) for k in classes])
    axes.set_yticks(range(len(truths)), [_name(names, t) for t in truths])
    if max(share.shape) > _MAX_LABELLED:
        axes.set_xticks([])
        axes.set_yticks([])
        return
    for row, col in np.argwhere(share >= _SHOWN_SHARE).tolist():
        ink = "white" if share[row, col] > 0.5 else "black"
        axes.text(col, row, f"{share[row, col]:.2f}", ha="center", va="center", fontsize=8, color=ink)


def _legend(
    figure: Figure, table: Table, names: list[str], colours: NDArray[np.uint8], true_colours: NDArray[np.uint8]
) -> None:
    from matplotlib.patches import Patch

    entries = [(_name(names, t), true_colours[t]) for t in table.truth_ids]
    entries += [(f"class {k}, unmatched", colours[k]) for k in _unmatched(table)]
    entries = [*entries[:_MAX_LABELLED], ("differs: another's class", np.array(rgb_of(WRONG)))]
    if _unmatched(table):
        entries.append(("differs: unmatched class", np.array(rgb_of(UNMATCHED))))
    patches = [Patch(facecolor=tuple(rgb / 255), edgecolor="black", lw=0.5, label=text) for text, rgb in entries]
    figure.legend(handles=patches, loc="outside lower center", ncols=6, fontsize=9, frameon=False)


def _name(names: list[str], true_id: int) -> str:
    return names[true_id][:_MAX_NAME] if true_id < len(names) and names[true_id] else str(true_id)
