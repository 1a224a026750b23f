"""`hrt compare` as a user runs it: kinds, refusals, the table, the figure."""

from __future__ import annotations

import itertools
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from affine import Affine
from compare_files import (
    PLACE,
    compare,
    edit,
    ids,
    put_classes,
    put_drive,
    put_plan,
    put_policy,
    put_scoremap,
    put_scores,
    put_texture,
    scores_map,
)

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.evaluation.compare.kinds import kind_of
from hrt_cli.evaluation.compare.names import NAMES

COLUMNS = ("speed_m_s", "commanded_m_s", "heading_deg", "pitch_deg", "roll_deg", "depth_m")


@pytest.fixture(scope="module")
def artifacts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("all")
    scoremap = put_scoremap(folder / "scoremap")
    (folder / "figures").write_text('{"ari": 0.5, "seconds": 3}\n')
    return {
        "classes": put_classes(folder / "classes"),
        "scoremap": scoremap,
        "scores": put_scores(folder / "scores"),
        "plan": put_plan(folder / "plan", scoremap),
        "team plan": put_plan(folder / "team", scoremap, robots=2),
        "policy": put_policy(folder / "policy"),
        "texture model": put_texture(folder / "texture"),
        "drive log": put_drive(folder / "drive"),
        "figures": folder / "figures",
    }


def test_kinds_are_told_by_what_a_file_holds_not_by_its_name(artifacts: dict[str, Path]) -> None:
    assert {kind: kind_of(path) for kind, path in artifacts.items()} == {kind: kind for kind in artifacts}


