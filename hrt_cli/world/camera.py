"""The terrain camera: what a robot's lens would see of a site, from its orthomosaic and its heights.

A column ray-march over the height map, as the landscapes of games of the 1990s were drawn ("voxel space"), freed of
their level horizon: it fills a table over azimuth and elevation, in which every pixel looks its ray up. docs/method.md
says what is exact in that and what is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.world import develop, raymarch
from hrt_cli.world.site import UNKNOWN, Site

Rgb = tuple[float, float, float]

_AZIMUTH_PX, _ELEVATION_PX = 1.0, 0.65
"""Steps of the table, in pixels of the middle of the frame."""
_STEP_PX = 1.6
"""Steps of the march relative to the distance, in pixels."""
_LARGEST_STEP = 0.02
"""The same as a share of the distance, for coarse lenses."""
_LEAST_STEP = 1.25
"""Shortest step of the march, in pixels of the map."""
_MOST_STATIONS = 4096
_LOWEST_M = 0.02
"""The lens is at least this high above the bare ground."""


@dataclass(frozen=True)
class Lens:
    """A pinhole with square pixels, its axis through the middle of the frame.

    Attributes
    ----------
    width, height : int
        Pixels.
    hfov_deg : float
        Horizontal field of view between the outer edges of the frame, below 180.
    """

    width: int = 160
    height: int = 120
    hfov_deg: float = 75.0

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.width / math.tan(math.radians(0.5 * self.hfov_deg))


@dataclass(frozen=True)
class Weather:
    """What lies between the lens and the ground, and how the sensor takes it.

    A surface of colour c at distance D shows as exposure · balance · (c t + veil (1 − t)), t = exp(−haze_per_m · D),
    each channel for itself, in grey levels as they are in the orthomosaic.

    Attributes
    ----------
    haze_per_m : tuple of 3 floats
        Extinction of red, green and blue, 1/m.
    veil : tuple of 3 floats
        Colour of haze, or of the light in the water, 0 to 255.
    sky_horizon, sky_zenith : tuple of 3 floats
        Colour of the sky at the horizon and straight up, 0 to 255.
    exposure : float
        Gain.
    balance : tuple of 3 floats
        White balance: gain of each channel.
    noise : float
        Standard deviation of the sensor's noise in grey levels of the frame; only in views with a `noise_seed`.
    """

    haze_per_m: Rgb = (0.006, 0.0065, 0.0075)
    veil: Rgb = (198.0, 209.0, 222.0)
    sky_horizon: Rgb = (198.0, 209.0, 222.0)
    sky_zenith: Rgb = (96.0, 142.0, 204.0)
    exposure: float = 1.0
    balance: Rgb = (1.0, 1.0, 1.0)
    noise: float = 2.0

    @classmethod
    def clear(cls) -> Weather:
        """Return a fair day: surfaces at 500 m have all but the colour of the horizon."""
        return cls()

    @classmethod
    def fog(cls, visibility_m: float = 30.0) -> Weather:
        """Return fog in which 5 % of the contrast is left at `visibility_m` (the meteorological optical range)."""
        grey = (203.0, 205.0, 207.0)
        thick = -math.log(0.05) / visibility_m
        return cls((thick, thick, thick), grey, grey, (186.0, 191.0, 197.0))

    @classmethod
    def water(cls, visibility_m: float = 14.0) -> Weather:
        """Return sea water in which 5 % of the contrast in green is left at `visibility_m`.

        Red is lost first: water itself takes another 0.30 of it per metre. There is no sky: upwards the water is
        lighter.
        """
        thick = -math.log(0.05) / visibility_m
        deep = (34.0, 106.0, 124.0)
        return cls((thick + 0.30, thick, 0.9 * thick + 0.02), deep, deep, (128.0, 196.0, 204.0), noise=3.0)

    def jittered(self, rng: np.random.Generator) -> Weather:
        """Return another moment of the same weather.

        Exposure varies by 15 % (standard deviation), the balance of red and blue by 5 %, haze by 25 %, veil and sky
        by 5 % in brightness.
        """
        exposure, red, blue, thick, bright = np.exp(rng.normal(0.0, (0.15, 0.05, 0.05, 0.25, 0.05))).tolist()
        r, g, b = self.balance
        return replace(
            self,
            haze_per_m=_scaled(self.haze_per_m, thick),
            veil=_scaled(self.veil, bright),
            sky_horizon=_scaled(self.sky_horizon, bright),
            sky_zenith=_scaled(self.sky_zenith, bright),
            exposure=self.exposure * exposure,
            balance=(r * red, g, b * blue),
        )


def _scaled(values: Rgb, gain: float) -> Rgb:
    return values[0] * gain, values[1] * gain, values[2] * gain


@dataclass(frozen=True)
class Frame:
    """A view.

    Attributes
    ----------
    rgb : uint8 [height, width, 3]
    classes : uint8 [height, width]
        True class that a pixel shows; `UNKNOWN` where it is sky, outside the map, or not known.
    range_m : float32 [height, width]
        Distance from the lens along the pixel's ray in metres; inf where it is sky.
    """

    rgb: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    range_m: NDArray[np.float32]

    def share(self, class_id: int) -> float:
        """Return the share of all pixels of the frame that show a class."""
        return float(np.count_nonzero(self.classes == class_id)) / self.classes.size


@dataclass(frozen=True)
class _Pyramid:
    """A site's heights and colours at ever halved resolution, flat, as `raymarch` takes them."""

    heights: NDArray[np.float32]
    colours: NDArray[np.uint32]
    ids: NDArray[np.uint8]
    ground: NDArray[np.float32]
    levels: NDArray[np.int64]
    highest_m: float


