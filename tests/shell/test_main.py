from __future__ import annotations

import importlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from hrt_commands.evaluate import KINDS

from hrt_cli import main as shell
from hrt_cli.errors import ArgumentError, DifferenceError, InputError, OutputError

HEAVY = ("torch", "numba", "cv2", "sklearn", "rasterio", "numpy", "scipy", "matplotlib", "pydantic")
PROGRAM = [sys.executable, "-m", "hrt_cli.main"]


def hrt(*args: object, env: dict[str, str] | None = None, **options: Any) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **(env or {})}
    captured = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    command = [*PROGRAM, *(os.fspath(arg) if isinstance(arg, Path) else str(arg) for arg in args)]
    return subprocess.run(command, env=environment, text=True, check=False, **captured)


def sh(script: str, *args: Path, **env: str) -> subprocess.CompletedProcess[str]:
    """Run a shell script in which `$HRT` is the program and `$1` ... are `args`."""
    environment = {**os.environ, **env, "HRT": " ".join(PROGRAM)}
    return subprocess.run(["sh", "-c", script, "sh", *map(str, args)], env=environment, text=True, capture_output=True)


def errors(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("Error:")]


def all_commands() -> Iterator[tuple[str, click.Command]]:
    for name in shell.COMMANDS:
        command = shell.cli.get_command(click.Context(shell.cli), name)
        assert command is not None
        if isinstance(command, click.Group):
            context = click.Context(command)
            for sub in command.list_commands(context):
                inner = command.get_command(context, sub)
                assert inner is not None
                yield f"{name} {sub}", inner
        else:
            yield name, command


def test_help_imports_nothing_heavy() -> None:
    probe = (
        "import sys; sys.argv = ['hrt', '--help']\n"
        "from hrt_cli.main import main\n"
        "try: main()\n"
        f"finally: print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr.strip() == "[]"


def test_no_help_of_a_command_imports_anything_heavy() -> None:
    probe = (
        "import click, sys\n"
        "from hrt_cli.main import COMMANDS, cli\n"
        "def load(group, names):\n"
        "    for name in names:\n"
        "        command = group.get_command(click.Context(group), name)\n"
        "        command.get_help(click.Context(command))\n"
        "        if isinstance(command, click.Group): load(command, command.list_commands(click.Context(command)))\n"
        "load(cli, COMMANDS)\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_help_is_quick() -> None:
    def seconds_of_processor() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        hrt("--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    # Processor time, so that a machine that is busy with other things does not fail it; twice the budget of 0.3 s.
    assert min(seconds_of_processor() for _ in range(5)) < 0.6


@pytest.mark.parametrize("name", list(shell.COMMANDS))
def test_the_table_says_what_the_command_itself_says(name: str) -> None:
    command = shell.cli.get_command(click.Context(shell.cli), name)
    assert isinstance(command, click.Command)
    assert command.name == name
    assert command.help is not None
    paragraph = " ".join(command.help.split("\n\n")[0].split())
    assert paragraph == shell.COMMANDS[name][1]


def test_the_kinds_of_evaluate_say_what_their_commands_say() -> None:
    for name, command in all_commands():
        kind = name.removeprefix("evaluate ")
        if kind != name:
            assert command.help is not None
            assert " ".join(command.help.split("\n\n")[0].split()) == KINDS[kind][1]


def test_every_command_has_help_that_ends_with_an_example() -> None:
    found = dict(all_commands())
    assert "evaluate segment" in found
    for name, command in found.items():
        text = command.get_help(click.Context(command, info_name=f"hrt {name}"))
        head, example, tail = text.rpartition("Example:\n")
        assert example, name
        lines = [line.strip() for line in tail.splitlines() if not line.strip().startswith("#")]
        assert all(line.startswith("hrt ") for line in lines), (name, lines)
        assert lines[-1].startswith(f"hrt {name} "), (name, lines)
        assert head, name


def test_help_lists_every_command() -> None:
    done = hrt("--help")
    assert done.returncode == 0
    listed = " ".join(done.stdout.split())
    for name, (target, text) in shell.COMMANDS.items():
        assert f" {name} {text}" in listed
        module, _, attribute = target.partition(":")
        assert hasattr(importlib.import_module(module), attribute)


def code_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException
) -> tuple[int, str]:
    """Exit code and stderr when a command raises `error`."""

    def command() -> None:
        raise error

    monkeypatch.setitem(shell.COMMANDS, "fail", ("builtins:nothing", "Fail."))
    monkeypatch.setattr(shell.cli, "get_command", lambda *_: click.Command("fail", callback=command))
    code = shell._run(["fail"])
    return code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("a.tif", "is\n cut  short", "copy it again"), 1, "Error: a.tif: is cut short (copy it again)"),
        (ArgumentError("--start: off the map"), 1, "Error: --start: off the map"),
        (OutputError("a.tif: exists"), 1, "Error: a.tif: exists"),
        (DifferenceError("a.tif: has changed"), 3, "Error: a.tif: has changed"),
        (MemoryError(), 1, "Error: not enough memory for this input"),
        (KeyboardInterrupt(), 130, "Error: interrupted; no output is half-written"),
        (shell.Stopped(signal.SIGINT), 130, "Error: interrupted; no output is half-written"),
        (shell.Stopped(signal.SIGTERM), 143, "Error: terminated; no output is half-written"),
        (click.UsageError("wrong"), 2, "Error: wrong"),
        (click.BadParameter("nan", param_hint="--budget"), 2, "Error: Invalid value for --budget: nan"),
        (ZeroDivisionError("x"), 1, "Error: internal error: ZeroDivisionError: x (set HRT_DEBUG=1 for the traceback)"),
        (OSError(28, "No space left on device"), 1, "Error: standard output: No space left on device"),
        (OSError(5, "Input/output error", "a.tif"), 1, "Error: internal error: OSError: [Errno 5]"),
    ],
)
def test_errors_become_exit_codes_and_one_line(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    message: str,
) -> None:
    monkeypatch.delenv("HRT_DEBUG", raising=False)
    monkeypatch.setattr(shell, "abandon_stdout", lambda: None)
    found, text = code_of(monkeypatch, capsys, error)
    assert found == code
    (line,) = errors(text)
    assert line.startswith(message)
    assert "Traceback" not in text


