"""A picture with what the network makes of it drawn in: where it would steer, how sure it is, what it looked at.

Drawn with OpenCV on arrays, a few milliseconds a frame. An arrow from the bottom centre bends with yaw, a fan about it
spans one standard deviation to either side, and below the picture stands the distribution over the angles. Pitch has a
strip of its own at the right edge and an upright arrow at the tip of the other one. What was really steered is yellow.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.steering.network.net import Output
from hrt_cli.steering.prediction.uncertainty import count_modes, moments

MIN_WIDTH_PX, MAX_WIDTH_PX = 480, 960
_STRIP_PX, _SIDE_PX, _MARGIN_PX = 84, 64, 16
_STEPS = 24
"""Points of an arc."""
_TURN_RAD = np.pi / 3
"""By how much the arrow's tip is turned at yaw 1."""
_LENGTH, _CLIMB = 0.55, 0.22
"""Of the arrow, and of its upright part at pitch 1, in heights of the picture."""

Colour = tuple[int, int, int]
_SAID: Colour = (76, 201, 240)
_LABEL: Colour = (255, 214, 70)
_DOUBT: Colour = (255, 122, 89)
_DARK: Colour = (18, 22, 28)
_AXIS: Colour = (150, 158, 168)
_TEXT: Colour = (240, 243, 246)
_TO_RIGHT, _TO_LEFT = (255, 90, 40), (160, 70, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4
"""Bits of a pixel in OpenCV's fixed-point coordinates."""

Image = NDArray[np.uint8]
Points = NDArray[np.float64]


def canvas(rgb: Image) -> Image:
    """Return a picture scaled to be drawn on: 480 to 960 pixels wide."""
    scale = min(max(1.0, MIN_WIDTH_PX / rgb.shape[1]), MAX_WIDTH_PX / rgb.shape[1])
    if scale == 1.0:
        return rgb
    size = (round(rgb.shape[1] * scale), max(1, round(rgb.shape[0] * scale)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA), np.uint8)


def draw_overlay(
    rgb: Image,
    distribution: Mapping[Output, NDArray[np.float64]],
    *,
    spread: Mapping[Output, float] | None = None,
    label: Mapping[Output, float] | None = None,
    heat: NDArray[np.float32] | None = None,
    crop_top: float = 0.0,
    title: str = "",
) -> Image:
    """Return a picture with a prediction drawn in, uint8 RGB; see `canvas` for its scale.

    Parameters
    ----------
    rgb : uint8 [rows, cols, 3]
    distribution : dict of float64 [2M + 1]
    spread : dict of float, optional
        Standard deviation to show as the fan; without it that of `distribution`.
    label : dict of float, optional
        What was steered.
    heat : float32 [height, width], optional
        What turned the answer (`saliency.angle_maps`), for the part of the picture below `crop_top`: orange pulls to
        the right, violet to the left, the stronger the more opaque.
    crop_top : float
        Share of the picture that the network does not see; it is drawn darker.
    title : str
        To stand in the picture's corner.
    """
    picture = canvas(rgb).copy()
    height, width = picture.shape[:2]
    unseen = round(crop_top * height)
    picture[:unseen] //= 2
    if heat is not None:
        picture[unseen:] = _heated(picture[unseen:], heat)
    mean = {name: float(moments(each)[0]) for name, each in distribution.items()}
    wide = {name: float(np.sqrt(moments(each)[1])) for name, each in distribution.items()} | dict(spread or {})
    picture = _arrows(picture, distribution["yaw"], mean, wide["yaw"], label)
    if "pitch" in distribution:
        side = _strip(distribution["pitch"], mean["pitch"], wide["pitch"], (label or {}).get("pitch"), height, "pitch")
        # Drawn from left to right, and turned: up is up.
        picture = np.hstack([picture, np.rot90(side)])
    strip = _strip(distribution["yaw"], mean["yaw"], wide["yaw"], (label or {}).get("yaw"), width, "yaw")
    below = np.full((strip.shape[0], picture.shape[1], 3), _DARK, np.uint8)
    below[:, :width] = strip
    ways = count_modes(distribution["yaw"])
    lines = [(title, _TEXT)] if title else []
    for name in distribution:
        lines.append((f"{name} {mean[name]:+.2f}, sd {wide[name]:.2f}", _SAID))
        if label is not None and name in label:
            lines.append((f"steered {name} {label[name]:+.2f}", _LABEL))
    if ways > 1:
        lines.append((f"{ways} ways: likeliest {_likeliest(distribution['yaw']):+.2f}", _DOUBT))
    if heat is not None:
        lines.append(("orange turns it right, violet left", _AXIS))
    return np.vstack([_titled(picture, lines), below])


def _arrows(
    picture: Image,
    yaw: NDArray[np.float64],
    mean: Mapping[Output, float],
    wide: float,
    label: Mapping[Output, float] | None,
) -> Image:
    height, width = picture.shape[:2]
    low, high = max(-1.0, mean["yaw"] - wide), min(1.0, mean["yaw"] + wide)
    tips = np.stack([_arc(each, height, width)[-1] for each in np.linspace(low, high, _STEPS)])
    fan = np.vstack([_arc(low, height, width), tips, _arc(high, height, width)[::-1]])
    picture = _blended(picture, fan, _SAID, 0.4)
    cv2.polylines(picture, [_fixed(fan)], True, _SAID, 1, cv2.LINE_AA, _SHIFT)
    if label is not None and "yaw" in label:
        _arrow(picture, _arc(label["yaw"], height, width), _LABEL, 3)
        _upright(picture, _arc(label["yaw"], height, width)[-1], label.get("pitch"), _LABEL)
    if count_modes(yaw) > 1:
        _arrow(picture, _arc(_likeliest(yaw), height, width), _DOUBT, 3)
    arc = _arc(mean["yaw"], height, width)
    _arrow(picture, arc, _SAID, 5)
    _upright(picture, arc[-1], mean.get("pitch"), _SAID)
    return picture


def _arc(yaw: float, height: int, width: int) -> Points:
    """Return the points (x, y) of a circular arc from the bottom centre upwards that ends turned by yaw."""
    along = np.linspace(0.0, 1.0, _STEPS)
    turned = _TURN_RAD * yaw * along
    # The integral of (sin, -cos) of the turn, by the midpoints.
    middle = (turned[1:] + turned[:-1]) / 2
    steps = np.stack([np.sin(middle), -np.cos(middle)], axis=1) * (_LENGTH * height / (_STEPS - 1))
    foot = np.array([[width / 2, height - 8.0]])
    return np.asarray(foot + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), np.float64)


