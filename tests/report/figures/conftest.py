"""What the tests of figures share."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from hrt_cli.report.figures import canvas
from hrt_cli.report.figures.canvas import Drawing


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are published while a test runs, to be read back; their files are of few pixels."""
    figures: list[Figure] = []
    publish = Drawing.publish

    def keep(self: Drawing, figure: Figure, *, trimmed: bool = False) -> None:
        figures.append(figure)
        publish(self, figure, trimmed=trimmed)

    monkeypatch.setattr(Drawing, "publish", keep)
    monkeypatch.setattr(canvas, "_DPI", 20)
    return figures
