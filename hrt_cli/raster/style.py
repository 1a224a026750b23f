"""Colours that hold from the GeoTIFF to QGIS and the figures: class palette, score ramp, QML styles."""

from __future__ import annotations

import colorsys
from xml.sax.saxutils import quoteattr

# Paul Tol's "muted" scheme (SRON/EPS/TN/09-002, 2021), told apart by colour-blind readers; ordered so that the
# first few are far from one another.
_MUTED = ("#332288", "#DDCC77", "#117733", "#88CCEE", "#CC6677", "#AA4499", "#44AA99", "#999933", "#882255")
_GOLDEN_TURN = 0.618033988749895

NO_GO_COLOUR = "#5a5a5a"

# Five stops of matplotlib's "cividis" (Nunez, Anderton, Renslow 2018), from 0 to 1.
SCORE_RAMP = ((0.0, "#00224e"), (0.25, "#434e6c"), (0.5, "#7d7c78"), (0.75, "#bcae6c"), (1.0, "#fee838"))


def class_colour(index: int) -> str:
    """Return the colour `#rrggbb` of a class id."""
    if index < len(_MUTED):
        return _MUTED[index]
    turn = (index * _GOLDEN_TURN) % 1.0
    red, green, blue = colorsys.hsv_to_rgb(turn, 0.45 + 0.3 * (index % 3) / 2, 0.55 + 0.4 * (index % 2))
    return f"#{round(red * 255):02x}{round(green * 255):02x}{round(blue * 255):02x}"


def rgb_of(colour: str) -> tuple[int, int, int]:
    """Split `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def class_palette(count: int, nodata: int) -> dict[int, tuple[int, int, int, int]]:
    """Return the GeoTIFF colour table of `count` classes; nodata is transparent."""
    palette = {index: (*rgb_of(class_colour(index)), 255) for index in range(count)}
    palette[nodata] = (0, 0, 0, 0)
    return palette


def class_qml(names: list[str]) -> str:
    """Return a QGIS style that shows a class raster with its legend."""
    entries = "".join(
        f'<paletteEntry value="{i}" color="{class_colour(i)}" alpha="255" label={quoteattr(f"{i} {name}".strip())}/>'
        for i, name in enumerate(names)
    )
    return _qml(f'<rasterrenderer type="paletted" band="1" opacity="1"><colorPalette>{entries}</colorPalette>')


def score_qml(top: float) -> str:
    """Return a QGIS style that shows band 1 of a scoremap from 0 to `top`."""
    items = "".join(
        f'<item value="{at * top:.6g}" label="{at * top:.3g}" color="{colour}" alpha="255"/>'
        for at, colour in SCORE_RAMP
    )
    return _qml(
        '<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" '
        f'classificationMin="0" classificationMax="{top:.6g}"><rastershader>'
        f'<colorrampshader colorRampType="INTERPOLATED" clip="0">{items}</colorrampshader></rastershader>'
    )


def _qml(renderer: str) -> str:
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        f'<qgis version="3.28.0" styleCategories="AllStyleCategories"><pipe>{renderer}</rasterrenderer></pipe></qgis>\n'
    )
