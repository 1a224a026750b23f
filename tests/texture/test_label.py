from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from hrt_cli.texture.label import NODATA, cell_scores, label


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 4, 8]), st.integers(2, 9))
def test_labels_are_the_least_of_bilinear_scores(seed: int, step_px: int, kinds: int) -> None:
    rng = np.random.default_rng(seed)
    scores = rng.normal(size=(kinds, 6, 7)).astype(np.float32)
    scores[:, 2:, 3:] = scores[:, 2:3, 3:4]
    first_row, first_col = (int(n) for n in rng.integers(step_px, 2 * step_px, 2))
    height, width = (int(n) for n in rng.integers(1, 3 * step_px, 2))
    valid = rng.random((height, width)) < 0.8
    defined = rng.random((6, 7)) < 0.8
    got, counts = label(scores, defined, valid, step_px, first_row, first_col)
    assert np.array_equal(counts, np.bincount(got.ravel(), minlength=256))
    y, x = np.mgrid[first_row : first_row + height, first_col : first_col + width]
    where = [(y + 0.5) / step_px - 0.5, (x + 0.5) / step_px - 0.5]
    full = np.stack([map_coordinates(one.astype(np.float64), where, order=1) for one in scores])
    known = valid & defined[y // step_px, x // step_px]
    assert np.array_equal(got != NODATA, known)
    chosen = np.take_along_axis(full, np.where(known, got, 0)[None].astype(np.int64), axis=0)[0]
    assert (chosen - full.min(axis=0))[known] == pytest.approx(0, abs=1e-5)


def test_scores_are_linear_in_the_features() -> None:
    rng = np.random.default_rng(0)
    values, mean = rng.normal(size=(5, 3, 4)).astype(np.float32), rng.normal(size=5).astype(np.float32)
    gain, offset = rng.normal(size=(6, 5)).astype(np.float32), rng.normal(size=6).astype(np.float32)
    expected = np.einsum("kc,crx->krx", gain, values - mean[:, None, None]) + offset[:, None, None]
    assert cell_scores(values, mean, gain, offset) == pytest.approx(expected, abs=1e-5)
