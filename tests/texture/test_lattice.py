from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import correlate1d

from hrt_cli.raster.windows import Window
from hrt_cli.texture.lattice import CellGrid, gaussian_taps, smooth


@settings(deadline=None, max_examples=50)
@given(
    st.integers(-50, 500), st.integers(-50, 500), st.integers(1, 90), st.integers(1, 90),
    st.integers(0, 10_000), st.integers(0, 10_000), st.sampled_from([2, 4, 8]),
)  # fmt: skip
def test_a_grid_covers_its_window_tightly_on_the_lattice(
    row: int, col: int, height: int, width: int, anchor_r: int, anchor_c: int, step: int
) -> None:
    anchor = (anchor_r, anchor_c)
    grid = CellGrid.covering(Window(row, col, height, width), anchor, step)
    pixels = grid.window(anchor)
    assert (pixels.row + anchor_r) % step == 0
    assert (pixels.col + anchor_c) % step == 0
    assert pixels.row <= row < pixels.row + step
    assert pixels.col <= col < pixels.col + step
    assert 0 <= pixels.row + pixels.height - row - height < step
    assert 0 <= pixels.col + pixels.width - col - width < step
    assert grid.grown(2, 3).window(anchor).height == pixels.height + 4 * step


def test_smoothing_is_a_normalised_gaussian_mean() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(2, 30, 40)).astype(np.float32)
    weights = (rng.random((30, 40)) < 0.6).astype(np.float32)
    rows, cols = gaussian_taps(1.5), gaussian_taps(2.5)
    full_rows = np.concatenate([rows[:0:-1], rows]).astype(np.float64)
    full_cols = np.concatenate([cols[:0:-1], cols]).astype(np.float64)
    assert full_rows.sum() == pytest.approx(1)

    def blur(image: np.ndarray) -> np.ndarray:
        both = correlate1d(correlate1d(image.astype(np.float64), full_rows, axis=0), full_cols, axis=1)
        return both[len(rows) - 1 : 1 - len(rows), len(cols) - 1 : 1 - len(cols)]

    got, share = smooth(values, weights, rows, cols)
    assert share == pytest.approx(blur(weights), abs=1e-6)
    for channel in range(2):
        assert got[channel] == pytest.approx(blur(values[channel] * weights) / blur(weights), abs=1e-5)


def test_without_data_there_is_zero_and_without_width_there_is_no_change() -> None:
    values = np.ones((1, 9, 9), np.float32)
    got, share = smooth(values, np.zeros((9, 9), np.float32), gaussian_taps(1.0), gaussian_taps(1.0))
    assert not got.any()
    assert not share.any()
    same, _ = smooth(values, np.ones((9, 9), np.float32), gaussian_taps(0.0), gaussian_taps(0.0))
    assert np.array_equal(same, values)
