"""Donkeycar tubs."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_files import put_text, put_tub, tub_record

from hrt_cli.errors import InputError
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import check_varied, read_samples
from hrt_cli.steering.recordings.split import split

REAL = Path(__file__).parents[3].parent / "shared" / "data" / "donkeycar_tub" / "tub.tar.gz"


def test_records_by_number(tmp_path: Path) -> None:
    put_tub(tmp_path / "tub", [[tub_record(2, 0.5), tub_record(0, -1)], [tub_record(1, 1)]])
    put_text(tmp_path / "tub" / "._catalog_0.catalog", "\0\x05\x16")
    found = read_samples([tmp_path / "tub"])
    assert found.steering.tolist() == [[-1.0], [1.0], [0.5]]
    assert [path.name for path in found.paths] == [f"{n}_cam_image_array_.jpg" for n in range(3)]
    assert found.paths[0].parent == tmp_path / "tub" / "images"
    assert found.sessions == ("tub",)
    assert [file.name for file in found.files] == ["manifest.json", "catalog_0.catalog", "catalog_1.catalog"]


def test_deleted_records(tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(n, n / 4) for n in range(4)]], deleted=[0, 2])
    found = read_samples([tmp_path])
    assert found.steering[:, 0].tolist() == [0.25, 0.75]
    assert found.moment is not None
    assert found.moment.tolist() == [1, 3]
    assert found.skipped == 0


def test_deleted_records_that_cannot_be_told(tmp_path: Path) -> None:
    """Donkeycar counts lines, we numbers: where they differ it is not known what was deleted."""
    put_tub(tmp_path, [[tub_record(n, n / 8) for n in range(4, 8)]])
    assert len(read_samples([tmp_path]).paths) == 4
    put_tub(tmp_path, [[tub_record(n, n / 8) for n in range(4, 8)]], deleted=[1])
    with pytest.raises(InputError, match="line 1: is record 0, but numbered 4"):
        read_samples([tmp_path])


def test_sessions(tmp_path: Path) -> None:
    put_tub(tmp_path / "t", [[tub_record(n, 0.1, _session_id=f"s{n // 2}") for n in range(4)]])
    found = read_samples([tmp_path / "t"])
    assert (found.sessions, found.session.tolist()) == (("t/s0", "t/s1"), [0, 0, 1, 1])


def test_what_the_pilot_drove_is_left_out(tmp_path: Path) -> None:
    modes = ["user", "local_angle", "pilot", None]
    records = [tub_record(n, n / 8) | ({"user/mode": mode} if mode else {}) for n, mode in enumerate(modes)]
    put_tub(tmp_path, [records])
    notes: list[str] = []
    found = read_samples([tmp_path], note=notes.append)
    assert found.steering[:, 0].tolist() == [0.0, 3 / 8]
    assert "2 records that the car drove by itself" in notes[0]


def test_a_joystick_at_its_stop(tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(0, -32768 / 32767), tub_record(1, 1)]])
    assert read_samples([tmp_path]).steering.tolist() == [[-1.0], [1.0]]


@pytest.mark.parametrize(
    ("record", "problem"),
    [
        (tub_record(1, 1.5), "user/angle is 1.5, outside [-1, 1]"),
        (tub_record(1, 0) | {"user/angle": "0.5"}, "user/angle is '0.5', not a number"),
        (tub_record(1, 0) | {"user/angle": True}, "user/angle is True"),
        (tub_record(1, 0) | {"user/angle": None}, "user/angle is None"),
        ({"_index": 1, "cam/image_array": "1.jpg"}, "user/angle is None"),
        ({"_index": 1, "user/angle": 0.5}, "cam/image_array or _session_id is no text"),
        (tub_record(1, 0, _session_id=3), "_session_id is no text"),
        ({"cam/image_array": "1.jpg", "user/angle": 0.5}, "_index is None"),
        (tub_record(-1, 0.5), "_index is -1"),
        (tub_record(1, 0) | {"_index": 1.0}, "_index is 1.0"),
        (tub_record(1, 0) | {"cam/image_array": "../catalog_0.catalog"}, "lies outside the folder"),
        (tub_record(1, 0) | {"cam/image_array": "0_cam_image_array_.jpg"}, "which 2 rows name"),
        ('{"_index": 1, "cam/image_array": "1.jpg", "user/angle": NaN}', "NaN is not a number"),
        ('{"_index": 1, "cam/image_array": "1.jpg", "user/angle": 1e999}', "1e999 is too large"),
        ('{"_index": 1, "cam/image_array": "1.jpg", "user/angle": 0, "user/angle": 1}', "stands twice"),
        ('{"_index": 1, "cam/image_array": "1.j', "is not valid JSON"),
        ("[1, 2]", "is no JSON object"),
    ],
)
def test_a_malformed_record(record: dict[str, Any] | str, problem: str, tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(0, 0.25), record, tub_record(2, 0.5), tub_record(3, 0.5)]])
    with pytest.raises(InputError) as refused:
        read_samples([tmp_path])
    assert problem in str(refused.value)
    assert refused.value.path == str(tmp_path / "catalog_0.catalog")
    assert f"line {1 if '2 rows' in problem else 2}: " in str(refused.value)
    bad = 2 if "2 rows" in problem else 1
    found = read_samples([tmp_path], skip_bad=True)
    assert (found.skipped, len(found.paths)) == (bad, 4 - bad)


def test_a_malformed_record_does_not_shift_what_is_deleted(tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(0, 0.25), "{", tub_record(2, 0.5), tub_record(3, 0.75)]], deleted=[2])
    assert read_samples([tmp_path], skip_bad=True).steering[:, 0].tolist() == [0.25, 0.75]


@pytest.mark.parametrize(
    ("state", "problem"),
    [
        ({"paths": []}, "names no catalogs"),
        ({"paths": ["../x.catalog"]}, "lies outside the folder"),
        ({"paths": ["absent.catalog"]}, "no such file"),
        ({"paths": ["catalog_0.catalog"] * 2}, "names a catalog twice"),
        ({"deleted_indexes": [0.5]}, "deleted_indexes"),
        ({"current_index": None}, "current_index"),
    ],
)
def test_a_damaged_manifest(state: dict[str, Any], problem: str, tmp_path: Path) -> None:
    put_tub(tmp_path / "t", [[tub_record(0, 0)]], **state)
    with pytest.raises(InputError, match=problem):
        read_samples([tmp_path / "t"])


@pytest.mark.parametrize(
    ("text", "problem"), [("{}\n", "not five"), ("1\n2\n3\n4\n[]\n", "no JSON object"), ("1\n2\n3\n4\n{\n", "JSON")]
)
def test_another_manifest(text: str, problem: str, tmp_path: Path) -> None:
    put_text(tmp_path / "manifest.json", text)
    with pytest.raises(InputError, match=problem):
        read_samples([tmp_path])


def test_two_records_of_one_number(tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(0, 0), tub_record(0, 1) | {"cam/image_array": "other.jpg"}]])
    with pytest.raises(InputError, match="two records are numbered 0"):
        read_samples([tmp_path])


def test_an_empty_catalog_and_records_that_lack(tmp_path: Path) -> None:
    put_tub(tmp_path, [[tub_record(0, 0.5)], []], current_index=7)
    notes: list[str] = []
    assert len(read_samples([tmp_path], note=notes.append).paths) == 1
    assert "speaks of 7 records, and there are 1" in notes[0]


@pytest.mark.real
@pytest.mark.skipif(not REAL.is_file(), reason="needs the real data")
def test_a_real_tub(tmp_path: Path) -> None:
    with tarfile.open(REAL) as archive:
        archive.extractall(tmp_path, filter="data")
    tub = tmp_path / "tub"
    samples = read_samples([tub])
    angles = {}
    for line in (tub / "catalog_0.catalog").read_text().splitlines():
        record = json.loads(line)
        angles[record["cam/image_array"]] = record["user/angle"]
    assert len(samples.paths) == len(angles) == 1000
    assert [float(each) for each in samples.steering[:, 0]] == [
        float(np.float32(angles[p.name])) for p in samples.paths
    ]
    check_varied(samples, 7)
    kept, pictures, digest = load_pictures(samples, SteeringConfig(width=80, height=60))
    assert (len(kept.paths), kept.skipped, pictures.shape) == (1000, 0, (1000, 60, 80, 3))
    assert pictures.std() > 20
    assert len(digest) == 64
    parts = split(samples)
    assert 0.15 < parts.validation.size / 1000 < 0.25
    bad = tub / "images" / "500_cam_image_array_.jpg"
    bad.write_bytes(bad.read_bytes()[: bad.stat().st_size // 2])
    with pytest.raises(InputError, match=r"500_cam.*cut short"):
        load_pictures(samples, SteeringConfig(width=80, height=60))
