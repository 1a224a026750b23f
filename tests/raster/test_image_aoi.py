from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from pyproj import Transformer
from raster_files import PLACE, UTM33, patches, write_raster

from hrt_cli.errors import InputError
from hrt_cli.raster.image import open_orthomosaic
from hrt_cli.raster.windows import Window

ROWS, COLS = 150, 200
TURNED = Affine.translation(500_000, 5_000_000) @ Affine.rotation(30) @ Affine.scale(0.1, -0.1)


def draw(folder: Path, corners: list[tuple[float, float]], place: Affine = PLACE) -> Path:
    """Write an area by its corners (row, col) in pixels of the raster."""
    ring = [list(place @ (col, row)) for row, col in [*corners, corners[0]]]
    crs = {"type": "name", "properties": {"name": UTM33}}
    path = folder / "area.geojson"
    path.write_text(json.dumps({"type": "Polygon", "coordinates": [ring], "crs": crs}))
    return path


TRIANGLE = [(20.2, 30.3), (100.6, 60.4), (60.1, 170.7)]


def inside_triangle() -> np.ndarray:
    row, col = np.mgrid[:ROWS, :COLS] + 0.5
    corners = np.array(TRIANGLE)
    sides = []
    for (r0, c0), (r1, c1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        sides.append((col - c0) * (r1 - r0) - (row - r0) * (c1 - c0) > 0)
    return np.logical_and.reduce(sides) | ~np.logical_or.reduce(sides)


@pytest.mark.parametrize("place", [PLACE, TURNED])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_an_area_clips_the_image_and_changes_no_value(tmp_path: Path, dtype: str, place: Affine) -> None:
    pixels = patches(ROWS, COLS).astype(dtype) * (1 if dtype == "uint8" else 90)
    pixels[:, 50:70, 80:110] = 0
    path = write_raster(tmp_path / "a.tif", pixels, nodata=0, transform=place)
    aoi = draw(tmp_path, TRIANGLE, place)
    with open_orthomosaic([path]) as whole, open_orthomosaic([path], aoi=aoi) as image:
        there = Window(20, 30, 81, 141)
        assert image.shape == (81, 141)
        assert image.grid.transform.almost_equals(place @ Affine.translation(30, 20), 1e-6)
        assert image.anchor == (whole.anchor[0] + 20, whole.anchor[1] + 30)
        assert (image.stretch, image.valid_share, image.pixel_m) == (whole.stretch, whole.valid_share, whole.pixel_m)
        assert image.notes == whole.notes
        assert image.sources() == {"raster": path, "aoi": aoi}
        rgb, valid = image.read(Window(-5, -6, 100, 160))
        whole_rgb, whole_valid = whole.read(Window(0, 0, ROWS, COLS))
        expected = (whole_valid & inside_triangle())[there.slices]
        np.testing.assert_array_equal(valid[5:86, 6:147], expected)
        assert valid.sum() == expected.sum()
        np.testing.assert_array_equal(rgb[5:86, 6:147][expected], whole_rgb[there.slices][expected])
        for window in (Window(0, 0, 3, 3), Window(10, 30, 40, 50), Window(60, 100, 30, 50)):
            np.testing.assert_array_equal(image.read(window)[1], valid[5:, 6:][window.slices])


def test_an_area_beyond_the_raster_is_cut_at_its_edge(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches(ROWS, COLS))
    aoi = draw(tmp_path, [(-50, 120), (-50, 900), (60, 900), (60, 120)])
    with open_orthomosaic([path], aoi=aoi) as image:
        assert image.shape == (60, 80)
        assert image.read(Window(0, 0, 60, 80))[1].all()


def test_an_area_clips_tiles_too(tmp_path: Path) -> None:
    (tmp_path / "tiles").mkdir()
    pixels = patches(ROWS, COLS)
    whole = write_raster(tmp_path / "whole.tif", pixels)
    for col in (0, 90):
        place = PLACE @ Affine.translation(col, 0)
        write_raster(tmp_path / "tiles" / f"{col:02d}.tif", pixels[:, :, col : col + 110], transform=place)
    aoi = draw(tmp_path, TRIANGLE)
    with open_orthomosaic([whole], aoi=aoi) as one, open_orthomosaic([tmp_path / "tiles"], aoi=aoi) as other:
        rgb, valid = one.read(Window(0, 0, *one.shape))
        other_rgb, other_valid = other.read(Window(0, 0, *other.shape))
        assert other.sources()["aoi"] == aoi
    np.testing.assert_array_equal(valid, other_valid)
    np.testing.assert_array_equal(rgb[valid], other_rgb[valid])


@pytest.mark.parametrize(
    ("corners", "options", "problem"),
    [
        ([(500, 500), (500, 600), (600, 600)], {}, r"area\.geojson: lies outside .*a\.tif$"),
        ([(10, 10), (10, 30), (30, 30), (30, 10)], {"nodata": 0}, r"area\.geojson: holds no valid pixel of .*a\.tif$"),
        ([(70.6, 70.6), (70.6, 70.9), (70.9, 70.9)], {}, r"area\.geojson: holds no valid pixel of .*a\.tif$"),
    ],
)
def test_an_area_of_nothing_is_refused_with_both_names(
    tmp_path: Path, corners: list[tuple[float, float]], options: dict[str, Any], problem: str
) -> None:
    pixels = patches(ROWS, COLS)
    pixels[:, :40, :40] = 0
    path = write_raster(tmp_path / "a.tif", pixels, **options)
    with pytest.raises(InputError, match=problem), open_orthomosaic([path], aoi=draw(tmp_path, corners)):
        pass


def test_colours_are_counted_inside_the_area(tmp_path: Path) -> None:
    pixels = np.full((3, ROWS, COLS), 90, np.uint8)
    pixels[:, :, 100:] = patches(ROWS, 100)
    path = write_raster(tmp_path / "a.tif", pixels)
    left = draw(tmp_path, [(10, 10), (10, 90), (90, 90), (90, 10)])
    with open_orthomosaic([path], aoi=left) as image:
        assert image.has_colours(1)
        assert not image.has_colours(2)
    with open_orthomosaic([path]) as image:
        assert image.has_colours(50)


def test_a_plain_image_has_no_place_for_an_area(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.png", patches(ROWS, COLS), driver="PNG")
    aoi = draw(tmp_path, TRIANGLE)
    with (
        pytest.raises(InputError, match="has no coordinate reference system"),
        open_orthomosaic([path], unreferenced=True, aoi=aoi),
    ):
        pass


def test_an_area_in_kml_clips_as_one_in_geojson_and_its_notes_are_told(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", patches(ROWS, COLS))
    to_earth = Transformer.from_crs(UTM33, "OGC:CRS84", always_xy=True)
    ring = [to_earth.transform(*(PLACE @ (col, row))) for row, col in [*TRIANGLE, TRIANGLE[0]]]
    kml = tmp_path / "area.kml"
    kml.write_text(
        "<kml><Document><Placemark><Point/></Placemark><Placemark><Polygon><outerBoundaryIs><LinearRing><coordinates>"
        + " ".join(f"{lon!r},{lat!r}" for lon, lat in ring)
        + "</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></Document></kml>"
    )
    whole = Window(0, 0, ROWS, COLS)
    with open_orthomosaic([path], aoi=draw(tmp_path, TRIANGLE)) as same, open_orthomosaic([path], aoi=kml) as image:
        assert image.grid == same.grid
        for one, other in zip(image.read(whole), same.read(whole), strict=True):
            np.testing.assert_array_equal(one, other)
        assert image.notes == [
            *same.notes,
            f"of the area {kml}: placemarks that are points, or hold no shape, are passed over: 1",
        ]
