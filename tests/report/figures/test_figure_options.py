"""`--figure` is one option everywhere: what it draws, once, and what it refuses before any work."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from raster_files import UTM33, write_raster
from world_files import GRASS, map_xy, place_of, put_drive_log, put_plan, put_world

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.errors import HrtError
from hrt_cli.main import cli

pytestmark = pytest.mark.usefixtures("drawn")


def hrt(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def stage_of(*words: object) -> str:
    """The stage that drew a command's figure `f.png`: it is drawn at the first run, and the same after the second."""
    folder = Path(str(words[-1])).parent
    done = hrt(*words, "--figure", folder / "f.png")
    assert done.exit_code == 0, (done.output, done.exception)
    before = (folder / "f.png").stat().st_mtime_ns
    assert hrt(*words, "--figure", folder / "f.png").exit_code == 0
    assert (folder / "f.png").stat().st_mtime_ns == before
    found = png_provenance(folder / "f.png")
    assert found is not None
    assert str(folder) not in found.model_dump_json()
    return found.stage


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small world with a plan, a drive log and its classes."""
    folder = put_world(
        tmp_path_factory.mktemp("s") / "site", np.zeros((60, 80)), classes=np.zeros((60, 80)), table={"0": GRASS}
    )
    put_plan(folder / "plan.json", [map_xy(1, 3), map_xy(7, 3)])
    records = [
        dict(zip("txy", (k, *map_xy(1 + k, 3)), strict=True)) | {"speed_m_s": 1.0, "commanded_m_s": 1.0}
        for k in range(6)
    ]
    put_drive_log(folder / "log.jsonl", records)
    write_raster(folder / "classes.tif", np.zeros((60, 80), np.uint8), crs=UTM33, transform=place_of(0.1), nodata=255)
    return folder


def test_feedback(site: Path, tmp_path: Path) -> None:
    words = ["feedback", site / "log.jsonl", "--classes", site / "classes.tif", "-o", tmp_path / "s.json"]
    assert stage_of(*words) == "figure-scores"


def test_drive(site: Path, tmp_path: Path) -> None:
    words = ["drive", site / "plan.json", "--world", site, "--time-limit", 3, "-o", tmp_path / "d.jsonl"]
    assert stage_of(*words) == "figure-drive"


def test_synth(tmp_path: Path) -> None:
    folder = tmp_path / "site"
    done = hrt("synth", "--size", 6.4, "--figure", tmp_path / "f.png", folder)
    assert done.exit_code == 0, done.output
    found = png_provenance(tmp_path / "f.png")
    assert found is not None
    assert {each.role for each in found.inputs} == {"ortho", "truth", "dsm"}


@pytest.mark.parametrize(
    ("name", "stage"),
    [("ortho.tif", "raster"), ("dsm.tif", "raster"), ("truth.tif", "classes"), ("log.jsonl", "drive")],
)
def test_inspect(site: Path, tmp_path: Path, name: str, stage: str) -> None:
    (tmp_path / name).write_bytes((site / name).read_bytes())
    assert stage_of("inspect", tmp_path / name) == f"figure-{stage}"


def test_a_log_is_inspected_on_an_orthomosaic(site: Path, tmp_path: Path) -> None:
    words = ["inspect", site / "log.jsonl", "--figure", tmp_path / "f.png", "--backdrop", site / "ortho.tif"]
    assert hrt(*words).exit_code == 0
    found = png_provenance(tmp_path / "f.png")
    assert found is not None
    assert {each.role for each in found.inputs} == {"log", "backdrop"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--figure", "f.jpg"], "a figure is a PNG"),
        (["--figure", "nowhere/f.png"], "does not exist"),
        (["--backdrop", "ortho.tif"], "is for a --figure"),
        (["--figure", "f.png", "--backdrop", "ortho.tif"], "--backdrop is for the figure of a drive log"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_any_work(site: Path, words: list[str], message: str) -> None:
    words = [word if word.startswith("--") else str(site / word) for word in words]
    for command in (["inspect", site / "ortho.tif"], ["inspect", site]):
        done = hrt(*command, *words)
        assert done.exit_code != 0
        assert message in done.output + str(done.exception)
        assert isinstance(done.exception, (HrtError, SystemExit))
    assert not list(site.glob("*.png"))


def test_a_folder_has_no_figure(site: Path, tmp_path: Path) -> None:
    done = hrt("inspect", site, "--figure", tmp_path / "f.png")
    assert done.exit_code == 2
    assert "name one of those in the folder" in done.output
