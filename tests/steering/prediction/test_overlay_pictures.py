"""Pictures with predictions drawn in: where the arrow points, which colours stand for what, and their sizes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from predict_files import noise

from hrt_cli.steering.prediction.overlay import canvas, draw_overlay

SAID, LABEL, DOUBT = (76, 201, 240), (255, 214, 70), (255, 122, 89)
GREY = np.full((120, 160, 3), 90, np.uint8)


def bell(mean: float, sd: float = 0.1, half: int = 7) -> NDArray[np.float64]:
    angles = np.arange(-half, half + 1) / half
    density = np.exp(-((angles - mean) ** 2) / (2 * sd**2))
    return density / density.sum()


def where(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    return (image == np.array(colour, np.uint8)).all(axis=2)


def tip(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> tuple[float, float]:
    """Column and row of the highest pixels of a colour below the title, in the picture."""
    rows, cols = np.nonzero(where(image[110:360], colour))
    top = rows.min()
    return float(cols[rows <= top + 12].mean()), float(top + 110)


@pytest.mark.parametrize(("yaw", "side"), [(-0.8, -1), (-0.3, -1), (0.0, 0), (0.3, 1), (0.8, 1)])
def test_the_arrow_bends_to_where_it_would_steer(yaw: float, side: int) -> None:
    found = draw_overlay(GREY, {"yaw": bell(yaw, 0.02)})
    col, _ = tip(found, SAID)
    assert np.sign(round((col - 240) / 8)) == side


def test_further_is_further() -> None:
    cols = [tip(draw_overlay(GREY, {"yaw": bell(yaw, 0.02)}), SAID)[0] for yaw in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    assert cols == sorted(cols)
    assert np.diff(cols).min() > 15


def test_small_pictures_grow_and_large_ones_shrink() -> None:
    assert canvas(GREY).shape == (360, 480, 3)
    assert canvas(np.zeros((300, 600, 3), np.uint8)).shape == (300, 600, 3)
    assert canvas(np.zeros((3000, 4000, 3), np.uint8)).shape == (720, 960, 3)
    assert draw_overlay(GREY, {"yaw": bell(0)}).shape == (444, 480, 3)
    assert draw_overlay(GREY, {"yaw": bell(0), "pitch": bell(0)}).shape == (444, 544, 3)


def test_what_was_steered_has_its_own_colour() -> None:
    assert not where(draw_overlay(GREY, {"yaw": bell(0.5)}), LABEL).any()
    found = draw_overlay(GREY, {"yaw": bell(0.5)}, label={"yaw": -0.5})
    assert tip(found, LABEL)[0] < 230
    assert where(found[360:], LABEL).any()


def test_two_ways_are_told() -> None:
    assert not where(draw_overlay(GREY, {"yaw": bell(0.5)}), DOUBT).any()
    found = draw_overlay(GREY, {"yaw": 0.6 * bell(0.7) + 0.4 * bell(-0.7)})
    assert tip(found, DOUBT)[0] > 250


def test_a_wider_spread_is_a_wider_fan() -> None:
    plain = draw_overlay(GREY, {"yaw": bell(0.0, 0.02)}, spread={"yaw": 0.05})
    wide = draw_overlay(GREY, {"yaw": bell(0.0, 0.02)}, spread={"yaw": 0.6})
    changed = [np.ptp(np.nonzero((each[120:340] != 90).any(axis=(0, 2)))[0]) for each in (plain, wide)]
    assert changed[1] > 2 * changed[0]


def test_bars_stand_at_their_angles() -> None:
    for index, col in ((0, 31), (7, 240), (14, 449)):
        strip = draw_overlay(GREY, {"yaw": np.eye(15)[index]})[360:]
        bars = np.nonzero(where(strip[40:60], SAID).all(axis=0))[0]
        assert abs(bars.mean() - col) < 4, index


def test_pitch_is_drawn_up() -> None:
    up, down = (draw_overlay(GREY, {"yaw": bell(0.0), "pitch": np.eye(15)[k]})[:360, 490:] for k in (14, 0))
    assert np.nonzero(where(up, SAID))[0].mean() < 60
    assert np.nonzero(where(down, SAID))[0].mean() > 300


def test_heat_lies_where_it_was_and_says_which_side() -> None:
    heat = np.zeros((60, 80), np.float32)
    heat[30:, :20], heat[30:, 60:] = -1.0, 1.0
    plain, found = (draw_overlay(GREY, {"yaw": bell(0.0)}, heat=each).astype(int) for each in (None, heat))
    left, right = found[300, 20], found[300, 460]
    assert right[0] > right[2]  # orange
    assert left[2] > left[0]  # violet
    assert (found[130:160, 380:] == plain[130:160, 380:]).all()


def test_what_is_cut_off_is_darker_and_heat_lies_below() -> None:
    found = draw_overlay(GREY, {"yaw": bell(0.0)}, crop_top=0.5, heat=np.ones((60, 80), np.float32))
    assert found[150, 470].tolist() == [45, 45, 45]
    assert found[200, 470, 0] > 150


def test_no_heat_at_all_and_odd_titles_and_the_input_are_left_alone() -> None:
    picture = noise(1)[0]
    before = picture.copy()
    large = np.ascontiguousarray(np.broadcast_to(GREY[:1, :1], (360, 480, 3)))
    draw_overlay(picture, {"yaw": bell(0.0)}, heat=np.zeros((48, 64), np.float32), title="Größe \u3042")
    draw_overlay(large, {"yaw": bell(0.0)}, crop_top=0.3)
    assert np.array_equal(picture, before)
    assert (large == 90).all()
