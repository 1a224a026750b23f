from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Geod, Proj, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from hrt_cli.errors import ArgumentError
from hrt_cli.missions.local import LocalFrame, utm_zone

PLACES = st.tuples(st.floats(-180, 179.99), st.floats(-79.9, 83.9))


@settings(max_examples=60)
@given(place=PLACES)
def test_the_convergence_is_the_projections(place: tuple[float, float]) -> None:
    frame = LocalFrame("utm", *place)
    factors = Proj(CRS.from_epsg(frame.crs.to_epsg())).get_factors(*place)
    assert math.degrees(frame.convergence_rad) == pytest.approx(factors.meridian_convergence, abs=1e-5)
    assert LocalFrame("enu", *place).convergence_rad == pytest.approx(0.0, abs=1e-7)


@settings(max_examples=60)
@given(place=PLACES, bearing=st.floats(0, 360), metres=st.floats(0, 2000))
def test_metres_are_true_in_both_frames(place: tuple[float, float], bearing: float, metres: float) -> None:
    there = Geod(ellps="WGS84").fwd(*place, bearing, metres)[:2]
    (x, y) = LocalFrame("enu", *place).xy([there])[0]
    angle = math.radians(bearing)
    assert (x, y) == pytest.approx((metres * math.sin(angle), metres * math.cos(angle)), abs=1e-4)
    frame = LocalFrame("utm", *place)
    to_utm = Transformer.from_crs("EPSG:4326", CRS.from_epsg(frame.crs.to_epsg()), always_xy=True)
    (x0, y0), (x1, y1) = to_utm.transform(*place), to_utm.transform(*there)
    assert frame.xy([there])[0] == pytest.approx((x1 - x0, y1 - y0), abs=1e-4)


@settings(max_examples=40)
@given(place=PLACES, bearing=st.floats(0, 360), metres=st.floats(0, 2000))
def test_enu_is_the_plane_on_the_ellipsoid(place: tuple[float, float], bearing: float, metres: float) -> None:
    """robot_localization's local cartesian frame (GeographicLib's LocalCartesian), by PROJ's topocentric."""
    lon, lat = place
    plane = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0=0"
    )
    there = Geod(ellps="WGS84").fwd(lon, lat, bearing, metres)[:2]
    assert LocalFrame("enu", lon, lat).xy([there])[0] == pytest.approx(plane.transform(*there, 0.0)[:2], abs=1e-4)


@pytest.mark.parametrize(
    ("lon", "lat", "zone"),
    [
        (-180.0, 0.0, 1),
        (179.99, -16.8, 60),
        (180.0, -16.8, 60),
        (138.6, -34.9, 54),
        (5.3, 60.4, 32),
        (2.9, 60.4, 31),
        (3.0, 60.4, 32),
        (11.9, 60.4, 32),
        (12.0, 60.4, 33),
        (5.3, 55.9, 31),
        (5.3, 64.0, 31),
        (8.9, 78.0, 31),
        (9.0, 78.0, 33),
        (20.9, 78.0, 33),
        (21.0, 78.0, 35),
        (33.0, 78.0, 37),
        (41.9, 78.0, 37),
        (42.0, 78.0, 38),
    ],
)
def test_zones_with_their_exceptions(lon: float, lat: float, zone: int) -> None:
    assert utm_zone(lon, lat) == zone


@settings(max_examples=10, deadline=None)
@given(lon=st.floats(-179.9, 179.9), lat=st.floats(-79, 55.9).filter(lambda lat: abs(lat) > 0.01))
def test_elsewhere_zones_are_those_of_the_epsg_registry(lon: float, lat: float) -> None:
    if abs(lon / 6 - round(lon / 6)) < 1e-6:
        return  # on the border two zones are right
    area = AreaOfInterest(lon, lat, lon, lat)
    found = {int(info.code) for info in query_utm_crs_info(datum_name="WGS 84", area_of_interest=area)}
    assert LocalFrame("utm", lon, lat).crs.to_epsg() in found


def test_the_frame_goes_on_across_the_meridian_180_and_the_equator() -> None:
    frame = LocalFrame("utm", 179.999, -0.0005)
    (x, y) = frame.xy([(-179.999, 0.0005)])[0]
    assert (x, y) == pytest.approx((222.6, 110.6), abs=0.5)


@pytest.mark.parametrize(("kind", "lon", "lat"), [("utm", 0, 84.5), ("utm", 0, -81), ("enu", 181, 0), ("enu", 0, 91)])
def test_a_datum_that_has_no_frame_is_refused(kind: str, lon: float, lat: float) -> None:
    with pytest.raises(ArgumentError):
        LocalFrame(kind, lon, lat)  # type: ignore[arg-type]
