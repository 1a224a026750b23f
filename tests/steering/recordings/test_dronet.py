"""DroNet's recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_files import put_text

from hrt_cli.errors import InputError
from hrt_cli.steering.recordings.samples import read_samples

HEADER = "# angle,torque,speed,lat,long,alt\n"


def put_dronet(
    folder: Path, angles: list[float | str], *, names: list[str] | None = None, header: str = HEADER
) -> Path:
    rows = [f"{angle},-5.0e-01,2.2e+01,3.7e+01,-1.2e+02,1.0e+01\n" for angle in angles]
    put_text(folder / "sync_steering.txt", header + "".join(rows))
    for name in names if names is not None else [f"{n}.png" for n in range(len(angles))]:
        put_text(folder / "images" / name, "")
    return folder


def test_left_is_positive_there_and_right_here(tmp_path: Path) -> None:
    put_dronet(tmp_path / "HMB_1", ["2.5e-01", "-5.0e-01", "0.0"])
    found = read_samples([tmp_path / "HMB_1"])
    assert found.steering[:, 0].tolist() == [-0.25, 0.5, 0.0]
    assert not np.signbit(found.steering[2, 0])
    assert found.paths == tuple(tmp_path / "HMB_1" / "images" / f"{n}.png" for n in range(3))


def test_pictures_by_the_number_in_their_name(tmp_path: Path) -> None:
    put_dronet(
        tmp_path, [0.1, 0.2, 0.3], names=["frame_10.jpg", "frame_9.jpg", "frame_0100.jpg", ".DS_Store", "._9.jpg"]
    )
    found = read_samples([tmp_path])
    assert [path.name for path in found.paths] == ["frame_9.jpg", "frame_10.jpg", "frame_0100.jpg"]
    np.testing.assert_allclose(found.steering[:, 0], [-0.1, -0.2, -0.3], atol=1e-7)


def test_beyond_one_radian(tmp_path: Path) -> None:
    notes: list[str] = []
    put_dronet(tmp_path, [1.5, -3, 0.5])
    assert read_samples([tmp_path], note=notes.append).steering[:, 0].tolist() == [-1.0, 1.0, -0.5]
    assert "2 of 3 angles are beyond 1 rad" in notes[0]


@pytest.mark.parametrize(
    ("angles", "names", "header", "problem"),
    [
        ([0.1, 0.2], ["1.png"], HEADER, "has 2 rows for 1 images"),
        ([0.1, 0.2], ["1.png", "2.png", "3.png"], HEADER, "has 2 rows for 3 images"),
        ([0.1, 0.2], ["1.png", "a.png"], HEADER, "a.png: is not a numbered"),
        ([0.1, 0.2], ["1.png", "2.txt"], HEADER, "2.txt: is not a numbered"),
        ([0.1, 0.2], ["cam0_1.png", "cam0_2.png"], HEADER, "has the same number"),
        ([0.1, 0.2], None, "", "is no header"),
        ([0.1, 0.2], None, "# torque,angle,speed,lat,long,alt\n", "is no header"),
        ([0.1, "nan"], None, HEADER, "line 3: the angle is 'nan'"),
        ([0.1, 30], None, HEADER, "line 3: the angle is 30; no steering wheel"),
        ([0.1, "0.1,2"], None, HEADER, "line 3: has 7 fields"),
    ],
)
def test_refused(angles: list[float | str], names: list[str] | None, header: str, problem: str, tmp_path: Path) -> None:
    put_dronet(tmp_path, angles, names=names, header=header)
    with pytest.raises(InputError, match=problem):
        read_samples([tmp_path])


def test_a_malformed_row_takes_its_picture_with_it(tmp_path: Path) -> None:
    put_dronet(tmp_path, [0.1, "x", 0.3])
    found = read_samples([tmp_path], skip_bad=True)
    assert [path.name for path in found.paths] == ["0.png", "2.png"]
    np.testing.assert_allclose(found.steering[:, 0], [-0.1, -0.3], atol=1e-7)


def test_no_images(tmp_path: Path) -> None:
    put_text(tmp_path / "sync_steering.txt", HEADER + "0,0,0,0,0,0\n")
    with pytest.raises(InputError, match="images: cannot be read"):
        read_samples([tmp_path])


def test_collisions_only(tmp_path: Path) -> None:
    put_text(tmp_path / "GOPR0200" / "labels.txt", "0\n1\n")
    for given in (tmp_path, tmp_path / "GOPR0200"):
        with pytest.raises(InputError, match=r"collision labels \(labels.txt\) and no steering"):
            read_samples([given])
    put_dronet(tmp_path / "HMB_1", [0.1, 0.2])
    notes: list[str] = []
    assert len(read_samples([tmp_path], note=notes.append).paths) == 2
    assert "1 folders with collision labels only" in notes[0]
