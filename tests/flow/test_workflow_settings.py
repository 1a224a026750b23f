"""The settings of a project: what the schema allows, what make and snakemake refuse, what a wheel brings."""

from __future__ import annotations

import fnmatch
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import OutputError
from hrt_cli.planning.request import parse_budget, parse_start
from hrt_cli.project import WORKFLOW_FILES, create_project

ROOT = Path(__file__).parents[2]
PIPELINES = ROOT / "pipelines"
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
OURS = {"__init__.py", "demo.sh", "missions.sh", "coral.json"}
"""What stands in pipelines/ and is no part of a project."""


def load(name: str) -> dict[str, Any]:
    return yaml.safe_load((PIPELINES / name).read_text())


CONFIG, SCHEMA, SITE_SCHEMA = load("config.yaml"), load("config.schema.yaml"), load("sites.schema.yaml")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    create_project(tmp_path / "project")
    return tmp_path / "project"


def told(folder: Path, *command: str) -> str:
    """Run a command that has to fail; return what it says."""
    done = subprocess.run(command, cwd=folder, env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stdout + done.stderr


def test_the_schema_describes_every_key_and_allows_what_is_there() -> None:
    assert list(CONFIG) == list(SCHEMA["properties"])
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(CONFIG, SCHEMA)
    assert all(each["description"].endswith(".") for each in SCHEMA["properties"].values())
    # What may be empty is what the workflow can do without.
    empty = {key for key in CONFIG if is_valid(key, None)}
    assert set(SCHEMA["required"]) == set(CONFIG) - empty


def test_a_row_of_the_table_of_sites_is_a_site_and_keys_of_the_configuration() -> None:
    jsonschema.Draft202012Validator.check_schema(SITE_SCHEMA)
    for key, each in list(SITE_SCHEMA["properties"].items())[1:]:
        assert each == {"$ref": f"config.schema.yaml#/properties/{key}"}
        assert key in SCHEMA["properties"]
    # Seeds, threads and what the sites share are of all sites.
    assert not {"out", "seed", "seeds", "sites", "model", "model_from", "policy", "workers"} & set(
        SITE_SCHEMA["properties"]
    )


def is_valid(key: str, value: object) -> bool:
    return jsonschema.Draft202012Validator(SCHEMA).is_valid(CONFIG | {key: value})


GOOD = {
    "seeds": [7, "0 1 2", [0, 1]],
    "classes": [2, 255, "auto"],
    "budget": [300, "250steps", "400m", "2.5min"],
    "start": ["auto", "cell:3,4", "lonlat:7.1,46.2", "xy:431000.5,5210000"],
    "steer_rate": [0.001, "0.0021 8e-4"],
    "thermal_units": [None, "celsius"],
    "interest_range": ["20,80", None],
}
BAD = {
    "ortho": [None, 3],
    "seeds": [-1, "a", "0,1", [], [-1], 0.5],
    "classes": [1, 256, "many", 4.5, None],
    "seed": [-1, 0.5, 2**31, "x"],
    "workers": [0, 257],
    "cell_m": [0, -1, "1"],
    "no_go_below": [1.1, -0.1, "low"],
    "margin_m": [-1],
    "interest_weight": [2],
    "interest_range": ["20", "20, 80"],
    "thermal_units": ["fahrenheit"],
    "budget": [0, -3, 0.5, "400q", "min", ""],
    "start": ["middle", "cell:3", "cell:3,4,5", 3],
    "method": ["greeedy", None],
    "policy_iterations": [0],
    "speed_m_s": [0, 51],
    "vehicle": ["car"],
    "robot": ["reel"],
    "rounds": [0, 1.5],
    "steer_size": ["64", "64x", "0x3"],
    "nonsense": [1],
}


@pytest.mark.parametrize("key", GOOD)
def test_what_hrt_takes_is_allowed(key: str) -> None:
    for value in GOOD[key]:
        assert is_valid(key, value), value
        if key == "budget":
            parse_budget(str(value))
        if key == "start" and value != "auto":
            parse_start(value)


@pytest.mark.parametrize("key", BAD)
def test_what_makes_no_sense_is_refused(key: str) -> None:
    for value in BAD[key]:
        assert not is_valid(key, value), value


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_refuses_a_key_that_it_does_not_know(project: Path) -> None:
    assert "bugdet: no such key of config.yaml" in told(project, "make", "-n", "bugdet=4")
    assert "sites and seeds are for snakemake" in told(project, "make", "-n", "seeds=0 1")
    config = project / "config.yaml"
    text = config.read_text()
    for wrong, name in (("explor: 0", "explor"), ("Explore: 0", "Explore:_0"), ("- explore", "-_explore")):
        config.write_text(f"{text}{wrong}\n")
        assert f"config.yaml: {name}: no such key, or no `key: value`" in told(project, "make", "-n")
    # Variables of make's own and of whoever calls it are no keys.
    config.write_text(text)
    (project / "ortho.tif").touch()
    done = subprocess.run(["make", "-n", "HRT=echo", "DEMO=x"], cwd=project, env=ENV, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "echo segment ortho.tif" in done.stdout


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_refuses_a_key_that_stands_there_twice_and_a_file_that_does_not(project: Path) -> None:
    config = project / "config.yaml"
    before = config.read_text()
    assert "config.yaml: no such file: ortho.tif" in told(project, "make")
    (project / "ortho.tif").touch()
    assert "config.yaml: no such file: s.json" in told(
        project, "make", "scores=s.json", "out/scoremap.tif", "-o", "out/classes.tif"
    )
    config.write_text(before + "budget: 5\n")
    assert "config.yaml: budget: stands there twice" in told(project, "make", "-n")


def test_make_plans_with_a_model_and_a_policy_that_it_is_given(project: Path) -> None:
    for name in ("ortho.tif", "m.npz", "p.npz"):
        (project / name).touch()

    def would(*args: str) -> str:
        done = subprocess.run(["make", "-n", *args], cwd=project, env=ENV, capture_output=True, text=True, check=True)
        return done.stdout

    given = would("model=m.npz", "policy=p.npz", "out/plan.json")
    assert re.search(r"hrt segment .* --model m\.npz ", given)
    assert not re.search("--classes|--model-out|train-plan", given)
    assert re.search(r"hrt plan .*--policy p\.npz ", given)
    trained = would("policy=train", "policy_iterations=2", "out/plan.json")
    assert re.search(r"hrt train-plan out/scoremap\.tif -o out/policy\.npz --iterations 2 --seed 0 ", trained)
    assert re.search(r"hrt plan .*--policy out/policy\.npz ", trained)


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
@pytest.mark.parametrize(
    ("change", "table", "expected"),
    [
        ("budget: 5\nbudget: 6", None, "config.yaml: budget: stands there twice"),
        ("explor: 0", None, "config.yaml: Additional properties are not allowed ('explor' was unexpected)"),
        ("sites: sites.tsv", "site\tvehicle\na\tcar\n", "sites.tsv: site 'a': vehicle: 'car' is not one of"),
        ("sites: sites.tsv", "site\tstart\na\n", "sites.tsv: site 'a': more or fewer cells than the table has columns"),
        ("sites: sites.tsv", "site\tdsm\na\tb.tif\n", "sites.tsv: site 'a': dsm: no such file: b.tif"),
    ],
)
def test_snakemake_names_the_key_that_is_wrong(project: Path, change: str, table: str | None, expected: str) -> None:
    (project / "ortho.tif").touch()
    config = project / "config.yaml"
    key = change.split(":")[0]
    kept = [line for line in config.read_text().splitlines() if not line.startswith(f"{key}:")]
    config.write_text("\n".join([*kept, change]) + "\n")
    if table is not None:
        (project / "sites.tsv").write_text(table)
    assert expected in told(project, "snakemake", "-n")


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
def test_the_profile_of_a_cluster_gives_every_job_its_resources(project: Path) -> None:
    (project / "ortho.tif").touch()
    profile = load("profiles/slurm/config.yaml")
    assert profile["executor"] == "slurm"
    rules = set(re.findall(r"^ *rule (\w+):", (PIPELINES / "Snakefile").read_text(), re.MULTILINE))
    assert set(profile["set-threads"]) | set(profile["set-resources"]) <= rules
    # The plugin need not be there: only who runs the jobs is another.
    command = ["snakemake", "-n", "--workflow-profile", "profiles/slurm", "--executor", "local", "--cores", "8"]
    done = subprocess.run(command, cwd=project, env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    segment = re.search(r"^rule segment:\n(?:    .*\n)*", done.stdout + done.stderr, re.MULTILINE)
    assert segment is not None
    assert "threads: 8" in segment[0]
    assert re.search(r"mem_mb=2000.* runtime=60", segment[0])


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
def test_snakemake_s_linter_asks_for_environments_only(project: Path) -> None:
    (project / "ortho.tif").touch()
    found = re.findall(r"^ +\* (.*)", told(project, "snakemake", "--lint"), re.MULTILINE)
    assert set(found) == {"Specify a conda environment or container for each rule.:"}


def test_init_brings_every_file_of_the_workflows() -> None:
    files = {str(path.relative_to(PIPELINES)) for path in PIPELINES.rglob("*") if path.is_file()}
    assert set(WORKFLOW_FILES) == {name for name in files if "__pycache__" not in name} - OURS
    shown = set(re.findall(r'"(report/\w+\.rst)"', "".join(p.read_text() for p in sorted(PIPELINES.glob("*S*f*")))))
    shown |= set(re.findall(r'"(report/\w+\.rst)"', "".join(p.read_text() for p in sorted(PIPELINES.glob("*.smk")))))
    assert shown == {name for name in WORKFLOW_FILES if name.startswith("report/")}


def test_a_wheel_carries_them() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for name in WORKFLOW_FILES:
        package = ".".join(["hrt_pipelines", *Path(name).parts[:-1]])
        assert package in settings["packages"]
        assert any(fnmatch.fnmatchcase(Path(name).name, each) for each in settings["package-data"][package]), name


def test_init_leaves_edited_files_alone_and_makes_what_is_missing(project: Path) -> None:
    assert create_project(project) == []
    profile = project / "profiles" / "slurm" / "config.yaml"
    profile.write_text("executor: slurm\n")
    (project / "Makefile").unlink()
    with pytest.raises(OutputError, match=r"slurm/config\.yaml: exists and differs"):
        create_project(project)
    assert profile.read_text() == "executor: slurm\n"
    assert create_project(project, existing=Existing(overwrite=True)) == [project / "Makefile", profile]
    assert profile.read_bytes() == (PIPELINES / "profiles" / "slurm" / "config.yaml").read_bytes()
