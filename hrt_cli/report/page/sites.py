"""Which artifacts lie on the same ground, and the map of each such site: its frame, layers, plans and drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.artifacts.plan import read_plan, team_members
from hrt_cli.errors import HrtError
from hrt_cli.logs.read import read_drive_log
from hrt_cli.raster.aoi import read_aoi
from hrt_cli.raster.gate import is_plain, open_raster
from hrt_cli.raster.grid import WGS84, Grid, transform_points
from hrt_cli.raster.scoremap import read_scoremap
from hrt_cli.report.page import layers
from hrt_cli.report.page.collect import Folder, Item, Kind
from hrt_cli.report.page.drives import track
from hrt_cli.report.page.frame import Box, Frame, frame_about, side_of, together
from hrt_cli.report.page.walks import grid_of, plan_lines

Floats = NDArray[np.float64]

MOST_OF_A_KIND = 24
"""Layers of one kind; of more the last are shown."""
_PLACED: tuple[Kind, ...] = (
    "orthomosaic",
    "surface model",
    "terrain model",
    "thermal orthomosaic",
    "index map",
    "measured values",
    "class raster",
    "scoremap",
    "area",
    "drive log",
)
_ALIKE = 0.05
"""Without georeference what differs no more than this in height and width is taken to show the same."""


@dataclass
class Place:
    """Where an item lies: its points as longitude and latitude [n], else (None) how high and wide it is."""

    item: Item
    lonlat: tuple[Floats, Floats] | None
    size: tuple[float, float] = (0.0, 0.0)


@dataclass
class SiteMap:
    """The map of one site.

    Attributes
    ----------
    name : str
    frame : Frame
    items : list of Item
    layers, plans, drives : list of dict
        As the page's script takes them.
    """

    name: str
    frame: Frame
    items: list[Item]
    layers: list[dict[str, Any]] = field(default_factory=list)
    plans: list[dict[str, Any]] = field(default_factory=list)
    drives: list[dict[str, Any]] = field(default_factory=list)
    note: str = ""

    def document(self) -> dict[str, Any]:
        """Return the map as a page's script takes it."""
        box = self._box()
        return {
            "name": self.name,
            "north": self.frame.crs is not None,
            "degrees": self.frame.degrees_over(box),
            "box": list(box),
            "note": self.note,
            "layers": self.layers,
            "plans": self.plans,
            "drives": self.drives,
        }

    def _box(self) -> Box:
        corners: list[tuple[float, float]] = []
        for layer in self.layers:
            if layer["type"] == "area":
                continue
            a, b, c, d, e, f = layer["affine"]
            for col, row in ((0, 0), (layer["cols"], 0), (0, layer["rows"]), (layer["cols"], layer["rows"])):
                corners.append((a * col + b * row + c, d * col + e * row + f))
        if not corners:
            corners = [tuple(point) for plan in self.plans for point in plan["path"]]
            corners += [point for drive in self.drives for point in zip(drive["e"], drive["n"], strict=True)]
        if not corners:
            corners = [tuple(point) for layer in self.layers for ring in layer["rings"] for point in ring]
        east, north = zip(*corners, strict=True)
        return min(east), min(north), max(east), max(north)


def find_sites(folder: Folder) -> list[SiteMap]:
    """Group what has a place by the ground that it lies on; what has none gets a map of its own for each size.

    Items that cannot be placed get a `problem`.
    """
    places = [place for item in folder.of(*_PLACED) + folder.plans() if (place := _place(item)) is not None]
    on_earth = [place for place in places if place.lonlat is not None]
    sites = []
    for group in together([_degrees(place) for place in on_earth]):
        members = [on_earth[k] for k in group]
        lon, lat = (np.concatenate([place.lonlat[axis] for place in members if place.lonlat]) for axis in (0, 1))
        sites.append(SiteMap(_name(members), frame_about(lon.tolist(), lat.tolist()), [p.item for p in members]))
    flat: list[list[Place]] = []
    for place in places:
        if place.lonlat is None:
            alike = next((group for group in flat if _alike(place, group[0])), None)
            flat.append([place]) if alike is None else alike.append(place)
    for members in flat:
        note = "without georeference: lengths are cells or pixels, and north is not known"
        sites.append(SiteMap(f"{_name(members)}, no georeference", Frame(), [p.item for p in members], note=note))
    return sites


def _place(item: Item) -> Place | None:
    try:
        return _placed(item)
    except (HrtError, ValueError) as error:
        item.problem = str(error).removeprefix(f"{item.path}: ")
        return None


def _placed(item: Item) -> Place:
    if item.kind == "drive log":
        log = read_drive_log(item.path)
        if log.own_frame is not None or not (log.geographic or log.crs):
            raise ValueError("its places are in the robot's own frame, which is not on the map")
        x, y = log.place.T
        return Place(item, (x, y) if log.geographic else transform_points(CRS.from_user_input(log.crs), WGS84, x, y))
    if item.kind == "area":
        rings = [outer for outer, _ in read_aoi(item.path).lonlat_polygons()]
        lon, lat = np.concatenate(rings).T
        return Place(item, (lon, lat))
    if item.kind in ("plan", "team plan"):
        first = [*team_members(item.path), item.path][0]
        return _on_grid(item, grid_of(first, read_plan(first)))
    if item.kind == "scoremap" and item.path.suffix.lower() == ".npz":
        return _on_grid(item, read_scoremap(item.path).grid)
    with open_raster(item.path, unreferenced=is_plain(item.path)) as raster:
        return _on_grid(item, raster.grid)


