"""What goes wrong with rasters of mapping programs: what `hrt` does about it, or what the user should.

Facts about the programs: OpenDroneMap's sources (OdmOrthoPhoto.cpp, opendm/), Pix4D's and Agisoft's manuals.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rasterio.crs import CRS

from hrt_cli.raster.gate import Raster
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.heights import VOID
from hrt_cli.raster.mosaic import UNTEXTURED
from hrt_cli.raster.recognise import Kind, Maker, Sample, alpha_band, data_bands
from hrt_cli.raster.thermal import temperatures_in

MODELS = ("surface model", "terrain model", "measured values")
_COARSE_M = 0.25
"""Of a model on coarser pixels, a step that stops a robot may not show."""
_LARGE_PX = 4096
_FEW = 0.001
_ABOUT = 1.01


def traps(raster: Raster, grid: Grid | None, sample: Sample, kind: Kind, maker: Maker) -> list[str]:
    """Tell the traps of a raster that opening it does not tell.

    Parameters
    ----------
    raster : Raster
    grid : Grid or None
        Its georeference, where that can be trusted.
    sample, kind, maker
        What was found out about it.
    """
    notes = [*_alpha(raster, sample), *_undeclared_alpha(raster, sample), *_untextured(raster, sample)]
    notes += _margin(raster, kind, maker)
    notes += _thermal(raster, sample, kind, maker)
    notes += _undeclared_nodata(raster, sample)
    notes += _scaled(raster)
    if grid is not None and grid.crs is not None:
        notes += _crs(raster, grid, grid.crs, kind)
    if kind.name in MODELS:
        notes += _model(raster, grid)
    if max(raster.grid.shape) > _LARGE_PX and not raster.overviews:
        notes.append(
            "it has no overviews: hrt needs none, but other programs show it slowly; gdaladdo -r average adds them"
        )
    return notes


def _alpha(raster: Raster, sample: Sample) -> list[str]:
    band = alpha_band(raster)
    if band is None:
        return []
    dtype = np.dtype(raster.dtypes[band - 1])
    values = sample.of(band)
    most = float(values.max(initial=0))
    notes = []
    if dtype.kind == "f":
        notes.append(
            f"its alpha band is {dtype}: GDAL and what is built on it take every pixel for valid; hrt reads the band "
            "itself and takes alpha > 0"
        )
    elif dtype != np.uint8 and most <= np.iinfo(np.uint8).max:
        notes.append(
            f"its alpha is at most {most:g} of {np.iinfo(dtype).max}: programs that blend by it show it nearly "
            "transparent; hrt takes alpha > 0"
        )
    elif dtype == np.uint8 and 0 < most < np.iinfo(np.uint8).max:
        notes.append(f"its alpha is at most {most:g} of 255, as after warping; hrt takes alpha > 0")
    partly = float(((values > 0) & (values < most)).mean()) if values.size else 0.0
    if partly > _FEW and not raster.lossy:
        notes.append(f"{partly:.1%} of its pixels are partly transparent; hrt takes alpha > 0 as data")
    return notes


def _undeclared_alpha(raster: Raster, sample: Sample) -> list[str]:
    """Tell of a last band of 0 and one other value: it is an alpha band in all but name."""
    bands = data_bands(raster)
    if len(bands) not in (2, 4, 5) or alpha_band(raster) is not None or bands[-1] not in sample.bands:
        return []
    different = np.unique(sample.of(bands[-1]))
    if different.size != 2 or different[0] != 0:
        return []
    name = f"colorinterp_{bands[-1]}"
    return [
        f"its band {bands[-1]} holds nothing but 0 and {different[1]:g}, like an alpha band, but is not declared as "
        f"one, so hrt takes no notice of it: gdal_edit.py -{name} alpha declares it"
    ]


def _untextured(raster: Raster, sample: Sample) -> list[str]:
    bands = [band for band in data_bands(raster) if band in sample.bands]
    if not bands or any(np.dtype(raster.dtypes[band - 1]).kind != "f" for band in bands):
        return []
    alpha = alpha_band(raster)
    shown = sample.of(alpha) > 0 if alpha else np.ones(sample.values[0].shape, np.bool_)
    bare = np.all([sample.of(band) == UNTEXTURED for band in bands], axis=0) & shown
    if not bare.any():
        return []
    return [
        f"{bare.mean():.1%} of its pixels are {2**32 - 1} in all bands, OpenDroneMap's mark for no texture, though not "
        "transparent; hrt takes them as no data"
    ]


def _margin(raster: Raster, kind: Kind, maker: Maker) -> list[str]:
    """Tell of margins that no alpha band or mask covers; see also `hrt_cli.raster.margins`."""
    if kind.name != "orthomosaic" or alpha_band(raster) is not None or raster.has_mask:
        return []
    notes = []
    if raster.lossy and raster.nodata[0] is not None:
        notes.append(
            f"it is compressed with loss: its margin is not exactly its nodata value {raster.nodata[0]:g} everywhere, "
            "and what differs counts as data; mask it with GDAL's nearblack -setmask"
        )
    stem = raster.path.stem.lower()
    if (maker.program or "").startswith("Pix4D") and "_mosaic_" in stem and raster.nodata[0] is None:
        notes.append(
            "Pix4D's mosaic without transparency is black where nothing was seen, and that counts as data: --nodata 0 "
            f"leaves it out; better take {_transparent(raster.path)}"
        )
    return notes


def _transparent(path: Path) -> str:
    head, mosaic, tail = path.name.rpartition("_mosaic_")
    beside = path.with_name(f"{head}_transparent{mosaic}{tail}")
    return f"{beside.name}, which lies beside it" if beside.is_file() else "its *_transparent_mosaic_*.tif"


def _thermal(raster: Raster, sample: Sample, kind: Kind, maker: Maker) -> list[str]:
    pictured = "thermal" in kind.because and kind.name == "orthomosaic"
    if kind.name != "thermal orthomosaic" and not pictured and "thermal" not in raster.path.stem.lower():
        return []
    if (maker.program or "").startswith("Pix4D") and "mosaic" in raster.path.stem.lower():
        return [
            "Pix4D balances the colours of its mosaics, so their values are no temperatures: take the index map of the "
            "thermal band (4_index) for --interest"
        ]
    if pictured:
        return ["it is a picture of temperatures, not temperatures: hotter need not be brighter in it"]
    return [temperatures_in(raster)]


def _undeclared_nodata(raster: Raster, sample: Sample) -> list[str]:
    notes = []
    for band in data_bands(raster):
        if np.dtype(raster.dtypes[band - 1]).kind == "u":
            continue
        values = sample.valid(raster, band) if band in sample.bands else np.empty(0)
        for value in VOID:
            share = float((values == value).mean()) if values.size else 0.0
            if share > _FEW:
                notes.append(
                    f"{share:.1%} of band {band} is {value:g}, which nothing declares as nodata: none to hrt, a "
                    f"measurement to other programs; gdal_edit.py -a_nodata {value:g} declares it"
                )
    return notes


def _scaled(raster: Raster) -> list[str]:
    meant = ((raster.scales[band - 1], raster.offsets[band - 1]) for band in data_bands(raster))
    scaled = [each for each in meant if each != (1.0, 0.0)]
    if not scaled:
        return []
    scale, offset = scaled[0]
    return [
        f"it declares a scale of {scale:g} and an offset of {offset:g}, which hrt applies to the heights and the "
        "temperatures of a scoremap and nowhere else: gdal_translate -unscale -ot Float32 does once and for all"
    ]


def _crs(raster: Raster, grid: Grid, crs: CRS, kind: Kind) -> list[str]:
    notes = []
    row_m, col_m = grid.pixel_m
    if crs.is_geographic:
        notes.append(
            f"its coordinates are degrees; hrt measures on the ground, where a pixel is {col_m:.4g} x {row_m:.4g} m"
        )
    elif abs(crs.linear_units_factor[1] - 1.0) > 1e-9:
        notes.append(
            f"its coordinates are in {crs.linear_units}; hrt measures on the ground, where a pixel is {col_m:.4g} x "
            f"{row_m:.4g} m"
        )
        if kind.name in MODELS and not any(raster.units):
            notes.append(f"its heights may be in {crs.linear_units} too; hrt takes them for metres")
    if _is_compound(crs):
        notes.append("its CRS is a compound one: hrt places it by the horizontal part, heights have the vertical unit")
    return notes


def _is_compound(crs: CRS) -> bool:
    return str(crs.to_wkt()).startswith(("COMPD_CS", "COMPOUNDCRS"))


def _model(raster: Raster, grid: Grid | None) -> list[str]:
    notes = []
    band = data_bands(raster)[0]
    unit = raster.units[band - 1].lower()
    if any(name in unit for name in ("ft", "foot", "feet")):
        notes.append(f"its heights are in {raster.units[band - 1]}: hrt makes metres of them")
    if grid is not None and grid.crs is not None and max(grid.pixel_m) > _COARSE_M * _ABOUT:
        notes.append(
            f"its pixels are {max(grid.pixel_m):.3g} m: obstacles and steps smaller than that do not show in it"
        )
    return notes