def test_debug_shows_the_traceback_of_an_internal_error_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HRT_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        code_of(monkeypatch, capsys, ZeroDivisionError())
    assert code_of(monkeypatch, capsys, InputError("a.tif", "is bad"))[0] == 1


def test_the_exit_codes_of_the_program(tmp_path: Path) -> None:
    (tmp_path / "plain.json").write_text("{}")
    cases: list[tuple[int, tuple[object, ...]]] = [
        (0, ("--version",)),
        (1, ("verify", tmp_path / "absent.json")),
        (2, ("verify",)),
        (2, ("nonsense",)),
        (3, ("verify", tmp_path / "plain.json")),
    ]
    for code, args in cases:
        done = hrt(*args)
        assert done.returncode == code, (args, done.stderr)
        assert len(errors(done.stderr)) == (code != 0), done.stderr
        assert "Traceback" not in done.stderr
        assert bool(done.stdout) == (code in (0, 3))
    done = hrt("init", tmp_path / "survey", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert json.loads(done.stdout)["output"] == str(tmp_path / "survey")


PLUGIN = """
import click

@click.command(help="Say hello.")
@click.argument("who")
def hello(who):
    print("hello", who)

not_a_command = 3
"""


@pytest.fixture
def plugins(tmp_path: Path) -> dict[str, str]:
    """An environment in which a distribution with entry points in `hrt.commands` is installed."""
    folder = tmp_path / "site"
    info = folder / "thirdparty-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "thirdparty.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: thirdparty\nVersion: 1.0\n")
    lines = {
        "hello": "thirdparty:hello",
        "plan": "thirdparty:hello",
        "number": "thirdparty:not_a_command",
        "gone": "thirdparty_gone:hello",
        "missing": "thirdparty:missing",
    }
    entries = "".join(f"{name} = {value}\n" for name, value in lines.items())
    (info / "entry_points.txt").write_text(f"[{shell.PLUGIN_GROUP}]\n{entries}")
    return {"PYTHONPATH": str(folder)}


def test_a_plugin_is_listed_and_run(plugins: dict[str, str]) -> None:
    listed = hrt("--help", env=plugins)
    assert listed.returncode == 0
    assert re.search(r"^  hello +\(plugin thirdparty 1\.0\)$", listed.stdout, re.MULTILINE)
    assert listed.stdout.count("\n  plan ") == 1
    assert "Plan the path" in listed.stdout
    assert hrt("hello", "world", env=plugins).stdout == "hello world\n"


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("number", "is not a click command"),
        ("gone", "cannot be loaded: ModuleNotFoundError"),
        ("missing", "cannot be loaded: AttributeError"),
    ],
)
def test_a_broken_plugin_is_named(plugins: dict[str, str], name: str, problem: str) -> None:
    done = hrt(name, env=plugins)
    assert done.returncode == 1
    (line,) = errors(done.stderr)
    assert f"the plugin '{name}' (thirdparty" in line
    assert problem in line
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("signum", "code", "moment"),
    [(signal.SIGINT, 130, "computing"), (signal.SIGTERM, 143, "writing")],
)
def test_a_signal_stops_a_long_run_without_leftovers(
    tmp_path: Path, signum: signal.Signals, code: int, moment: str
) -> None:
    site = tmp_path / "site"
    # Made large enough to be still at it when the signal comes.
    side = "400" if moment == "computing" else "20"
    command = [*PROGRAM, "synth", str(site), "--size", side]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        deadline = time.monotonic() + 60
        if moment == "writing":
            while not (site.is_dir() and any(".hrt-" in name for name in os.listdir(site))):
                assert child.poll() is None, "finished before the signal"
                assert time.monotonic() < deadline
                time.sleep(0.001)
        else:
            while not site.is_dir():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            time.sleep(0.5)
        child.send_signal(signum)
        out, err = child.communicate(timeout=60)
    assert child.returncode == code, err
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith("Note: compiling")]
    assert errors(err) == lines
    assert len(lines) == 1
    assert not [path for path in site.iterdir() if path.name.startswith(".")]