def _halved(values: NDArray[Any]) -> NDArray[Any]:
    """Return the means of squares of 2 x 2 pixels; an odd last row or column is left out."""
    rows, cols = values.shape[0] // 2, values.shape[1] // 2
    even = values[: 2 * rows, : 2 * cols]
    return np.asarray(cv2.resize(even, (cols, rows), interpolation=cv2.INTER_AREA))


def _pyramid(site: Site) -> _Pyramid:
    heights: list[NDArray[np.float32]] = [np.ascontiguousarray(site.surface_m, np.float32)]
    colours = [np.ascontiguousarray(site.rgb)]
    while min(heights[-1].shape) >= 4:
        heights.append(_halved(heights[-1]))
        colours.append(_halved(colours[-1]))
    levels, start = [], 0
    for height in heights:
        levels.append((start, *height.shape))
        start += height.size
    packed = np.empty(start, np.uint32)
    for (first, rows, cols), colour in zip(levels, colours, strict=True):
        flat = colour.reshape(-1, 3).astype(np.uint32)
        packed[first : first + rows * cols] = flat[:, 0] | flat[:, 1] << 8 | flat[:, 2] << 16
    return _Pyramid(
        np.concatenate([each.ravel() for each in heights]),
        packed,
        np.ascontiguousarray(site.classes, np.uint8).ravel(),
        np.ascontiguousarray(site.ground_m, np.float32).ravel(),
        np.array(levels, np.int64),
        float(site.surface_m.max()),
    )


