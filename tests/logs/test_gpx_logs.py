"""GPX tracks read as drive logs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import gpxpy.gpx
import numpy as np
import pytest

from hrt_cli.errors import InputError
from hrt_cli.logs.read import read_drive_log

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
OPEN = {
    v: f'<gpx version="{v}" creator="t" xmlns="http://www.topografix.com/GPX/{v.replace(".", "/")}"'
    for v in ("1.0", "1.1")
}


def point(second: float = 0, lon: object = 15.0, lat: object = 45.0, inside: str = "") -> str:
    time = (datetime(2024, 5, 1, 12, tzinfo=UTC) + timedelta(seconds=second)).isoformat().replace("+00:00", "Z")
    return f'<trkpt lat="{lat}" lon="{lon}"><ele>3</ele><time>{time}</time>{inside}</trkpt>'


def put(folder: Path, *segments: Sequence[str], version: str = "1.1", head: str = HEAD, more: str = "") -> Path:
    path = folder / "a.gpx"
    body = "".join(f"<trkseg>{''.join(each)}</trkseg>" for each in segments)
    path.write_text(f"{head}{OPEN[version]} {more}><trk><name>x</name>{body}</trk></gpx>", encoding="utf-8")
    return path


def test_points_are_records(tmp_path: Path) -> None:
    log = read_drive_log(put(tmp_path, [point(0), point(1.5, 15.00001, 45.00002)]))
    assert log.geographic
    assert log.time_s[0] == datetime(2024, 5, 1, 12, tzinfo=UTC).timestamp()
    np.testing.assert_allclose(np.diff(log.time_s), [1.5])
    np.testing.assert_array_equal(log.place, [[15.0, 45.0], [15.00001, 45.00002]])
    assert np.isnan(log.speed_m_s).all()
    assert np.isnan(log.heading_deg).all()
    assert (log.crs, log.robot, log.events, log.breaks) == (None, None, (), ())


def test_speed_and_course_of_gpx_1_0(tmp_path: Path) -> None:
    inside = "<course>271.5</course><speed>0.75</speed>"
    log = read_drive_log(put(tmp_path, [point(0, inside=inside), point(1)], version="1.0"))
    np.testing.assert_array_equal(log.speed_m_s, [0.75, np.nan])
    np.testing.assert_array_equal(log.heading_deg, [271.5, np.nan])


def test_speed_and_course_in_the_extensions_of_gpx_1_1(tmp_path: Path) -> None:
    plain = "<extensions><speed>0.5</speed><!-- m/s --><course>10</course></extensions>"
    garmin = (
        "<extensions><gpxtpx:TrackPointExtension><gpxtpx:speed>1.25</gpxtpx:speed><gpxtpx:course>90</gpxtpx:course>"
        "</gpxtpx:TrackPointExtension></extensions>"
    )
    unknown = "<extensions><speed>-1</speed><course>-1</course></extensions>"
    odd = "<extensions><speed>fast</speed><course>1e999</course></extensions>"
    points = [point(i, inside=inside) for i, inside in enumerate((plain, garmin, unknown, odd))]
    more = 'xmlns:gpxtpx="http://www.garmin.com/xmlschemas/TrackPointExtension/v2"'
    log = read_drive_log(put(tmp_path, points, more=more))
    np.testing.assert_array_equal(log.speed_m_s, [0.5, 1.25, np.nan, np.nan])
    np.testing.assert_array_equal(log.heading_deg, [10, 90, np.nan, np.nan])


def test_segments_and_tracks_are_breaks(tmp_path: Path) -> None:
    path = put(tmp_path, [point(0), point(1)], [], [point(5)], [point(6), point(7)])
    assert read_drive_log(path).breaks == (2, 3)
    text = path.read_text().replace("</gpx>", f"<trk><trkseg>{point(9)}</trkseg></trk></gpx>")
    path.write_text(text)
    assert read_drive_log(path).breaks == (2, 3, 5)


def test_times_of_other_zones_and_of_none(tmp_path: Path) -> None:
    here = point(0).replace("Z</time>", "</time>"), point(0).replace("12:00:00Z", "14:00:01+02:00")
    np.testing.assert_allclose(np.diff(read_drive_log(put(tmp_path, here)).time_s), [1.0])


def test_what_gpxpy_writes_is_read(tmp_path: Path) -> None:
    gpx = gpxpy.gpx.GPX()
    gpx.tracks.append(gpxpy.gpx.GPXTrack())
    gpx.tracks[0].segments.append(gpxpy.gpx.GPXTrackSegment())
    for second in range(3):
        time = datetime(2024, 1, 1, tzinfo=UTC) + timedelta(seconds=second)
        gpx.tracks[0].segments[0].points.append(gpxpy.gpx.GPXTrackPoint(45 + second * 1e-5, 15.0, time=time, speed=1.1))
    for version in ("1.0", "1.1"):
        path = tmp_path / "b.GPX"
        path.write_text(gpx.to_xml(version))
        log = read_drive_log(path)
        np.testing.assert_allclose(log.place[:, 1], 45 + np.arange(3) * 1e-5)
        np.testing.assert_array_equal(log.speed_m_s, [1.1] * 3 if version == "1.0" else [np.nan] * 3)


BOMB = '<!DOCTYPE lolz [<!ENTITY lol "lol"><!ENTITY lol2 "&lol;&lol;">]>'
REFUSED = {
    "a document type": ({"head": HEAD + BOMB}, [point()], "declares a document type"),
    "a file of elsewhere": ({"head": HEAD + '<!DOCTYPE gpx SYSTEM "file:///etc/passwd">'}, [point()], "document type"),
    "no time": ({}, [point(), '<trkpt lat="45" lon="15"></trkpt>'], "track point 2 has no time"),
    "no such time": ({}, [point().replace("2024-05-01", "2024-13-41")], "track point 1 has no time that can be read"),
    "time in words": ({}, [point().replace("2024-05-01T", "noon")], "no time that can be read"),
    "a latitude beyond the pole": ({}, [point(lat=91)], "no place on Earth"),
    "a longitude beyond": ({}, [point(lon=-180.5)], "no place on Earth"),
    "a latitude that is no number": ({}, [point(lat="nan")], "no place on Earth|not a GPX"),
    "a longitude in words": ({}, [point(lon="east")], "not a GPX that can be read"),
    "time backwards": ({}, [point(1), point(0)], "time goes backwards"),
    "no point": ({}, [], "no track with points"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_drive_is_refused(tmp_path: Path, name: str) -> None:
    options, points, problem = REFUSED[name]
    with pytest.raises(InputError, match=problem) as refusal:
        read_drive_log(put(tmp_path, points, **options))
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "is empty"),
        ("{}", "not a GPX that can be read"),
        ("<html><body/></html>", "no track with points"),
        (HEAD + OPEN["1.1"] + '><rte><rtept lat="1" lon="1"/></rte></gpx>', "routes and waypoints are no drive"),
        (HEAD + OPEN["1.1"] + f"><trk><trkseg>{point()}<trkpt", "not a GPX that can be read"),
        ("<a>" * 100_000, "not a GPX that can be read"),
    ],
)
def test_what_is_no_gpx_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "a.gpx"
    path.write_text(text)
    with pytest.raises(InputError, match=problem) as refusal:
        read_drive_log(path)
    assert len(str(refusal.value)) < 500
