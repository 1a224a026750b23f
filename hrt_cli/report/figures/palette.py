"""The colours of figures, one meaning each; those of classes, scores and no-go ground are in `raster.style`.

They are of the scheme of Okabe and Ito (2008) where nothing else is said. What stands side by side in a figure stays
apart for colour-blind readers too: a test simulates them.
"""

from __future__ import annotations

from hrt_cli.raster.style import class_colour

BLUE, ORANGE, GREEN, SKY = "#0072b2", "#d55e00", "#009e73", "#56b4e9"

SERIES, ACCENT = BLUE, ORANGE
"""What a curve or histogram shows, and its mean or whatever is picked out in it."""
LEARNT = "#332288"
"""The learning curve of a policy."""
TRAINING, VALIDATION, CONSTANT = "#88ccee", "#332288", "#cc6677"
"""Learning curves: those of the training and validation frames, and what steering by a constant would reach."""
INK, SOFT, GRID = "#222222", "#888888", "#e0e0e0"
MATRIX_RAMP = ("#ffffff", "#332288")
"""A share from 0 to 1."""
VALUE_RAMP = ("#0d0887", "#7e03a8", "#cc4778", "#f89540", "#f0f921")
"""Values other than scores (speeds, temperatures): five stops of matplotlib's "plasma"."""

EMPTY, CANVAS = "#eeeeee", "#e8e8e8"
"""A part of a table that holds nothing, and ground that no picture covers."""
RIGHT, WRONG, UNMATCHED, VOID = "#d9d9d9", "#c1272d", "#f2a25c", "#ffffff"
"""Where two class rasters agree, differ, hold a class of one alone, or nothing."""

START, END = BLUE, ORANGE
PATH, PATH_EDGE = "#ffffff", "#111111"
"""A path on a map: a light line in a dark edge is seen on any ground."""
KEEP_IN, KEEP_OUT = "#56b4e9", "#c1272d"
EVENTS = {
    "stuck": ("standstill", "^", "#f0e442", 12),
    "intervention": ("intervention", "D", "#56b4e9", 9),
    "collision": ("collision", "X", "#d55e00", 9),
}
"""What happens on a drive: its name in a legend, marker, colour and size."""

METHODS = {
    "refined": "#0072b2",
    "policy": "#d55e00",
    "rectangle": "#009e73",
    "greedy": "#56b4e9",
    "spiral": "#cc79a7",
    "lawnmower": "#e69f00",
    "random": "#b8b8b8",
}
"""A planning method has its colour in every figure."""
BOUND = "#444444"
_PLANS = ("#111111", "#332288", "#882255", "#117733", "#999933")
_ROBOTS = ("#ffffff", "#56b4e9", "#e69f00", "#cc79a7", "#f0e442", "#009e73", "#0072b2", "#d55e00")
_DASHES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


def plan_colour(index: int) -> str:
    """Return the colour of one of several plans that are compared."""
    return _PLANS[index] if index < len(_PLANS) else class_colour(index)


def robot_line(index: int) -> tuple[str, str | tuple[float, tuple[float, ...]]]:
    """Return colour and line style of one robot of a team: the colours come again after eight robots, dashed."""
    return _ROBOTS[index % len(_ROBOTS)], _DASHES[index // len(_ROBOTS) % len(_DASHES)]