class Camera:
    """Renders views of a site.

    Views may be taken from several threads at once.

    Parameters
    ----------
    site : Site
    lens : Lens
    weather : Weather, optional
        Default: `Weather.water()` under water, else `Weather.clear()`.
    reach_m : float
        How far things are seen to stand; beyond, the ground goes on level to the horizon.
    """

    def __init__(self, site: Site, lens: Lens = Lens(), weather: Weather | None = None, reach_m: float = 60.0):
        if weather is None:
            weather = Weather.water() if site.under_water else Weather.clear()
        self.site = site
        self._pyramid = _pyramid(site)
        self._set(lens, weather, reach_m)

    def _set(self, lens: Lens, weather: Weather, reach_m: float) -> None:
        self.lens, self.weather, self.reach_m = lens, weather, reach_m
        gains = _scaled(weather.balance, weather.exposure)
        rows = (weather.haze_per_m, weather.veil, weather.sky_horizon, weather.sky_zenith, gains)
        self._light = np.array(rows, np.float32)

    def changed(
        self, *, lens: Lens | None = None, weather: Weather | None = None, reach_m: float | None = None
    ) -> Camera:
        """Return another camera on the same site, at no cost: they share what was made of it."""
        other = object.__new__(Camera)
        other.site, other._pyramid = self.site, self._pyramid
        other._set(lens or self.lens, weather or self.weather, self.reach_m if reach_m is None else reach_m)
        return other

    def ground_m(self, east_m: float, south_m: float) -> float:
        """Return the height of the bare ground at a place; beyond the rim it goes on as it is there."""
        made, per_m = self._pyramid, 1.0 / self.site.pixel_m
        return float(raymarch.ground_height(made.ground, made.levels, east_m * per_m - 0.5, south_m * per_m - 0.5))

    def view(
        self,
        east_m: float,
        south_m: float,
        height_m: float,
        heading_rad: float,
        pitch_rad: float = 0.0,
        roll_rad: float = 0.0,
        *,
        noise_seed: int | None = None,
    ) -> Frame:
        """Render what the lens sees.

        Parameters
        ----------
        east_m, south_m : float
            Place in the site; may lie outside it.
        height_m : float
            Height of the lens among the site's heights. A lens under the bare ground is lifted just above it; one
            inside what stands on the ground (under a tree's crown) looks out of it.
        heading_rad, pitch_rad, roll_rad : float
            Heading as in the site; pitch is positive with the nose up, roll with the right side down.
        noise_seed : int, optional
            Adds the weather's noise: the same for the same seed. Default: none.

        Returns
        -------
        Frame
        """
        made, site, lens = self._pyramid, self.site, self.lens
        focal, per_m = lens.focal_px, 1.0 / site.pixel_m
        ground_m = self.ground_m(east_m, south_m)
        height_m = max(height_m, ground_m + _LOWEST_M)
        place = np.array([east_m * per_m - 0.5, south_m * per_m - 0.5, height_m])
        axes = _axes(pitch_rad, roll_rad)
        first, width, low, high = raymarch.span(axes, focal, lens.width, lens.height)
        first, azimuth_rad, columns = _azimuths(first, width, low, high, focal)
        bin_rad = _ELEVATION_PX / focal
        lowest = math.floor(low / bin_rad - 0.5) - 1
        angles = (np.arange(lowest, math.ceil(high / bin_rad - 0.5) + 2) + 0.5) * bin_rad
        table = np.empty((columns, angles.size), np.float32)
        stations, level_ends = np.empty((3, _MOST_STATIONS)), np.empty(len(made.levels), np.int64)
        limits = (self.reach_m, _LEAST_STEP * site.pixel_m, min(_STEP_PX / focal, _LARGEST_STEP), height_m - ground_m)
        count = raymarch.place_stations(stations, level_ends, made.levels, site.pixel_m, np.array(limits))
        raymarch.march(
            table, np.sin(angles), np.cos(angles), made.heights, made.ground, made.levels, place,
            np.array([heading_rad + first, azimuth_rad, per_m, self.reach_m, made.highest_m - height_m]),
            np.ascontiguousarray(stations[:, :count]), level_ends,
        )  # fmt: skip
        shape = (lens.height, lens.width)
        frame = Frame(np.empty((*shape, 3), np.uint8), np.empty(shape, np.uint8), np.empty(shape, np.float32))
        develop.develop(
            frame.rgb, frame.classes, frame.range_m, np.empty((develop.LINE_ROWS, lens.width), np.float32), table,
            axes.astype(np.float32), np.array([math.sin(heading_rad), math.cos(heading_rad), first], np.float32), focal,
            made.colours, made.ids, made.levels, place.astype(np.float32), self._light,
            np.array([1.0 / focal, bin_rad, per_m, lowest + 0.5, 1.0 / azimuth_rad, 1.0 / _ELEVATION_PX], np.float32),
            np.uint64((noise_seed or 0) & 0xFFFFFFFFFFFFFFFF),
            0.0 if noise_seed is None else self.weather.noise,
        )  # fmt: skip
        return frame


def _axes(pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """Return the lens's right, up and forward in terms of right, ahead and up of the level robot, float64 [3, 3]."""
    sin_p, cos_p, sin_r, cos_r = math.sin(pitch_rad), math.cos(pitch_rad), math.sin(roll_rad), math.cos(roll_rad)
    return np.array([
        [cos_r, sin_r * sin_p, -sin_r * cos_p],
        [sin_r, -cos_r * sin_p, cos_r * cos_p],
        [0.0, cos_p, sin_p],
    ])  # fmt: skip


def _azimuths(first: float, width: float, low: float, high: float, focal: float) -> tuple[float, float, int]:
    """Return first azimuth, step and number of the columns that cover a frame, with one to spare at either side.

    Columns converge downwards: a frame without the horizon needs them only as close as is right at its middle.
    """
    level = 0.0 if low < 0.0 < high else 0.5 * abs(low + high)
    step = _AZIMUTH_PX / focal / max(math.cos(level), 0.1)
    if width >= 2.0 * math.pi:
        count = math.ceil(width / step)
        return first, width / count, count + 1
    return first - step, step, math.ceil(width / step) + 3


__all__ = ["UNKNOWN", "Camera", "Frame", "Lens", "Weather"]
