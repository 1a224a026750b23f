from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from hrt_cli.artifacts.carriers import (
    json_provenance,
    npz_provenance,
    parse_provenance,
    publish_json,
    publish_npz,
    read_stamped_npz,
)
from hrt_cli.artifacts.npz import read_npz, write_npz
from hrt_cli.artifacts.provenance import Provenance, file_sha256, record
from hrt_cli.errors import InputError

PARAMETERS = {"classes": 5, "scale": 0.1, "names": ["a", "b"], "nothing": None}


def file_of(path: Path, content: bytes = b"pixels") -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


def fingerprint(inputs: dict[str, Path], stage: str = "segment", version: int = 1, **changes: Any) -> str:
    return record(stage, version, PARAMETERS | changes, inputs).fingerprint


def test_the_fingerprint_depends_on_stage_parameters_and_input_bytes_only(tmp_path: Path) -> None:
    here = file_of(tmp_path / "ortho.tif")
    base = fingerprint({"ortho": here})
    assert fingerprint({"ortho": file_of(tmp_path / "sub" / "renamed.tif")}) == base
    os.utime(here, (0, 0))
    assert fingerprint({"ortho": here}) == base
    assert record("segment", 1, dict(reversed(PARAMETERS.items())), {"ortho": here}).fingerprint == base
    changed = {
        fingerprint({"ortho": file_of(tmp_path / "other.tif", b"pixelz")}),
        fingerprint({"ortho": here}, stage="other"),
        fingerprint({"ortho": here}, version=2),
        fingerprint({"ortho": here}, classes=6),
        fingerprint({"ortho": here}, scale=0.1000001),
        fingerprint({"ortho": here}, more=None),
        fingerprint({"dsm": here}),
        fingerprint({"ortho": here, "dsm": here}),
        fingerprint({}),
    }
    assert len(changed) == 9
    assert base not in changed


def test_the_record_names_no_folder_and_no_time(tmp_path: Path) -> None:
    path = file_of(tmp_path / "deep" / "ortho.tif")
    made = record("segment", 1, PARAMETERS, {"ortho": path})
    (entry,) = made.inputs
    assert (entry.role, entry.name, entry.size) == ("ortho", "ortho.tif", 6)
    assert entry.sha256 == hashlib.sha256(b"pixels").hexdigest()
    assert str(tmp_path) not in made.model_dump_json()
    assert record("segment", 1, PARAMETERS, {"ortho": path}) == made


def test_a_file_name_that_is_not_utf8_can_be_recorded(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.tif"))
    try:
        path.write_bytes(b"pixels")
    except OSError:
        pytest.skip("the file system takes UTF-8 names only")
    made = record("segment", 1, {}, {"ortho": path})
    assert made.inputs[0].name == r"caf\xe9.tif"
    publish_json(tmp_path / "out.json", {}, made)
    assert json_provenance(tmp_path / "out.json") is not None


def test_the_hash_is_taken_in_pieces(tmp_path: Path) -> None:
    content = os.urandom(9 * 2**20)
    assert file_sha256(file_of(tmp_path / "a", content)) == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("name", ["absent.tif", "."])
def test_an_input_that_is_no_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="no such file"):
        record("segment", 1, {}, {"ortho": tmp_path / name})
    with pytest.raises(InputError, match="cannot be read"):
        file_sha256(tmp_path / name)


def test_a_json_artifact_carries_its_provenance_last(tmp_path: Path) -> None:
    target = tmp_path / "plan.json"
    made = record("plan", 1, PARAMETERS, {})
    publish_json(target, {"score": 1.5, "cells": [[0, 1]], "größe": "ü"}, made)
    document = json.loads(target.read_text())
    assert list(document) == ["score", "cells", "größe", "provenance"]
    found = json_provenance(target)
    assert found is not None
    assert found.fingerprint == made.fingerprint
    assert len(found.content_sha256) == 64


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"score": 1.5', '"score": 1.25'),
        ('"score": 1.5', '"score": 1.5, "more": 0'),
        ('"content_sha256": "', '"content_sha256": "0'),
        ('"tool": "hrt"', '"tool": "hrt", "who": "me"'),
        ('"stage_version": 1', '"stage_version": "1"'),
        ('"inputs": []', '"inputs": {}'),
        ('"provenance": {', '"provenance": [], "was": {'),
    ],
)
def test_an_edited_json_artifact_is_refused(tmp_path: Path, old: str, new: str) -> None:
    target = tmp_path / "plan.json"
    publish_json(target, {"score": 1.5}, record("plan", 1, {}, {}))
    text = target.read_text()
    assert text.count(old) == 1
    target.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"plan\.json: its (content|provenance)"):
        json_provenance(target)


def test_a_reformatted_json_artifact_is_the_same_content(tmp_path: Path) -> None:
    target = tmp_path / "plan.json"
    publish_json(target, {"score": 1.5, "steps": 3}, record("plan", 1, {}, {}))
    document = json.loads(target.read_text())
    target.write_text(json.dumps(dict(reversed(document.items())), indent=7))
    assert json_provenance(target) is not None


@pytest.mark.parametrize("text", ["{}", "[]", "3", '{"a": 1}'])
def test_other_json_has_no_provenance(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert json_provenance(tmp_path / "a.json") is None


def test_an_npz_artifact_carries_its_provenance_beside_the_arrays(tmp_path: Path) -> None:
    target = tmp_path / "policy.npz"
    made = record("train-plan", 1, PARAMETERS, {})
    publish_npz(target, {"weights": np.arange(3.0)}, made)
    arrays, found = read_stamped_npz(target)
    assert list(arrays) == ["weights"]
    assert found is not None
    assert found.fingerprint == made.fingerprint
    first = target.read_bytes()
    publish_npz(target, {"weights": np.arange(3.0)}, made)
    assert target.read_bytes() == first


def test_an_edited_npz_artifact_is_refused(tmp_path: Path) -> None:
    target = tmp_path / "policy.npz"
    publish_npz(target, {"weights": np.arange(3.0)}, record("train-plan", 1, {}, {}))
    arrays = read_npz(target)
    for changes in (
        {"weights": np.arange(3.0) + 1e-12},
        {"more": np.array(1)},
        {"provenance": np.array(5)},
        {"provenance": np.array(["{}", "{}"])},
        {"provenance": np.array("{")},
        {"provenance": np.array("")},
    ):
        write_npz(target, arrays | changes)
        with pytest.raises(InputError, match=r"policy\.npz: "):
            npz_provenance(target)
    write_npz(target, {"weights": arrays["weights"]})
    assert npz_provenance(target) is None


def test_a_record_without_a_content_hash_does_not_pass(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"provenance": record("plan", 1, {}, {}).model_dump(mode="json")}))
    with pytest.raises(InputError, match="its content is not what its provenance recorded"):
        json_provenance(tmp_path / "a.json")


@pytest.mark.parametrize("key", ["fingerprint", "content_sha256"])
def test_hashes_have_the_form_of_hashes(key: str) -> None:
    members = record("plan", 1, {}, {}).model_dump(mode="json")
    for wrong in ("0" * 63, "G" * 64, "0" * 65, "0" * 64 + "\n"):
        with pytest.raises(InputError, match="its provenance record is damaged"):
            parse_provenance(Path("a.json"), members | {key: wrong})
    with pytest.raises(ValidationError):
        Provenance.model_validate(members | {"parameters": {"x": object()}})
