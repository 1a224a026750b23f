"""One policy for what the user sees: the library reports to a callback, the console decides what is shown and where.

stdout carries the result only; notes and progress go to stderr, progress only where stderr is a terminal.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hrt_cli.errors import OutputError

Progress = Callable[[int, int], None]
"""A callback `(done, total)` in whatever units the caller of it counts."""


def silent(done: int, total: int) -> None:
    """Ignore progress: the default of every library function that takes a `Progress`."""


Note = Callable[[str], None]
"""A callback that takes one line for the user that is not the result."""


def unheard(text: str) -> None:
    """Drop a note: the default of every library function that takes a `Note`."""


@dataclass(frozen=True)
class Console:
    """How one command talks to its user.

    Attributes
    ----------
    as_json : bool
        Print the result as one JSON object instead of one human line.
    quiet, verbose : bool
        Drop notes and progress; show details.
    """

    as_json: bool = False
    quiet: bool = False
    verbose: bool = False

    def note(self, text: str) -> None:
        """Tell the user something on stderr that is not the result."""
        if not self.quiet:
            to_stderr(text)

    def detail(self, text: str) -> None:
        """Tell the user something that only `--verbose` asks for."""
        if self.verbose:
            to_stderr(text)

    def result(self, line: str, data: dict[str, Any], *, only_here: bool = False) -> None:
        """Print the result: `line`, or with `--json` the JSON object `data`.

        Parameters
        ----------
        only_here : bool
            The result is in no file: then failing to print it is an error. Otherwise the work is done and saved,
            and a full stdout is only worth a note. A reader that stops listening (`hrt ... | head`) is no error.

        Raises
        ------
        OutputError
            stdout is full or closed, and the result is only there.
        """
        text = json.dumps(data, allow_nan=False) if self.as_json else line
        if sys.stdout is None:
            if only_here:
                raise OutputError("standard output: is closed, and the result is in no file")
            return
        try:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
        except OSError as error:
            abandon_stdout()
            if only_here and not isinstance(error, BrokenPipeError):
                raise OutputError(f"standard output: {error.strerror}") from error
            if not isinstance(error, BrokenPipeError):
                self.note(f"Warning: standard output: {error.strerror}; the files are written")

    @contextmanager
    def bar(self, label: str) -> Iterator[Progress]:
        """Yield a `Progress` that draws a bar on stderr where that is a terminal, else does nothing.

        While it lasts, the first kernel that numba compiles is told of: the first use on a machine is slow.
        """
        with self._telling_of_compiling():
            if self.quiet or sys.stderr is None or not sys.stderr.isatty():
                yield silent
                return
            from tqdm import tqdm

            with tqdm(total=None, desc=label, leave=False, file=sys.stderr) as shown:

                def update(done: int, total: int) -> None:
                    shown.total = total
                    shown.update(done - shown.n)

                yield update

    @contextmanager
    def _telling_of_compiling(self) -> Iterator[None]:
        if "numba" not in sys.modules:
            yield
            return
        from numba.core import event

        note, told = self.note, False

        class Compiling(event.Listener):
            def on_start(self, event: object) -> None:
                nonlocal told
                if not told:
                    told = True
                    note("Note: compiling for this machine; only the first use takes this long")

            def on_end(self, event: object) -> None:
                pass

        with event.install_listener("numba:compile", Compiling()):
            yield


def to_stderr(text: str) -> None:
    """Print a line on stderr, or drop it where stderr is closed or full."""
    if sys.stderr is not None:
        try:
            print(text, file=sys.stderr, flush=True)
        except OSError:
            sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - nobody listens any more


def abandon_stdout() -> None:
    """Give stdout up after a failed write.

    Python flushes it once more at exit; pointing it elsewhere keeps that from failing a second time.
    """
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    os.close(devnull)
