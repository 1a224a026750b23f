"""What other rasters add to the cells of a scoremap: a surface model says where, a raster of interest says why."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hrt_cli.drivability.cells import Cover
from hrt_cli.drivability.interest import Interest, degree, open_interest, values_on, weighed
from hrt_cli.drivability.surface import SHOWN_M, Ground, Relief, ground_of
from hrt_cli.errors import InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.gate import Raster, open_raster
from hrt_cli.raster.heights import open_heights
from hrt_cli.raster.scoremap import Scoremap
from hrt_cli.raster.thermal import Units, in_celsius, settle

_OF_INTEREST = ("interest_range", "interest_cells")
_OF_RELIEF = ("steep_cells", "rough_cells", "terrain_unknown_share")


def sources(raster: Raster, role: str) -> dict[str, Path]:
    """Return the files of a raster by role: itself, a mask side-car, the parts of a VRT."""
    return {name.replace("raster", role, 1): path for name, path in raster.sources().items()}


@dataclass(frozen=True)
class Layers:
    """The rasters beside the classes, looked at before anything is made of them.

    Attributes
    ----------
    interest : Interest or None
    relief : Relief or None
    files : dict of str to Path
        Their files by role.
    units : str or None
        What the temperatures of interest are read in.
    pixel_m : float
        Side of the surface model's pixels.
    notes : list of str
        What the user ought to know of the unit.
    """

    interest: Interest | None
    relief: Relief | None
    files: dict[str, Path]
    units: Units | None
    pixel_m: float
    notes: list[str]

    @property
    def parameters(self) -> dict[str, Any]:
        """What goes into the fingerprint beside the files."""
        found = {"interest": self.interest, "relief": self.relief}
        return {name: layer.parameters for name, layer in found.items() if layer is not None}


def layers_of(interest: Interest | None, relief: Relief | None) -> Layers:
    """Look at the rasters.

    Raises
    ------
    InputError
        One of them cannot be used, or the unit of interest is not as asked (see `thermal.settle`).
    """
    files: dict[str, Path] = {}
    units, note, pixel_m = None, None, 0.0
    if interest is not None:
        with open_interest(interest.path) as raster:
            units, note = settle(raster, interest.units)
            files |= sources(raster, "interest")
    if relief is not None:
        with open_heights(relief.path) as raster:
            files |= sources(raster, "dsm")
            pixel_m = max(raster.grid.pixel_m)
    return Layers(interest, relief, files, units, pixel_m, [note] if note else [])


def relief_on(relief: Relief, covered: Cover, cell_m: float, progress: Progress = silent) -> Ground:
    """Return slope and ruggedness of the cells.

    Raises
    ------
    InputError
        As `ground_of`; or no height is known in any cell that has a class.
    """
    with open_heights(relief.path) as raster:
        ground = ground_of(raster, covered.grid, cell_m, progress)
    if not (ground.known & covered.seen).any():
        raise InputError(relief.path, "tells the height of no cell that has a class")
    return ground


def relief_tags(relief: Relief, ground: Ground, covered: Cover, go: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what is told of the relief; `go` [rows, cols] are the cells that may be entered in the end."""
    return {
        "steep_cells": int((covered.seen & (ground.slope_deg >= relief.slope_limit_deg)).sum()),
        "rough_cells": int((covered.seen & (ground.rugosity >= relief.rugosity_limit)).sum()),
        "terrain_unknown_share": float((go & ~ground.known).sum() / go.sum()),
    }


def relief_notes(layers: Layers, cell_m: float, told: dict[str, Any]) -> list[str]:
    """Return what the user ought to know of the surface model, if there is one; `told` as `told_by` returns it."""
    if layers.relief is None:
        return []
    path, unknown_share = layers.relief.path, told["terrain_unknown_share"]
    notes = []
    if unknown_share > 0:
        percent = f"{unknown_share:.1%}" if unknown_share >= 0.001 else "less than 0.1%"
        notes.append(f"{path}: has no heights for {percent} of the cells to go, which count as level")
    if layers.pixel_m > min(cell_m, SHOWN_M) * (1 + 1e-3):
        notes.append(f"{path}: its pixels measure {layers.pixel_m:.2g} m: obstacles smaller than that do not show")
    return notes


def with_interest(scoremap: Scoremap, interest: Interest, units: Units | None) -> tuple[Scoremap, dict[str, Any]]:
    """Return the scoremap with its scores weighed by interest, and what is told of it.

    Raises
    ------
    InputError
        See `degree`.
    """
    with open_interest(interest.path) as raster:
        values = values_on(raster, scoremap.grid, interest.cell)
        real = values if units is None else in_celsius(values, raster, units)
    go = np.isfinite(scoremap.score)
    tags: dict[str, Any] = {}
    if interest.radius_m is None:
        share, low, high = degree(interest, real, go)
    else:
        from hrt_cli.drivability.reach import interest_at_stations  # it brings a compiler

        radius = interest.radius_m / scoremap.cell_size_m
        share, low, high = degree(interest, real, ndimage.distance_transform_edt(~go) <= radius + 1e-9)
        share, tags["interest_out_of_reach"] = interest_at_stations(real, share, go, radius)
    if units is not None:
        tags["thermal_units"] = units
    tags |= {"interest_range": [low, high], "interest_cells": int(((share > 0) & go).sum())}
    score, sd = (weighed(plain, share, interest.weight) for plain in (scoremap.score, scoremap.sd))
    return Scoremap(score, sd, scoremap.grid, scoremap.cell_size_m), tags


def told_by(path: Path, layers: Layers) -> dict[str, Any]:
    """Return what a scoremap of ours, made with these layers, was tagged with.

    Raises
    ------
    InputError
        The tags are damaged.
    """
    interest = layers.interest
    wanted = [*(_OF_INTEREST if interest else ()), *(_OF_RELIEF if layers.relief else ())]
    if interest and interest.radius_m is not None:
        wanted.append("interest_out_of_reach")
    if interest and interest.units is not None:
        wanted.append("thermal_units")
    with open_raster(path) as raster:
        tags = raster.hrt_tags
    try:
        told = {name: json.loads(tags[name.upper()]) for name in wanted}
        if interest:
            low, high = told["interest_range"]
            told["interest_range"] = float(low), float(high)
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise InputError(path, "its tags are damaged", "use --force to make it again") from error
    return told
