from __future__ import annotations

import numpy as np
import pytest
from skimage.color import rgb2lab

from hrt_cli.texture.colour import HUE_BINS, cell_means, hue_histogram, hue_votes, lab


def test_lab_agrees_with_scikit_image_and_grey_is_neutral() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (3, 20, 20)).astype(np.float32)
    expected = rgb2lab(np.moveaxis(rgb, 0, -1) / 255)
    assert np.abs(np.moveaxis(lab(rgb), 0, -1) - expected).max() < 0.05
    grey = lab(np.tile(np.arange(256, dtype=np.float32), (3, 1, 1)))
    assert not grey[1:].any()
    assert grey[0, 0, 255] == pytest.approx(100, abs=1e-3)


def test_cell_means_count_valid_pixels_only() -> None:
    rng = np.random.default_rng(1)
    rgb = rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
    valid = rng.random((12, 16)) < 0.5
    valid[:4, :4] = False
    padded = np.pad(rgb, ((2, 0), (3, 0), (0, 0)), constant_values=99)
    planes = np.ascontiguousarray(np.moveaxis(padded, -1, 0))
    mean, share = cell_means(planes, np.pad(valid, ((2, 0), (3, 0)), constant_values=True), (2, 3), (3, 4), 4)
    assert share[0, 0] == 0
    assert not mean[:, 0, 0].any()
    for i in range(3):
        for j in range(4):
            cell = (slice(4 * i, 4 * i + 4), slice(4 * j, 4 * j + 4))
            assert share[i, j] == valid[cell].mean()
            if valid[cell].any():
                assert mean[:, i, j] == pytest.approx(rgb[cell][valid[cell]].mean(axis=0), rel=1e-6)


def test_hue_votes_carry_chroma_and_turn_with_hue() -> None:
    angle = np.linspace(-np.pi, np.pi, 361)[None]
    cells = np.stack([np.full_like(angle, 50), 30 * np.cos(angle), 30 * np.sin(angle)]).astype(np.float32)
    votes = hue_votes(cells)
    assert votes.sum(axis=0) == pytest.approx(30, abs=1e-3)
    assert (votes >= 0).all()
    assert votes[:, 0, 0] == pytest.approx(votes[:, 0, -1], abs=1e-3)
    turned = hue_votes(np.stack([cells[0], -cells[1], -cells[2]]))
    assert np.roll(votes, HUE_BINS // 2, axis=0) == pytest.approx(turned, abs=1e-3)


def test_grey_does_not_enter_the_histogram() -> None:
    assert not hue_histogram(np.zeros((HUE_BINS, 2, 2), np.float32)).any()
    strong = np.zeros((HUE_BINS, 1, 1), np.float32)
    strong[3] = 1000
    assert hue_histogram(strong)[3, 0, 0] == pytest.approx(1, abs=0.01)
