"""The `hrt` program: a table of subcommands imported only when run, and the one place where errors become exit codes.

Exit codes: 0 done or up to date; 1 the input or data was refused; 2 usage; 3 a check found a difference;
130/143 stopped by SIGINT/SIGTERM.
"""

from __future__ import annotations

import errno
import gc
import io
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

import click

from hrt_cli import __version__
from hrt_cli.errors import HrtError
from hrt_cli.lazy import LazyGroup
from hrt_cli.progress import abandon_stdout, to_stderr

VARIABLE = "_HRT_COMPLETE"
"""Set by the scripts of `hrt completion` to ask what may come next."""
_GARBAGE = 500_000
"""New containers before the collector of cycles looks: importing numba makes so many that at Python's own 700 it looks
500 times, which takes half a second."""
COMMANDS = {
    "inspect": (
        "hrt_commands.inspect:inspect",
        "Tell what is in a raster, whether `segment` will take it, and roughly what that will cost.",
    ),
    "synth": ("hrt_commands.synth:synth", "Make a sample site in FOLDER that looks like an aerial photograph."),
    "init": (
        "hrt_commands.init:init",
        "Make a project FOLDER with the workflows (make and snakemake) and their config.yaml.",
    ),
    "segment": ("hrt_commands.segment:segment", "Segment an orthomosaic into texture classes."),
    "feedback": ("hrt_commands.feedback:feedback", "Learn from drives how drivable each class is."),
    "scoremap": ("hrt_commands.scoremap:scoremap", "Turn a class raster and a score table into a scoremap."),
    "train-plan": (
        "hrt_commands.train_plan:train_plan",
        "Train a planning policy by policy gradients, on SCOREMAPS or on generated maps where none is given.",
    ),
    "plan": ("hrt_commands.plan:plan", "Plan the path that collects the most score within a budget."),
    "export": ("hrt_commands.export:export", "Write a plan as a mission that an autopilot opens."),
    "drive": (
        "hrt_commands.drive:drive",
        "Drive PLAN on a site in simulation and log what the robot would have logged, never the truth.",
    ),
    "record": (
        "hrt_commands.record:record",
        "Look from random places of a site and tell how to steer there: steering data without a drive.",
    ),
    "train-steer": (
        "hrt_commands.train_steer:train_steer",
        "Train a network on DATA that steers from what the camera sees.",
    ),
    "steer": (
        "hrt_commands.steer:steer",
        "Predict with MODEL how to steer in INPUTS: pictures, folders of pictures, recordings or videos.",
    ),
    "export-steer": (
        "hrt_commands.export_steer:export_steer",
        "Write a steering MODEL as ONNX, which robots run without PyTorch.",
    ),
    "evaluate": ("hrt_commands.evaluate:evaluate", "Measure a segmentation, plans, drives or a steering model."),
    "compare": ("hrt_commands.compare:compare", "Tell how two artifacts of one kind, A and B, differ."),
    "report": (
        "hrt_commands.report:report",
        "Write one page of all that PATHS, files and folders, hold: maps, drives, charts, provenance.",
    ),
    "verify": ("hrt_commands.verify:verify", "Check artifacts against the provenance they carry."),
    "completion": (
        "hrt_commands.completion:completion",
        "Print the script that lets bash, zsh or fish complete commands, options, their values and files.",
    ),
}
"""Subcommand -> (module:attribute, the first paragraph of its help, so that `hrt --help` imports none of them)."""
STAGES = {
    "Begin": ("inspect", "synth", "init"),
    "From a survey to a map": ("segment", "feedback", "scoremap"),
    "From a map to a mission": ("plan", "export", "train-plan"),
    "Driving and steering": ("drive", "record", "train-steer", "steer", "export-steer"),
    "Measuring and checking": ("evaluate", "compare", "report", "verify"),
    "The shell": ("completion",),
}
"""The commands in the help of `hrt`, by what they are for; those that none names come after."""

PLUGIN_GROUP = "hrt.commands"


class Stopped(BaseException):
    """SIGINT or SIGTERM arrived: unwinds the stack so that `finally` blocks clean up.

    Not `KeyboardInterrupt`: when that passes through an `exec` (dataclasses, numba), CPython kills the process with
    SIGINT at exit even though it was caught.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signum = signum


def _show_versions(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        from hrt_cli.versions import lines

        click.echo("\n".join(lines()))
        ctx.exit()


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    plugins=PLUGIN_GROUP,
    stages=STAGES,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""\b
Example:
  hrt synth site --scene meadow --size 40
  hrt segment site/ortho.tif -o classes.tif --classes 5
  hrt scoremap classes.tif -o scoremap.tif
  hrt plan scoremap.tif -o plan.json --start auto --budget 200
  hrt export plan.json -o mission.plan
""",
)
@click.version_option(__version__, prog_name="hrt", message="%(prog)s %(version)s")
@click.option(
    "--show-versions",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_versions,
    help="Print what a bug report needs: versions, machine, settings.",
)
def cli() -> None:
    """Turn one UAV survey of a site into a robot that can work there.

    An orthomosaic becomes texture classes, classes become a scoremap, a learned policy plans the path that collects
    the most score within a budget, and the path becomes a mission. Every stage reads and writes files; `hrt COMMAND
    --help` tells which, with an example that runs.
    """


def main(args: list[str] | None = None) -> NoReturn:
    """Run the program and exit with its code."""
    gc.set_threshold(_GARBAGE)
    _fill_closed_descriptors()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    for signum in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(signum) is not signal.SIG_IGN:
            signal.signal(signum, _stop)
    if VARIABLE in os.environ:
        from hrt_cli.completion import register

        register()
    code = _run(args)
    # Leaving, Python looks for cycles several times over: in hundreds of thousands of objects that the system frees.
    gc.freeze()
    sys.exit(code)


def _run(args: list[str] | None) -> int:
    try:
        outcome = cli.main(args=args, prog_name="hrt", standalone_mode=False)
        return outcome if isinstance(outcome, int) else 0
    except click.ClickException as error:
        text = io.StringIO()
        error.show(text)
        to_stderr(text.getvalue().rstrip())
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted; no output is half-written", 128 + signal.SIGINT)
    except Stopped as stop:
        word = "interrupted" if stop.signum == signal.SIGINT else "terminated"
        return _fail(f"{word}; no output is half-written", 128 + stop.signum)
    except HrtError as error:
        return _fail(str(error), error.exit_code)
    except MemoryError:
        return _fail("not enough memory for this input", 1)
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None:
            abandon_stdout()  # a full disk under an output file is an `OutputError`; this is click printing the help
            return _fail(f"standard output: {error.strerror}", 1)
        if os.environ.get("HRT_DEBUG"):
            raise
        return _fail(f"internal error: {type(error).__name__}: {error} (set HRT_DEBUG=1 for the traceback)", 1)


def _fail(message: str, code: int) -> int:
    to_stderr("Error: " + " ".join(message.split()))
    return code


def _stop(signum: int, frame: FrameType | None) -> None:
    raise Stopped(signum)


def _fill_closed_descriptors() -> None:
    # Where the caller closed a standard stream (`>&-`), the next file opened would get its number, and with it
    # whatever a C library prints.
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


if __name__ == "__main__":
    main()
