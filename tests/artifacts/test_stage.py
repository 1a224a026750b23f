from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hrt_cli.artifacts import publish
from hrt_cli.artifacts.carriers import json_provenance, publish_json
from hrt_cli.artifacts.stage import REFUSE, Existing, Job, begin, freshen
from hrt_cli.errors import InputError, OutputError

OVERWRITE, FORCE = Existing(overwrite=True), Existing(force=True)


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    (tmp_path / "ortho.tif").write_bytes(b"pixels")
    return tmp_path / "ortho.tif"


def asked(ortho: Path, *outputs: str, existing: Existing = REFUSE, classes: int = 5) -> Job:
    return begin(
        "segment",
        1,
        inputs={"ortho": ortho},
        parameters={"classes": classes},
        outputs={ortho.parent / name: json_provenance for name in outputs or ("out.json",)},
        existing=existing,
    )


def done(ortho: Path, *outputs: str, classes: int = 5) -> None:
    """Run the stage: publish what `begin` decided on."""
    job = asked(ortho, *outputs, existing=FORCE, classes=classes)
    for name in outputs or ("out.json",):
        publish_json(ortho.parent / name, {"classes": classes}, job.provenance)


def test_an_absent_output_is_made(ortho: Path) -> None:
    job = asked(ortho)
    assert not job.up_to_date
    assert job.provenance.stage == "segment"
    assert not (ortho.parent / "out.json").exists()


@pytest.mark.parametrize("existing", [REFUSE, OVERWRITE])
def test_an_output_of_the_same_run_is_up_to_date(ortho: Path, existing: Existing) -> None:
    done(ortho)
    before = (ortho.parent / "out.json").read_bytes()
    assert asked(ortho, existing=existing).up_to_date
    assert (ortho.parent / "out.json").read_bytes() == before


def test_it_stays_up_to_date_when_the_folder_moves(ortho: Path) -> None:
    done(ortho)
    moved = ortho.parent.with_name("moved")
    ortho.parent.rename(moved)
    assert asked(moved / "ortho.tif").up_to_date


def test_force_runs_again(ortho: Path) -> None:
    done(ortho)
    assert not asked(ortho, existing=FORCE).up_to_date


@pytest.mark.parametrize("change", ["parameter", "input", "foreign", "empty", "damaged", "edited"])
def test_anything_else_is_refused_unless_it_may_be_overwritten(ortho: Path, change: str) -> None:
    done(ortho)
    output, classes = ortho.parent / "out.json", 5
    if change == "parameter":
        classes = 6
    elif change == "input":
        ortho.write_bytes(b"pixelz")
    elif change == "edited":
        output.write_text(output.read_text().replace('"classes": 5,', '"classes": 7,', 1))
    else:
        whole = output.read_bytes()
        output.write_bytes({"foreign": b'{"by": "hand"}', "empty": b"", "damaged": whole[:-20]}[change])
    before = output.read_bytes(), output.stat().st_mtime_ns
    with pytest.raises(OutputError, match=r"out\.json: exists and was not made by this run; use --overwrite"):
        asked(ortho, classes=classes)
    assert (output.read_bytes(), output.stat().st_mtime_ns) == before
    for existing in (OVERWRITE, FORCE):
        assert not asked(ortho, existing=existing, classes=classes).up_to_date
    assert (output.read_bytes(), output.stat().st_mtime_ns) == before


def test_one_missing_output_of_two_runs_the_stage_again(ortho: Path) -> None:
    done(ortho, "a.json", "b.json")
    assert asked(ortho, "a.json", "b.json").up_to_date
    (ortho.parent / "b.json").unlink()
    assert not asked(ortho, "a.json", "b.json").up_to_date


def test_one_foreign_output_of_two_is_refused(ortho: Path) -> None:
    done(ortho, "a.json", "b.json")
    (ortho.parent / "b.json").write_text("{}")
    with pytest.raises(OutputError, match=r"b\.json: exists"):
        asked(ortho, "a.json", "b.json")


def test_an_output_that_is_an_input_is_refused_even_with_force(ortho: Path) -> None:
    with pytest.raises(OutputError, match="also an input"):
        asked(ortho, "ortho.tif", existing=FORCE)
    assert ortho.read_bytes() == b"pixels"


def test_a_missing_input_is_an_input_error(ortho: Path) -> None:
    ortho.unlink()
    with pytest.raises(InputError, match=r"ortho\.tif: no such file"):
        asked(ortho)


def test_a_read_only_folder_is_refused_before_the_inputs_are_hashed(
    ortho: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publish.os, "access", lambda *_: False)
    ortho.unlink()
    with pytest.raises(OutputError, match="cannot be written"):
        asked(ortho)


@pytest.mark.parametrize("ahead_s", [-100, 1000])
def test_touched_inputs_freshen_what_is_up_to_date(ortho: Path, ahead_s: int) -> None:
    done(ortho, "a.json", "b.json")
    outputs = [ortho.parent / name for name in ("a.json", "b.json")]
    for path in outputs:
        os.utime(path, (1000, 1000))
    stamp = time.time() + ahead_s
    os.utime(ortho, (stamp, stamp))
    assert asked(ortho, "a.json", "b.json").up_to_date
    for path in outputs:
        assert path.stat().st_mtime_ns >= ortho.stat().st_mtime_ns


def test_what_is_newer_than_its_inputs_keeps_its_time(ortho: Path) -> None:
    done(ortho)
    os.utime(ortho, (1000, 1000))
    os.utime(ortho.parent / "out.json", (2000, 2000))
    assert asked(ortho).up_to_date
    assert (ortho.parent / "out.json").stat().st_mtime == 2000


def test_freshening_a_file_of_another_user_is_no_error(ortho: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done(ortho)
    output = ortho.parent / "out.json"
    os.utime(output, (1000, 1000))

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "utime", refuse)
    freshen([output], [ortho])
    assert output.stat().st_mtime == 1000
