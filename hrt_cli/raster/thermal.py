"""Temperatures of a thermal raster in degrees Celsius, in whatever unit its camera or its maker wrote them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.align import real_values
from hrt_cli.raster.gate import Raster
from hrt_cli.raster.windows import Window, blocks

Units = Literal["celsius", "kelvin", "centikelvin"]
Asked = Literal["celsius", "kelvin", "centikelvin", "auto"]

ZERO_C = -273.15
_IN_CELSIUS: dict[Units, tuple[float, float]] = {
    "celsius": (1.0, 0.0),
    "kelvin": (1.0, ZERO_C),
    "centikelvin": (0.01, ZERO_C),
}
NAMES: dict[Units, str] = {"celsius": "degrees Celsius", "kelvin": "Kelvin", "centikelvin": "centi-Kelvin"}

GROUND_C = (-90.0, 1200.0)
"""The median of a survey's temperatures lies within, whatever burns there."""

_TAGS: tuple[tuple[str, Units | Literal["fahrenheit"]], ...] = (
    (r"c|°c|degc|deg c|.*\bcelsius\b.*|.*\bcentigrade\b.*", "celsius"),
    (r"ck|.*\bcenti-?kelvins?\b.*|.*\bk(elvin)? ?[x*] ?100|0\.01 ?k(elvin)?", "centikelvin"),
    (r"k|°k|degk|.*\bkelvins?\b.*", "kelvin"),
    (r"f|°f|degf|deg f|.*\bfahrenheit\b.*", "fahrenheit"),
)
_NAMES_UNIT = re.compile(r"celsius|centigrade|kelvin|fahrenheit", re.IGNORECASE)
_CENTIKELVIN = 20_000.0, 40_000.0
_CENTIKELVIN_MEDIAN = 23_000.0, 36_000.0
_KELVIN_MEDIAN = 230.0, 400.0
_COLDEST_KELVIN = 200.0
_CELSIUS_MEDIAN = -40.0, 150.0
_SAMPLE_SIDE = 64
_SAMPLE_ALONG = 12


@dataclass(frozen=True)
class Readings:
    """What a sample of a raster's values tells, scale and offset of the band applied.

    Attributes
    ----------
    dtype : str
        As stored.
    said : str
        The band's unit tag, else its description if that names a unit.
    least, first, median, last, most : float
        Minimum, 1 %, 50 %, 99 % and maximum.
    whole : bool
        All are whole numbers.
    """

    dtype: str
    said: str
    least: float
    first: float
    median: float
    last: float
    most: float
    whole: bool

    def celsius(self, units: Units) -> tuple[float, float, float]:
        """Return minimum, median and maximum in degrees Celsius."""
        scale, offset = _IN_CELSIUS[units]
        return self.least * scale + offset, self.median * scale + offset, self.most * scale + offset

    def fits(self, units: Units) -> bool:
        """Whether the ground of a survey can be as warm."""
        return GROUND_C[0] <= self.celsius(units)[1] <= GROUND_C[1]


@dataclass(frozen=True)
class Guess:
    """In what unit temperatures seem to be: None if in none that is known; `why` says what tells so."""

    units: Units | None
    certain: bool
    why: str


def guess(seen: Readings) -> Guess:
    """Guess the unit of temperatures from what is said of them and from where they lie.

    Certain are a unit that the file names and numbers that nothing else has: centi-Kelvin where 98 % lie in 20000 to
    40000 with the median of ground that is not all ice or fire, Kelvin where 99 % are above 200 and the median is in
    230 to 400 and they are no whole numbers (tenths of degrees look alike). Degrees Celsius are never told from
    Fahrenheit or plain counts by their numbers alone, and pictures of 8 bits hold no temperatures.
    """
    named = next((units for form, units in _TAGS if re.fullmatch(form, seen.said.strip().lower())), None)
    if named == "fahrenheit":
        return Guess(None, False, "it says that it is in degrees Fahrenheit")
    if named is not None:
        sure = seen.fits(named)
        return Guess(named, sure, f"it says {seen.said.strip()!r}" + ("" if sure else ", which its numbers belie"))
    if np.dtype(seen.dtype).itemsize == 1:
        return Guess(None, False, "pictures of 8 bits hold no temperatures")
    if _within(seen.median, _CENTIKELVIN_MEDIAN):
        sure = seen.first >= _CENTIKELVIN[0] and seen.last <= _CENTIKELVIN[1]
        return Guess("centikelvin", sure, "its numbers lie in 20000 to 40000" if sure else "its median does")
    if _within(seen.median, _KELVIN_MEDIAN) and seen.first > _COLDEST_KELVIN:
        sure = not seen.whole
        return Guess(
            "kelvin", sure, "its numbers lie above 200" + ("" if sure else ", but tenths of degrees could too")
        )
    if _within(seen.median, _CELSIUS_MEDIAN):
        return Guess("celsius", False, "its numbers could be, but also degrees Fahrenheit or counts")
    return Guess(None, False, "its numbers are those of no known unit")


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def readings(raster: Raster) -> Readings | None:
    """Read a sample of a raster's first band: all of a small one, else windows on a regular lattice.

    Zeros of 16 bits are left out: absolute zero, or what was not seen. None if it holds no value at all.
    """
    found = _sample(raster, _windows(raster.grid.shape))
    if not found.size:
        found = _sample(raster, blocks(raster.grid.shape, 2048), until_found=True)
    if not found.size:
        return None
    values = found.astype(np.float64) * raster.scales[0] + raster.offsets[0]
    least, first, median, last, most = (float(v) for v in np.quantile(values, (0.0, 0.01, 0.5, 0.99, 1.0)))
    said = raster.units[0] or (raster.descriptions[0] if _NAMES_UNIT.search(raster.descriptions[0]) else "")
    return Readings(raster.dtypes[0], said, least, first, median, last, most, bool((values == np.rint(values)).all()))


