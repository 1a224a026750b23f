"""Recordings of Udacity's simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_files import put_text

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.steering.recordings.samples import read_samples

HEADER = "center,left,right,steering,throttle,brake,speed\n"


def row(moment: int, steering: float | str, prefix: str = "IMG/") -> str:
    names = ", ".join(f"{prefix}{camera}_{moment}.jpg" for camera in ("center", "left", "right"))
    return f"{names}, {steering}, 0.5, 0, 30.1\n"


@pytest.mark.parametrize("header", ["", HEADER])
@pytest.mark.parametrize("prefix", ["IMG/", "/mnt/sim/IMG/", "C:\\Users\\me\\IMG\\", "IMG\\"])
def test_three_cameras(header: str, prefix: str, tmp_path: Path) -> None:
    put_text(tmp_path / "sim" / "driving_log.csv", header + row(1, 0.25, prefix) + row(2, -0.9, prefix))
    found = read_samples([tmp_path / "sim"])
    names = [f"{camera}_{n}.jpg" for n in (1, 2) for camera in ("center", "left", "right")]
    assert found.paths == tuple(tmp_path / "sim" / "IMG" / name for name in names)
    np.testing.assert_allclose(found.steering[:, 0], [0.25, 0.45, 0.05, -0.9, -0.7, -1.0], atol=1e-7)
    assert found.moment is not None
    assert len(set(found.moment[:3])) == len(set(found.moment[3:])) == 1
    assert found.moment[3] == found.moment[0] + 1
    assert (found.sessions, found.outputs) == (("sim",), ("yaw",))


def test_the_correction(tmp_path: Path) -> None:
    put_text(tmp_path / "driving_log.csv", row(1, 0.8))
    np.testing.assert_allclose(read_samples([tmp_path], correction=0.5).steering[:, 0], [0.8, 1.0, 0.3], atol=1e-7)
    with pytest.raises(ArgumentError, match="correction"):
        read_samples([tmp_path], correction=1.5)


def test_the_centre_alone(tmp_path: Path) -> None:
    put_text(tmp_path / "driving_log.csv", "IMG/c.jpg,,,0.5,0,0,1\n")
    assert read_samples([tmp_path]).steering.tolist() == [[0.5]]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (row(2, "nan"), "line 2: steering is 'nan'"),
        (row(2, 1.5), "line 2: steering is 1.5, outside"),
        ("IMG/a.jpg,0.5\n", "line 2: has 2 fields, not 7"),
        (row(2, 0.5)[:-1], "line 2: has no end of line"),
        (row(2, 0.5, "../IMG/"), "line 2: .*lies outside the folder"),
        ("IMG/a.jpg,IMG/a.jpg,IMG/b.jpg,0,0,0,0\n", "names one image for two cameras"),
        (",IMG/a.jpg,IMG/b.jpg,0,0,0,0\n", "names no image"),
        (row(1, 0.5), "line 1: names the image center_1.jpg, which 2 rows name"),
    ],
)
def test_a_malformed_row(text: str, problem: str, tmp_path: Path) -> None:
    put_text(tmp_path / "driving_log.csv", row(1, 0.1) + text)
    with pytest.raises(InputError, match=problem):
        read_samples([tmp_path])


def test_other_columns(tmp_path: Path) -> None:
    put_text(tmp_path / "driving_log.csv", "center,steering\nIMG/a.jpg,0\n")
    with pytest.raises(InputError, match="its first line names other columns"):
        read_samples([tmp_path])
