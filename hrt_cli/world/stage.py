"""The synth stage: a sample site as the files that a survey and its ground truth would be."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.artifacts.carriers import json_provenance, publish_json
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import OutputError
from hrt_cli.progress import Progress, silent
from hrt_cli.raster.classes import NODATA, publishing_classes
from hrt_cli.raster.cog import Layout, cog_provenance, publishing_cog
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.style import class_qml
from hrt_cli.raster.windows import Window
from hrt_cli.world.synth import Site, SiteSpec, make_site

STAGE = "synth"
STAGE_VERSION = 1

DSM_STEP_M = 0.01
THERMAL_STEP_C = 0.1

# A made-up place in a real CRS, far from any zone's edge, so that ground metres and map metres nearly agree.
_PLACES = {
    "meadow": ("EPSG:32632", 431_000.0, 5_210_000.0),
    "wildfire": ("EPSG:32610", 561_000.0, 4_405_000.0),
    "reef": ("EPSG:32620", 203_000.0, 1_459_000.0),
}


@dataclass(frozen=True)
class SynthSummary:
    """What the synth stage wrote: the files by role, the class names, and where the robot starts (lon, lat)."""

    up_to_date: bool
    files: dict[str, Path]
    class_names: tuple[str, ...]
    shape: tuple[int, int]


def synthesize(
    folder: Path, spec: SiteSpec, *, existing: Existing = REFUSE, progress: Progress = silent
) -> SynthSummary:
    """Write a sample site into `folder` (made if absent).

    The files are `ortho.tif`, `truth.tif`, `dsm.tif`, for a wildfire `thermal.tif`, `aoi.geojson` and `world.json`;
    the last holds what only a simulator may know (the true drivability), and is never read by a planner.

    Raises
    ------
    ArgumentError
        The specification is out of range.
    OutputError
        The folder cannot be made or written, or holds other files of these names.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; a sample site needs a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
    files = {name: folder / file for name, file in _FILES.items() if name != "thermal" or spec.scene == "wildfire"}
    outputs = {path: json_provenance if path.suffix.endswith("json") else cog_provenance for path in files.values()}
    parameters = json.loads(json.dumps(asdict(spec)))
    job = begin(STAGE, STAGE_VERSION, inputs={}, parameters=parameters, outputs=outputs, existing=existing)
    if job.up_to_date:
        world = json.loads(files["world"].read_text(encoding="utf-8"))
        names = tuple(entry["name"] for entry in world["classes"].values())
        return SynthSummary(True, files, names, spec.shape)
    site = make_site(spec, progress)
    grid = _grid(spec)
    _write_rasters(files, site, grid, job.provenance)
    publish_json(files["aoi"], _aoi(site, grid), job.provenance)
    publish_json(files["world"], _world(site, grid), job.provenance)
    return SynthSummary(False, files, site.class_names, spec.shape)


_FILES = {
    "ortho": "ortho.tif",
    "truth": "truth.tif",
    "dsm": "dsm.tif",
    "thermal": "thermal.tif",
    "aoi": "aoi.geojson",
    "world": "world.json",
}


def _grid(spec: SiteSpec) -> Grid:
    code, x, y = _PLACES[spec.scene]
    rows, cols = spec.shape
    transform = Affine(spec.pixel_m, 0.0, x, 0.0, -spec.pixel_m, y)
    return Grid(rows, cols, transform, CRS.from_string(code))


def _write_rasters(files: dict[str, Path], site: Site, grid: Grid, provenance: Provenance) -> None:
    whole = Window(0, 0, grid.rows, grid.cols)
    ortho = Layout(("red", "green", "blue"), "uint8", rgb=True, resampling="average")
    with publishing_cog(files["ortho"], grid, ortho, provenance) as writer:
        writer.write(whole, np.moveaxis(site.rgb, -1, 0), site.valid)
    names = list(site.class_names)
    with publishing_classes(files["truth"], grid, names, provenance, tags={}, creation={}) as writer:
        writer.write(whole, site.truth)
        counts = np.bincount(site.truth[site.truth != NODATA], minlength=len(names))
        writer.style = class_qml(names, (counts / max(1, counts.sum())).tolist())
    _write_field(files["dsm"], "height above the datum in metres", site.dsm, DSM_STEP_M, grid, provenance)
    if site.thermal_c is not None:
        _write_field(
            files["thermal"], "temperature in degrees Celsius", site.thermal_c, THERMAL_STEP_C, grid, provenance
        )


def _write_field(
    path: Path, what: str, values: NDArray[np.float32], step: float, grid: Grid, provenance: Provenance
) -> None:
    """Write a field rounded to `step`, its instrument's resolution: digits that mean nothing do not compress."""
    layout = Layout((what,), "float32", nodata=-9999.0, resampling="average")
    with publishing_cog(path, grid, layout, provenance) as writer:
        writer.write(Window(0, 0, grid.rows, grid.cols), np.round(values / step) * np.float32(step))


def _aoi(site: Site, grid: Grid) -> dict[str, Any]:
    """Return the area of interest as GeoJSON: WGS 84, counter-clockwise, closed (RFC 7946)."""
    rows, cols = zip(*site.aoi, strict=True)
    lon, lat = grid.lonlat(*grid.xy(rows, cols))
    ring = [[round(float(x), 8), round(float(y), 8)] for x, y in zip(lon, lat, strict=True)]
    doubled_area = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(ring, ring[1:] + ring[:1], strict=True))
    if doubled_area < 0:
        ring.reverse()
    polygon = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
    feature = {"type": "Feature", "properties": {"name": "area of interest"}, "geometry": polygon}
    return {"type": "FeatureCollection", "features": [feature]}


def _world(site: Site, grid: Grid) -> dict[str, Any]:
    at: Callable[[float, float], list[float]] = lambda row, col: [float(v) for v in grid.xy(row + 0.5, col + 0.5)]  # noqa: E731
    start = at(*site.start)
    lon, lat = grid.lonlat(*start)
    return {
        "format": "hrt-world",
        "version": 1,
        "scene": site.spec.scene,
        "seed": site.spec.seed,
        "crs": grid.crs_text(),
        "pixel_m": site.spec.pixel_m,
        "start": {"xy": start, "lonlat": [float(lon[0]), float(lat[0])]},
        "target_class": site.target_class,
        "classes": {
            str(k): {"name": name, "drivability": site.drivability[k], "obstacle": bool(site.obstacle[k])}
            for k, name in enumerate(site.class_names)
        },
        "hotspots": [{"xy": at(spot.row, spot.col), **_spot(spot)} for spot in site.hotspots],
    }


def _spot(spot: Any) -> dict[str, float]:
    return {key: float(value) for key, value in asdict(spot).items() if key not in ("row", "col")}
