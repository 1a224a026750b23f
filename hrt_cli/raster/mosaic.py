"""The colour bands of an orthomosaic and where they are valid, from one raster or from tiles that lie on one lattice.

Tiles are taken in the order of their names, whatever the order in which they were given: the first lends the lattice,
and where tiles overlap, the first whose pixel is valid wins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import ColorInterp

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.files import choose_files
from hrt_cli.raster.gate import DatasetPool, Raster, is_nodata, load_raster
from hrt_cli.raster.grid import Grid, require_measurable
from hrt_cli.raster.windows import Window

MAX_OPEN = 32
"""Files of a mosaic that a thread keeps open."""
_SAME_SIZE = 1e-6
_SAME_LATTICE_PX = 0.01
_MAX_SPREAD = 1000
_BLURRED_ALPHA = 127
"""Alpha up to which a pixel is transparent where compression with loss has blurred the steps from 0 to 255."""

UNTEXTURED = np.float32(2**32 - 1)
"""What OpenDroneMap writes into all bands of real values where its mesh has no texture (OdmOrthoPhoto.cpp)."""

Colours = NDArray[Any]
Valid = NDArray[np.bool_] | None
"""Where pixels are valid [height, width]; None stands for everywhere."""


class Layer(Protocol):
    """The colour bands of an orthomosaic in the file's own type: one raster (`Single`) or several (`Mosaic`).

    Attributes
    ----------
    path : Path
        What messages name.
    file : Raster
        The raster, of tiles the first: what its header declares of the bands holds for all.
    grid : Grid
    bands : list of int
        The 1-based bands taken as red, green, blue, or one band taken as grey.
    alpha : int or None
        The 1-based band declared as alpha.
    dtype : str
        The type of the pixels.
    palette : uint8 [values, 3] or None
        The colours that the values of a paletted band stand for.
    block_shape : (int, int)
        Rows and columns of the blocks in which the pixels are stored.
    notes : list of str
        What the user ought to know though it was no reason to refuse.
    """

    path: Path
    file: Raster
    grid: Grid
    bands: list[int]
    alpha: int | None
    dtype: str
    palette: NDArray[np.uint8] | None
    block_shape: tuple[int, int]
    notes: list[str]

    def read(self, window: Window, out: Colours | None = None) -> tuple[Colours, Valid]:
        """Read `(colours [band, height, width], valid)` in a window inside the grid; safe from several threads.

        The colours may be put into `out`, of their shape and type, and are then `out` itself.
        """
        ...

    def sources(self) -> dict[str, Path]:
        """Return the files that pixels and validity come from, by role, for provenance."""
        ...


class Single:
    """One raster as a `Layer`."""

    def __init__(self, raster: Raster, bands: tuple[int, ...]) -> None:
        self.file = raster
        self.path = raster.path
        self.grid = raster.grid
        self.notes = raster.notes
        self.bands = _choose_bands(raster, bands)
        alphas = [i + 1 for i, colour in enumerate(raster.colours) if colour == ColorInterp.alpha]
        self.alpha: int | None = alphas[-1] if alphas and alphas[-1] not in self.bands else None
        self.dtype = raster.dtypes[self.bands[0] - 1]
        if any(raster.dtypes[band - 1] != self.dtype for band in self.bands):
            raise InputError(raster.path, "its colour bands are of different types", "use gdal_translate -ot")
        self._transparent = self._transparent_up_to()
        self.palette = raster.palette
        self.block_shape = raster.block_shape

    def read(self, window: Window, out: Colours | None = None) -> tuple[Colours, Valid]:
        """See `Layer`."""
        colours, alpha = self._read(window, out)
        found = [_having_data(colours, [self.file.nodata[band - 1] for band in self.bands])]
        if alpha is not None:
            found.append(alpha > self._transparent)
        elif self.file.has_mask:
            found.append(self.file.read_mask(window))
        valid: Valid = None
        for one in found:
            valid = one if valid is None else valid if one is None else valid & one
        return colours, valid

    def sources(self) -> dict[str, Path]:
        """See `Layer`."""
        return self.file.sources()

    def _read(self, window: Window, out: Colours | None) -> tuple[Colours, NDArray[Any] | None]:
        """Read the colours, and the alpha band as data: GDAL's own mask takes all of a real-valued one for valid."""
        if self.alpha is None:
            return self.file.read_bands(self.bands, window, out), None
        if self.file.dtypes[self.alpha - 1] != self.dtype:  # as only a VRT can have it
            return self.file.read_bands(self.bands, window, out), self.file.read_bands([self.alpha], window)[0]
        values = self.file.read_bands([*self.bands, self.alpha], window)
        return values[: len(self.bands)], values[-1]

    def _transparent_up_to(self) -> int:
        if self.alpha is None or not self.file.lossy or self.file.dtypes[self.alpha - 1] != "uint8":
            return 0
        self.notes.append(
            f"its alpha band is compressed with loss: pixels count as data where it is more than {_BLURRED_ALPHA}"
        )
        return _BLURRED_ALPHA

    def require_like(self, other: Single) -> None:
        """Refuse a tile whose pixels do not mean what another's do.

        Raises
        ------
        InputError
            The number, types, meaning or colour table of the bands differ.
        """
        mine, its = self.file, other.file
        beside = f"does not go with {other.path}"
        if mine.count != its.count:
            raise InputError(self.path, f"{beside}: it has {mine.count} bands, not {its.count}")
        if mine.dtypes != its.dtypes:
            raise InputError(self.path, f"{beside}: its pixels are {mine.dtypes[0]}, not {its.dtypes[0]}")
        if mine.colours != its.colours:
            found, wanted = (", ".join(c.name for c in raster.colours) for raster in (mine, its))
            raise InputError(self.path, f"{beside}: its bands are {found}, not {wanted}")
        if self.palette is not None and (other.palette is None or (self.palette != other.palette).any()):
            raise InputError(self.path, f"{beside}: its colour table differs", "expand both to RGB")


