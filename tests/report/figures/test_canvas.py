"""Maps of any shape: north, lengths, legends and titles stand where they belong, and nothing hides anything."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rasterio.crs import CRS
from rasterio.warp import transform as warp

from hrt_cli.raster.grid import Grid
from hrt_cli.report.figures import layers
from hrt_cli.report.figures.canvas import (
    Backdrop,
    Entry,
    map_canvas,
    map_inches,
    north_of,
    show_legend,
    size_m,
    thinned,
)

UTM = CRS.from_epsg(32632)
GRIDS = {
    "square": Grid(300, 300, Affine(0.1, 0, 431_000, 0, -0.1, 5_210_000), UTM),
    "long": Grid(40, 2000, Affine(0.1, 0, 431_000, 0, -0.1, 5_210_000), UTM),
    "tall": Grid(2000, 40, Affine(0.1, 0, 431_000, 0, -0.1, 5_210_000), UTM),
    "degrees": Grid(300, 400, Affine(1e-6, 0, 8.1, 0, -1e-6, 47), CRS.from_epsg(4326)),
    "unreferenced": Grid(300, 400, Affine.identity(), None),
}


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 135.0, -90.0])
def test_north_is_where_the_raster_was_turned_from(turn_deg: float) -> None:
    turned = Affine.translation(500_000, 5_210_000) * Affine.rotation(turn_deg) * Affine.scale(0.1, -0.1)
    across, down = north_of(Grid(300, 300, turned, UTM))  # on the meridian of the zone north is up on the grid
    assert (across, -down) == pytest.approx((np.sin(np.radians(turn_deg)), np.cos(np.radians(turn_deg))), abs=2e-3)


def overlap(figure: Figure) -> list[tuple[str, str]]:
    """The pairs of texts that hide one another, title, legend and scale bar among them."""
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    texts = [axes.title, axes._left_title, *axes.texts]
    legend = axes.get_legend()
    texts += legend.get_texts() if legend else []
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text()]
    return [
        (one, other)
        for index, (one, box) in enumerate(boxes)
        for other, there in boxes[index + 1 :]
        if box.overlaps(there)
    ]


@pytest.mark.parametrize(("name", "entries"), [*((name, 20) for name in GRIDS), ("square", 1), ("long", 60)])
def test_nothing_hides_anything(name: str, entries: int) -> None:
    title = "a plan of many words, " * 9
    figure, axes = map_canvas(GRIDS[name], title)
    long = "a class with a name that is too long to be written in full" if entries == 20 else "class"
    show_legend(axes, [Entry("#332288", f"{long} {k}") for k in range(entries)])
    assert overlap(figure) == []
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert len(shown) == min(entries, 36)
    assert shown[-1] == ("and 25 more" if entries == 60 else shown[-1])
    north = [text for text in axes.texts if text.get_text() == "N"]
    assert len(north) == (GRIDS[name].crs is not None)
    (length,) = [text.get_text() for text in axes.texts if text.get_text()[:1].isdigit()]
    assert length.endswith("px" if GRIDS[name].crs is None else "m")


def test_the_scale_bar_is_as_long_as_it_says() -> None:
    for grid in GRIDS.values():
        _, axes = map_canvas(grid, "a map")
        (bar,) = [line for line in axes.lines if line.get_label() == "_scale"]
        (text,) = [text.get_text() for text in axes.texts if text.get_text()[:1].isdigit()]
        assert np.ptp(bar.get_xdata()) == float(text.split()[0])
        assert np.ptp(bar.get_xdata()) < size_m(grid)[0]


@pytest.mark.parametrize("name", GRIDS)
def test_a_map_on_paper_has_the_shape_of_the_ground(name: str) -> None:
    width_in, height_in = map_inches(GRIDS[name])
    width_m, height_m = size_m(GRIDS[name])
    assert width_in / height_in == pytest.approx(width_m / height_m)
    assert width_in <= 14
    assert height_in <= 12


def test_names_are_written_as_they_are() -> None:
    _, axes = map_canvas(GRIDS["square"], "$x$")
    show_legend(axes, [Entry("#332288", "_hidden"), Entry("#332288", "$a_b$")])
    texts = axes.get_legend().get_texts()
    assert [text.get_text() for text in texts] == ["_hidden", "$a_b$"]
    assert not any(text.get_parse_math() for text in (*texts, axes._left_title))


@pytest.mark.parametrize("shape", [(5, 3), (100, 40), (1, 999)])
def test_every_nth_pixel_is_read(shape: tuple[int, int]) -> None:
    band = np.arange(np.prod(shape)).reshape(shape)

    def read(window):
        return band[window.row : window.row + window.height, window.col : window.col + window.width]

    found, step = thinned(read, shape, 30)
    np.testing.assert_array_equal(found, band[::step, ::step])
    assert max(found.shape) <= 30
    assert step == 1 or max(-(-side // (step - 1)) for side in shape) > 30


def test_places_in_degrees_lie_where_they_are(tmp_path) -> None:
    base = GRIDS["square"]
    x, y = base.xy([30.0, 200.0], [40.0, 250.0])
    lon, lat = warp(UTM, "EPSG:4326", x, y)
    right, down = layers.lonlat_on(tmp_path, base, np.column_stack([lon, lat]))
    row_m, col_m = base.pixel_m
    assert right == pytest.approx(np.array([40.0, 250.0]) * col_m, abs=1e-4)
    assert down == pytest.approx(np.array([30.0, 200.0]) * row_m, abs=1e-4)


def test_shading_leaves_ground_of_middling_brightness_its_colour() -> None:
    rgba = np.full((300, 300, 4), 255, np.uint8)
    rgba[..., :3] = 100
    rgba[:50, :, :3], rgba[250:, :, :3], rgba[:, :10, 3] = 20, 180, 0
    _, axes = map_canvas(GRIDS["square"], "")
    layers.show_shading(axes, Backdrop(GRIDS["square"], rgba), 0.5)
    layer = np.asarray(axes.images[-1].get_array())
    assert (layer[50:250, :, 3] == 0).all()
    assert (layer[:, :10, 3] == 0).all()
    assert (layer[:50, 10:] == (0, 0, 0, 128)).all()
    assert (layer[250:, 10:] == (255, 255, 255, 128)).all()


@pytest.mark.parametrize("shape", [(7, 5), (300, 2), (1300, 3)])
def test_hatching_covers_what_is_no_go_and_nothing_else(shape: tuple[int, int]) -> None:
    no_go = np.random.default_rng(0).random(shape) < 0.4
    picture = layers._hatched(no_go)
    factor = picture.shape[0] // shape[0]
    np.testing.assert_array_equal(picture[..., 3] > 0, no_go.repeat(factor, 0).repeat(factor, 1))
    assert len(np.unique(picture[picture[..., 3] > 0], axis=0)) == 2
