"""Which files are meant by the paths that an orthomosaic is given as: rasters, and folders of tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hrt_cli.errors import ArgumentError, InputError

_TILES = (".tif", ".tiff", ".jp2", ".img")
_PLAIN_TILES = (".png", ".jpg", ".jpeg")
"""Previews where there are GeoTIFFs; else tiles that a side-car places."""
_SIDE_CARS = (
    *(".ovr", ".msk", ".xml", ".aux", ".rrd", ".ige", ".qml", ".qmd", ".sld", ".clr", ".prj", ".wkt", ".txt", ".csv"),
    *(".tfw", ".tifw", ".tiffw", ".j2w", ".jp2w", ".igw", ".pgw", ".pngw", ".jgw", ".jpgw", ".jpegw", ".wld"),
    *(".json", ".geojson", ".gpkg", ".kml", ".kmz", ".shp", ".shx", ".dbf", ".cpg", ".pdf", ".html", ".md", ".md5"),
)
_NAMED_AT_MOST = 3


@dataclass
class Choice:
    """Which files are meant, in the order of their names, and what was left out."""

    files: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def choose_files(paths: Sequence[Path]) -> Choice:
    """List the files that are meant, sorted by name."""
    if not paths:
        raise ArgumentError("no orthomosaic is named")
    choice = Choice()
    for path in paths:
        if path.is_dir():
            _choose_in_folder(path, choice)
        else:
            choice.files.append(path)
    choice.files.sort(key=lambda path: (path.name, path.absolute().as_posix()))
    seen: dict[tuple[int, int], Path] = {}
    for path in choice.files:
        if not path.is_file():
            raise InputError(path, "no such file")
        status = path.stat()
        identity = status.st_dev, status.st_ino
        if identity in seen:
            raise InputError(path, f"is the same file as {seen[identity]}: give it once")
        seen[identity] = path
    choice.notes.sort()
    return choice


def _choose_in_folder(folder: Path, choice: Choice) -> None:
    tiles, notes = rasters_in(folder)
    choice.files.extend(tiles)
    choice.notes.extend(notes)


def rasters_in(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the rasters that a folder of tiles is read as, by name, and notes on what is left out.

    Raises
    ------
    InputError
        The folder holds none, or cannot be read.
    """
    try:
        inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise InputError(folder, f"cannot be read: {error.strerror or error}") from error
    files = [path for path in inside if path.is_file()]
    tiles = [path for path in files if path.suffix.lower() in _TILES]
    plain = [path for path in files if path.suffix.lower() in _PLAIN_TILES]
    if not tiles:
        tiles, plain = plain, []
    if not tiles:
        vrts = [path for path in files if path.suffix.lower() == ".vrt"]
        remedy = f"name {vrts[0]} itself" if vrts else f"tiles end in {', '.join(_TILES + _PLAIN_TILES)}"
        raise InputError(folder, "is a folder without rasters", remedy)
    stems = {path.stem for path in tiles}
    expected = {*tiles, *(path for path in plain if path.stem in stems)}
    unused = [path.name for path in inside if path not in expected and path.suffix.lower() not in _SIDE_CARS]
    if not unused:
        return tiles, []
    more = f" and {len(unused) - _NAMED_AT_MOST} more" if len(unused) > _NAMED_AT_MOST else ""
    return tiles, [f"not used of the folder {folder.name}: {', '.join(unused[:_NAMED_AT_MOST])}{more}"]