class Mosaic:
    """Several rasters on one lattice as a `Layer`.

    Parameters
    ----------
    tiles : list of Single
        By priority.
    path : Path
        What messages name.

    Raises
    ------
    InputError
        The tiles do not go together, or lie too far apart.
    """

    def __init__(self, tiles: list[Single], path: Path) -> None:
        first = tiles[0]
        for tile in tiles[1:]:
            tile.require_like(first)
        self.path = path
        self.grid, self._origins = _union(path, [tile.path for tile in tiles], [tile.grid for tile in tiles])
        self._ends = self._origins + np.array([tile.grid.shape for tile in tiles])
        self._tiles = tiles
        self.file, self.bands, self.alpha = first.file, first.bands, first.alpha
        self.dtype, self.palette = first.dtype, first.palette
        self.block_shape = first.block_shape
        self.notes = list(dict.fromkeys(note for tile in tiles for note in tile.notes))

    def read(self, window: Window, out: Colours | None = None) -> tuple[Colours, Valid]:
        """See `Layer`."""
        start = np.array([window.row, window.col])
        end = np.array([window.row + window.height, window.col + window.width])
        touching = np.flatnonzero(((self._origins < end) & (self._ends > start)).all(axis=1))
        if len(touching) == 1 and (self._origins[touching] <= start).all() and (self._ends[touching] >= end).all():
            return self._read_tile(int(touching[0]), window)
        colours = np.zeros((len(self.bands), window.height, window.width), self.dtype)
        valid = np.zeros((window.height, window.width), np.bool_)
        for index in touching:
            top, left = (int(edge) for edge in np.maximum(self._origins[index], start))
            bottom, right = (int(edge) for edge in np.minimum(self._ends[index], end))
            there = Window(top - window.row, left - window.col, bottom - top, right - left).slices
            wanted = ~valid[there]
            if not wanted.any():
                continue
            values, good = self._read_tile(int(index), Window(top, left, bottom - top, right - left))
            if good is not None:
                wanted &= good
            if wanted.all():
                colours[:, *there] = values
            else:
                np.copyto(colours[:, *there], values, where=wanted)
            valid[there] |= wanted
        return colours, valid

    def sources(self) -> dict[str, Path]:
        """See `Layer`: each tile under its place in the order, its own parts under that."""
        digits = len(str(len(self._tiles) - 1))
        return {
            role.replace("raster", f"raster/{index:0{digits}d}", 1): path
            for index, tile in enumerate(self._tiles)
            for role, path in tile.sources().items()
        }

    def _read_tile(self, index: int, window: Window) -> tuple[Colours, Valid]:
        row, col = (int(edge) for edge in self._origins[index])
        return self._tiles[index].read(Window(window.row - row, window.col - col, window.height, window.width))


@contextmanager
def open_layer(
    paths: Sequence[Path], *, bands: tuple[int, ...], nodata: float | None, unreferenced: bool
) -> Iterator[Layer]:
    """Open one raster, several, or the rasters of folders through the gate.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders of tiles; their order has no meaning.
    bands, nodata, unreferenced
        As in `hrt_cli.raster.image.open_orthomosaic`.

    Raises
    ------
    InputError
        A file is no raster that the gate lets through, a folder holds none, a file is given twice, or the rasters
        do not lie on one lattice with the same bands.
    """
    choice = choose_files(paths)
    if unreferenced and len(choice.files) > 1:
        raise InputError(
            choice.files[1], f"has no place beside {choice.files[0]}: --unreferenced takes one plain image"
        )
    with DatasetPool(min(len(choice.files), MAX_OPEN)) as pool:
        rasters = [load_raster(path, pool, nodata=nodata, unreferenced=unreferenced) for path in choice.files]
        tiles = [Single(raster, bands) for raster in rasters]
        layer: Layer = tiles[0] if len(tiles) == 1 else Mosaic(tiles, paths[0] if len(paths) == 1 else tiles[0].path)
        layer.notes.extend(choice.notes)
        yield layer