def _windows(shape: tuple[int, int]) -> Iterable[Window]:
    if max(shape) <= _SAMPLE_SIDE * _SAMPLE_ALONG * 2:
        return blocks(shape, 1024)
    tops, lefts = (
        sorted({int(at) for at in np.linspace(0, max(side - _SAMPLE_SIDE, 0), _SAMPLE_ALONG)}) for side in shape
    )
    height, width = (min(_SAMPLE_SIDE, side) for side in shape)
    return [Window(top, left, height, width) for top in tops for left in lefts]


def _sample(raster: Raster, windows: Iterable[Window], *, until_found: bool = False) -> NDArray[np.float32]:
    found: list[NDArray[np.float32]] = [np.zeros(0, np.float32)]
    sixteen_bits = raster.dtypes[0] in ("uint16", "int16")
    for window in windows:
        values = real_values(raster, window)
        real = values[~np.isnan(values)]
        found.append(real[real != 0] if sixteen_bits else real)
        if until_found and found[-1].size:
            break
    return np.concatenate(found)


def settle(raster: Raster, asked: Asked | None) -> tuple[Units | None, str]:
    """Return the unit in which a raster's temperatures are to be read, and a note on it ("": none).

    Parameters
    ----------
    asked : str or None
        A unit, or "auto" to take what is certain. None: values stay as they are, with a note if they look like
        Kelvin or centi-Kelvin.

    Raises
    ------
    InputError
        It cannot be as asked, or with "auto" is not certain.
    """
    seen = readings(raster)
    if asked is None:
        return None, _suspicion(raster, seen)
    if seen is None:
        raise InputError(raster.path, "holds no value")
    if asked != "auto":
        return asked, _contradiction(raster, seen, asked)
    found = guess(seen)
    reads = f"reads {_three((seen.least, seen.median, seen.most))} (least, median, most)"
    if found.units is None:
        raise InputError(raster.path, f"{reads}: {found.why}", "convert it to degrees Celsius, or say --thermal-units")
    as_celsius = f"{_three(seen.celsius(found.units))} °C"
    if not found.certain:
        what = f"{reads}, in {NAMES[found.units]} {as_celsius}, which is a guess: {found.why}"
        raise InputError(raster.path, what, f"say --thermal-units {found.units} if that is right")
    return found.units, f"{raster.path}: taken to be in {NAMES[found.units]}, for {found.why}: {as_celsius}"


def temperatures_in(raster: Raster) -> str:
    """Say for people in which unit a raster's temperatures are, or seem to be."""
    seen = readings(raster)
    if seen is None:
        return "holds no temperature at all"
    found = guess(seen)
    if found.units is None:
        return f"the unit of its temperatures is not known: {found.why}"
    as_celsius = f"{NAMES[found.units]}, {_three(seen.celsius(found.units))} °C (least, median, most)"
    if found.certain:
        return f"temperatures in {as_celsius}: {found.why}"
    return f"perhaps temperatures in {as_celsius}: {found.why}; --thermal-units {found.units} confirms it"


def _contradiction(raster: Raster, seen: Readings, asked: Units) -> str:
    """Refuse a unit in which no ground is as warm; return a note where another one is certain."""
    if not seen.fits(asked):
        would = f"is not in {NAMES[asked]}: it would be {_three(seen.celsius(asked))} °C (least, median, most)"
        raise InputError(raster.path, would, "see --thermal-units")
    found = guess(seen)
    if not found.certain or found.units in (None, asked):
        return ""
    return f"{raster.path}: taken to be in {NAMES[asked]} as asked, but looks like {NAMES[found.units]}: {found.why}"


def _suspicion(raster: Raster, seen: Readings | None) -> str:
    found = None if seen is None else guess(seen)
    if found is None or not found.certain or found.units in (None, "celsius"):
        return ""
    return (
        f"{raster.path}: looks like temperatures in {NAMES[found.units]} ({found.why}), and its numbers are taken as "
        f"they are; --thermal-units {found.units} reads them in degrees Celsius"
    )


def _three(values: tuple[float, float, float]) -> str:
    return " / ".join(f"{value:.4g}" if abs(value) < 10_000 else f"{value:.0f}" for value in values)


def in_celsius(values: NDArray[np.float32], raster: Raster, units: Units) -> NDArray[np.float64]:
    """Return values of a raster's first band in degrees Celsius; NaN where they are at absolute zero or below."""
    scale, offset = _IN_CELSIUS[units]
    meant = values.astype(np.float64) * raster.scales[0] + raster.offsets[0]
    celsius = meant * scale + offset
    return np.where(celsius > ZERO_C, celsius, math.nan)
