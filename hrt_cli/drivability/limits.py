"""Where a robot may not go whatever the ground is like: outside the area of interest, and in keep-outs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.pixel_area import PixelArea
from hrt_cli.raster.scoremap import Scoremap

if TYPE_CHECKING:
    from hrt_cli.raster.aoi import Aoi

AOI_CELLS, KEEP_OUT_CELLS = "aoi_cells", "keep_out_cells"
"""How many cells to go each kind of limit took, by its name in the map's tags and in the summary."""


@dataclass(frozen=True)
class Limits:
    """Files of polygons that limit where the robot may go.

    Attributes
    ----------
    aoi : Path or None
        The area of interest: a cell that does not lie wholly in it is no-go.
    keep_out : tuple of Path
        A cell that one of them touches is no-go.
    """

    aoi: Path | None = None
    keep_out: tuple[Path, ...] = ()

    def files(self) -> dict[str, Path]:
        """Return the files by role, for provenance."""
        aoi = {"aoi": self.aoi} if self.aoi else {}
        return aoi | {f"keep_out/{index}": path for index, path in enumerate(self.keep_out)}

    def counts(self) -> list[str]:
        """Return the names of the counts that a map with these limits carries."""
        return [AOI_CELLS] * (self.aoi is not None) + [KEEP_OUT_CELLS] * bool(self.keep_out)


NO_LIMITS = Limits()


@dataclass(frozen=True)
class PlacedLimits:
    """Limits on the cells of a map.

    A walk over the cells to go, from centre to centre of 4- or 8-neighbours, keeps clear of the keep-outs and stays in
    the area of interest. For a move lies in the closed squares of its two cells, a diagonal one too, as it leads
    through the corner that they share; and of a cell to go not even a corner touches a keep-out or the edge of the
    area. With a margin the whole of its square lies further away than that, and so does the walk.

    Attributes
    ----------
    limits : Limits
    aoi : PixelArea or None
    keep_out : list of PixelArea
    notes : list of str
        What the user ought to know of the files.
    """

    limits: Limits
    aoi: PixelArea | None
    keep_out: list[PixelArea]
    notes: list[str]

    def bar(self, scoremap: Scoremap, margin_m: float, raster: Path) -> tuple[Scoremap, dict[str, Any]]:
        """Return the map with its no-go cells, and as tags how many cells to go each limit took.

        A cell that lies outside the area of interest and in a keep-out counts as taken by the area. `raster` is for the
        message.

        Raises
        ------
        InputError
            A limit leaves no cell to go.
        """
        go = np.isfinite(scoremap.score)
        taken = dict.fromkeys(self.limits.counts(), 0)
        for name, path, barred in self._barred(_reach_px(scoremap.grid, margin_m)):
            taken[name] += int((go & barred).sum())
            go &= ~barred
            if not go.any():
                within = f", {margin_m:g} m of --margin included" if margin_m else ""
                what = "lies wholly in it" if name == AOI_CELLS else "keeps clear of it"
                raise InputError(path, f"leaves nowhere to go on {raster}: no cell that may be entered {what}{within}")
        score, sd = (np.where(go, plain, np.float32(np.nan)) for plain in (scoremap.score, scoremap.sd))
        return Scoremap(score, sd, scoremap.grid, scoremap.cell_size_m), taken

    def _barred(self, reach_px: float) -> Iterator[tuple[str, Path, NDArray[np.bool_]]]:
        if self.limits.aoi and self.aoi:
            yield AOI_CELLS, self.limits.aoi, ~self.aoi.held(reach_px)
        for path, area in zip(self.limits.keep_out, self.keep_out, strict=True):
            yield KEEP_OUT_CELLS, path, area.touched(reach_px)


def place_limits(limits: Limits, grid: Grid, raster: Path) -> PlacedLimits:
    """Read the files and place them on the cells of a map made of `raster`.

    A keep-out that lies outside the map is told of, as it may be meant for another.

    Raises
    ------
    InputError
        A file is no area (see `read_aoi`), the map has no CRS, or the area of interest lies outside it.
    """
    if limits == NO_LIMITS:
        return PlacedLimits(limits, None, [], [])
    # Imported here: most maps have no limits.
    from hrt_cli.raster.aoi import read_aoi

    notes: list[str] = []

    def read(path: Path) -> Aoi:
        drawn = read_aoi(path)
        notes.extend(f"{path}: {note}" for note in drawn.notes)
        return drawn

    aoi = read(limits.aoi).require_on(grid, raster) if limits.aoi else None
    keep_out = []
    for drawn in map(read, limits.keep_out):
        keep_out.append(drawn.on(grid))
        if keep_out[-1].misses_grid:
            why = drawn.why_it_misses(grid)
            notes.append(f"{drawn.path}: lies outside {raster}" + (f" ({why})" if why else ""))
    return PlacedLimits(limits, aoi, keep_out, notes)


def taken_by(limits: Limits, path: Path) -> dict[str, int]:
    """Return from the tags of a scoremap of ours how many cells to go each kind of limit took.

    Raises
    ------
    InputError
        Its tags are damaged.
    """
    if not limits.counts():
        return {}
    with open_raster(path) as raster:
        tags = raster.hrt_tags
    try:
        return {name: int(tags[name.upper()]) for name in limits.counts()}
    except (KeyError, ValueError) as error:
        raise InputError(path, "its tags are damaged", "use --force to make it again") from error


def _reach_px(grid: Grid, margin_m: float) -> float:
    """Return how many cells a margin reaches at most, wherever on the map and in whichever direction."""
    ground = grid.ground
    shortest_m = min(ground.row_m, ground.col_m) * (1 - ground.variation) * math.sqrt(1 - ground.shear)
    return margin_m / shortest_m