def _on_grid(item: Item, grid: Grid) -> Place:
    if grid.crs is None or grid.placeholder_georeference:
        return Place(item, None, (grid.rows * side_of(grid), grid.cols * side_of(grid)))
    rows, cols = np.array([0, 0, 1, 1]) * grid.rows, np.array([0, 1, 0, 1]) * grid.cols
    return Place(item, grid.lonlat(*grid.xy(rows, cols)))


def _alike(one: Place, other: Place) -> bool:
    return all(abs(a - b) <= _ALIKE * max(a, b) for a, b in zip(one.size, other.size, strict=True))


def _degrees(place: Place) -> Box:
    lon, lat = place.lonlat or (np.zeros(1), np.zeros(1))
    return float(lon.min()), float(lat.min()), float(lon.max()), float(lat.max())


def _name(members: list[Place]) -> str:
    """Name a site after its orthomosaic, else after what comes first."""
    pictures = [place.item for place in members if place.item.kind == "orthomosaic"]
    return (pictures or [place.item for place in members])[0].name


def draw_site(site: SiteMap, detail: int, tick: Callable[[], None]) -> None:
    """Fill in the layers, plans and drives of a site; what cannot be drawn gets a `problem`."""
    for kind, draw in _DRAWN:
        items = [item for item in site.items if item.kind == kind]
        for item in items[:-MOST_OF_A_KIND]:
            item.problem = f"left out: only the last {MOST_OF_A_KIND} of a kind are drawn"
        for item in items[-MOST_OF_A_KIND:]:
            try:
                draw(site, item, detail, last=item is items[-1])
            except (HrtError, ValueError) as error:
                item.problem = str(error).removeprefix(f"{item.path}: ")
            tick()
    site.layers.sort(key=lambda layer: _ORDER.index(layer["group"]))
    _show_the_last(site.plans, lambda plan: bool(plan["length_m"] > 0))
    _show_the_last(site.drives, lambda drive: any(drive[axis] != drive[axis][:1] * len(drive[axis]) for axis in "en"))


def _show_the_last(parts: list[dict[str, Any]], moves: Callable[[dict[str, Any]], bool]) -> None:
    """Show the last file of plans or drives that gets anywhere: in rounds some stay where they are."""
    going = [part for part in parts if moves(part)] or parts
    for part in parts:
        part["shown"] = part["file"] == going[-1]["file"]


def _picture(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    site.layers.append(_layer(layers.picture_layer, site, item, detail, "orthomosaic", shown=last))


def _relief(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    alone = not any(other.kind == "orthomosaic" for other in site.items)
    site.layers.append(_layer(layers.relief_layer, site, item, detail, "heights", shown=alone and last))


def _heat(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    site.layers.append(_layer(layers.heat_layer, site, item, detail, "heat", opacity=0.7))


def _measured(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    def draw(path: Path, frame: Frame, most: int, **about: Any) -> dict[str, Any]:
        return layers.measured_layer(path, frame, most, item.kind, **about)

    site.layers.append(_layer(draw, site, item, detail, "measured", opacity=0.7))


def _classes(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    truth = item.provenance is not None and item.provenance.stage == "synth"
    site.layers.append(_layer(layers.class_layer, site, item, detail, "truth" if truth else "classes", opacity=0.65))


def _scores(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    shown = {"score": 0.6, "no_go": 0.45, "sd": 0.6}
    for part, layer in layers.score_layers(item.path, site.frame).items():
        title = item.name if part == "score" else f"{item.name}, {'no-go' if part == 'no_go' else part}"
        about = {"title": title, "group": part, "shown": last and part == "no_go", "opacity": shown[part]}
        site.layers.append(about | layer)


def _area(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    used = {
        record.sha256
        for other in site.items
        if other.kind == "scoremap" and other.provenance is not None
        for record in other.provenance.inputs
    }
    about = {"title": item.name, "group": "areas", "shown": item.sha256 in used, "opacity": 1.0}
    site.layers.append(layers.area_layer(item.path, site.frame, **about))


def _plan(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    for line in plan_lines(item.path, item.name, site.frame):
        if all(line["name"] != other["name"] for other in site.plans):
            site.plans.append(line | {"file": item.name})


def _drive(site: SiteMap, item: Item, detail: int, *, last: bool) -> None:
    site.drives.append(track(item.path, item.name, site.frame) | {"file": item.name})


def _layer(
    draw: Callable[..., dict[str, Any]],
    site: SiteMap,
    item: Item,
    detail: int,
    group: str,
    *,
    shown: bool = False,
    opacity: float = 1.0,
) -> dict[str, Any]:
    return draw(item.path, site.frame, detail, title=item.name, group=group, shown=shown, opacity=opacity)


_ORDER = ("orthomosaic", "heights", "truth", "classes", "measured", "heat", "score", "sd", "no_go", "areas")
"""From the bottom to the top."""
_DRAWN: tuple[tuple[str, Callable[..., None]], ...] = (
    ("orthomosaic", _picture),
    ("surface model", _relief),
    ("terrain model", _relief),
    ("thermal orthomosaic", _heat),
    ("index map", _measured),
    ("measured values", _measured),
    ("class raster", _classes),
    ("scoremap", _scores),
    ("area", _area),
    ("plan", _plan),
    ("team plan", _plan),
    ("drive log", _drive),
)
