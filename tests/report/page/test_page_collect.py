"""Files of a folder are told by their content, and it is known what was made of what."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.report.page.collect import collect, natural
from hrt_cli.report.page.lineage import lineage

MEADOW = Path(__file__).parents[3] / "fixtures" / "meadow"


def test_a_site_is_told_file_by_file() -> None:
    kinds = {item.name: item.kind for item in collect([MEADOW]).items}
    assert kinds == {
        "aoi.geojson": "area",
        "dsm.tif": "surface model",
        "ortho.tif": "orthomosaic",
        "truth.tif": "class raster",
        "world.json": "world",
    }


def test_names_do_not_matter_but_content_does(tmp_path: Path) -> None:
    shutil.copy(MEADOW / "truth.tif", tmp_path / "ortho.tif")
    (tmp_path / "my scores.json").write_text(json.dumps({"scores": {"0": 0.5}}))
    (tmp_path / "numbers.json").write_text(json.dumps({"a": 1}))
    (tmp_path / "cut.json").write_text('{"scores": ')
    (tmp_path / "report.html").write_text("a page is no part of what it shows")
    (tmp_path / "notes.md").write_text("nor are notes")
    folder = collect([tmp_path])
    kinds = {item.name: (item.kind, bool(item.problem)) for item in folder.items}
    assert kinds == {
        "ortho.tif": ("class raster", False),
        "my scores.json": ("score table", False),
        "cut.json": ("unknown", True),
    }
    assert folder.notes == ["1 files of other kinds are not shown: numbers.json"]


def test_what_is_evaluated_is_known_by_its_keys(tmp_path: Path) -> None:
    (tmp_path / "steer.json").write_text(json.dumps({"mae": 0.1, "nll": 1.0, "reliability": {}, "ece": 0.1}))
    (tmp_path / "agreement.json").write_text(json.dumps({"ari": 0.9, "nmi": 0.9, "confusion": [[1]], "accuracy": 1.0}))
    (tmp_path / "epochs.jsonl").write_text('{"epoch": 1, "train_loss": 2.0}\n{"epoch": 2, "train_loss": 1.0}\n')
    kinds = {item.name: item.kind for item in collect([tmp_path]).items}
    assert kinds == {"steer.json": "evaluation", "agreement.json": "evaluation", "epochs.jsonl": "training history"}


def made(path: Path, stage: str, inputs: dict[str, Path]) -> Path:
    publish_json(path, {"format": "hrt-scores", "scores": {"0": 0.5}, "of": stage}, record(stage, 1, {}, inputs))
    return path


def test_what_was_made_of_others_comes_after_them_and_knows_them_by_their_bytes(tmp_path: Path) -> None:
    first = made(tmp_path / "z.json", "one", {})
    second = made(tmp_path / "a.json", "two", {"scores": first})
    made(tmp_path / "0.json", "three", {"scores": second})
    folder = collect([tmp_path])
    assert [item.name for item in folder.items] == ["z.json", "a.json", "0.json"]
    assert folder.input_of(folder.items[1], "scores") is folder.items[0]
    assert folder.input_of(folder.items[1], "dsm") is None
    shutil.move(first, tmp_path / "renamed.json")
    folder = collect([tmp_path])
    (a,) = (item for item in folder.items if item.name == "a.json")
    found = folder.input_of(a, "scores")
    assert found is not None
    assert found.name == "renamed.json"


def test_an_input_that_changed_since_is_told_from_one_that_is_elsewhere(tmp_path: Path) -> None:
    first = made(tmp_path / "first.json", "one", {})
    second = made(tmp_path / "second.json", "two", {"scores": first})
    made(tmp_path / "third.json", "three", {"scores": second})

    def states() -> dict[str, list[str]]:
        rows = lineage(collect([tmp_path]))
        return {row["name"]: [each["status"] for each in row.get("inputs", [])] for row in rows}

    assert states() == {"first.json": [], "second.json": ["here"], "third.json": ["here"]}
    made(first, "another", {})
    assert states()["second.json"] == ["changed"]
    first.unlink()
    assert states()["second.json"] == ["elsewhere"]


def test_links_and_hidden_folders_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / ".hidden").mkdir()
    made(tmp_path / ".hidden" / "a.json", "one", {})
    (tmp_path / "link").symlink_to(MEADOW)
    (tmp_path / "link.tif").symlink_to(MEADOW / "ortho.tif")
    assert collect([tmp_path]).items == []


def test_several_paths_and_one_that_is_not_there(tmp_path: Path) -> None:
    made(tmp_path / "a.json", "one", {})
    names = [item.name for item in collect([tmp_path, MEADOW / "ortho.tif"]).items]
    assert names == [f"{tmp_path.name}/a.json", "ortho.tif"] or names == ["ortho.tif", f"{tmp_path.name}/a.json"]
    with pytest.raises(InputError, match="no such file or folder"):
        collect([tmp_path / "nothing"])


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    paths = []
    for folder in ("a/seed-0", "a/seed-1", "b/seed-0"):
        (tmp_path / folder).mkdir(parents=True)
        paths.append(made(tmp_path / folder / "plan.json", folder, {}))
    single = made(tmp_path / "scores.json", "one", {})
    names = [item.name for item in collect([*paths, single]).items]
    assert sorted(names) == ["a/seed-0/plan.json", "a/seed-1/plan.json", "b/seed-0/plan.json", "scores.json"] or sorted(
        names
    ) == ["a/seed-0/plan.json", "b/seed-0/plan.json", "scores.json", "seed-1/plan.json"]
    folders = [tmp_path / "a" / "seed-0", tmp_path / "b" / "seed-0"]
    assert sorted(item.name for item in collect(folders).items) == ["a/seed-0/plan.json", "b/seed-0/plan.json"]


def test_numbers_in_names_are_sorted_as_numbers() -> None:
    names = ["round-10/leg-1", "round-2/leg-10", "round-2/leg-9", "a", "round-2"]
    assert sorted(names, key=natural) == ["a", "round-2", "round-2/leg-9", "round-2/leg-10", "round-10/leg-1"]