def _arrow(picture: Image, arc: Points, colour: Colour, thick: int) -> None:
    ahead = (arc[-1] - arc[-2]) / np.linalg.norm(arc[-1] - arc[-2])
    across = np.array([-ahead[1], ahead[0]])
    size = 3.2 * thick
    head = np.array([arc[-1] + ahead * size * 1.3, arc[-1] + across * size * 0.7, arc[-1] - across * size * 0.7])
    for grown, paint in ((4, _DARK), (0, colour)):
        cv2.polylines(picture, [_fixed(arc)], False, paint, thick + grown, cv2.LINE_AA, _SHIFT)
        centre = head.mean(axis=0)
        bigger = centre + (head - centre) * (1.0 + grown / size)
        cv2.fillPoly(picture, [_fixed(bigger)], paint, cv2.LINE_AA, _SHIFT)


def _upright(picture: Image, foot: Points, pitch: float | None, colour: Colour) -> None:
    if pitch is None:
        return
    tip = foot - np.array([0.0, pitch * _CLIMB * picture.shape[0]])
    for grown, paint in ((4, _DARK), (0, colour)):
        cv2.polylines(picture, [_fixed(np.stack([foot, tip]))], False, paint, 3 + grown, cv2.LINE_AA, _SHIFT)
        cv2.circle(picture, _point(tip), (5 * 16) + grown * 8, paint, -1, cv2.LINE_AA, _SHIFT)


