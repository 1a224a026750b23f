"""Who made a raster, and what it is: by its tags, its bands, its values and its name, and how sure that is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.errors import InputError
from hrt_cli.raster.cog import tagged_provenance
from hrt_cli.raster.gate import Raster, is_nodata
from hrt_cli.raster.heights import VOID
from hrt_cli.raster.image import Image
from hrt_cli.raster.windows import probe_windows

Quantity = Literal["surface model", "terrain model", "thermal orthomosaic", "index map"]
Certainty = Literal["declared", "likely", "unclear"]

_WORDS: dict[Quantity, frozenset[str]] = {
    "thermal orthomosaic": frozenset(
        ("thermal", "temperature", "temperatures", "lwir", "tir", "celsius", "kelvin", "degc", "centikelvin")
    ),
    "terrain model": frozenset(("dtm", "terrain")),
    "surface model": frozenset(("dsm", "dem", "chm", "ndsm", "height", "heights", "elevation", "elevations")),
    "index map": frozenset(("ndvi", "ndre", "gndvi", "savi", "evi", "vari", "index", "indices", "reflectance")),
}
"""Words of a name or of a band's description, and what they say that the values are."""
_FOLDERS: dict[str, Quantity] = {
    "odm_dem": "surface model",
    "1_dsm": "surface model",
    "dtm": "terrain model",
    "indices": "index map",
    "reflectance": "index map",
}
"""Folders of OpenDroneMap and Pix4Dmapper."""
_UNITS: dict[str, Quantity] = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), "surface model"),
    **dict.fromkeys(("ft", "foot", "feet", "us survey foot", "us-ft"), "surface model"),
    **dict.fromkeys(("degc", "°c", "celsius", "k", "kelvin", "degrees celsius"), "thermal orthomosaic"),
}
_SMALL = 1.5
"""Reflectances and indices lie below it, heights and temperatures hardly ever do."""
_CENTIKELVIN = (20_000, 40_000)
_MOST_CLASSES = 64
_PROBES = 6
_MOST_BANDS = 8

_TAGS = (
    (re.compile(r"ODM\b[ v]*(.*)", re.IGNORECASE), "OpenDroneMap"),
    (re.compile(r"OpenDroneMap\b[ v]*(.*)", re.IGNORECASE), "OpenDroneMap"),
    (re.compile(r"pix4d *mapper\b[ v]*(.*)", re.IGNORECASE), "Pix4Dmapper"),
    (re.compile(r"(?:agisoft )?metashape\b *(.*)", re.IGNORECASE), "Agisoft Metashape"),
    (re.compile(r"(?:agisoft )?photoscan\b *(.*)", re.IGNORECASE), "Agisoft PhotoScan"),
)
_ODM_FOLDERS = {"odm_orthophoto", "odm_dem"}
_PIX4D_NAME = re.compile(r"_(transparent_)?(mosaic|reflectance)_|_index_[a-z]+$", re.IGNORECASE)
_PIX4D_FOLDERS = {"3_dsm_ortho", "4_index"}


@dataclass(frozen=True)
class Maker:
    """The program that made a raster.

    Attributes
    ----------
    program : str or None
        Its name and version; None where nothing tells.
    by : {"tag", "name"} or None
        Whether the file says so, or only its name and folder are those that the program uses.
    """

    program: str | None
    by: Literal["tag", "name"] | None


@dataclass(frozen=True)
class Kind:
    """What a raster is.

    Attributes
    ----------
    name : str
        "orthomosaic", "surface model", "terrain model", "thermal orthomosaic", "index map", "class raster",
        "scoremap", "measured values" (of a quantity that nothing tells), or "unknown".
    certainty : {"declared", "likely", "unclear"}
        The file says so; several things or its bands speak for it; it could well be something else.
    because : str
        What speaks for it.
    """

    name: str
    certainty: Certainty
    because: str


@dataclass(frozen=True)
class Sample:
    """A bounded look at a raster's pixels.

    Attributes
    ----------
    bands : list of int
        Those looked at, counted from 1: the first few, and the alpha band.
    values : list of arrays [n]
        The values of each, in its own type, at the same n pixels.
    """

    bands: list[int]
    values: list[NDArray[Any]]

    def of(self, band: int) -> NDArray[Any]:
        """Return the values [n] of a band; none where it was not looked at."""
        return self.values[self.bands.index(band)] if band in self.bands else np.empty(0)

    def valid(self, raster: Raster, band: int) -> NDArray[Any]:
        """Return those values of a band that are data, by nodata value and alpha band."""
        values, alpha = self.of(band), alpha_band(raster)
        empty = is_nodata(values, raster.nodata[band - 1])
        return values[~empty & (self.of(alpha) > 0)] if alpha is not None else values[~empty]


