"""Colours that hold from the GeoTIFF to QGIS and the figures: class palette, score ramp, QML styles.

The first 20 class colours stay apart for colour-blind readers too (a test simulates them). The styles have the elements
and attributes that QGIS 3 itself writes for such layers.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

# The first nine are Paul Tol's "muted" scheme (SRON/EPS/TN/09-002, 2021), ordered so that the first few are far from
# one another. Each of the others is, of the colours of a coarse cube, the one farthest (CIEDE2000) from all before it,
# and from white and the greys of figures, where it comes nearest to one of them: for the trichromat, and for the
# protanope, deuteranope and tritanope of Machado, Oliveira and Fernandes (2009).
_APART = (
    *("#332288", "#ddcc77", "#117733", "#88ccee", "#cc6677", "#aa4499", "#44aa99", "#999933", "#882255"),
    *("#331111", "#9977ff", "#111133", "#7733ff", "#bbff11", "#bbbb99", "#115533", "#bb77bb", "#99ffbb"),
    *("#ee99bb", "#771111"),
)
_GOLDEN_TURN = 0.618033988749895

NO_GO_COLOUR = "#5a5a5a"

# Five stops of matplotlib's "cividis" (Nunez, Anderton, Renslow 2018), from 0 to 1.
SCORE_RAMP = ((0.0, "#00224e"), (0.25, "#434e6c"), (0.5, "#7d7c78"), (0.75, "#bcae6c"), (1.0, "#fee838"))

_NO_LIMITS = (
    "<rasterTransparency/><minMaxOrigin><limits>None</limits><extent>WholeRaster</extent>"
    "<statAccuracy>Exact</statAccuracy></minMaxOrigin>"
)


def class_colour(index: int) -> str:
    """Return the colour `#rrggbb` of a class id."""
    if index < len(_APART):
        return _APART[index]
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


def class_qml(names: Sequence[str], shares: Sequence[float] | None = None) -> str:
    """Return a QGIS style that shows a class raster with its legend, and the share in [0, 1] of each class."""
    ends = [""] * len(names) if shares is None else [f" ({share:.1%})" for share in shares]
    entries = "".join(
        f'<paletteEntry value="{i}" color="{class_colour(i)}" alpha="255" '
        f"label={quoteattr(f'{i} {name}'.strip() + end)}/>"
        for i, (name, end) in enumerate(zip(names, ends, strict=True))
    )
    return _qml(
        '<rasterrenderer type="paletted" band="1" alphaBand="-1" opacity="1" nodataColor="">'
        f"{_NO_LIMITS}<colorPalette>{entries}</colorPalette></rasterrenderer>"
    )


def score_qml(top: float) -> str:
    """Return a QGIS style that shows band 1 of a scoremap from 0 to `top`; no-go cells, its nodata, are transparent."""
    items = "".join(
        f'<item value="{at * top:.6g}" label="{at * top:.3g}" color="{colour}" alpha="255"/>'
        for at, colour in SCORE_RAMP
    )
    return _qml(
        '<rasterrenderer type="singlebandpseudocolor" band="1" alphaBand="-1" opacity="1" nodataColor="" '
        f'classificationMin="0" classificationMax="{top:.6g}">{_NO_LIMITS}<rastershader>'
        # Classification mode 1: the ramp is continuous, its stops are those of the colour ramp.
        '<colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" labelPrecision="3" '
        f'minimumValue="0" maximumValue="{top:.6g}">{_gradient()}{items}</colorrampshader></rastershader>'
        "</rasterrenderer>"
    )


def _gradient() -> str:
    """Write the ramp as QGIS keeps it to classify anew: as options from 3.26 on, as properties before."""
    (_, first), *between, (_, last) = SCORE_RAMP
    parts = {
        "color1": _rgba(first),
        "color2": _rgba(last),
        "discrete": "0",
        "rampType": "gradient",
        "stops": ":".join(f"{at:g};{_rgba(colour)}" for at, colour in between),
    }
    options = "".join(f'<Option name="{k}" type="QString" value="{v}"/>' for k, v in parts.items())
    properties = "".join(f'<prop k="{k}" v="{v}"/>' for k, v in parts.items())
    return f'<colorramp name="[source]" type="gradient"><Option type="Map">{options}</Option>{properties}</colorramp>'


def _rgba(colour: str) -> str:
    return ",".join(map(str, (*rgb_of(colour), 255)))


def _qml(renderer: str) -> str:
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        '<qgis version="3.28.0" styleCategories="AllStyleCategories">'
        f"<pipe>{renderer}</pipe><blendMode>0</blendMode></qgis>\n"
    )
