from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli.raster.windows import Window, blocks

QUICK = settings(deadline=None, max_examples=60)
sides = st.integers(-40, 40)
sizes = st.integers(0, 50)


def pixels(window: Window) -> set[tuple[int, int]]:
    return {
        (r, c)
        for r in range(window.row, window.row + window.height)
        for c in range(window.col, window.col + window.width)
    }


@QUICK
@given(sides, sides, sizes, sizes, st.integers(1, 30), st.integers(1, 30))
def test_clipping_keeps_what_is_inside(row: int, col: int, height: int, width: int, rows: int, cols: int) -> None:
    window = Window(row, col, height, width)
    inside = window.clipped((rows, cols))
    expected = pixels(window) & pixels(Window(0, 0, rows, cols))
    assert inside.height >= 0
    assert inside.width >= 0
    assert pixels(inside) == expected
    assert np.ones((rows, cols))[inside.slices].size == len(expected)


@QUICK
@given(sides, sides, sizes, sizes, st.integers(0, 10))
def test_a_window_grows_on_all_sides(row: int, col: int, height: int, width: int, halo: int) -> None:
    window = Window(row, col, height, width).grown(halo)
    assert (window.row, window.col) == (row - halo, col - halo)
    assert (window.row + window.height, window.col + window.width) == (row + height + halo, col + width + halo)


@QUICK
@given(st.integers(0, 300), st.integers(0, 300), st.integers(1, 400), st.integers(1, 400), st.integers(20, 130))
def test_blocks_of_a_crop_are_cut_where_those_of_the_whole_are(
    top: int, left: int, rows: int, cols: int, size: int
) -> None:
    anchor = (-50_000_013, 4_999_987)
    crop = list(blocks((rows, cols), size, (anchor[0] + top, anchor[1] + left)))
    assert {w.row + top for w in crop if w.row} <= {w.row for w in blocks((700, 1), size, anchor)}
    assert {w.col + left for w in crop if w.col} <= {w.col for w in blocks((1, 700), size, anchor)}
    seen = np.zeros((rows, cols), int)
    for window in crop:
        assert 0 < window.height <= size
        assert 0 < window.width <= size
        seen[window.slices] += 1
    assert (seen == 1).all()


def test_blocks_come_row_by_row() -> None:
    found = list(blocks((5, 7), 4, (1, 2)))
    assert found == [
        Window(0, 0, 3, 2),
        Window(0, 2, 3, 4),
        Window(0, 6, 3, 1),
        Window(3, 0, 2, 2),
        Window(3, 2, 2, 4),
        Window(3, 6, 2, 1),
    ]