def test_an_interrupt_inside_exec_still_ends_with_130() -> None:
    # CPython would otherwise kill the process with SIGINT at exit, for the interrupt passed through `exec`.
    probe = (
        "import click, os, signal, sys\n"
        "from hrt_cli import main as shell\n"
        "def work(): exec('import os, signal; os.kill(os.getpid(), signal.SIGINT)\\nwhile True: pass')\n"
        "shell.cli.get_command = lambda *_: click.Command('work', callback=work)\n"
        "shell.main(['work'])\n"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "Error: interrupted; no output is half-written\n"


def test_an_ignored_signal_stays_ignored() -> None:
    probe = (
        "import click, os, signal\n"
        "from hrt_cli import main as shell\n"
        "def work(): os.kill(os.getpid(), signal.SIGINT); print('done')\n"
        "shell.cli.get_command = lambda *_: click.Command('work', callback=work)\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "shell.main(['work'])\n"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "done\n")


def test_a_reader_that_stops_listening_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "plain.json").write_text("{}")
    script = '{ $HRT verify "$1"; echo "code $?" >&2; } | true'
    done = sh(script, tmp_path / "plain.json")
    assert "Traceback" not in done.stderr
    assert "code 3" in done.stderr
    helped = sh("{ $HRT --help; echo code $? >&2; } | true")
    assert helped.stderr in ("code 0\n", "code 1\n")


def test_a_full_stdout_is_an_error_only_where_the_result_is_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "plain.json").write_text("{}")
    for script in ('$HRT verify "$1" > /dev/full', "$HRT --help > /dev/full"):
        done = sh(script, tmp_path / "plain.json")
        assert done.returncode == 1
        assert done.stderr == "Error: standard output: No space left on device\n"
    done = sh('$HRT init "$1" > /dev/full', tmp_path / "survey")
    assert done.returncode == 0
    assert done.stderr == "Warning: standard output: No space left on device; the files are written\n"
    assert (tmp_path / "survey" / "Makefile").is_file()


NOISY = """
import click, os
from pathlib import Path
from hrt_cli import main as shell
from hrt_cli.artifacts.publish import publishing

def work():
    with publishing(Path(os.environ["TARGET"]), os.stat) as draft, open(draft, "wb", buffering=0) as file:
        file.write(b"content")
        for descriptor in (1, 2):
            os.write(descriptor, b"what a C library prints")

shell.cli.get_command = lambda *_: click.Command("work", callback=work)
shell.main(["work"])
"""


def test_closed_streams_do_not_end_up_in_an_output(tmp_path: Path) -> None:
    target = tmp_path / "out"
    done = sh(f"'{sys.executable}' -c \"$NOISY\" <&- >&- 2>&-", NOISY=NOISY, TARGET=str(target))
    assert done.returncode == 0
    assert target.read_bytes() == b"content"


def test_a_closed_stdout_is_an_error_where_the_result_is_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "plain.json").write_text("{}")
    assert sh('$HRT init "$1" >&-', tmp_path / "survey").returncode == 0
    nowhere = sh('$HRT verify "$1" >&-', tmp_path / "plain.json")
    assert nowhere.returncode == 1
    assert nowhere.stderr == "Error: standard output: is closed, and the result is in no file\n"


@pytest.mark.parametrize("where", ["2>&-", "2>/dev/full"])
def test_a_lost_stderr_does_not_change_the_exit_code(tmp_path: Path, where: str) -> None:
    assert sh(f'$HRT verify "$1" {where}', tmp_path / "absent.json").returncode == 1
    assert sh(f"$HRT verify {where}").returncode == 2


def test_a_plain_locale_and_a_unicode_path(tmp_path: Path) -> None:
    folder = tmp_path / "Grüße & 地図"
    plain = 'env -i "PATH=$PATH" LC_ALL=C PYTHONIOENCODING=ascii'
    done = sh(f'{plain} $HRT init "$1"', folder)
    assert done.returncode == 0, done.stderr
    assert "Gr\\xfc\\xdfe & \\u5730\\u56f3" in done.stdout
    assert (folder / "Makefile").is_file()
    done = sh(f'{plain} $HRT verify "$1"', folder / "absent.json")
    assert done.returncode == 1
    (line,) = errors(done.stderr)
    assert "Gr\\xfc\\xdfe" in line
    assert "no such file" in line
