"""The `hrt` program: a table of subcommands imported only when run, and the one place where errors become exit codes.

Exit codes: 0 done or up to date; 1 the input or data was refused; 2 usage; 3 a check found a difference;
130/143 stopped by SIGINT/SIGTERM.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

import click

from hrt_cli import __version__
from hrt_cli.errors import HrtError

COMMANDS = {
    "inspect": ("hrt_commands.inspect:inspect", "Tell what is in a raster and whether it will work."),
    "synth": ("hrt_commands.synth:synth", "Make a sample site: orthomosaic, truth, DSM, world."),
    "init": ("hrt_commands.init:init", "Make a project folder with the workflow and its config."),
    "segment": ("hrt_commands.segment:segment", "Segment an orthomosaic into texture classes."),
    "scoremap": ("hrt_commands.scoremap:scoremap", "Turn classes and their scores into a map of grid cells."),
    "train-plan": ("hrt_commands.train_plan:train_plan", "Train a planning policy by policy gradients."),
    "plan": ("hrt_commands.plan:plan", "Plan the path that collects the most score in a budget."),
    "export": ("hrt_commands.export:export", "Write a plan as a mission that an autopilot opens."),
    "evaluate": ("hrt_commands.evaluate:evaluate", "Measure a segmentation or plans against the truth."),
    "verify": ("hrt_commands.verify:verify", "Check artifacts against the provenance they carry."),
}
"""Subcommand -> (module:attribute, one-line help). The help stands here so that `hrt --help` imports none of them."""

PLUGIN_GROUP = "hrt.commands"


class Terminated(BaseException):
    """SIGTERM arrived: unwinds the stack so that `finally` blocks clean up."""


class LazyGroup(click.Group):
    """A group that imports a subcommand only when it is run, from the table or from installed plugins."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: D102
        return [*COMMANDS, *sorted(set(_plugins()) - set(COMMANDS))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: D102
        target = COMMANDS[cmd_name][0] if cmd_name in COMMANDS else _plugins().get(cmd_name)
        if target is None:
            return None
        module, _, attribute = target.partition(":")
        command = getattr(importlib.import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise HrtError(f"the plugin {cmd_name!r} ({target}) is not a click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: D102
        rows = [(name, COMMANDS[name][1] if name in COMMANDS else "(plugin)") for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="hrt")
def cli() -> None:
    """Turn one UAV survey of a site into a robot that can work there.

    An orthomosaic becomes texture classes, classes become a scoremap, a learned policy plans the path that collects
    the most score within a budget, and the path becomes a mission. Every stage reads and writes files.
    """


def main(args: list[str] | None = None) -> NoReturn:
    """Run the program and exit with its code."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    signal.signal(signal.SIGTERM, _on_sigterm)
    sys.exit(_run(args))


def _run(args: list[str] | None) -> int:
    try:
        outcome = cli.main(args=args, prog_name="hrt", standalone_mode=False)
        return outcome if isinstance(outcome, int) else 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted; no output was changed", 128 + signal.SIGINT)
    except Terminated:
        return _fail("terminated; no output was changed", 128 + signal.SIGTERM)
    except HrtError as error:
        return _fail(str(error), error.exit_code)
    except MemoryError:
        return _fail("not enough memory for this input", 1)
    except Exception as error:
        if os.environ.get("HRT_DEBUG"):
            raise
        return _fail(f"internal error: {type(error).__name__}: {error} (set HRT_DEBUG=1 for the traceback)", 1)


def _fail(message: str, code: int) -> int:
    if sys.stderr is not None:
        print("Error: " + " ".join(message.split()), file=sys.stderr)
    return code


def _on_sigterm(signum: int, frame: FrameType | None) -> None:
    raise Terminated


def _plugins() -> dict[str, str]:
    from importlib.metadata import entry_points

    return {point.name: point.value for point in entry_points(group=PLUGIN_GROUP)}


if __name__ == "__main__":
    main()