def take_sample(raster: Raster) -> Sample:
    """Read a lattice of small windows of a raster."""
    alpha = alpha_band(raster)
    bands = sorted({*range(1, min(raster.count, _MOST_BANDS) + 1), *([alpha] if alpha else [])})
    windows = probe_windows(raster.grid.shape, _PROBES)
    parts = [[raster.read_bands([band], window)[0].ravel() for band in bands] for window in windows]
    return Sample(bands, [np.concatenate(of_band) for of_band in zip(*parts, strict=True)])


def alpha_band(raster: Raster) -> int | None:
    """Return the 1-based band that is declared as alpha, of several the last."""
    found = [band for band, colour in enumerate(raster.colours, start=1) if colour == ColorInterp.alpha]
    return found[-1] if found else None


def data_bands(raster: Raster) -> list[int]:
    """Return the 1-based bands that are not declared as alpha."""
    return [band for band, colour in enumerate(raster.colours, start=1) if colour != ColorInterp.alpha]


def made_with(raster: Raster) -> Maker:
    """Tell which program made a raster."""
    if stage := hrt_stage(raster):
        return Maker(f"hrt {stage}", "tag")
    text = " ".join(raster.tags.get("TIFFTAG_SOFTWARE", "").split())
    for pattern, name in _TAGS:
        if found := pattern.fullmatch(text):
            return Maker(f"{name} {found[1]}".strip(), "tag")
    if text:
        return Maker(text, "tag")
    folders = {part.lower() for part in raster.path.absolute().parts[-4:-1]}
    stem = raster.path.stem.lower()
    if stem.startswith("odm_orthophoto") or folders & _ODM_FOLDERS:
        return Maker("OpenDroneMap", "name")
    if _PIX4D_NAME.search(stem) or folders & _PIX4D_FOLDERS:
        return Maker("Pix4Dmapper", "name")
    return Maker(None, None)


def what_it_is(raster: Raster, sample: Sample) -> Kind:
    """Tell what a raster is."""
    if ours := _of_hrt(raster):
        return Kind(ours, "declared", "so its tags of hrt say")
    bands = data_bands(raster)
    if len(bands) >= 3:
        return _picture(raster, bands)
    if len(bands) == 2:
        scored = raster.descriptions[:2] == ("score", "sd") and np.dtype(raster.dtypes[0]).kind == "f"
        return Kind("scoremap", "likely", "its bands are called score and sd") if scored else _unknown("two bands")
    return _one_band(raster, bands[0], sample) if bands else _unknown("no band but alpha")


def quantity(raster: Raster, band: int) -> tuple[Quantity, str] | None:
    """Return what a raster says that a band (1-based) holds, and where: in unit, description, name or folder."""
    unit, description = raster.units[band - 1], raster.descriptions[band - 1]
    if unit.strip().lower() in _UNITS:
        return _UNITS[unit.strip().lower()], f"its unit is {unit}"
    for text, where in ((description, f"its band is called {description!r}"), (raster.path.stem, "its name says so")):
        words = set(_words(text))
        for name, meant in _WORDS.items():
            if words & meant:
                return name, where
    folder = raster.path.absolute().parent.name.lower()
    return (_FOLDERS[folder], f"its folder is {folder}") if folder in _FOLDERS else None


def hrt_stage(raster: Raster) -> str | None:
    """Return the command of hrt that made a raster; None where none did, or the tags are damaged."""
    try:
        provenance = tagged_provenance(raster)
    except InputError:
        return None
    return provenance.stage if provenance else None


