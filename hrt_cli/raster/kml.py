"""Polygons in KML 2.0 to 2.3 (OGC 07-147r2, 12-007r2), plain or zipped as KMZ: what Google Earth and GCS programs draw.

The file is read as a stream of elements, so that memory is bounded by its text. Elements count by their names, whatever
namespace they claim: what looks like a polygon is either read or refused, never lost.
"""

from __future__ import annotations

import lzma
import re
import xml.etree.ElementTree as ET
import zipfile
import zlib
from itertools import islice
from pathlib import Path

from hrt_cli.artifacts.jsonio import MAX_DEPTH, read_text
from hrt_cli.errors import InputError
from hrt_cli.raster import polygons
from hrt_cli.raster.grid import WGS84
from hrt_cli.raster.polygons import Drawn, PolygonChecker

MAX_BYTES = 64 * 2**20
"""Of a KML file, and of a KMZ: a million positions with all their digits."""

_DECLARES = re.compile(r"<!\s*(?:DOCTYPE|ENTITY)", re.IGNORECASE)
_NAMESPACE = re.compile(r"http://(?:www\.opengis\.net|earth\.google\.com)/kml/2\.[0-3]")
_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_POSITION = re.compile(rf"({_NUMBER}),({_NUMBER})(?:,{_NUMBER})?")
_WORD = re.compile(r"\S+")
_COLLECTIONS = {"Placemark", "MultiGeometry", "GeometryCollection"}
_OTHER_SHAPES = {"LineString", "Track", "MultiTrack", "Model"}
_LINKS = {"NetworkLink", "NetworkLinkControl"}
_BOUNDARIES = ("outerBoundaryIs", "innerBoundaryIs")


def read_kml(path: Path) -> Drawn:
    """Read the polygons of all placemarks, in WGS 84; heights, styles and visibility have no meaning here.

    Placemarks that are points or hold no shape at all are labels, and passed over with a note. Lines, tracks and models
    are refused, as a fence drawn as a line would keep nobody out, and so are links to other files.

    Raises
    ------
    InputError
        The file is no XML or no KML, declares a document type or entities, holds what is refused, or rings that are
        none (see `PolygonChecker`); it is a KMZ that is damaged, too large or without one KML that is the main one.
    """
    text = _unzipped(path) if path.suffix.lower() == ".kmz" else read_text(path, MAX_BYTES)
    if _DECLARES.search(text):
        raise InputError(path, "declares a document type or entities, which no KML needs")
    reader = _Reader(path)
    parser = ET.XMLParser(target=reader)
    try:
        parser.feed(text)
        parser.close()
    except ET.ParseError as error:
        raise InputError(path, f"is not XML that can be read: {error}") from error
    return Drawn(WGS84, reader.polygons, reader.notes)


