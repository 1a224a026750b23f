"""The rounds of a project: make and snakemake run them, to the same bytes, do nothing twice, and spare real drives."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BIN = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
HRT = shutil.which("hrt", path=BIN)
SNAKEMAKE = shutil.which("snakemake", path=BIN)
LEGS = [f"round-{r}/leg-{leg}" for r in (1, 2) for leg in (1, 2)]
KEYS = {
    "ortho": "site/ortho.tif",
    "world": "site",
    "classes": "4",
    "rounds": "2",
    "legs": "2",
    "round_budget": "0.5min",
}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed"),
]


class Project:
    """A project folder in which every call of hrt is written down."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calls = folder.with_name(f"{folder.name}-calls")
        wrapper = folder.with_name(f"{folder.name}-bin") / "hrt"
        wrapper.parent.mkdir(exist_ok=True)
        wrapper.write_text(f'#!/bin/sh\necho "$*" >> "{self.calls}"\nexec "{HRT}" "$@"\n')
        wrapper.chmod(0o755)
        self.env = {**os.environ, "PATH": f"{wrapper.parent}{os.pathsep}{BIN}"}

    def run(self, *command: str, fails: bool = False) -> tuple[str, list[str]]:
        """Run a command in the folder; return what it said and the calls of hrt, each without its options."""
        self.calls.write_text("")
        done = subprocess.run(
            command, cwd=self.folder, env=self.env, capture_output=True, text=True, check=False
        )  # fmt: skip
        assert (done.returncode != 0) == fails, done.stdout + done.stderr
        return done.stdout + done.stderr, self.calls.read_text().splitlines()

    def make(self, *args: str, fails: bool = False) -> tuple[str, list[str]]:
        return self.run("make", "-f", "rounds.mk", *args, fails=fails)

    def would_make(self, *args: str) -> set[str]:
        """Return what make would have made with these arguments, and put back what it keeps of arguments."""
        args_kept = self.folder / "out" / ".args"
        shutil.copytree(args_kept, aside := self.folder.with_name("args"))
        said, calls = self.make("-n", *args)
        assert calls == []
        shutil.rmtree(args_kept)
        shutil.copytree(aside, args_kept)
        shutil.rmtree(aside)
        return made_by(said.replace("\\\n", " ").splitlines())

    def put_real_log(self, leg: str) -> str:
        """Write the log of a leg as a robot would have: without provenance."""
        log = self.folder / leg / "drive.jsonl"
        header, *records = log.read_text().splitlines()
        kept = {key: value for key, value in json.loads(header).items() if key in ("format", "version", "crs")}
        log.write_text(text := "\n".join([json.dumps(kept), *records]) + "\n")
        return text

    def times(self) -> dict[str, int]:
        return {
            str(path.relative_to(self.folder)): path.stat().st_mtime_ns for path in self.folder.glob("round-*/**/*.*")
        }

    def artifacts(self) -> dict[str, bytes]:
        paths = [*self.folder.glob("round-*/**/*.*"), self.folder / "out" / "classes.tif"]
        return {str(path.relative_to(self.folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project whose rounds are done; not to be changed."""
    project = Project(tmp_path_factory.mktemp("rounds") / "project")
    subprocess.run(["hrt", "init", str(project.folder)], env=project.env, check=True, capture_output=True)
    config = project.folder / "config.yaml"
    lines = [line.split(":")[0] for line in config.read_text().splitlines()]
    assert set(KEYS) < set(lines)
    config.write_text(
        "".join(
            f"{line.split(':')[0]}: {KEYS[line.split(':')[0]]}  # of the test\n"
            if line.split(":")[0] in KEYS
            else f"{line}\n"
            for line in config.read_text().splitlines()
        )
    )
    project.run("hrt", "synth", "site", "--scene", "meadow", "--size", "20", "--pixel", "0.1", "--seed", "3")
    said, calls = project.make()
    assert sum(call.startswith("drive") for call in calls) == len(LEGS)
    assert "stays where it is" in said  # the second leg of a round: the first used the budget up
    return project.folder


@pytest.fixture
def project(finished: Path, tmp_path: Path) -> Project:
    shutil.copytree(finished, tmp_path / "project")  # copies times as well
    return Project(tmp_path / "project")


def made_by(calls: list[str]) -> set[str]:
    """Return the artifacts of legs that calls of hrt write, those to draw a figure left out."""
    return {
        word
        for call in calls
        for word in call.split()
        if word.startswith("round-") and f"-o {word}" in call and "--figure" not in call
    }


def of_legs(*legs: str) -> set[str]:
    return {f"{leg}/{name}" for leg in legs for name in ("scoremap.tif", "plan.json", "drive.jsonl", "scores.json")}


def test_make_writes_what_it_should_and_then_rests(project: Project) -> None:
    for name in (*of_legs(*LEGS), "round-1/report.json", "round-2/report.json", "round-1/plan.png"):
        assert (project.folder / name).stat().st_size > 0
    report = json.loads((project.folder / "round-2" / "report.json").read_text())
    assert list(report["drives"]) == ["round-2/leg-1/drive.jsonl", "round-2/leg-2/drive.jsonl"]
    # What a round leaves is kept for the next: budgets are cumulative.
    budgets = [json.loads((project.folder / leg / "plan.json").read_text())["budget"]["value"] for leg in LEGS]
    assert budgets == [0.5, 0.5, 1.0, 1.0]
    said, calls = project.make()
    assert "Nothing to be done" in said
    assert calls == []
    said, calls = project.run("make", "-C", str(project.folder), "-f", "rounds.mk")
    assert "Nothing to be done" in said
    assert calls == []


def test_a_touched_log_reruns_only_what_depends_on_it(project: Project) -> None:
    kept = project.artifacts()
    (project.folder / "round-2" / "leg-1" / "drive.jsonl").touch()
    said, calls = project.make()
    assert made_by(calls) == {"round-2/leg-1/scores.json"} | of_legs("round-2/leg-2")
    assert said.count("up to date)") + said.count("json: up to date") == 5
    assert sum(call.startswith("evaluate drive round-2/leg-1") for call in calls) == len(calls) - 5 == 1
    assert project.artifacts() == kept
    assert project.make()[1] == []


def test_a_changed_parameter_reruns_only_what_depends_on_it(project: Project) -> None:
    assert project.would_make("round_budget=0.4min") == of_legs(*LEGS) - {"round-1/leg-1/scoremap.tif"}
    assert project.would_make("start=cell:3,4") == of_legs(*LEGS) - {"round-1/leg-1/scoremap.tif"}
    assert project.would_make("local=expert") == of_legs(*LEGS) - of_legs(LEGS[0]) | {
        "round-1/leg-1/drive.jsonl",
        "round-1/leg-1/scores.json",
    }
    assert project.would_make("legs=1") == of_legs("round-2/leg-1")
    assert project.would_make("rounds=3") == of_legs("round-3/leg-1", "round-3/leg-2")


def test_the_drive_of_a_real_robot_in_a_simulated_ones_place(project: Project) -> None:
    log = project.folder / "round-2" / "leg-1" / "drive.jsonl"
    before = project.times()
    text = project.put_real_log("round-2/leg-1")
    os.utime(log, (1e9, 1e9))  # copied with its time, long before what stands there was made
    _, calls = project.make()
    assert made_by(calls) == {"round-2/leg-1/scores.json"} | of_legs("round-2/leg-2")
    assert sum(call.startswith("evaluate drive round-2/leg-1") for call in calls) == len(calls) - 5 == 1
    after = project.times()
    upstream = ("round-1", "round-2/leg-1/scoremap", "round-2/leg-1/plan", "round-2/plan")
    assert all(before[name] == after[name] for name in before if name.startswith(upstream))
    assert project.make()[1] == []
    # The same with another real log, older still.
    log.write_text(text.rsplit("\n", 2)[0] + "\n")
    os.utime(log, (9e8, 9e8))
    assert project.would_make() == {"round-2/leg-1/scores.json"} | of_legs("round-2/leg-2")
    log.write_text(text)
    os.utime(log, (1e9, 1e9))
    assert project.make()[1] == []
    # Its plan changes: simulated drives follow, the real one stays, and so it does when all else is cleared.
    assert project.would_make("start=cell:3,4") == of_legs(*LEGS) - {
        "round-1/leg-1/scoremap.tif",
        "round-2/leg-1/drive.jsonl",
    }
    project.make("clean-rounds")
    assert [str(path.relative_to(project.folder)) for path in project.folder.glob("round-*/**/*.*")] == [
        "round-2/leg-1/drive.jsonl"
    ]
    assert log.read_text() == text


def test_a_real_robot(project: Project) -> None:
    text = project.put_real_log("round-1/leg-1")
    log = project.folder / "round-1" / "leg-1" / "drive.jsonl"
    log.rename(project.folder / "log.jsonl")
    project.make("clean-rounds")
    real = ("robot=real", "rounds=1", "world=")
    said, calls = project.make(*real, fails=True)
    assert (
        "Error: round-1/leg-1/drive.jsonl: no such log: let the robot drive round-1/leg-1/plan.json, put its log there"
        in said
    )
    assert made_by(calls) == {"round-1/leg-1/scoremap.tif", "round-1/leg-1/plan.json"}
    (project.folder / "log.jsonl").rename(log)
    # Nothing is left for the second leg, so nobody has to drive it.
    _, calls = project.make(*real)
    assert [call.split()[:3] for call in calls if call.startswith("drive")] == [
        ["drive", "round-1/leg-2/plan.json", "--stay"]
    ]
    assert of_legs("round-1/leg-2") < made_by(calls)
    report = json.loads((project.folder / "round-1" / "report.json").read_text())
    assert report["distance_m"] > 10
    assert report["min_clearance_m"] is None
    assert project.make(*real)[1] == []
    # Another plan asks for no other drive.
    assert "round-1/leg-1/plan.json" in (wanted := project.would_make(*real, "start=cell:3,4"))
    assert not any(name.endswith("drive.jsonl") for name in wanted)
    assert log.read_text() == text


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["world="], "the simulated robot needs a world"),
        (["robot=reel"], "robot is simulated or real, not 'reel'"),
    ],
)
def test_keys_that_make_no_sense(project: Project, args: list[str], told: str) -> None:
    said, calls = project.make(*args, fails=True)
    assert told in said
    assert calls == []


@pytest.mark.skipif(SNAKEMAKE is None, reason="snakemake is not installed")
def test_snakemake(project: Project) -> None:
    made = {name: content for name, content in project.artifacts().items() if not name.startswith("round-2")}
    for name in ("round-1", "round-2"):
        shutil.rmtree(project.folder / name)
    command = ("snakemake", "-s", "rounds.smk", "--cores", "2", "--config", "rounds=1")
    project.run(*command)
    assert project.artifacts() == made
    said, calls = project.run(*command)
    assert "Nothing to be done" in said
    assert calls == []
    # A real drive is spared, however old, and what depends on it follows.
    text = project.put_real_log("round-1/leg-1")
    log = project.folder / "round-1" / "leg-1" / "drive.jsonl"
    os.utime(log, (1e9, 1e9))
    follow = {"round-1/leg-1/scores.json"} | of_legs("round-1/leg-2")
    assert made_by(project.run(*command, "-n", "-p")[0].splitlines()) == follow
    said = project.run(*command, "start=cell:3,4", "-n", "-p")[0]
    assert made_by(said.splitlines()) == {"round-1/leg-1/plan.json"} | follow
    assert log.read_text() == text
    log.unlink()
    said, calls = project.run(*command, "robot=real", "world=", fails=True)
    assert "Error: round-1/leg-1/drive.jsonl: no such log: let the robot drive" in said
    assert not any(call.startswith("drive") for call in calls)
