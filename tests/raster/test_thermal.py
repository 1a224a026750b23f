"""In what unit temperatures are: the guess on a table of cameras and slips, and what is done with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from raster_files import PLACE, write_raster

from hrt_cli.errors import InputError
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.thermal import Guess, Readings, guess, in_celsius, readings, settle


def seen(dtype: str, *values: float, said: str = "", whole: bool = False) -> Readings:
    return Readings(dtype, said, *values, whole)


TABLE = [
    # MicaSense Altum and DJI H20T: hundredths of a Kelvin; a morning, an afternoon with a fire, a frost.
    (seen("uint16", 28010, 28300, 29100, 30200, 31000, whole=True), "centikelvin", True),
    (seen("uint16", 29000, 29300, 30500, 34000, 65535, whole=True), "centikelvin", True),
    (seen("uint16", 24500, 25000, 26000, 26600, 27000, whole=True), "centikelvin", True),
    (seen("float32", 28010.2, 28300.5, 29100.1, 30200.7, 31000.3), "centikelvin", True),
    # The same with what is none of it.
    (seen("uint16", 1, 300, 29100, 30200, 31000, whole=True), "centikelvin", False),
    (seen("uint16", 28010, 28300, 29100, 60000, 65535, whole=True), "centikelvin", False),
    # Kelvin: Planck's formula in a script.
    (seen("float32", 270.2, 275.1, 293.3, 320.4, 600.5), "kelvin", True),
    (seen("float64", 250.2, 251.1, 260.3, 270.4, 280.5), "kelvin", True),
    # Tenths of degrees Celsius in 16 bits look like Kelvin.
    (seen("uint16", 210, 215, 293, 320, 600, whole=True), "kelvin", False),
    (seen("float32", 210, 215, 293, 320, 600, whole=True), "kelvin", False),
    (seen("float32", 10.5, 190.3, 293.3, 320.4, 600.5), None, False),
    # Degrees Celsius, which OpenDroneMap writes, are in the range of Fahrenheit and of counts.
    (seen("float32", 8.2, 10.1, 22.5, 60.3, 281.4), "celsius", False),
    (seen("float32", -30.2, -25.1, -12.5, -3.3, 0.4), "celsius", False),
    (seen("int16", 8, 10, 22, 60, 281, whole=True), "celsius", False),
    (seen("float32", 50.2, 61.1, 95.5, 130.3, 500.4), "celsius", False),
    # Counts of a camera, a reflectance, a picture.
    (seen("uint16", 7000, 7200, 8100, 9000, 12000, whole=True), None, False),
    (seen("uint16", 100, 3000, 52000, 60000, 65535, whole=True), None, False),
    (seen("uint8", 0, 10, 120, 240, 255, whole=True), None, False),
    (seen("uint8", 270, 271, 272, 273, 274, whole=True), None, False),
    # What the file says counts, unless its numbers belie it.
    (seen("float32", 8.2, 10.1, 22.5, 60.3, 281.4, said="degC"), "celsius", True),
    (seen("float32", 8.2, 10.1, 22.5, 60.3, 281.4, said="temperature in degrees Celsius"), "celsius", True),
    (seen("uint8", 8, 10, 22, 60, 200, said="°C", whole=True), "celsius", True),
    (seen("uint16", 270, 275, 293, 320, 600, said="K", whole=True), "kelvin", True),
    (seen("uint16", 7000, 27500, 29300, 32000, 60000, said="centi-Kelvin", whole=True), "centikelvin", True),
    (seen("uint16", 7000, 27500, 29300, 32000, 60000, said="K*100", whole=True), "centikelvin", True),
    (seen("uint16", 28010, 28300, 29100, 30200, 31000, said="K", whole=True), "kelvin", False),
    (seen("float32", 270.2, 275.1, 2930.3, 3200.4, 6000.5, said="C"), "celsius", False),
    (seen("float32", 50.2, 61.1, 75.5, 130.3, 500.4, said="degF"), None, False),
    (seen("float32", 270.2, 275.1, 293.3, 320.4, 600.5, said="furlongs"), "kelvin", True),
]


@pytest.mark.parametrize(("found", "units", "certain"), TABLE)
def test_the_guess(found: Readings, units: str | None, certain: bool) -> None:
    made = guess(found)
    assert (made.units, made.certain) == (units, certain)
    assert made.why


@settings(deadline=None, max_examples=100)
@given(
    st.sampled_from(["uint8", "uint16", "float32"]),
    st.lists(st.floats(-1e5, 1e5), min_size=5, max_size=5),
    st.booleans(),
    st.sampled_from(["", "K", "degC", "x"]),
)
def test_what_is_certain_is_warm_as_ground_is(dtype: str, values: list[float], whole: bool, said: str) -> None:
    found = seen(dtype, *sorted(values), said=said, whole=whole)
    made = guess(found)
    if made.certain:
        assert made.units is not None
        assert -90 <= found.celsius(made.units)[1] <= 1200


def thermal(path: Path, values: np.ndarray, unit: str = "", **options: Any) -> Path:
    write_raster(path, values, **options)
    if unit:
        with rasterio.open(path, "r+") as dataset:
            dataset.units = (unit,)
    return path


def field(seed: int = 1, shape: tuple[int, int] = (60, 70)) -> np.ndarray:
    """Return temperatures of ground with a hot spot, degrees Celsius."""
    values = np.random.default_rng(seed).normal(24, 3, shape)
    values[10:13, 20:23] = 180
    return values


def asked(path: Path, units: Any) -> tuple[str | None, str]:
    with open_raster(path) as raster:
        return settle(raster, units)


class TestSettle:
    def test_what_is_certain_is_taken_and_told(self, tmp_path: Path) -> None:
        raw = np.round((field() + 273.15) * 100).astype(np.uint16)
        path = thermal(tmp_path / "t.tif", raw)
        units, note = asked(path, "auto")
        assert units == "centikelvin"
        assert note.startswith(f"{path}: taken to be in centi-Kelvin, for its numbers lie in 20000 to 40000: ")
        assert note.endswith("/ 180 °C")

    def test_what_is_a_guess_is_refused_with_what_it_would_be(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "t.tif", field().astype(np.float32))
        with pytest.raises(InputError) as refusal:
            asked(path, "auto")
        text = str(refusal.value)
        assert text.startswith(f"{path}: reads ")
        assert "/ 180 (least, median, most), in degrees Celsius " in text
        assert text.endswith("(say --thermal-units celsius if that is right)")
        assert "\n" not in text

    def test_a_picture_is_refused(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "t.tif", np.clip(field(), 0, 255).astype(np.uint8))
        with pytest.raises(InputError, match="pictures of 8 bits hold no temperatures"):
            asked(path, "auto")
        assert asked(path, "celsius") == ("celsius", "")

    def test_fahrenheit_is_refused_by_name(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "t.tif", (field() * 1.8 + 32).astype(np.float32), "degF")
        with pytest.raises(InputError, match="Fahrenheit"):
            asked(path, "auto")

    def test_unasked_only_kelvin_is_remarked_on(self, tmp_path: Path) -> None:
        celsius = field().astype(np.float32)
        assert asked(thermal(tmp_path / "c.tif", celsius), None) == (None, "")
        assert asked(thermal(tmp_path / "said.tif", celsius, "degC"), None) == (None, "")
        units, note = asked(thermal(tmp_path / "k.tif", celsius + np.float32(273.15)), None)
        assert units is None
        assert "looks like temperatures in Kelvin" in note
        assert "--thermal-units kelvin" in note

    def test_a_unit_in_which_no_ground_is_as_warm_is_refused(self, tmp_path: Path) -> None:
        raw = np.round((field() + 273.15) * 100).astype(np.uint16)
        path = thermal(tmp_path / "t.tif", raw)
        for units in ("celsius", "kelvin"):
            with pytest.raises(InputError, match=r"is not in .*: it would be"):
                asked(path, units)
        with pytest.raises(InputError, match="is not in centi-Kelvin"):
            asked(thermal(tmp_path / "c.tif", field().astype(np.float32)), "centikelvin")

    def test_another_unit_than_the_certain_one_is_taken_with_a_note(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "k.tif", (field() + 273.15).astype(np.float32))
        units, note = asked(path, "celsius")
        assert units == "celsius"
        assert "as asked, but looks like Kelvin" in note

    def test_nothing_but_nodata_is_refused_where_a_unit_is_asked_for(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "t.tif", np.full((9, 9), np.nan, np.float32))
        assert asked(path, None) == (None, "")
        for units in ("auto", "kelvin"):
            with pytest.raises(InputError, match="holds no value"):
                asked(path, units)


class TestReadings:
    def test_of_a_small_raster_all_is_read(self, tmp_path: Path) -> None:
        values = field().astype(np.float32)
        values[0] = np.nan
        with open_raster(thermal(tmp_path / "t.tif", values)) as raster:
            found = readings(raster)
        assert found is not None
        real = values[1:].astype(float)
        assert (found.least, found.most) == (real.min(), real.max())
        assert found.median == pytest.approx(np.median(real))
        assert not found.whole

    def test_of_a_large_one_a_sample_says_much_the_same(self, tmp_path: Path) -> None:
        values = field(2, (2000, 2100)).astype(np.float32)
        with open_raster(thermal(tmp_path / "t.tif", values, tiled=True)) as raster:
            found = readings(raster)
        assert found is not None
        assert found.median == pytest.approx(np.median(values), abs=0.05)
        assert found.first == pytest.approx(np.quantile(values, 0.01), abs=0.2)

    def test_values_that_the_sample_misses_are_found(self, tmp_path: Path) -> None:
        values = np.full((2000, 2100), np.nan, np.float32)
        values[1013, 333] = 295.5
        with open_raster(thermal(tmp_path / "t.tif", values, tiled=True)) as raster:
            found = readings(raster)
        assert found is not None
        assert found.median == 295.5

    def test_scale_and_offset_count_and_zeros_of_sixteen_bits_do_not(self, tmp_path: Path) -> None:
        values = np.full((40, 40), 2950, np.uint16)
        values[:30] = 0
        path = thermal(tmp_path / "t.tif", values, "K")
        with rasterio.open(path, "r+") as dataset:
            dataset.scales, dataset.offsets = (0.1,), (1.0,)
        with open_raster(path) as raster:
            found = readings(raster)
            assert found is not None
            assert (found.least, found.most) == (296, 296)
            assert guess(found) == Guess("kelvin", True, "it says 'K'")
            celsius = in_celsius(np.array([[2950, 0, np.nan]], np.float32), raster, "kelvin")
        np.testing.assert_allclose(celsius, [[22.85, -272.15, np.nan]])

    def test_a_description_is_no_unit_by_its_letter(self, tmp_path: Path) -> None:
        path = thermal(tmp_path / "t.tif", field().astype(np.float32))
        with rasterio.open(path, "r+") as dataset:
            dataset.set_band_description(1, "C")
        with open_raster(path) as raster:
            found = readings(raster)
        assert found is not None
        assert found.said == ""


@pytest.mark.parametrize(("units", "raw"), [("celsius", 24.5), ("kelvin", 297.65), ("centikelvin", 29765)])
def test_in_celsius(tmp_path: Path, units: Any, raw: float) -> None:
    with open_raster(
        thermal(tmp_path / "t.tif", np.ones((2, 2), np.float32), transform=PLACE @ Affine.scale(2))
    ) as raster:
        found = in_celsius(np.array([raw, np.nan, -30000], np.float32), raster, units)
    np.testing.assert_allclose(found, [24.5, np.nan, np.nan], atol=1e-4)
