"""Colours that stand side by side stay apart, also for readers who lack one kind of cone."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from hrt_cli.raster.style import NO_GO_COLOUR, SCORE_RAMP, class_colour, rgb_of
from hrt_cli.report.figures import palette

# Machado, Oliveira and Fernandes (2009), severity 1.0, on linear RGB.
EYES = {
    "trichromat": np.eye(3),
    "protanope": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranope": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanope": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
# CIEDE2000: 1 is just seen when two areas touch, 10 at a glance.
APART = 10.0


def lab(colours, eye: str) -> np.ndarray:
    srgb = np.array([rgb_of(each) for each in colours]) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ EYES[eye].T, 0, 1)
    return rgb2lab(np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055))


def nearest(colours, eye: str) -> tuple[float, str, str]:
    """The smallest distance of any two colours, and the two."""
    places = lab(colours, eye)
    distance = deltaE_ciede2000(places[:, None], places[None])
    np.fill_diagonal(distance, np.inf)
    one, other = np.unravel_index(distance.argmin(), distance.shape)
    return float(distance.min()), colours[one], colours[other]


SETS = {
    "twenty classes": [class_colour(k) for k in range(20)],
    "classes and what is none": [*(class_colour(k) for k in range(20)), palette.CANVAS],
    "robots": [palette.robot_line(k)[0] for k in range(8)],
    "methods": [*palette.METHODS.values()],
    "plans": [palette.plan_colour(k) for k in range(4)],
    "ends of a path": [palette.START, palette.END, palette.PATH],
    "events": [colour for _, _, colour, _ in palette.EVENTS.values()],
    "fences": [palette.KEEP_IN, palette.KEEP_OUT, palette.PATH],
    "agreement": [palette.RIGHT, palette.WRONG, palette.UNMATCHED],
    "learning": [palette.TRAINING, palette.VALIDATION, palette.CONSTANT],
    "a series and what is picked out": [palette.SERIES, palette.ACCENT, palette.GREEN, palette.INK],
    "stops of the scores' ramp": [colour for _, colour in SCORE_RAMP],
}


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("name", SETS)
def test_colours_stay_apart_for_every_eye(name: str, eye: str) -> None:
    distance, one, other = nearest(SETS[name], eye)
    assert distance >= APART, f"{one} and {other}: {distance:.1f}"


def test_the_simulation_knows_what_cannot_be_told_apart() -> None:
    # A red and a green that a deuteranope confuses, as the reference implementations show them.
    assert nearest(["#c03000", "#7f7000"], "trichromat")[0] > 25
    assert nearest(["#c03000", "#7f7000"], "deuteranope")[0] < APART


@pytest.mark.parametrize("ramp", [palette.VALUE_RAMP, [colour for _, colour in SCORE_RAMP], palette.MATRIX_RAMP])
@pytest.mark.parametrize("eye", EYES)
def test_ramps_rise_in_lightness(ramp, eye: str) -> None:
    lightness = np.diff(lab(list(ramp), eye)[:, 0])
    assert (lightness > 0).all() or (lightness < 0).all()


def test_no_go_is_hatched_because_its_grey_is_near_a_score() -> None:
    from hrt_cli.report.figures.layers import NO_GO

    assert nearest([NO_GO_COLOUR, SCORE_RAMP[2][1]], "trichromat")[0] < 20
    assert NO_GO.hatch


def test_no_two_robots_of_a_team_look_alike() -> None:
    lines = [palette.robot_line(k) for k in range(32)]
    assert len(set(lines)) == 32