def _union(path: Path, paths: list[Path], grids: list[Grid]) -> tuple[Grid, NDArray[np.int64]]:
    """Return the smallest grid that holds all the tiles, and the first pixel (row, col) of each in it [n, 2]."""
    lattice = grids[0]
    origins = np.array([_place(path, grid, paths[0], lattice) for path, grid in zip(paths, grids, strict=True)])
    shapes = np.array([grid.shape for grid in grids])
    first = origins.min(axis=0)
    rows, cols = (int(n) for n in (origins + shapes).max(axis=0) - first)
    if rows * cols > _MAX_SPREAD * int(shapes.prod(axis=1).sum()):
        far = int(np.abs(origins - np.median(origins, axis=0)).max(axis=1).argmax())
        raise InputError(
            paths[far],
            f"lies far from the other rasters: together they span {rows} x {cols} pixels, nearly all of them empty",
            "leave it out, or segment the sites one by one",
        )
    at_corner = np.flatnonzero((origins == first).all(axis=1))
    # The corner tile's own transform is what one raster cut into these tiles would have, to the last bit.
    corner = grids[at_corner[0]].transform if len(at_corner) else None
    row, col = (int(n) for n in first)
    union = Grid(rows, cols, corner or lattice.transform @ Affine.translation(col, row), lattice.crs)
    require_measurable(path, union)
    return union, origins - first


def _place(path: Path, grid: Grid, lattice_path: Path, lattice: Grid) -> tuple[int, int]:
    """Return the pixel (row, col) of a lattice at which a tile begins."""
    beside = f"does not lie on the lattice of {lattice_path}"
    if grid.crs is not lattice.crs and grid.crs != lattice.crs:
        found, wanted = grid.crs_text(), lattice.crs_text()
        raise InputError(path, f"{beside}: its CRS is {found}, not {wanted}", "reproject it with gdalwarp")
    steps, wanted_steps = (np.array(one.transform[:6]).reshape(2, 3)[:, :2] for one in (grid, lattice))
    sizes, wanted_sizes = np.hypot(*steps), np.hypot(*wanted_steps)
    if (np.abs(sizes / wanted_sizes - 1) > _SAME_SIZE).any():
        described = "its pixels are {:.9g} x {:.9g}, not {:.9g} x {:.9g}".format(*sizes, *wanted_sizes)
        raise InputError(path, f"{beside}: {described}", "resample it with gdalwarp -tr -tap")
    if (np.abs(steps - wanted_steps) > _SAME_SIZE * wanted_sizes).any():
        raise InputError(path, f"{beside}: it is turned or mirrored against it", "resample it with gdalwarp")
    at = np.array(lattice.rowcol(grid.transform.c, grid.transform.f))
    origin = np.rint(at)
    offset = float(np.abs(at - origin).max())
    if not offset <= _SAME_LATTICE_PX:
        raise InputError(path, f"{beside}: it is {offset:.2f} px off", "resample it with gdalwarp -tr -tap")
    return int(origin[0]), int(origin[1])


def _having_data(colours: Colours, nodata: list[float | None]) -> Valid:
    """Where a pixel is data: not where all its bands are nodata (one alone may be black), nor where any is no number.

    Neither is what has no texture.

    Only what may be nodata is looked at: most files declare none, and whole numbers are all finite.
    """
    real = colours.dtype.kind == "f"
    if not real and None in nodata:
        return None
    valid = np.ones(colours.shape[1:], np.bool_)
    if real:
        for plane in colours:
            valid &= np.isfinite(plane)
        valid &= ~(colours == UNTEXTURED).all(axis=0)
    empty = is_nodata(colours[0], nodata[0])
    for plane, value in zip(colours[1:], nodata[1:], strict=True):
        if not empty.any():
            return valid
        empty &= is_nodata(plane, value)
    return valid & ~empty


def _choose_bands(raster: Raster, asked: tuple[int, ...]) -> list[int]:
    if asked:
        if len(asked) not in (1, 3) or not all(1 <= band <= raster.count for band in asked):
            raise ArgumentError(f"{raster.path}: --bands takes one or three of the bands 1 to {raster.count}")
        return list(asked)
    declared = {colour: i + 1 for i, colour in reversed(list(enumerate(raster.colours)))}
    wanted = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(colour in declared for colour in wanted):
        chosen = [declared[colour] for colour in wanted]
    else:
        colours = [i + 1 for i, colour in enumerate(raster.colours) if colour != ColorInterp.alpha]
        if not colours:
            raise InputError(raster.path, "has an alpha band but no colour")
        chosen = colours[:3] if len(colours) >= 3 else colours[:1]
    extra = [i + 1 for i, colour in enumerate(raster.colours) if i + 1 not in chosen and colour != ColorInterp.alpha]
    if extra:
        raster.notes.append(
            f"bands {', '.join(map(str, chosen))} are taken as colour; "
            f"band {', '.join(map(str, extra))} is not declared as alpha and is not used"
        )
    return chosen
