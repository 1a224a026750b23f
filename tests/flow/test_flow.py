"""The contract between the commands: caching, overwriting, same bytes, keys of the JSON that other tools rely on."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import rasterio

ROOT = Path(__file__).parents[2]
ORTHO = ROOT / "fixtures" / "meadow" / "ortho.tif"


def run(*args: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


def run_json(*args: str | Path) -> dict[str, Any]:
    done = run(*args, "--json")
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def flow(out: Path, seed: int = 0) -> list[Path]:
    classes, scoremap, plan, mission = (out / n for n in ("c.tif", "s.tif", "p.json", "m.plan"))
    run_json("segment", ORTHO, "-o", classes, "--classes", "4", "--seed", str(seed), "--model-out", out / "m.npz")
    run_json("scoremap", classes, "-o", scoremap, "--figure", out / "s.png", "--backdrop", ORTHO)
    run_json("plan", scoremap, "-o", plan, "--start", "auto", "--budget", "60", "--figure", out / "p.png")
    run_json("export", plan, "-o", mission)
    return [classes, out / "m.npz", scoremap, out / "s.png", plan, out / "p.png", mission]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return flow(tmp_path_factory.mktemp("first"))


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_two_fresh_runs_are_byte_identical(first: list[Path], tmp_path: Path) -> None:
    deeper = tmp_path / "another" / "place with spaces & ü"
    deeper.mkdir(parents=True)
    second = flow(deeper)
    assert [sha(p) for p in first] == [sha(p) for p in second]


def test_same_command_twice_is_up_to_date(first: list[Path]) -> None:
    before = [(sha(p), p.stat().st_mtime_ns) for p in first]
    out = first[0].parent
    began = time.monotonic()
    done = run("segment", ORTHO, "-o", out / "c.tif", "--classes", "4", "--model-out", out / "m.npz")
    assert done.returncode == 0
    assert "up to date" in done.stdout
    assert time.monotonic() - began < 30
    for args in (("scoremap", out / "c.tif", "-o", out / "s.tif"), ("export", out / "p.json", "-o", out / "m.plan")):
        assert "up to date" in run(*args).stdout
    found = run("plan", out / "s.tif", "-o", out / "p.json", "--start", "auto", "--budget", "60")
    assert "up to date" in found.stdout
    assert before == [(sha(p), p.stat().st_mtime_ns) for p in first]


def test_other_parameters_are_refused_without_overwrite(first: list[Path]) -> None:
    out = first[0].parent
    before = [sha(p) for p in first]
    for args in (
        ("segment", ORTHO, "-o", out / "c.tif", "--classes", "4", "--seed", "1"),
        ("scoremap", out / "c.tif", "-o", out / "s.tif", "--cell", "2"),
        ("plan", out / "s.tif", "-o", out / "p.json", "--start", "auto", "--budget", "61"),
        ("export", out / "p.json", "-o", out / "m.plan", "--speed", "2"),
    ):
        done = run(*args)
        assert done.returncode == 1, args
        assert [line for line in done.stderr.splitlines() if line.startswith("Error:")], done.stderr
        assert "--overwrite" in done.stderr
    assert before == [sha(p) for p in first]


def test_overwrite_and_force(first: list[Path], tmp_path: Path) -> None:
    source = first[0]
    copy = tmp_path / "s.tif"
    assert run("scoremap", source, "-o", copy).returncode == 0
    old = sha(copy)
    assert run("scoremap", source, "-o", copy, "--cell", "2", "--overwrite").returncode == 0
    assert sha(copy) != old
    assert run("scoremap", source, "-o", copy, "--force").returncode == 0
    assert sha(copy) == old


def test_json_keys_that_other_tools_rely_on(first: list[Path]) -> None:
    out = first[0].parent
    segmented = run_json("segment", ORTHO, "-o", out / "c.tif", "--classes", "4", "--model-out", out / "m.npz")
    assert {"output", "classes", "class_fractions", "pixels", "seconds", "megapixels_per_second"} <= set(segmented)
    assert abs(sum(segmented["class_fractions"]) - 1) < 1e-9
    planned = run_json("plan", out / "s.tif", "-o", out / "p.json", "--start", "auto", "--budget", "60")
    wanted = {"output", "method", "score", "discounted_score", "upper_bound", "gap", "steps", "length_m", "seconds"}
    assert wanted <= set(planned)
    assert planned["steps"] == 60
    valued = run_json("evaluate", "plan", out / "s.tif", out / "p.json")
    assert {"plans", "baselines", "upper_bound"} <= set(valued)
    (worth,) = valued["plans"].values()
    assert worth["score"] == pytest.approx(planned["score"])
    for each in (*valued["plans"].values(), *valued["baselines"].values()):
        assert {"score", "discounted_score", "fraction_of_bound"} <= set(each)
        assert 0 < each["fraction_of_bound"] <= 1 + 1e-9


def test_outputs_open_in_rasterio(first: list[Path]) -> None:
    with rasterio.open(ORTHO) as ortho, rasterio.open(first[0]) as classes, rasterio.open(first[2]) as scoremap:
        assert classes.crs == ortho.crs == scoremap.crs
        assert classes.shape == ortho.shape
        assert classes.transform.almost_equals(ortho.transform)
        assert (classes.nodata, classes.dtypes) == (255, ("uint8",))
        assert len({classes.colormap(1)[k] for k in range(4)}) == 4
        assert scoremap.count == 2
        assert scoremap.dtypes == ("float32", "float32")
        assert str(scoremap.nodata) == "nan"


def test_provenance_has_no_path_and_no_clock(first: list[Path]) -> None:
    for path in first:
        content = path.read_bytes()
        assert str(path.parent).encode() not in content
        assert os.fsencode(ROOT) not in content
    assert run("verify", *[p for p in first if p.suffix != ".plan"], "--inputs", ORTHO.parent).returncode == 0


def test_verify_notices_a_changed_input(first: list[Path], tmp_path: Path) -> None:
    copies = [tmp_path / p.name for p in first[:3]]
    for source, copy in zip(first, copies, strict=False):
        copy.write_bytes(source.read_bytes())
    assert run("verify", copies[2]).returncode == 0
    copies[0].write_bytes(copies[0].read_bytes() + b"\0")
    done = run("verify", copies[2])
    assert done.returncode == 3
    assert "c.tif has changed" in done.stdout


def test_unreferenced_image(tmp_path: Path) -> None:
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    image = rng.integers(0, 60, (256, 256, 3), dtype=np.uint8)
    image[:, 128:] += 150
    cv2.imwrite(str(tmp_path / "plain.png"), image)
    refused = run("segment", tmp_path / "plain.png", "-o", tmp_path / "c.tif", "--classes", "2")
    assert refused.returncode == 1
    assert "coordinate reference system" in refused.stderr
    found = run_json("segment", tmp_path / "plain.png", "-o", tmp_path / "c.tif", "--classes", "2", "--unreferenced")
    assert found["class_fractions"] == pytest.approx([0.5, 0.5], abs=0.1)


def test_two_outputs_cannot_be_one_file(tmp_path: Path) -> None:
    same = tmp_path / "x.tif"
    done = run("segment", ORTHO, "-o", same, "--classes", "4", "--model-out", tmp_path / "." / "x.tif")
    assert done.returncode == 1
    assert "two outputs" in done.stderr
    assert not same.exists()
