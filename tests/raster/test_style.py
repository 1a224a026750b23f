"""The styles for QGIS, read by another XML parser as QGIS reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from rasterio.crs import CRS

from hrt_cli.artifacts.provenance import record
from hrt_cli.raster.classes import publishing_classes
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap
from hrt_cli.raster.style import SCORE_RAMP, class_colour, class_qml, rgb_of, score_qml
from hrt_cli.raster.windows import Window

GRID = Grid(4, 6, Affine(1, 0, 431_000, 0, -1, 5_210_000), CRS.from_epsg(32632))


def read(text: str) -> etree._Element:
    """The one renderer of a style, by the way that `QgsRasterLayer::readSymbology` goes."""
    tree = etree.fromstring(text.encode(), etree.XMLParser(no_network=True, load_dtd=False, resolve_entities=False))
    assert tree.getroottree().docinfo.doctype == "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>".replace(
        "'", '"'
    )
    assert tree.tag == "qgis"
    assert tree.get("styleCategories") == "AllStyleCategories"
    assert int(tree.get("version").split(".")[0]) == 3
    (renderer,) = tree.findall("pipe/rasterrenderer")
    assert (renderer.get("band"), renderer.get("alphaBand"), renderer.get("opacity")) == ("1", "-1", "1")
    assert renderer.get("nodataColor") == ""  # nodata stays transparent
    assert renderer.findtext("minMaxOrigin/limits") == "None"  # nothing is stretched anew on loading
    return renderer


NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12)


@given(st.lists(NAMES, min_size=1, max_size=9))
def test_every_class_has_its_id_colour_and_name(names: list[str]) -> None:
    renderer = read(class_qml(names))
    assert renderer.get("type") == "paletted"
    found = [tuple(map(entry.get, ("value", "color", "alpha", "label"))) for entry in renderer.iter("paletteEntry")]
    assert found == [(str(k), class_colour(k), "255", f"{k} {name}".strip()) for k, name in enumerate(names)]


def test_shares_stand_in_the_legend() -> None:
    entries = read(class_qml(["grass", ""], [0.256, 0.744])).iter("paletteEntry")
    assert [entry.get("label") for entry in entries] == ["0 grass (25.6%)", "1 (74.4%)"]


@pytest.mark.parametrize("top", [1.0, 0.8, 37.5, 1e-6])
def test_scores_have_their_ramp_from_nothing_to_the_top(top: float) -> None:
    renderer = read(score_qml(top))
    assert renderer.get("type") == "singlebandpseudocolor"
    assert float(renderer.get("classificationMin")) == 0
    assert float(renderer.get("classificationMax")) == pytest.approx(top)
    (shader,) = renderer.findall("rastershader/colorrampshader")
    told = {name: shader.get(name) for name in ("colorRampType", "classificationMode", "clip")}
    assert told == {"colorRampType": "INTERPOLATED", "classificationMode": "1", "clip": "0"}
    assert float(shader.get("minimumValue")) == 0
    assert float(shader.get("maximumValue")) == pytest.approx(top)
    items = [(float(item.get("value")), item.get("color")) for item in shader.findall("item")]
    assert [value for value, _ in items] == pytest.approx([at * top for at, _ in SCORE_RAMP])
    assert [colour for _, colour in items] == [colour for _, colour in SCORE_RAMP]


def test_the_source_of_the_ramp_is_that_of_its_items() -> None:
    (ramp,) = read(score_qml(1.0)).iter("colorramp")
    assert (ramp.get("name"), ramp.get("type")) == ("[source]", "gradient")
    options = {option.get("name"): option.get("value") for option in ramp.find("Option")}
    assert options == {prop.get("k"): prop.get("v") for prop in ramp.findall("prop")}  # of QGIS before 3.26
    stops = [stop.split(";") for stop in options["stops"].split(":")]
    places = [("0", options["color1"]), *stops, ("1", options["color2"])]
    for (at, rgba), (place, colour) in zip(places, SCORE_RAMP, strict=True):
        assert float(at) == place
        assert tuple(map(int, rgba.split(","))) == (*rgb_of(colour), 255)


def test_the_styles_beside_rasters_tell_what_is_in_them(tmp_path: Path) -> None:
    made = record("test", 1, {}, {})
    with publishing_classes(tmp_path / "c.tif", GRID, ["a", "b"], made, tags={}, creation={}) as writer:
        writer.write(Window(0, 0, 4, 6), np.zeros((4, 6), np.uint8))
        writer.style = class_qml(["a", "b"], [1.0, 0.0])
    labels = [entry.get("label") for entry in read((tmp_path / "c.qml").read_text()).iter("paletteEntry")]
    assert labels == ["0 a (100.0%)", "1 b (0.0%)"]
    score = np.full((4, 6), 3.0, np.float32)
    publish_scoremap(tmp_path / "s.tif", Scoremap(score, score * 0, GRID, 1.0), made, tags={}, creation={})
    assert read((tmp_path / "s.qml").read_text()).get("classificationMax") == "3"
