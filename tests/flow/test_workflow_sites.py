"""Several sites and seeds in one workflow: what they share is made once, and the report shows all of it."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from hrt_cli.project import create_project

ROOT = Path(__file__).parents[2]
BIN = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
SITES = ("meadow", "reef")
TABLE = "# two of the sample sites\nsite\tortho\tbudget\nmeadow\tmeadow.tif\t30\nreef\treef.tif\t25m\n"
SETTINGS = {
    "sites": "sites.tsv", "seeds": "0 1", "classes": "4", "model_from": "meadow", "policy": "train",
    "policy_iterations": "1", "no_go_below": "", "margin_m": "", "workers": "1",
}  # fmt: skip
TARGETS = ("out/summary.json", "out/meadow/evaluation.json")
"""What shows how jobs depend on each other; the missions, a second each, are those of one site."""

pytestmark = pytest.mark.skipif(shutil.which("snakemake", path=BIN) is None, reason="snakemake is not installed")


def set_keys(folder: Path, settings: dict[str, str]) -> None:
    config = folder / "config.yaml"
    lines = config.read_text().splitlines()
    for key, value in settings.items():
        (at,) = (k for k, line in enumerate(lines) if line.startswith(f"{key}:"))
        lines[at] = f"{key}: {value}"
    config.write_text("\n".join(lines) + "\n")


def snakemake(folder: Path, *args: str) -> str:
    command = ["snakemake", "--cores", "2", *args]
    env = {**os.environ, "PATH": f"{folder / 'bin'}{os.pathsep}{BIN}"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def jobs(said: str) -> dict[str, int]:
    """Return how many jobs of each rule a dry run names."""
    table = said.partition("Job stats:")[2].partition("total")[0]
    return {name: int(count) for name, count in re.findall(r"^(\w+) +([0-9]+)$", table, re.MULTILINE)}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sites by two seeds, planned and compared; not to be changed."""
    folder = tmp_path_factory.mktemp("sites") / "project"
    create_project(folder)
    for site in SITES:
        shutil.copy(ROOT / "fixtures" / site / "ortho.tif", folder / f"{site}.tif")
    (folder / "sites.tsv").write_text(TABLE)
    set_keys(folder, SETTINGS)
    # Every call of hrt is written down.
    wrapper = folder / "bin" / "hrt"
    wrapper.parent.mkdir()
    wrapper.write_text(f'#!/bin/sh\necho "$*" >> "{folder}/calls"\nexec "{shutil.which("hrt", path=BIN)}" "$@"\n')
    wrapper.chmod(0o755)
    snakemake(folder, *TARGETS)
    return folder


def test_what_sites_share_is_made_once(project: Path) -> None:
    calls = Counter(" ".join(line.split()[:2]) for line in (project / "calls").read_text().splitlines())
    assert calls == {
        "segment meadow.tif": 1,
        "segment reef.tif": 1,
        "scoremap out/meadow/classes.tif": 1,
        "scoremap out/reef/classes.tif": 1,
        "train-plan out/meadow/scoremap.tif": 1,
        "plan out/meadow/scoremap.tif": 2,
        "plan out/reef/scoremap.tif": 2,
        "evaluate plan": 1,
        "evaluate runs": 1,
    }
    assert "Nothing to be done" in snakemake(project, *TARGETS)
    assert jobs(snakemake(project, "-n", "--forceall")) == {
        "all": 1, "segment": 1, "segment_by_model": 1, "scoremap": 2, "train_policy": 1, "plan": 4, "evaluate": 2,
        "summary": 1, "export": 20, "export_nav2": 4, "export_qgc": 4,
    }  # fmt: skip


def test_each_site_and_seed_has_its_place_and_its_own_settings(project: Path) -> None:
    out = project / "out"
    for site, budget in (("meadow", [30.0, "steps"]), ("reef", [25.0, "m"])):
        for seed in (0, 1):
            made = json.loads((out / site / f"seed-{seed}" / "plan.json").read_text())["provenance"]
            assert made["parameters"]["budget"] == budget
            assert made["parameters"]["seed"] == seed
            assert [each["role"] for each in made["inputs"]] == ["scoremap", "policy/0"]
            for kind in ("logs/plan.log", "benchmarks/plan.tsv"):
                assert (out / site / f"seed-{seed}" / kind).stat().st_size > 0
    # The model of the meadow tells the reef's classes apart; none is fitted to the reef.
    assert (out / "meadow" / "model.npz").exists()
    assert not (out / "reef" / "model.npz").exists()
    assert "--model out/meadow/model.npz" in (project / "calls").read_text()


def test_the_summary_is_of_all_sites_and_seeds(project: Path) -> None:
    summary = json.loads((project / "out" / "summary.json").read_text())
    plans = [f"out/{site}/seed-{seed}/plan.json" for site in SITES for seed in (0, 1)]
    assert list(summary["plans"]) == plans
    assert [(task["name"], len(task["plans"])) for task in summary["tasks"]] == [("out/meadow", 2), ("out/reef", 2)]
    with open(project / "out" / "summary.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["plan"], row["seed"]) for row in rows] == [(plan, plan[-11]) for plan in plans]
    # Two ways to the same figures.
    evaluation = json.loads((project / "out" / "meadow" / "evaluation.json").read_text())
    assert list(evaluation["plans"]) == plans[:2]
    for plan, worth in evaluation["plans"].items():
        assert summary["plans"][plan]["score"] == pytest.approx(worth["score"])


def test_another_seed_and_another_budget_rerun_no_more_than_they_must(project: Path, tmp_path: Path) -> None:
    copy = tmp_path / "project"
    shutil.copytree(project, copy)
    set_keys(copy, {"seeds": "0 2"})
    assert jobs(snakemake(copy, "-n", *TARGETS)) == {"plan": 2, "evaluate": 1, "summary": 1}
    set_keys(copy, {"seeds": "0 1"})
    (copy / "sites.tsv").write_text(TABLE.replace("25m", "20m"))
    said = snakemake(copy, "-n", *TARGETS)
    assert jobs(said) == {"plan": 2, "summary": 1}
    outputs = re.findall(r"^    output: (.*)", said, re.MULTILINE)
    assert [name.split("/")[1] for name in outputs] == ["reef", "reef", "summary.json, out"]


def test_the_report_shows_every_figure_with_its_caption(project: Path) -> None:
    snakemake(project, *TARGETS, "--report", "report.html")
    page = (project / "report.html").read_text()
    names = ["policy.png", "summary.png", "summary.csv", "meadow/rewards.png"]
    names += [f"{site}/{name}.png" for site in SITES for name in ("classes", "scoremap")]
    names += [f"{site}/seed-{seed}/plan.png" for site in SITES for seed in (0, 1)]
    for name in names:
        assert f"out/{name}" in page
    for caption in ("From orthomosaics to missions", "How the planner", "How near the plans come", "as the model"):
        assert caption in page
    # It is read where there is no network: nothing is loaded from elsewhere.
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=[\"']https?://", page)