def require_picture(image: Image) -> list[str]:
    """Refuse what holds classes, scores, heights or temperatures where a picture is wanted.

    Returns
    -------
    list of str
        Notes, where it may or may not be one.

    Raises
    ------
    InputError
    """
    raster, bands = image.raster.file, image.bands
    if ours := _of_hrt(raster):
        raise InputError(
            raster.path, f"is a {ours} of hrt, not an orthomosaic", "-b 1 takes it as a picture all the same"
        )
    if len(bands) != 1 or image.stretch is None:
        return []
    low, high = image.stretch.low, image.stretch.high
    dtype, nodata = np.dtype(raster.dtypes[bands[0] - 1]), raster.nodata[bands[0] - 1]
    values = f"its one band holds {dtype} values from {low:.6g} to {high:.6g}"
    told = quantity(raster, bands[0])
    remedy = "give heights to --dsm, temperatures to --interest; -b 1 takes it as a grey picture all the same"
    if told is not None and told[0] != "index map":
        raise InputError(raster.path, f"looks like a {told[0]}, not a picture: {told[1]}, and {values}", remedy)
    if max(abs(low), abs(high)) <= _SMALL or dtype.kind == "u":
        return []
    if nodata in VOID:
        problem = f"looks like heights or temperatures, not a picture: {values}, nodata is {nodata:g}"
        raise InputError(raster.path, problem, remedy)
    return [f"{values}, taken as grey: heights belong to --dsm, temperatures to --interest"]


def _of_hrt(raster: Raster) -> str | None:
    """Return whether a raster is a class raster or a scoremap of hrt; a picture made of one is neither."""
    stage = hrt_stage(raster)
    if (
        raster.count == 1
        and np.dtype(raster.dtypes[0]).kind == "u"
        and (stage == "segment" or "NAMES" in raster.hrt_tags)
    ):
        return "class raster"
    if raster.count <= 2 and np.dtype(raster.dtypes[0]).kind == "f" and stage == "scoremap":
        return "scoremap"
    return None


def _words(text: str) -> Iterable[str]:
    """Split a name into words, also where only a capital divides them."""
    return (word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", text))


def _unknown(why: str) -> Kind:
    return Kind("unknown", "unclear", f"it has {why}")


def _picture(raster: Raster, bands: list[int]) -> Kind:
    rgb = {ColorInterp.red, ColorInterp.green, ColorInterp.blue} <= set(raster.colours)
    named = ", ".join(raster.colours[band - 1].name for band in bands[:_MOST_BANDS])
    told = quantity(raster, bands[0])
    if told is not None and told[0] != "index map":
        return Kind("orthomosaic", "unclear", f"its bands are {named}, but {told[1]}: a picture of a {told[0]}?")
    return Kind("orthomosaic", "likely" if rgb else "unclear", f"its bands are {named}")


def _one_band(raster: Raster, band: int, sample: Sample) -> Kind:
    dtype = np.dtype(raster.dtypes[band - 1])
    told = quantity(raster, band)
    values = sample.valid(raster, band)
    if dtype == np.uint8:
        return _bytes(raster, values, told)
    if told is not None:
        return Kind(told[0], "likely", told[1])
    if not values.size:
        return _unknown("no valid value in a sample")
    low, high = (float(value) for value in np.quantile(values.astype(np.float64), (0.01, 0.99)))
    if dtype == np.uint16:
        if _CENTIKELVIN[0] <= low and high <= _CENTIKELVIN[1]:
            return Kind("thermal orthomosaic", "unclear", f"its values, {low:.0f} to {high:.0f}, may be centi-Kelvin")
        return Kind("orthomosaic", "unclear", "one band of whole numbers: a grey picture?")
    found = f"values from {low:.6g} to {high:.6g}"
    if dtype.kind == "f" and max(abs(low), abs(high)) <= _SMALL:
        return Kind("index map", "unclear", f"{found}: reflectance, an index or scores")
    empty = raster.nodata[band - 1]
    beside = f", nodata {empty:g}" if empty in VOID else ""
    return Kind("measured values", "unclear", f"{found}{beside}: heights or temperatures")


def _bytes(raster: Raster, values: NDArray[Any], told: tuple[Quantity, str] | None) -> Kind:
    if told is not None and told[0] != "index map":
        return Kind("orthomosaic", "unclear", f"{told[1]}, but 8 bits hold a picture of it, not the values")
    different = np.unique(values)
    coded = raster.palette is not None
    if coded or (0 < different.size <= _MOST_CLASSES and int(different.max(initial=0)) < _MOST_CLASSES):
        why = "its values stand for colours of a table" if coded else f"its values are few, 0 to {different.max()}"
        return Kind("class raster", "likely" if coded else "unclear", why)
    return Kind("orthomosaic", "unclear", "one band of 8 bits: a grey picture?")
