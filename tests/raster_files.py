"""Small rasters for the tests, good ones and bad ones, written with plain rasterio."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.control import GroundControlPoint
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.rpc import RPC

UTM33 = "EPSG:32633"
PIXEL_M = 0.1
ORIGIN = (500_000.0, 5_000_000.0)
PLACE = Affine(PIXEL_M, 0, ORIGIN[0], 0, -PIXEL_M, ORIGIN[1])
RGB = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
RGBA = (*RGB, ColorInterp.alpha)


def patches(rows: int = 96, cols: int = 96, seed: int = 0) -> NDArray[np.uint8]:
    """Return four textures in four quarters: [3, rows, cols], no pixel black in all bands."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols]
    quarter = 2 * (y >= rows // 2) + (x >= cols // 2)
    noise = np.array([4.0, 25.0, 12.0, 40.0])[quarter] * rng.normal(size=(rows, cols))
    tints = np.array([[60, 120, 60], [150, 130, 110], [90, 90, 160], [200, 190, 90]], float)
    return np.clip(np.moveaxis(tints[quarter], -1, 0) + noise, 1, 255).astype(np.uint8)


def write_raster(
    path: Path,
    pixels: NDArray[Any],
    *,
    crs: str | None = UTM33,
    transform: Affine | None = PLACE,
    colours: tuple[ColorInterp, ...] | None = None,
    mask: NDArray[np.bool_] | None = None,
    internal_mask: bool = True,
    palette: dict[int, tuple[int, int, int, int]] | None = None,
    **profile: Any,
) -> Path:
    """Write `pixels` [band, rows, cols] (or [rows, cols]) as a raster and return its path."""
    bands = pixels if pixels.ndim == 3 else pixels[np.newaxis]
    options = {"driver": "GTiff", "dtype": bands.dtype.name, **profile}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with (
            rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal_mask),
            rasterio.open(
                path,
                "w",
                count=bands.shape[0],
                height=bands.shape[1],
                width=bands.shape[2],
                crs=crs,
                transform=transform,
                **options,
            ) as dataset,
        ):
            if colours is not None:
                dataset.colorinterp = colours  # before the first pixel, or GTiff forgets what is alpha
            if palette is not None:
                dataset.write_colormap(1, palette)
            dataset.write(bands)
            if mask is not None:
                dataset.write_mask(mask)
    return path


def write_sparse(path: Path, rows: int, cols: int, count: int = 1, **profile: Any) -> Path:
    """Write a GeoTIFF of which no pixel is stored: a small file that promises much."""
    options = {"driver": "GTiff", "dtype": "uint8", "SPARSE_OK": True, **profile}
    with rasterio.open(path, "w", height=rows, width=cols, count=count, crs=UTM33, transform=PLACE, **options):
        pass
    return path


def write_vrt(path: Path, source: str, rows: int = 96, cols: int = 96, extra: str = "") -> Path:
    """Write a VRT of three bands that shows `source`, in UTM 33N."""
    bands = "".join(
        f'<VRTRasterBand dataType="Byte" band="{band}"><ColorInterp>{colour}</ColorInterp>{extra}<SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{source}</SourceFilename><SourceBand>{band}</SourceBand>'
        f'<SrcRect xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"/>'
        f'<DstRect xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"/></SimpleSource></VRTRasterBand>'
        for band, colour in enumerate(("Red", "Green", "Blue"), start=1)
    )
    place = ",".join(map(str, PLACE.to_gdal()))
    path.write_text(
        f'<VRTDataset rasterXSize="{cols}" rasterYSize="{rows}"><SRS>{UTM33}</SRS>'
        f"<GeoTransform>{place}</GeoTransform>{bands}</VRTDataset>"
    )
    return path


def cut(path: Path, share: float) -> Path:
    """Cut a file's end off."""
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    return path


def truncated(path: Path) -> None:
    cut(write_raster(path, patches(), compress="deflate"), 0.8)


def headless(path: Path) -> None:
    cut(write_raster(path, patches(), compress="deflate"), 0.001)


def png(path: Path) -> None:
    write_raster(path, patches(), driver="PNG", crs=None, transform=None)
    path.with_name(path.name + ".aux.xml").unlink(missing_ok=True)


def huge_block(path: Path) -> None:
    write_sparse(path, 64, 64, tiled=True, blockxsize=65536, blockysize=65536)


def gcps_only(path: Path) -> None:
    write_raster(path, patches(), crs=None, transform=None)
    corners = [(0, 0), (0, 96), (96, 0), (96, 96)]
    with rasterio.open(path, "r+") as dataset:
        x, y = PLACE.c, PLACE.f
        dataset.gcps = ([GroundControlPoint(r, c, x + c, y - r) for r, c in corners], rasterio.CRS.from_epsg(32633))


def rpcs_only(path: Path) -> None:
    write_raster(path, patches(), crs=None, transform=None)
    ones = [1.0] + [0.0] * 19
    rpc = RPC(100.0, 50.0, 45.0, 1.0, ones, ones, 48.0, 10.0, 10.0, 1.0, ones, ones, 48.0, 10.0)
    with rasterio.open(path, "r+") as dataset:
        dataset.rpcs = rpc


def complex_pixels(path: Path) -> None:
    write_raster(path, patches().astype(np.complex64))


def complex_whole_pixels(path: Path) -> None:
    write_raster(path, patches().astype(np.complex64), dtype="complex_int16")


def netpbm(path: Path) -> None:
    path.write_bytes(b"P6 4 4 255\n" + bytes(48))


BAD_FILES: dict[str, Callable[[Path], object]] = {
    "absent": lambda path: None,
    "a folder": lambda path: path.mkdir(),
    "empty": lambda path: path.touch(),
    "a web page": lambda path: path.write_text("<!DOCTYPE html><html><body>404</body></html>"),
    "random bytes": lambda path: path.write_bytes(np.random.default_rng(0).bytes(5000)),
    "a tiff header and no more": lambda path: path.write_bytes(b"II*\x00\x08\x00\x00\x00"),
    "cut in the header": headless,
    "cut in the pixels": truncated,
    "another driver": netpbm,
    "png by another name": png,
    "bomb": lambda path: write_sparse(path, 100000, 100000, 3, tiled=True),
    "one huge block": huge_block,
    "no crs": lambda path: write_raster(path, patches(), crs=None),
    "no place": lambda path: write_raster(path, patches(), transform=None),
    "control points only": gcps_only,
    "rpcs only": rpcs_only,
    "complex": complex_pixels,
    "complex whole numbers": complex_whole_pixels,
    "metres called degrees": lambda path: write_raster(path, patches(), crs="EPSG:4326"),
    "sheared": lambda path: write_raster(path, patches(), transform=Affine(0.1, 0.05, 500000.0, 0, -0.1, 5000000.0)),
}
"""Files that no command takes for an orthomosaic, by what is wrong with them."""