class _Reader:
    """Follows the elements of a KML file as the parser meets them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.polygons: list[object] = []
        self._check = PolygonChecker(path, True, "give degrees, longitude first")
        self._open: list[str] = []
        self._hidden: list[bool] = []
        self._rings: dict[str, list[list[list[float]]]] = {}
        self._texts: list[str] | None = None
        self._read = 0
        self._shapes = 0
        self._labels = 0
        self._unseen = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """What was passed over, and what counts though Google Earth does not show it."""
        notes = []
        if self._labels:
            notes.append(f"placemarks that are points, or hold no shape, are passed over: {self._labels}")
        if self._unseen:
            notes.append(f"polygons that are hidden (visibility 0) count all the same: {self._unseen}")
        return tuple(notes)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Take note of an element that begins."""
        namespace, _, name = tag.rpartition("}")
        inside = self._open[-1] if self._open else ""
        if not inside and (name != "kml" or (namespace and not _NAMESPACE.fullmatch(namespace[1:]))):
            raise InputError(self.path, f"is not KML: it begins with an element {tag[:60]}")
        if len(self._open) >= MAX_DEPTH:
            raise InputError(self.path, f"is nested deeper than {MAX_DEPTH} levels")
        if name in _LINKS:
            raise InputError(self.path, f"holds a {name}, to what is not in the file", "save the polygons themselves")
        is_line = name == "LinearRing" and inside not in _BOUNDARIES
        if name in _OTHER_SHAPES or is_line:
            raise InputError(self.path, f"holds a {name}; an area is made of Polygons")
        if (name == "Polygon" and inside not in _COLLECTIONS) or (name in _BOUNDARIES and inside != "Polygon"):
            raise InputError(self.path, f"is not KML: a {name} stands in a {inside[:40]}")
        if name == "Placemark":
            self._shapes = 0
        elif name == "Polygon":
            self._rings = {boundary: [] for boundary in _BOUNDARIES}
        elif name == "LinearRing":
            self._rings[inside].append([])
        self._texts = [] if name == "visibility" or (name == "coordinates" and inside == "LinearRing") else None
        self._open.append(name)
        self._hidden.append(False)

    def data(self, text: str) -> None:
        """Keep a piece of text, if it is one of those that count."""
        if self._texts is not None:
            self._texts.append(text)

    def end(self, tag: str) -> None:
        """Take in an element that ends."""
        name, text = self._open.pop(), "".join(self._texts or ())
        self._texts = None
        self._hidden.pop()
        if name == "visibility" and text.strip() in ("0", "false") and self._hidden:
            self._hidden[-1] = True
        elif name == "coordinates" and self._open[-1] == "LinearRing":
            self._rings[self._open[-2]][-1] += self._positions(text)
        elif name == "Polygon":
            self._take_polygon()
        elif name == "Placemark" and not self._shapes:
            self._labels += 1

    def close(self) -> None:
        """Be done: the parser asks for this."""

    def _take_polygon(self) -> None:
        outer, holes = (self._rings[boundary] for boundary in _BOUNDARIES)
        if len(outer) > 1:
            raise InputError(self.path, "holds a polygon with several outer rings")
        self.polygons.append(self._check.polygon([*outer, *holes] if outer else []))
        self._shapes += 1
        self._unseen += any(self._hidden)

    def _positions(self, text: str) -> list[list[float]]:
        words = list(islice(_WORD.finditer(text), polygons.MAX_POSITIONS + 1 - self._read))
        self._read += len(words)
        if self._read > polygons.MAX_POSITIONS:
            raise InputError(self.path, f"holds more than {polygons.MAX_POSITIONS} positions", "simplify it")
        return [self._position(word[0]) for word in words]

    def _position(self, word: str) -> list[float]:
        found = _POSITION.fullmatch(word)
        if found is None:
            raise InputError(
                self.path, f"holds the position {word[:60]!r}, which is not of the form lon,lat[,altitude]"
            )
        return [float(found[1]), float(found[2])]


def _unzipped(path: Path) -> str:
    """Return the main KML of a KMZ: `doc.kml`, or the only one."""
    try:
        if not path.is_file():
            raise InputError(path, "no such file")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(path, f"is more than the {MAX_BYTES} bytes long that are read")
        with zipfile.ZipFile(path) as archive:
            found = [info for info in archive.infolist() if info.filename.lower().endswith(".kml")]
            main = [info for info in found if info.filename.lower() == "doc.kml"] or found
            if len(main) != 1:
                raise InputError(path, f"holds {len(main)} KML files, of which none is the main one: doc.kml")
            with archive.open(main[0]) as file:
                content = file.read(MAX_BYTES + 1)
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError, ValueError) as error:
        # RuntimeError: encrypted, or (NotImplementedError) compressed in a way that is not known.
        raise InputError(path, f"is no KMZ that can be read: {error or type(error).__name__}") from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if len(content) > MAX_BYTES:
        raise InputError(path, f"holds a KML of more than the {MAX_BYTES} bytes that are read")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"its {main[0].filename[:60]!r} is not a UTF-8 text file") from error
