"""Orthomosaics and heights as OpenDroneMap, Pix4Dmapper and Metashape write them, small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio.shutil
from affine import Affine
from numpy.typing import NDArray
from raster_files import PLACE, RGB, RGBA, patches, write_raster
from rasterio.enums import ColorInterp

SIDE = 192
MOST = {"uint8": 255, "uint16": 65535, "float32": 2**32 - 1}
"""What OpenDroneMap writes where it has no texture (OdmOrthoPhoto.cpp, maxRange)."""
SCALE = {"uint8": 1.0, "uint16": 257.0, "float32": 1 / 255}
ODM_LAYOUT = {"tiled": True, "blockxsize": 512, "blockysize": 512, "compress": "deflate", "predictor": 2}


def seen(side: int = SIDE) -> NDArray[np.bool_]:
    """Return where the survey saw anything: a circle with a bay, as crops of surveys are."""
    y, x = np.mgrid[:side, :side] / side - 0.5
    return (x**2 + y**2 < 0.23) & ~((abs(x) < 0.05) & (y > 0.1))


def pixels(side: int = SIDE) -> NDArray[np.uint8]:
    """Return textures [3, rows, cols] of which more than the quantiles of a stretch are 0, and as many 255."""
    found = patches(side, side)
    found[:, side // 3 : side // 3 + 12, 20:-20] = 0
    found[:, side // 2 : side // 2 + 12, 20:-20] = 255
    return found


def odm(path: Path, dtype: str = "uint8", *, opaque: float = 255, side: int = SIDE, **profile: Any) -> Path:
    """Write an orthomosaic as OpenDroneMap does: alpha 255 in every type, the largest value where nothing was seen."""
    shown = np.where(seen(side), pixels(side) * SCALE[dtype], MOST[dtype]).astype(dtype)
    alpha = np.where(seen(side), opaque, 0).astype(dtype)
    colours = profile.pop("colours", RGBA)
    write_raster(path, np.concatenate([shown, alpha[np.newaxis]]), colours=colours, **{**ODM_LAYOUT, **profile})
    return path


def as_cog(path: Path, target: Path, **options: Any) -> Path:
    """Copy a raster as a Cloud Optimised GeoTIFF, as `--cog` does."""
    rasterio.shutil.copy(path, target, driver="COG", COMPRESS="DEFLATE", BLOCKSIZE=256, **options)
    return target


def tag(path: Path, **tags: str) -> Path:
    """Add tags to a raster."""
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(**tags)
    return path


def heights(side: int = SIDE, base: float = 300.0) -> NDArray[np.float32]:
    """Return a hill [rows, cols] in metres."""
    y, x = np.mgrid[:side, :side] / side
    return (base + 8 * np.sin(3 * x) * np.cos(2 * y)).astype(np.float32)


def model(path: Path, *, nodata: float | None = -9999.0, step: int = 1, **options: Any) -> Path:
    """Write a surface model of pixels `step` times as large as the orthomosaic's."""
    values = heights()[::step, ::step].copy()
    values[:20] = -9999.0 if nodata is None else nodata
    transform = options.pop("transform", PLACE @ Affine.scale(step))
    return write_raster(path, values, nodata=nodata, transform=transform, **options)


def pix4d_mosaic(path: Path, *, transparent: bool) -> Path:
    """Write a mosaic as Pix4Dmapper does: black where nothing was seen, with an alpha band or without."""
    shown = np.where(seen(), np.maximum(pixels(), 1), 0).astype(np.uint8)
    alpha = np.where(seen(), 255, 0).astype(np.uint8)
    bands = np.concatenate([shown, alpha[np.newaxis]]) if transparent else shown
    write_raster(path, bands, colours=RGBA if transparent else RGB, compress="lzw")
    return tag(path, TIFFTAG_SOFTWARE="pix4dmapper")


def odm_project(folder: Path) -> Path:
    """Write a project folder of OpenDroneMap."""
    for name in ("odm_orthophoto", "odm_dem"):
        (folder / name).mkdir(parents=True)
    tag(odm(folder / "odm_orthophoto" / "odm_orthophoto.tif"), TIFFTAG_SOFTWARE="ODM 3.5.4")
    model(folder / "odm_dem" / "dsm.tif")
    model(folder / "odm_dem" / "dtm.tif", step=2)
    return folder


def pix4d_project(folder: Path) -> Path:
    """Write a project folder of Pix4Dmapper."""
    for name in ("3_dsm_ortho/2_mosaic", "3_dsm_ortho/1_dsm", "4_index/indices/ndvi"):
        (folder / name).mkdir(parents=True)
    pix4d_mosaic(folder / "3_dsm_ortho" / "2_mosaic" / "site_mosaic_group1.tif", transparent=False)
    pix4d_mosaic(folder / "3_dsm_ortho" / "2_mosaic" / "site_transparent_mosaic_group1.tif", transparent=True)
    model(folder / "3_dsm_ortho" / "1_dsm" / "site_dsm.tif", nodata=-10000.0)
    ndvi = (heights() - 300) / 8
    write_raster(folder / "4_index" / "indices" / "ndvi" / "site_index_ndvi.tif", ndvi, nodata=-10000.0)
    return folder


def metashape_tiles(folder: Path, count: int = 2) -> Path:
    """Write an orthomosaic split in blocks, with an alpha band."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = np.concatenate([pixels(), np.where(seen(), 255, 0).astype(np.uint8)[np.newaxis]])
    part = SIDE // count
    for row in range(count):
        for col in range(count):
            tile = whole[:, row * part : (row + 1) * part, col * part : (col + 1) * part]
            place = PLACE @ Affine.translation(col * part, row * part)
            path = folder / f"ortho-{row}-{col}.tif"
            write_raster(path, tile, transform=place, colours=RGBA)
            tag(path, TIFFTAG_SOFTWARE="Agisoft Metashape Professional 2.1.0")
    return folder


NOT_ALPHA = (*RGB, ColorInterp.undefined)