def _strip(
    probability: NDArray[np.float64], mean: float, wide: float, label: float | None, length: int, name: str
) -> Image:
    """Return the distribution as bars over the angles, from -1 at the left to 1 at the right, uint8 [84, length, 3]."""
    strip = np.full((_STRIP_PX if name == "yaw" else _SIDE_PX, length, 3), _DARK, np.uint8)
    floor, top = strip.shape[0] - 18, 8
    inner = length - 2 * _MARGIN_PX
    half = len(probability) // 2
    pitch_px = inner / (2 * half + 1)

    def across(angle: float) -> float:
        """Return where an angle is: the outermost classes are half a bar within."""
        return _MARGIN_PX + pitch_px / 2 + (angle + 1.0) / 2.0 * (inner - pitch_px)

    band = np.array([[across(max(-1.0, mean - wide)), top], [across(min(1.0, mean + wide)), floor]])
    corners = np.array([band[0], [band[1, 0], top], band[1], [band[0, 0], floor]])
    strip = _blended(strip, corners, _SAID, 0.22)
    top_share = float(probability.max())
    for index, share in enumerate(probability):
        x = across((index - half) / half)
        tall = (floor - top) * share / top_share
        box = np.array([[x - 0.36 * pitch_px, floor - tall], [x + 0.36 * pitch_px, floor]])
        paint = _SAID if share == top_share else tuple(int(0.6 * each) for each in _SAID)
        cv2.fillPoly(strip, [_fixed(np.array([box[0], [box[1, 0], box[0, 1]], box[1], [box[0, 0], box[1, 1]]]))], paint,
                     cv2.LINE_AA, _SHIFT)  # fmt: skip
    cv2.line(strip, (_MARGIN_PX, floor), (length - _MARGIN_PX, floor), _AXIS, 1)
    for angle in (-1.0, -0.5, 0.0, 0.5, 1.0):
        cv2.line(strip, (round(across(angle)), floor), (round(across(angle)), floor + 3), _AXIS, 1)
        _written(strip, f"{angle:g}", round(across(angle)), floor + 14, 0.36, _AXIS, centred=True)
    _pin(strip, across(mean), top, floor, _SAID)
    if label is not None:
        _pin(strip, across(label), top, floor, _LABEL)
    _written(strip, f"{top_share:.0%}", 2, top + 6, 0.34, _AXIS)
    return strip


def _pin(strip: Image, x: float, top: int, floor: int, colour: Colour) -> None:
    for thick, paint in ((4, _DARK), (2, colour)):
        cv2.polylines(strip, [_fixed(np.array([[x, top], [x, floor]]))], False, paint, thick, cv2.LINE_AA, _SHIFT)
    cv2.fillPoly(strip, [_fixed(np.array([[x - 5, top - 7], [x + 5, top - 7], [x, top + 2]]))], colour, cv2.LINE_AA,
                 _SHIFT)  # fmt: skip


def _heated(picture: Image, heat: NDArray[np.float32]) -> Image:
    large = cv2.resize(heat, (picture.shape[1], picture.shape[0]), interpolation=cv2.INTER_LINEAR)
    strength = np.abs(large) / max(float(np.abs(large).max()), 1e-12)
    paint = np.where(large[..., None] > 0, np.array(_TO_RIGHT, np.float32), np.array(_TO_LEFT, np.float32))
    opaque = 0.7 * strength[..., None]
    return np.asarray(np.round(picture * (1 - opaque) + paint * opaque), np.uint8)


def _titled(picture: Image, lines: list[tuple[str, Colour]]) -> Image:
    scale, step, pad = 0.46, 19, 8
    wide = max(cv2.getTextSize(text, _FONT, scale, 1)[0][0] for text, _ in lines) + 2 * pad
    tall = step * len(lines) + pad
    box = np.array([[0, 0], [wide, 0], [wide, tall], [0, tall]], np.float64)
    picture = _blended(picture, box, _DARK, 0.65)
    for number, (text, colour) in enumerate(lines):
        _written(picture, text, pad, step * (number + 1) - 3, scale, colour)
    return picture


def _blended(image: Image, polygon: Points, colour: Colour, opaque: float) -> Image:
    painted = image.copy()
    cv2.fillPoly(painted, [_fixed(polygon)], colour, cv2.LINE_AA, _SHIFT)
    return np.asarray(cv2.addWeighted(painted, opaque, image, 1.0 - opaque, 0.0), np.uint8)


def _written(image: Image, text: str, x: int, y: int, scale: float, colour: Colour, *, centred: bool = False) -> None:
    # OpenCV's own fonts hold ASCII only.
    shown = text.encode("ascii", "replace").decode()
    if centred:
        x -= cv2.getTextSize(shown, _FONT, scale, 1)[0][0] // 2
    cv2.putText(image, shown, (x, y), _FONT, scale, colour, 1, cv2.LINE_AA)


def _likeliest(probability: NDArray[np.float64]) -> float:
    half = len(probability) // 2
    return (int(probability.argmax()) - half) / half


def _fixed(points: Points) -> NDArray[np.int32]:
    return np.round(points * (1 << _SHIFT)).astype(np.int32)


def _point(point: Points) -> tuple[int, int]:
    x, y = _fixed(point)
    return int(x), int(y)
