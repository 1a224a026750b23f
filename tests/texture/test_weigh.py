from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from hrt_cli.texture.discriminate import Tile
from hrt_cli.texture.features import Windows
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.weigh import persistence, site_factors, trust

SETTINGS = SegmentSpec(2).settings((1.0, 1.0))


def tiles(seed: int, share: float = 0.9) -> list[Tile]:
    rng = np.random.default_rng(seed)
    found = []
    for shape in ((24, 30), (17, 40), (9, 9)):
        ground = gaussian_filter(rng.normal(size=(7, *shape)), (0, 2, 2)) * [
            [[3]],
            [[2]],
            [[1]],
            [[1]],
            [[1]],
            [[1]],
            [[1]],
        ]
        wide = ground + 0.1 * rng.normal(size=ground.shape)
        found.append(Tile(wide.astype(np.float32), rng.random(shape) < share))
    return found


def slow_persistence(found: list[Tile], down: int, along: int) -> NDArray[np.float64]:
    points = np.concatenate([one.patches for one in found])
    pairs = []
    for one in found:
        rows, cols = one.usable.shape
        for r in range(0, rows, 2):
            for c in range(0, cols, 2):
                for y, x in ((r + down, c), (r, c + along)):
                    if y < rows and x < cols and one.usable[r, c] and one.usable[y, x]:
                        pairs.append((one.wide[:, r, c], one.wide[:, y, x]))
    a, b = (np.array(side, np.float64) - points.mean(axis=0) for side in zip(*pairs, strict=True))
    return np.clip((a * b).mean(axis=0) / points.var(axis=0), 0, 1)


@pytest.mark.parametrize(("down", "along"), [(2, 2), (4, 6), (12, 10)])
def test_persistence_agrees_with_the_definition(down: int, along: int) -> None:
    found = tiles(1)
    assert persistence(found, (down, along)) == pytest.approx(slow_persistence(found, down, along), abs=1e-5)


def test_odd_distances_are_no_nearer_than_asked() -> None:
    found = tiles(2, share=1.0)
    assert np.array_equal(persistence(found, (3, 5)), persistence(found, (4, 6)))


def test_ground_persists_and_noise_does_not() -> None:
    rng = np.random.default_rng(3)
    ground = np.repeat(np.arange(2.0), 40)[None, :, None] * np.ones((1, 80, 80))
    noise = rng.normal(size=(1, 80, 80))
    found = [
        Tile(np.concatenate([ground, noise, np.full((1, 80, 80), 7.0)]).astype(np.float32), np.ones((80, 80), bool))
    ]
    kept, lost, constant = persistence(found, (8, 8))
    assert kept > 0.75
    assert lost < 0.05
    assert constant == 0


def test_where_no_pair_is_known_all_count_in_full() -> None:
    small = [Tile(np.random.default_rng(4).normal(size=(7, 5, 5)).astype(np.float32), np.ones((5, 5), bool))]
    assert np.array_equal(persistence(small, (12, 12)), np.ones(7))
    assert np.array_equal(trust(np.ones(7)), np.ones(7))


@given(st.lists(st.floats(0, 1), min_size=4, max_size=12).map(np.array))
@settings(max_examples=100, deadline=None)
def test_trust_is_a_share_and_chroma_keeps_its_own(persisting: NDArray[np.float64]) -> None:
    factors = trust(persisting)
    assert ((factors > 0) & (factors <= 1)).all()
    assert np.array_equal(factors[1:3], [1, 1])
    assert len(set(factors[3:])) == 1
    # What persists half as much as chroma counts in full.
    if persisting[0] >= persisting[1:3].mean():
        assert factors[0] == 1


def test_trust_by_hand() -> None:
    # Chroma .48 + .02 = .5, half of it .25; lightness .1 + .02 over it is .48, texture .03 + .02 is .2.
    found = trust(np.array([0.1, 0.46, 0.5, 0.02, 0.04]))
    assert found == pytest.approx([0.48**2, 1, 1, 0.2**2, 0.2**2])


def test_texture_that_is_only_shade_counts_little() -> None:
    rng = np.random.default_rng(5)
    ground = np.repeat(np.repeat(rng.normal(size=(3, 4, 4)), 16, axis=1), 16, axis=2)
    shade = gaussian_filter(rng.normal(size=(4, 64, 64)), (0, 1, 1))
    found = [Tile(np.concatenate([ground, shade]).astype(np.float32), np.ones((64, 64), bool))]
    centred = found[0].patches - found[0].patches.mean(axis=0)
    spread = (centred * site_factors(found, centred, SETTINGS, (6, 6))).std(axis=0)
    assert np.hypot.reduce(spread[3:]) < 0.3
    assert spread[1] == pytest.approx(1.3 / np.sqrt(3))


def test_windows_apart_share_nothing() -> None:
    windows = Windows(SETTINGS, (1.0, 0.5), 8)
    rows, cols = windows.apart_cells
    assert (rows, cols) == (12, 25)
    taps = windows._taps(SETTINGS.fit_sigma_m)[0]
    offsets = np.abs(np.arange(-len(taps) + 1, len(taps)))
    window = taps[offsets]
    shared = np.correlate(window, window, "full")
    middle = len(shared) // 2
    assert shared[min(middle + rows, len(shared) - 1)] < 0.01 * shared[middle]
