"""From where hot spots are sampled: by hand, beside a plain reference, and the laws that hold for any map."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.drivability.reach import ABOUT_SHARE, interest_at_stations, stations_of

Maps = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]


def plain(values: NDArray[np.float64], share: NDArray[np.float64], go: NDArray[np.bool_], radius: float) -> np.ndarray:
    """The rule of the docstring, cell by cell."""
    out = np.zeros(go.shape)
    cells = [(i, j) for i in range(go.shape[0]) for j in range(go.shape[1])]
    span = math.ceil(radius)
    lattice = [math.hypot(i, j) for i in range(-span, span + 1) for j in range(-span, span + 1)]
    all_about = sum(1 - d / radius for d in lattice if 0 < d < radius)
    labels, count = ndimage.label(go)
    sizes = [int((labels == k).sum()) for k in range(1, count + 1)]
    largest = labels == 1 + sizes.index(max(sizes)) if sizes else go
    for region in (largest, go & ~largest):
        ground = [cell for cell in cells if region[cell]]
        sampled: set[tuple[int, int]] = set()
        wholly: set[tuple[int, int]] = set()
        for hot in sorted((c for c in cells if share[c] > 0), key=lambda c: (-values[c], c)):
            away = {cell: math.dist(cell, hot) for cell in ground}
            about = [c for c in cells if share[c] > 0 and math.dist(c, hot) < 1.5]
            done = wholly if values[hot] == max(values[c] for c in about) else sampled
            if hot in done or not away or min(away.values()) > radius + 1e-9:
                continue
            # Which of several nearest ones it is has no meaning, but must be the same here and there.
            near = nearest(region, hot)
            assert away[near] == pytest.approx(min(away.values()))
            sampled |= {cell for cell in cells if math.dist(cell, near) <= radius + 1e-9}
            wholly |= {cell for cell in cells if math.dist(cell, near) <= radius - math.sqrt(0.5) + 1e-9}
            out[near] = max(out[near], share[hot])
            for cell in ground:
                if 0 < away[cell] < radius:
                    out[cell] = max(out[cell], share[hot] * ABOUT_SHARE * (1 - away[cell] / radius) / all_about)
    return out


def nearest(region: NDArray[np.bool_], cell: tuple[int, int]) -> tuple[int, int]:
    found = ndimage.distance_transform_edt(~region, return_distances=False, return_indices=True)
    return int(found[0][cell]), int(found[1][cell])


def maps(seed: int, rows: int = 12, cols: int = 14, share_go: float = 0.7, hot: float = 0.15) -> Maps:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(rows, cols)).round(1)
    share = np.clip((values - np.quantile(values, 1 - hot)) / 2, 0, 1)
    return values, share, rng.random((rows, cols)) < share_go


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.4, 1.0, 1.5, 2.0, 3.3]), st.sampled_from([0.3, 0.7, 1.0]))
def test_it_is_as_the_rule_says(seed: int, radius: float, share_go: float) -> None:
    values, share, go = maps(seed, share_go=share_go)
    found, _ = interest_at_stations(values, share, go, radius)
    np.testing.assert_allclose(found, plain(values, share, go, radius), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 5), st.sampled_from([0.2, 0.6, 0.9]))
def test_every_hot_cell_in_reach_is_sampled_and_nothing_else_is_promised(
    seed: int, radius: float, share_go: float
) -> None:
    values, share, go = maps(seed, share_go=share_go)
    found, out_of_reach = interest_at_stations(values, share, go, radius)
    assert not found[~go].any()
    assert found.max(initial=0) <= share.max()
    worth = np.argwhere(found > 0)
    for i, j in np.argwhere(share > 0):
        distance = np.hypot(*(np.argwhere(go) - (i, j)).T) if go.any() else np.array([np.inf])
        if distance.min(initial=np.inf) <= radius:
            # A station that pays no less lies within the radius: the hottest cell that it was set for is as hot.
            about = np.hypot(*(worth - (i, j)).T) <= radius + 1e-9
            assert found[tuple(worth[about].T)].max() >= share[i, j] - 1e-12
    for i, j in worth:
        assert np.hypot(*(np.argwhere(share > 0) - (i, j)).T).min() <= radius + 1e-9
    spots, count = ndimage.label(share > 0, np.ones((3, 3)))
    away = ndimage.distance_transform_edt(~go) if go.any() else np.full(go.shape, np.inf)
    assert out_of_reach == sum(away[spots == k].min() > radius for k in range(1, count + 1))


def one_spot(at: tuple[int, int], go: NDArray[np.bool_], radius: float, size: int = 0) -> NDArray[np.float64]:
    away = np.hypot(*(np.indices(go.shape) - np.array(at)[:, None, None]))
    share = np.where(away <= size, 1 - 0.05 * away, 0.0)
    return interest_at_stations(-away, share, go, radius)[0]


@pytest.mark.parametrize("radius", [2.0, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("size", [0, 1, 2])
def test_lingering_at_a_spot_pays_little(radius: float, size: int) -> None:
    found = one_spot((20, 20), np.ones((41, 41), bool), radius, size)
    assert found[20, 20] == found.max() == 1
    assert found.sum() - 1 <= ABOUT_SHARE + 1e-9
    away = np.hypot(*(np.indices(found.shape) - 20))
    assert not found[away >= radius].any()
    ring = found[20, 21 : 20 + math.ceil(radius)]
    assert (np.diff(ring) < 0).all()


def test_a_spot_in_no_go_ground_is_sampled_from_its_rim() -> None:
    go = np.ones((21, 21), bool)
    go[6:15, 6:15] = False
    found = one_spot((8, 10), go, 4.0)
    assert np.unravel_index(found.argmax(), found.shape) == (5, 10)
    assert found[5, 10] == 1
    assert (found[go & (np.hypot(*(np.indices(go.shape) - np.array([8, 10])[:, None, None])) < 4)] > 0).all()


def test_a_spot_too_deep_in_no_go_ground_is_out_of_reach() -> None:
    go = np.ones((21, 21), bool)
    go[6:15, 6:15] = False
    share = np.zeros(go.shape)
    share[10, 10] = share[2, 2] = share[3, 3] = 1
    found, out_of_reach = interest_at_stations(share, share, go, 4.0)
    assert out_of_reach == 1
    assert found[2, 2] == 1
    assert not found[5:16, 5:16].any()
    assert interest_at_stations(share, share, go, 5.0)[1] == 0


def test_a_spot_beside_a_pocket_is_sampled_from_the_open_ground_too() -> None:
    go = np.zeros((9, 12), bool)
    go[:, :6] = True
    go[4, 8] = True
    share = np.zeros(go.shape)
    share[4, 7] = 0.8
    found, _ = interest_at_stations(share, share, go, 3.0)
    assert found[4, 8] == found[4, 5] == 0.8


def test_a_peak_is_sampled_wherever_in_its_cell_it_lies() -> None:
    values = np.zeros((9, 12))
    values[4, 2:9] = 5, 4.9, 4.8, 3, 2, 1, 0.5
    values[4, 4] = 4.95  # a second peak, two cells from the first
    share = np.clip(values / 5, 0, 1)
    go = np.ones(values.shape, bool)
    found = {radius: interest_at_stations(values, share, go, radius)[0] for radius in (2.0, 2.8)}
    assert found[2.0][4, 4] == pytest.approx(0.99)
    assert found[2.8][4, 4] < 0.1


def test_a_large_fire_has_stations_no_closer_than_the_sensor_reaches() -> None:
    go = np.ones((60, 60), bool)
    values = np.random.default_rng(1).normal(size=go.shape)
    found, _ = interest_at_stations(values, np.ones(go.shape), go, 4.0)
    stations = np.argwhere(found == 1)
    gaps = np.hypot(*(stations[:, None] - stations[None]).transpose(2, 0, 1))
    assert gaps[gaps > 0].min() > 4.0 - math.sqrt(0.5)
    assert 3600 / 60 < len(stations) < 3600 / 12


def test_the_kernel_is_its_own_plain_python() -> None:
    rng = np.random.default_rng(4)
    hot = rng.permutation(30 * 40)[:300]
    at = np.where(rng.random(300) < 0.8, hot, rng.integers(0, 1200, 300))
    disc = np.argwhere(np.hypot(*np.ogrid[-3:4, -3:4]) <= 3.2) - 3
    peak, whole = rng.random(300) < 0.3, np.hypot(*disc.T) <= 2.5
    compiled, slow = (kernel(hot, at, peak, disc, whole, 30, 40) for kernel in (stations_of, stations_of.py_func))
    np.testing.assert_array_equal(compiled, slow)
    assert 0 < compiled.sum() < 300


def test_no_hot_cell_and_no_ground_to_go_are_no_trouble() -> None:
    nothing = np.zeros((5, 6))
    for share, go in ((nothing, np.ones((5, 6), bool)), (nothing + 1, np.zeros((5, 6), bool))):
        found, out_of_reach = interest_at_stations(share, share, go, 2.0)
        assert not found.any()
        assert out_of_reach == int(share.any())
