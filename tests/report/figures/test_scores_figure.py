"""The picture of what drives taught says what the two tables say."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.provenance import record
from hrt_cli.artifacts.scores import ClassScore, scores_document
from hrt_cli.artifacts.stage import REFUSE
from hrt_cli.errors import OutputError
from hrt_cli.raster.style import class_colour
from hrt_cli.report.figures.scores import draw_scores, scores_figure

BEFORE = {0: ClassScore(2, 6, 6.0, "grass"), 1: ClassScore(3, 1, 2.0, "$mud_$")}
AFTER = {0: ClassScore(20, 10, 28.0, "grass"), 1: ClassScore(3, 1, 2.0, "$mud_$"), 7: ClassScore(1, 4, 3.0, "")}


def bars(figure: Figure) -> list[tuple[float, float, str]]:
    """Mean, standard deviation and colour of each error bar, in the order of drawing."""
    found = []
    for bar in figure.axes[0].containers:
        line, _, (spread,) = bar.lines
        ends = spread.get_segments()[0][:, 0]
        found.append((line.get_xdata()[0], (ends[1] - ends[0]) / 2, to_hex(line.get_color())))
    return found


def test_means_spreads_and_colours_are_those_of_the_tables() -> None:
    figure = scores_figure(BEFORE, AFTER, 3)
    found = bars(figure)
    for row, (k, new) in enumerate(AFTER.items()):
        old = BEFORE.get(k, ClassScore(1, 1))
        assert found[2 * row][:2] == pytest.approx((old.mean, old.sd))
        assert found[2 * row + 1] == (pytest.approx(new.mean), pytest.approx(new.sd), class_colour(k))
    axes = figure.axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["0 grass", "1 $mud_$", "7"]
    assert [text.get_text() for text in axes.texts] == ["28.0 (+22.0)", "2.0", "3.0 (+3.0)", "m of evidence"]
    assert axes.get_title(loc="left") == "25.0 m of new evidence, 3 logs in the table"


def test_of_very_many_classes_those_are_shown_that_gained() -> None:
    after = {k: ClassScore(1, 1, float(k >= 100)) for k in range(255)}
    axes = scores_figure({}, after, 1).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == [str(k) for k in range(100, 140)]
    assert "the 40 of 255 classes" in axes.get_title(loc="left")


@pytest.mark.usefixtures("drawn")
def test_it_is_drawn_once_and_again_for_another_table(tmp_path: Path) -> None:
    paths = [tmp_path / "before.json", tmp_path / "after.json"]
    for path, scores in zip(paths, (BEFORE, AFTER), strict=True):
        publish_json(path, scores_document(scores), record("test", 1, {}, {}))
    output = tmp_path / "f.png"
    assert not draw_scores(paths[1], paths[0], output, existing=REFUSE)
    assert draw_scores(paths[1], paths[0], output, existing=REFUSE)
    with pytest.raises(OutputError, match="--overwrite"):
        draw_scores(paths[1], None, output, existing=REFUSE)