def test_two_kinds_are_not_compared(artifacts: dict[str, Path]) -> None:
    paths = list(artifacts.values())
    for a, b in itertools.pairwise(paths):
        done = compare(a, b)
        assert isinstance(done.exception, InputError)
        assert "they cannot be compared" in str(done.exception)
        assert done.stdout == ""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "e"),
        ("[1, 2]", "a list in JSON"),
        ("{", "not valid JSON"),
        ('{"a": NaN}', "NaN"),
        ('{"a": 1, "a": 2}', "stands twice"),
        ('{"fileType": "Plan", "mission": {}}', "compare the plans"),
        ('{"type": "FeatureCollection", "features": []}', "compare the plans"),
        ("QGC WPL 110\n0\t1\n", "compare the plans"),
        ('<?xml version="1.0"?><kml xmlns="x"></kml>', "compare the plans"),
        ('<gpx version="1.1"><rte></rte></gpx>', "compare the plans"),
        ('{"format": "hrt-plan"}', "Field required"),
        ('{"scores": {"0": 2}}', "scores.0.mean"),
        ('{"format": "hrt-drive-log"}\n{"t": 0}\n', "line 2"),
        ("hello", "nothing that can be compared"),
    ],
)
def test_what_cannot_be_compared_is_refused(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "e"
    path.write_text(text)
    done = compare(path, path)
    assert isinstance(done.exception, InputError), done.output
    assert done.exception.exit_code == 1
    assert str(path) in str(done.exception)
    assert told in str(done.exception)


def test_files_that_are_not_there_and_archives_of_nothing_known_are_refused(
    artifacts: dict[str, Path], tmp_path: Path
) -> None:
    known = artifacts["scores"]
    np.savez(tmp_path / "n.npz", other=np.zeros(3))
    with zipfile.ZipFile(tmp_path / "z.npz", "w") as archive:
        archive.writestr("a.txt", "x")
    for other in (tmp_path / "absent.tif", tmp_path, tmp_path / "n.npz", tmp_path / "z.npz"):
        for pair in ((known, other), (other, known)):
            assert isinstance(compare(*pair).exception, InputError)


def test_json_and_table_say_the_same(artifacts: dict[str, Path], tmp_path: Path) -> None:
    other = put_scores(tmp_path / "b.json", _0={"alpha": 7.0})
    done = compare(artifacts["scores"], other, "--tolerance", "sd_max=1")
    found = json.loads(compare(artifacts["scores"], other, "--tolerance", "sd_max=1", "--json").stdout)
    assert found["kind"] == "scores"
    assert set(found["figures"]["max"]) == {"a", "b", "difference", "tolerance", "ok", "unit"}
    assert found["figures"]["sd_max"]["ok"] is True
    assert found["figures"]["sd_max"]["tolerance"] == 1
    lines = done.stdout.splitlines()
    assert lines[0].endswith("(B) are DIFFERENT")
    states = {line.split()[0]: line.split()[-1] for line in lines[2:] if line.split()[-1] in ("ok", "DIFFERENT")}
    assert states == {name: "ok" if each["ok"] else "DIFFERENT" for name, each in found["figures"].items()}
    assert any(line.startswith("class 0: 'grass', mean 0.8") for line in lines)


def test_a_long_list_of_figures_shows_those_that_differ(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({str(k): k for k in range(500)}))
    (tmp_path / "b.json").write_text(json.dumps({str(k): k + (k == 321) for k in range(500)}))
    lines = compare(tmp_path / "a.json", tmp_path / "b.json").stdout.splitlines()
    assert lines[1] == "499 of 500 figures are equal"
    assert len(lines) == 4
    assert lines[-1].split() == ["321", "321", "322", "1", "0", "DIFFERENT"]
    assert lines[0].endswith("(B) are DIFFERENT")
    lines = compare(tmp_path / "a.json", tmp_path / "b.json", "--tolerance", "321=1").stdout.splitlines()
    assert lines[0].endswith("(B) are the same within the tolerances")
    lines = compare(tmp_path / "a.json", tmp_path / "a.json").stdout.splitlines()
    assert lines[0].endswith("(B) are the same")
    assert lines[1:] == ["500 of 500 figures are equal"]


def pairs(artifacts: dict[str, Path], folder: Path) -> dict[str, Path]:
    """Another artifact of every kind."""
    values, score = ids(), scores_map()
    values[10:20, 10:20] = 2
    score[12:16, 2:6] = np.nan
    score[10, 10] += 0.4
    scoremap = put_scoremap(folder / "s.tif", score)
    (folder / "f.json").write_text('{"ari": 0.4, "more": 1, "seconds": 5}')
    return {
        "classes": put_classes(folder / "c.tif", values),
        "scoremap": scoremap,
        "scores": put_scores(folder / "t.json", _0={"alpha": 5.0}, _2=None),
        "plan": put_plan(folder / "p.json", scoremap),
        "team plan": put_plan(folder / "team.json", scoremap, robots=2),
        "policy": put_policy(folder / "p.npz", lambda arrays: arrays["weights"].__imul__(1.01)),
        "texture model": put_texture(folder / "t.npz", lambda arrays: arrays["centroids"].__imul__(1.01)),
        "drive log": put_drive(folder / "d.jsonl", [{"t": float(k), "x": 4e5 + k, "y": 5e6 - k} for k in range(9)]),
        "figures": folder / "f.json",
    }


def test_every_kind_has_a_figure_that_is_an_artifact(artifacts: dict[str, Path], tmp_path: Path) -> None:
    others = pairs(artifacts, tmp_path)
    for kind, a in artifacts.items():
        figure = tmp_path / f"{kind}.png"
        on = ("--scoremap", artifacts["scoremap"]) if kind == "plan" else ()
        assert compare(a, others[kind], "--figure", figure, *on).exception.exit_code == 3, kind
        assert cv2.imread(str(figure)).std() > 10, kind
        found = png_provenance(figure)
        assert found is not None
        assert {"a", "b"} <= {each.role for each in found.inputs}
        before = figure.read_bytes()
        assert compare(a, others[kind], "--figure", figure, *on).exception.exit_code == 3
        assert figure.read_bytes() == before, kind


def test_a_figure_is_the_same_bytes_and_replaces_no_other(artifacts: dict[str, Path], tmp_path: Path) -> None:
    other, figure = put_scores(tmp_path / "t.json", _0={"alpha": 5.0}), tmp_path / "f.png"
    for kind in ("scores", "policy", "figures", "plan"):
        a = artifacts[kind]
        assert compare(a, a, "--figure", figure, "--overwrite").exit_code == 0, "what is the same is drawn, too"
        before = figure.read_bytes()
        assert compare(a, a, "--figure", figure, "--force").exit_code == 0
        assert figure.read_bytes() == before
    done = compare(artifacts["scores"], other, "--figure", figure)
    assert isinstance(done.exception, OutputError), "it is another's"
    assert done.stdout == ""


def test_every_figure_has_its_place_among_those_that_take_a_tolerance(
    artifacts: dict[str, Path], tmp_path: Path
) -> None:
    for kind, other in pairs(artifacts, tmp_path).items():
        if kind == "figures":
            continue
        found = json.loads(compare(artifacts[kind], other, "--json").stdout)["figures"]
        judged = {name for name, each in found.items() if each["tolerance"] is not None}
        assert judged <= set(NAMES[kind])
        # A log of more records is not compared record by record.
        assert set(NAMES[kind]) - judged <= ({"times_s", *COLUMNS} if kind == "drive log" else set())


@pytest.mark.parametrize(
    ("put", "change"),
    [(put_classes, Affine.translation(0.5, 0)), (put_scoremap, Affine.translation(0.5, 0)),
     (put_classes, Affine.translation(7, -3))],
)  # fmt: skip
def test_rasters_on_other_grids_are_drawn_too(tmp_path: Path, put: Callable[..., Path], change: Affine) -> None:
    a, b = put(tmp_path / "a.tif"), put(tmp_path / "b.tif", transform=PLACE @ change)
    assert compare(a, b, "--figure", tmp_path / "f.png").exception.exit_code == 3
    assert cv2.imread(str(tmp_path / "f.png")) is not None


def test_a_scoremap_is_for_plans_and_of_their_grid(artifacts: dict[str, Path], tmp_path: Path) -> None:
    plan, figure = artifacts["plan"], ("--figure", tmp_path / "f.png")
    assert compare(plan, plan, "--scoremap", artifacts["scoremap"]).exit_code == 2
    done = compare(artifacts["scores"], artifacts["scores"], "--scoremap", artifacts["scoremap"], *figure)
    assert isinstance(done.exception, ArgumentError)
    other = put_scoremap(tmp_path / "s.tif", transform=PLACE @ Affine.translation(1, 0))
    assert isinstance(compare(plan, plan, "--scoremap", other, *figure).exception, InputError)


def test_inputs_are_told_and_do_not_count(artifacts: dict[str, Path], tmp_path: Path) -> None:
    plan = artifacts["plan"]
    signed = edit(plan, tmp_path / "b.json", lambda document: None, signed=True)
    found = json.loads(compare(plan, signed, "--json").stdout)
    assert found["same"] is True
    assert found["origin"]["same_inputs"] is False
    assert "made from other inputs" in compare(plan, signed).stdout
