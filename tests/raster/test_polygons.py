"""Polygons without holes: the pieces cover the same ground once."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli.raster.polygons import without_holes


@st.composite
def sieves(draw: st.DrawFn) -> Any:
    """Draw a polygon with holes, some of which touch one another, the outer ring, or lie one above the other."""
    shape = shapely.box(0, 0, 12, 8)
    for _ in range(draw(st.integers(0, 6))):
        x, y = draw(st.integers(1, 11)), draw(st.integers(1, 7))
        size = draw(st.sampled_from([0.3, 0.5, 1.0]))
        hole = draw(
            st.sampled_from(
                [
                    shapely.box(x - size, y - size, x + size, y + size),
                    shapely.Polygon([(x - size, y), (x, y - size), (x + size, y), (x, y + size)]),
                    shapely.Point(x, y).buffer(size, quad_segs=3),
                ]
            )
        )
        shape = shape.difference(hole)
    turned = shapely.affinity.rotate(shape, draw(st.sampled_from([0, 90, 31.7])), origin=(5, 4))
    far = draw(st.sampled_from([0.0, 500_000.0]))
    return max(shapely.get_parts(shapely.affinity.translate(turned, far, far * 10)), key=lambda part: part.area)


@given(sieves())
def test_the_pieces_cover_the_same_ground_once(shape: Any) -> None:
    pieces = without_holes(shape)
    assert all(piece.is_valid and not len(piece.interiors) for piece in pieces)
    assert sum(piece.area for piece in pieces) == pytest.approx(shape.area, rel=1e-9)
    for one, other in itertools.combinations(pieces, 2):
        assert one.intersection(other).area < 1e-7
    assert shapely.union_all(pieces).symmetric_difference(shape).area < 1e-7
    assert len(pieces) <= 4 * len(shape.interiors) + 1


def test_what_has_no_hole_stays_as_it_is() -> None:
    shape = shapely.Polygon([(0, 0), (3, 0), (3, 2), (1, 1)])
    assert without_holes(shape) == [shape]


def test_one_cut_opens_a_ring() -> None:
    ring = shapely.box(0, 0, 5, 5).difference(shapely.box(1, 1, 3, 4))
    left, right = without_holes(ring)
    assert (left.bounds, right.bounds) == ((0, 0, 2, 5), (2, 0, 5, 5))
