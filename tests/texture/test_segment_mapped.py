"""Orthomosaics as OpenDroneMap writes them, segmented; and heights, which are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from mapping_files import as_cog, heights, model, odm, seen
from numpy.typing import NDArray
from raster_files import patches, write_raster

from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import InputError
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.stage import ImageOptions, Wanted, segment_file

AGAIN = Existing(overwrite=True, force=True)


def classes(ortho: Path, **options: Any) -> NDArray[np.uint8]:
    output = ortho.with_name("classes.tif")
    segment_file([ortho], output, Wanted(SegmentSpec(4)), image_options=ImageOptions(**options), existing=AGAIN)
    with rasterio.open(output) as dataset:
        return dataset.read(1)


def test_classes_are_the_same_in_every_type_and_255_exactly_where_nothing_was_seen(tmp_path: Path) -> None:
    plain = classes(odm(tmp_path / "plain.tif"))
    np.testing.assert_array_equal(plain != 255, seen())
    for dtype, opaque in (("uint8", 1), ("uint16", 255), ("uint16", 65535), ("float32", 255), ("float32", 1)):
        np.testing.assert_array_equal(classes(odm(tmp_path / "a.tif", dtype, opaque=opaque)), plain)
    np.testing.assert_array_equal(classes(as_cog(tmp_path / "a.tif", tmp_path / "cog.tif")), plain)


class TestWhatIsNoPicture:
    def test_a_surface_model_is_refused_by_its_name(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"dsm\.tif: looks like a surface model.*its name says so.*-b 1 takes it"):
            classes(write_raster(tmp_path / "site_dsm.tif", heights()))
        assert not (tmp_path / "classes.tif").exists()

    def test_or_by_its_nodata_value_and_heights(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"looks like heights or temperatures.*nodata is -9999"):
            classes(model(tmp_path / "a.tif"))

    def test_unless_its_band_is_asked_for(self, tmp_path: Path) -> None:
        assert (classes(model(tmp_path / "site_dsm.tif"), bands=(1,)) != 255).any()

    @pytest.mark.parametrize("nodata", [None, -9999.0])
    def test_one_band_of_reflectance_is_a_grey_picture(self, tmp_path: Path, nodata: float | None) -> None:
        grey = (patches()[0] / 255).astype(np.float32)
        assert (classes(write_raster(tmp_path / "red.tif", grey, nodata=nodata)) != 255).any()

    def test_real_values_that_nothing_explains_are_taken_with_a_note(self, tmp_path: Path) -> None:
        path = write_raster(tmp_path / "a.tif", patches()[0].astype(np.float32))
        done = segment_file([path], tmp_path / "classes.tif", Wanted(SegmentSpec(4)))
        assert any("heights belong to --dsm, temperatures to --interest" in note for note in done.notes)

    def test_classes_of_before_are_no_picture(self, tmp_path: Path) -> None:
        classes(odm(tmp_path / "a.tif"))
        with pytest.raises(InputError, match=r"classes\.tif: is a class raster of hrt, not an orthomosaic"):
            segment_file([tmp_path / "classes.tif"], tmp_path / "again.tif", Wanted(SegmentSpec(3)))
