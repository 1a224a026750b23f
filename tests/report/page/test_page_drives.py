"""Tracks of drives as a page plays them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from pyproj import Transformer

from hrt_cli.errors import InputError
from hrt_cli.report.page.drives import MOST_RECORDS, track
from hrt_cli.report.page.frame import Frame
from hrt_cli.report.page.frames import WIDTH_PX, recorded_frames

FRAME = Frame(8.09, 47.039)


def write_log(path: Path, records: list[dict[str, object]], **header: object) -> Path:
    first = {"format": "hrt-drive-log", "version": 1} | header
    path.write_text("\n".join(json.dumps(each) for each in [first, *records]) + "\n")
    return path


def test_places_are_the_same_in_degrees_and_in_a_crs(tmp_path: Path) -> None:
    lon, lat = 8.09 + 1e-5 * np.arange(20), 47.039 + 2e-6 * np.arange(20)
    x, y = Transformer.from_crs(4326, 32632, always_xy=True).transform(lon, lat)
    degrees = [
        {"t": k / 2, "lon": a, "lat": b} for k, (a, b) in enumerate(zip(lon.tolist(), lat.tolist(), strict=True))
    ]
    metres = [{"t": k / 2 + 7, "x": a, "y": b} for k, (a, b) in enumerate(zip(x.tolist(), y.tolist(), strict=True))]
    one = track(write_log(tmp_path / "a.jsonl", degrees), "a", FRAME)
    other = track(write_log(tmp_path / "b.jsonl", metres, crs="EPSG:32632"), "b", FRAME)
    np.testing.assert_allclose(one["e"], other["e"], atol=2e-3)
    np.testing.assert_allclose(one["n"], other["n"], atol=2e-3)
    assert one["t"] == other["t"] == [k / 2 for k in range(20)]
    assert one["heading"] == [None] * 20


def test_a_long_log_is_thinned_but_keeps_what_happened(tmp_path: Path) -> None:
    n, at = 3 * MOST_RECORDS, 3 * 1234 + 1
    records: list[dict[str, object]] = [{"t": 100 + k / 10, "lon": 8.09 + 1e-7 * k, "lat": 47.039} for k in range(n)]
    records[at]["event"] = "collision"
    found = track(write_log(tmp_path / "a.jsonl", records), "a", FRAME)
    assert len(found["t"]) <= MOST_RECORDS + 3
    assert found["t"][0] == 0
    assert found["t"][-1] == pytest.approx((n - 1) / 10)
    (event,) = found["events"]
    assert (event["kind"], event["t"]) == ("collision", at / 10)
    assert event["t"] in found["t"]


def test_a_log_without_a_place_on_the_map_is_refused(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.jsonl", [{"t": 0, "x": 1, "y": 2}, {"t": 1, "x": 2, "y": 2}])
    with pytest.raises(InputError, match="coordinate reference system"):
        track(log, "a", FRAME)


def test_frames_of_a_recording_are_spread_and_small(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for k in range(10):
        cv2.imwrite(str(tmp_path / "frames" / f"{k:06d}.jpg"), np.full((60, 480, 3), 20 * k, np.uint8))
    about = tmp_path / "recording.json"
    times = [0.3 * k for k in range(10)]
    found = recorded_frames(about, {"frames": 10, "times_s": times}, 4)
    assert [frame["t"] for frame in found] == [0.0, 0.9, 1.8, 2.7]
    assert all(frame["src"].startswith("data:image/jpeg;base64,") for frame in found)
    assert WIDTH_PX < 480
    assert recorded_frames(about, {"frames": 0, "times_s": []}, 4) == []
    with pytest.raises(InputError, match="when its frames were taken"):
        recorded_frames(about, {"frames": 10}, 4)
    (tmp_path / "frames" / "000009.jpg").write_bytes(b"torn")
    with pytest.raises(InputError, match="damaged"):
        recorded_frames(about, {"frames": 10, "times_s": times}, 4)
