"""The error tree: every refusal the library makes is an `HrtError`; `main.py` turns it into one line.

The library raises; it never prints and never exits. A message names the file (or the argument) and says
what is wrong and what to do, so that the line alone is enough for a tired person in the field.
"""

from __future__ import annotations

import os


class HrtError(Exception):
    """Base of every refusal; exit code 1."""

    exit_code = 1


class InputError(HrtError):
    """An input file or the data in it cannot be used.

    Parameters
    ----------
    path : str or os.PathLike
        The file at fault; named first in the message.
    problem : str
        What is wrong, in one clause.
    remedy : str, optional
        What to do about it.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str, remedy: str = "") -> None:
        self.path = os.fspath(path)
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{self.path}: {problem}" + (f" ({remedy})" if remedy else ""))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Survive the way from a worker process."""
        return InputError, (self.path, self.problem, self.remedy)


class ArgumentError(HrtError):
    """A value given on the command line does not fit the data (a start off the map, K above the limit)."""


class ClusterError(HrtError):
    """The machines that were asked to share the work do not."""


class OutputError(HrtError):
    """The output cannot be written, or would overwrite something that is not its own."""


class DifferenceError(HrtError):
    """A check (`verify`, `compare`, `evaluate --require`) found a difference; exit code 3."""

    exit_code = 3
