"""A folder of what a mapping program made: which rasters are in it, whether they go together, what to run on them."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hrt_cli.errors import HrtError, InputError
from hrt_cli.inspection.rasters import USES, Inspection, inspect_raster, inspect_rasters
from hrt_cli.raster.files import rasters_in
from hrt_cli.raster.grid import Grid, transform_points
from hrt_cli.raster.mosaic import open_layer

_ODM = ("odm_orthophoto/odm_orthophoto.tif", "odm_dem/dsm.tif", "odm_dem/dtm.tif")
_PIX4D = ("2_mosaic/*_mosaic_*.tif", "1_dsm/*_dsm.tif", "extras/dtm/*_dtm.tif")
_PIX4D_TILES = "2_mosaic/tiles"
_PIX4D_INDEX = ("4_index/reflectance/*.tif", "4_index/indices/*/*.tif")
_MOST = 40
"""Rasters of a folder that are looked at one by one."""

_MODELS = ("surface model", "terrain model")
_GRID_POINTS = 33
_COVERED = 0.99
_ABOUT = 1.01


@dataclass(frozen=True)
class Project:
    """What was found in a folder.

    Attributes
    ----------
    program : str or None
        Whose project it is laid out like.
    found : list of Inspection
        Each with `path` among its facts, relative to the folder: of tiles that make one orthomosaic, their folder.
    notes : list of str
        What there is to know of them together.
    commands : list of str
        What to run on them, as a shell takes it.
    """

    program: str | None
    found: list[Inspection]
    notes: list[str]
    commands: list[str]


def inspect_folder(folder: Path, *, nodata: float | None = None) -> Project:
    """Look at the rasters of a project of OpenDroneMap or Pix4Dmapper, or of any folder.

    Raises
    ------
    InputError
        There is no raster in it.
    """
    program, parts, notes = _choose(folder)
    found = [_look(folder, part, nodata) for part in parts]
    if program is None and len(found) > 1 and all(one.facts["kind"] == "orthomosaic" for one in found):
        notes.append(f"they are no tiles of one orthomosaic: {_apart([path for [path] in parts])}")
    ortho = _first(found, "orthomosaic")
    for other in (_first(found, *_MODELS), _first(found, "thermal orthomosaic")):
        if ortho is not None and other is not None:
            notes += _beside(ortho, other)
    return Project(program, found, notes, _commands(folder, found))


def _choose(folder: Path) -> tuple[str | None, list[list[Path]], list[str]]:
    """Return whose folder it is, its rasters (each one file, or the tiles of one orthomosaic), and notes."""
    if odm := [folder / name for name in _ODM if (folder / name).is_file()]:
        return "OpenDroneMap", [[path] for path in odm], []
    if pix4d := _pix4d(folder):
        return "Pix4Dmapper", pix4d, []
    rasters, notes = rasters_in(folder)
    if len(rasters) > 1 and _apart(rasters) is None:
        return None, [rasters], notes
    if len(rasters) > _MOST:
        notes.append(f"of its {len(rasters)} rasters only the first {_MOST} were looked at")
        return None, [[path] for path in rasters[:_MOST]], notes
    return None, [[path] for path in rasters], []


def _pix4d(folder: Path) -> list[list[Path]]:
    base = folder / "3_dsm_ortho" if (folder / "3_dsm_ortho").is_dir() else folder
    files = [[path] for pattern in _PIX4D for path in sorted(base.glob(pattern))]
    if not any("_mosaic_" in path.name for [path] in files) and (base / _PIX4D_TILES).is_dir():
        files.insert(0, rasters_in(base / _PIX4D_TILES)[0])
    if not files:
        return []
    # The mosaic without an alpha band comes after all others, so that it is not the one to be segmented.
    files.sort(key=lambda part: "_mosaic_" in part[0].name and "_transparent_mosaic_" not in part[0].name)
    return files + [[path] for pattern in _PIX4D_INDEX for path in sorted(folder.glob(pattern))]


def _apart(rasters: list[Path]) -> str | None:
    """Return why rasters are not the tiles of one orthomosaic; None if they are."""
    try:
        with open_layer(rasters, bands=(), nodata=None, unreferenced=False) as layer:
            return None if len(layer.bands) == 3 else "they have one band"
    except HrtError as error:
        return str(error)


def _look(folder: Path, part: list[Path], nodata: float | None) -> Inspection:
    place = part[0] if len(part) == 1 else part[0].parent
    name = Path(os.path.relpath(place, folder)).as_posix()
    try:
        if len(part) == 1:
            seen = inspect_raster(place, nodata=nodata)
        else:
            seen = inspect_tiles(part, named=[place], nodata=nodata)
    except InputError as error:
        return Inspection({"path": name, "file": place.name, "kind": "unknown"}, [], str(error))
    return replace(seen, facts={"path": name, **seen.facts})


def inspect_tiles(
    tiles: list[Path], *, named: list[Path], bands: tuple[int, ...] = (), nodata: float | None = None
) -> Inspection:
    """Look at several rasters as at one orthomosaic.

    Parameters
    ----------
    tiles : list of Path
    named : list of Path
        What the user calls them by: the files, or their folder.

    Raises
    ------
    InputError
        The first is no raster at all.
    """
    seen = inspect_rasters(tiles, first=min(tiles, key=lambda path: path.name), bands=bands, nodata=nodata)
    size = sum(path.stat().st_size for path in tiles if path.is_file())
    (use,) = USES["orthomosaic"]
    uses = [use.replace("FILE", shlex.join(map(str, named)))] if seen.facts["kind"] == "orthomosaic" else []
    return replace(seen, facts={**seen.facts, "bytes": size, "tiles": len(tiles), "used_by": uses})


def _first(found: list[Inspection], *kinds: str) -> Inspection | None:
    fit = [one for one in found if one.facts["kind"] in kinds and one.grid is not None]
    return fit[0] if fit else None


def _beside(ortho: Inspection, other: Inspection) -> list[str]:
    """Tell where another raster does not lie on the orthomosaic."""
    mine, its = ortho.grid, other.grid
    if mine is None or its is None:
        return []
    name, notes = f"{other.facts['path']} (the {other.facts['kind']})", []
    covered = _covered(mine, its)
    if covered == 0:
        return [f"{name} lies wholly beside {ortho.facts['path']}: they are not of one survey, or a CRS is wrong"]
    if covered < _COVERED:
        notes.append(f"{name} covers {covered:.0%} of {ortho.facts['path']}; beyond it hrt knows no values")
    if mine.crs != its.crs:
        notes.append(
            f"{name} is in another CRS ({_short(its)}) than {ortho.facts['path']} ({_short(mine)}); hrt reprojects"
        )
    if max(its.pixel_m) > max(mine.pixel_m) * _ABOUT:
        sizes = f"{max(its.pixel_m):.3g} m, those of {ortho.facts['path']} {max(mine.pixel_m):.3g} m"
        notes.append(f"the pixels of {name} are {sizes}: what is smaller shows in the colours only")
    return notes


def _short(grid: Grid) -> str:
    text = grid.crs_text() or "none"
    return text if text.startswith("EPSG") else text.split('"')[1] if '"' in text else text


def _covered(mine: Grid, its: Grid) -> float:
    """Return the share of a raster that lies within the bounds of another."""
    along = (np.arange(_GRID_POINTS) + 0.5) / _GRID_POINTS
    rows, cols = (a.ravel() * side for a, side in zip(np.meshgrid(along, along), mine.shape, strict=True))
    x, y = mine.xy(rows, cols)
    if mine.crs is None or its.crs is None:
        return 0.0
    if mine.crs != its.crs:
        try:
            x, y = transform_points(mine.crs, its.crs, x, y)
        except ValueError:
            return 0.0
    back = ~its.transform
    col, row = back.a * x + back.b * y + back.c, back.d * x + back.e * y + back.f
    return float(((row >= 0) & (row < its.rows) & (col >= 0) & (col < its.cols)).mean())


def _commands(folder: Path, found: list[Inspection]) -> list[str]:
    """Return what leads from an orthomosaic, or from classes, to a mission."""
    ortho, classes = _first(found, "orthomosaic"), _first(found, "class raster")
    commands, source = [], "classes.tif"
    if ortho is not None and ortho.refusal is None:
        commands.append(f"hrt segment {_quoted(folder, ortho)} -o classes.tif --classes 5")
    elif classes is not None:
        source = _quoted(folder, classes)
    else:
        return []
    scoremap = f"hrt scoremap {source} -o scoremap.tif"
    model, thermal = _first(found, *_MODELS), _first(found, "thermal orthomosaic")
    base = ortho or classes
    if model is not None and base is not None and _overlap(base, model):
        scoremap += f" --dsm {_quoted(folder, model)}"
    if thermal is not None and base is not None and _overlap(base, thermal):
        scoremap += f" --interest {_quoted(folder, thermal)} --thermal-units auto"
    commands += [scoremap, "hrt plan scoremap.tif -o plan.json --start auto --budget 400m"]
    if base is not None and not base.facts.get("placeholder_georeference"):
        commands.append("hrt export plan.json -o mission.plan")
    return commands


def _overlap(one: Inspection, other: Inspection) -> bool:
    return one.grid is not None and other.grid is not None and _covered(one.grid, other.grid) > 0


def _quoted(folder: Path, one: Inspection) -> str:
    return shlex.quote(os.path.normpath(folder / one.facts["path"]))
