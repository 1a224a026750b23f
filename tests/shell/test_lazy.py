"""The lazy group: what its help lists, what it imports and when, and plugins."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint
from typing import Any

import click
import pytest
from click.testing import CliRunner
from hrt_commands.evaluate import KINDS, evaluate

from hrt_cli.errors import HrtError
from hrt_cli.lazy import LazyGroup
from hrt_cli.main import cli

TABLE = {"one": ("lazy_probe_that_is_absent:one", "The first."), "two": ("hrt_commands.drive:drive", "The second.")}


def group(plugins: str = "") -> LazyGroup:
    return LazyGroup("g", table=TABLE, plugins=plugins)


def test_help_imports_no_command() -> None:
    done = CliRunner().invoke(group(), ["--help"])
    assert done.exit_code == 0
    assert "The first." in done.stdout
    assert "The second." in done.stdout
    with pytest.raises(ModuleNotFoundError):
        group().get_command(click.Context(group()), "one")
    assert group().get_command(click.Context(group()), "two").name == "drive"
    assert group().get_command(click.Context(group()), "three") is None
    assert CliRunner().invoke(group(), ["three"]).exit_code == 2


@pytest.mark.parametrize(
    ("typed", "hint"),
    [
        (["segmnt"], "No such command 'segmnt'. Did you mean 'segment'?"),
        (["PLAN"], "No such command 'PLAN'. Did you mean 'plan'?"),
        (["evaluate", "drve"], "No such command 'drve'. Did you mean 'drive'?"),
        (["xyzzy"], "No such command 'xyzzy'.\n"),
        (["--vrsion"], "No such option"),
        (["plan", "--methd", "x"], "--method"),
    ],
)
def test_what_was_meant_is_guessed(typed: list[str], hint: str) -> None:
    done = CliRunner().invoke(cli, typed)
    assert done.exit_code == 2
    assert hint in done.output


def test_commands_stand_by_their_stage_and_the_others_after() -> None:
    stages = {"First": ("two", "not there"), "Empty": ("nor this",)}
    shown = CliRunner().invoke(LazyGroup("g", table=TABLE, stages=stages), ["--help"]).stdout
    titles = [line for line in shown.splitlines() if line.endswith(":") and not line.startswith("Usage")]
    assert titles == ["Options:", "First:", "Commands:"]
    assert shown.index("First:") < shown.index("The second.") < shown.index("Commands:") < shown.index("The first.")


def test_the_kinds_of_evaluate() -> None:
    context = click.Context(evaluate)
    assert evaluate.list_commands(context) == list(KINDS) == ["segment", "plan", "runs", "drive", "steer"]
    for name in KINDS:
        command = evaluate.get_command(context, name)
        assert command.name == name
        assert KINDS[name][1] == " ".join(command.help.split("\n\n")[0].split())
    shown = CliRunner().invoke(cli, ["evaluate", "--help"]).stdout
    assert all(name in shown for name in KINDS)
    assert CliRunner().invoke(cli, ["evaluate", "weather"]).exit_code == 2


def test_help_of_a_group_stays_light() -> None:
    probe = (
        "import sys; sys.argv = ['hrt', 'evaluate', '--help']\n"
        "from hrt_cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'rasterio', 'cv2', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "assert 'hrt_commands.evaluate_drive' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def points(group: str) -> list[EntryPoint]:
        asked.append(group)
        return [
            EntryPoint("zeta", "hrt_commands.drive:drive", group),
            EntryPoint("bad", "no_such_module:drive", group),
            EntryPoint("number", "math:pi", group),
            EntryPoint("two", "math:pi", group),
        ]

    monkeypatch.setattr("importlib.metadata.entry_points", points)
    assert group().list_commands(click.Context(group())) == ["one", "two"]
    assert not asked
    plugged = group("hrt.commands")
    context = click.Context(plugged)
    assert plugged.list_commands(context) == ["one", "two", "bad", "number", "zeta"]
    assert plugged.get_command(context, "zeta").name == "drive"
    assert plugged.get_command(context, "two").name == "drive", "a plugin takes no name that is taken"
    with pytest.raises(HrtError, match=r"the plugin 'bad' .* cannot be loaded: ModuleNotFoundError"):
        plugged.get_command(context, "bad")
    with pytest.raises(HrtError, match=r"the plugin 'number' .* is not a click command"):
        plugged.get_command(context, "number")
    assert "(plugin)" in CliRunner().invoke(plugged, ["--help"]).stdout
