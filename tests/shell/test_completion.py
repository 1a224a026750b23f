"""Completion: what the program answers, and what bash, zsh and fish make of it."""

from __future__ import annotations

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hrt_cli.completion import SHELLS, paths, script
from hrt_cli.main import COMMANDS, VARIABLE, cli

BIN = Path(sys.executable).parent
ENV = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with files of many kinds."""
    for name in ("ortho.tif", "Old ortho.TIF", "plan.json", "log.jsonl", ".hidden.tif", "notes.txt"):
        (tmp_path / name).write_text("")
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "a.tif").write_text("")
    (tmp_path / ".git").mkdir()
    return tmp_path


def asked(words: str, folder: Path, shell: str = "bash", **env: str) -> list[str]:
    """What the program answers for the last of some words, the values alone."""
    asking = {VARIABLE: f"{shell}_complete", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1)}
    if shell == "fish":
        asking["COMP_CWORD"] = words.rpartition(" ")[2]
    command = [sys.executable, "-m", "hrt_cli.main"]
    done = subprocess.run(command, env=ENV | asking | env, cwd=folder, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return [line.split("\t")[1] for line in done.stdout.splitlines() if line]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("hrt ", list(COMMANDS)),
        ("hrt seg", ["segment"]),
        ("hrt --show", ["--show-versions"]),
        ("hrt evaluate ", ["segment", "plan", "runs", "drive", "steer"]),
        ("hrt evaluate st", ["steer"]),
        ("hrt segment --ro", ["--rotation"]),
        ("hrt segment --rotation ", ["invariant", "aware", "sorted"]),
        ("hrt export --format g", ["gpx", "geojson"]),
        ("hrt completion ", ["bash", "zsh", "fish"]),
        ("hrt segment ", ["Old ortho.TIF", "ortho.tif", "tiles"]),
        ("hrt segment -o ", ["Old ortho.TIF", "ortho.tif", "tiles"]),
        ("hrt export pl", ["plan.json"]),
        ("hrt export plan.json --aoi p", ["plan.json"]),
        ("hrt feedback ", ["log.jsonl", "tiles"]),
        ("hrt drive plan.json --world ", ["tiles"]),
        ("hrt verify n", ["notes.txt"]),
        ("hrt segment --nonsense ", ["Old ortho.TIF", "ortho.tif", "tiles"]),
    ],
)
def test_what_may_come_next(words: str, found: list[str], site: Path) -> None:
    assert asked(words, site) == found


def test_the_classes_of_a_world(site: Path) -> None:
    (site / "tiles" / "world.json").write_text('{"classes": {"0": {"name": "sand"}, "1": {"name": "coral"}}}')
    assert asked("hrt evaluate drive log.jsonl --world tiles --target ", site) == ["sand", "coral"]
    assert asked("hrt evaluate drive log.jsonl --world tiles --target co", site) == ["coral"]
    assert asked("hrt evaluate drive log.jsonl --world absent --target ", site) == []
    assert asked("hrt evaluate drive log.jsonl --target ", site) == []


def test_asking_for_commands_and_options_imports_nothing_heavy(tmp_path: Path) -> None:
    probe = (
        "import sys\nfrom hrt_cli.main import main\ntry: main()\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'rasterio', 'cv2', 'scipy', 'torch', 'pydantic'} & set(sys.modules)\n"
        "print([name for name in sys.modules if name.startswith('hrt_commands.')], heavy, file=sys.stderr)\n"
    )
    for words, modules in (("hrt se", "[]"), ("hrt segment --se", "['hrt_commands.segment']")):
        asking = {VARIABLE: "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
        done = subprocess.run([sys.executable, "-c", probe], env=ENV | asking, capture_output=True, text=True)
        assert done.stderr == f"{modules} set()\n"


def test_a_plugin_that_is_broken_answers_nothing(tmp_path: Path) -> None:
    info = tmp_path / "lib" / "broken-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hrt.commands]\nbroken = no_such_module:command\n")
    env = {"PYTHONPATH": f"{info.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    assert asked("hrt bro", tmp_path, **env) == ["broken"]
    assert asked("hrt broken --", tmp_path, **env) == []


@pytest.mark.parametrize(
    ("typed", "suffixes", "found"),
    [
        ("", (), ["Old ortho.TIF", "log.jsonl", "notes.txt", "ortho.tif", "plan.json", "tiles"]),
        (".", (".tif",), [".git", ".hidden.tif"]),
        ("tiles/", (".tif",), ["tiles/a.tif"]),
        ("./o", (".tif",), ["./ortho.tif"]),
        ("n", (".tif",), ["notes.txt"]),
        ("absent/", (), []),
        ("ortho.tif/", (), []),
    ],
)
def test_paths(
    typed: str, suffixes: tuple[str, ...], found: list[str], site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(site)
    assert [item.value for item in paths(typed, suffixes)] == found


def test_the_home_folder_is_understood_and_kept_as_typed(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(site))
    assert [item.value for item in paths("~/pl", (".json",))] == ["~/plan.json"]
    assert [item.value for item in paths("~/", (), folders_only=True)] == ["~/tiles"]


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_is_printed_and_understood_by_its_shell(shell: str) -> None:
    done = subprocess.run(["hrt", "completion", shell], env=ENV, capture_output=True, text=True, check=True)
    assert done.stdout == script(shell, cli)
    assert done.stderr == ""
    if shutil.which(shell):
        checked = subprocess.run([shell, "-n"], input=done.stdout, capture_output=True, text=True, check=False)
        assert (checked.returncode, checked.stderr) == (0, "")


def in_bash(words: list[str], folder: Path) -> list[str]:
    """What bash would offer: the completion function, called as bash calls it."""
    quoted = " ".join(f"'{word}'" for word in words)
    driver = f"""
    compopt() {{ echo "option $2" >> options; }}
    eval "$(hrt completion bash)"
    complete -p hrt
    COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}
    _hrt_completion hrt
    for each in "${{COMPREPLY[@]}}"; do echo "<$each>"; done
    """
    done = subprocess.run(["bash", "-c", driver], env=ENV, cwd=folder, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    first, *offered = done.stdout.splitlines()
    assert first == "complete -o nosort -F _hrt_completion hrt"
    return [each.removeprefix("<").removesuffix(">") for each in offered]


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_in_bash(site: Path) -> None:
    assert in_bash(["hrt", "seg"], site) == ["segment"]
    assert not (site / "options").exists()
    assert in_bash(["hrt", "segment", ""], site) == ["Old ortho.TIF", "ortho.tif", "tiles"]
    assert set((site / "options").read_text().splitlines()) == {"option filenames"}, "so that bash quotes and adds /"
    assert in_bash(["hrt", "plan", "--method", "po"], site) == ["policy", "policy-sample"]
    assert in_bash(["hrt", "plan", "--method", "x"], site) == []


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish here")
def test_in_fish(site: Path) -> None:
    def offered(line: str) -> list[str]:
        driver = f"hrt completion fish | source; complete --do-complete '{line}'"
        env = ENV | {"HOME": str(site)}
        done = subprocess.run(["fish", "-c", driver], env=env, cwd=site, capture_output=True, text=True, check=True)
        return [found.split("\t")[0] for found in done.stdout.splitlines()]

    assert offered("hrt seg") == ["segment"]
    assert sorted(offered("hrt segment ./")) == ["./Old ortho.TIF", "./ortho.tif", "./tiles/"]
    assert sorted(offered("hrt plan --method po")) == ["policy", "policy-sample"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh here")
def test_in_zsh(site: Path) -> None:
    driver = """
    compdef() { print "compdef $*"; }
    compadd() { print -l -- ${(P)@[-1]}; }
    _describe() { print -l -- ${(P)@[-1]}; }
    source =(hrt completion zsh)
    words=(hrt plan --method po); CURRENT=4; _hrt_completion
    words=(hrt se); CURRENT=2; _hrt_completion
    words=(hrt segment ''); CURRENT=3; _hrt_completion
    """
    done = subprocess.run(["zsh", "-f", "-c", driver], env=ENV, cwd=site, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    segment = f"segment:{COMMANDS['segment'][1]}"
    expected = [
        "compdef _hrt_completion hrt",
        "policy",
        "policy-sample",
        segment,
        "Old ortho.TIF",
        "ortho.tif",
        "tiles",
    ]
    assert done.stdout.splitlines() == expected


SHELLS_AS_USERS_RUN_THEM = {
    "bash": (["bash", "--norc", "-i"], 'eval "$(hrt completion bash)"'),
    "zsh": (["zsh", "-f", "-i"], "autoload -U compinit; compinit -D; source <(hrt completion zsh)"),
}


@pytest.mark.parametrize("shell", SHELLS_AS_USERS_RUN_THEM)
def test_the_tab_key_in_a_terminal(shell: str, site: Path) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    command, setup = SHELLS_AS_USERS_RUN_THEM[shell]
    leader, follower = pty.openpty()
    env = ENV | {"TERM": "dumb", "HOME": str(site), "PS1": "$ ", "COLUMNS": "200"}
    streams = {"stdin": follower, "stdout": follower, "stderr": follower}
    # In a session of its own, so that it does not take the terminal that the tests run in.
    with subprocess.Popen(command, **streams, cwd=site, env=env, start_new_session=True) as child:

        def until(awaited: str) -> None:
            shown, deadline = "", time.monotonic() + 60
            while awaited not in shown:
                assert time.monotonic() < deadline, shown
                if select.select([leader], [], [], 0.2)[0]:
                    shown += os.read(leader, 65536).decode(errors="replace").replace("\a", "")

        try:
            os.write(leader, f"{setup}; echo rea''dy\n".encode())
            until("ready")
            for typed, awaited in (
                ("hrt segment Ol", r"Old\ ortho.TIF "),
                ("hrt segment ti", "tiles/"),
                ("hrt seg", "segment "),
            ):
                os.write(leader, f"{typed}\t".encode())
                until(awaited)
                os.write(leader, b"\x15")
        finally:
            child.kill()
    os.close(leader)
    os.close(follower)
