from __future__ import annotations

import io
import json
import math
import sys

import pytest

from hrt_cli import progress
from hrt_cli.errors import OutputError
from hrt_cli.progress import Console, silent, to_stderr


class Broken(io.StringIO):
    """A stream whose reader is gone or whose disk is full."""

    def __init__(self, error: OSError) -> None:
        super().__init__()
        self.error = error

    def write(self, text: str) -> int:
        raise self.error


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


FULL = OSError(28, "No space left on device")
GONE = BrokenPipeError(32, "Broken pipe")


@pytest.fixture(autouse=True)
def abandoned(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether stdout was given up; the tests' own must not be."""
    calls: list[bool] = []
    monkeypatch.setattr(progress, "abandon_stdout", lambda: calls.append(True))
    return calls


def test_the_result_goes_to_stdout_and_notes_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    console.note("a note")
    console.detail("a detail")
    console.result("the result", {"a": 1})
    assert capsys.readouterr() == ("the result\n", "a note\n")


def test_json_is_one_object_on_one_line_in_ascii(capsys: pytest.CaptureFixture[str]) -> None:
    Console(as_json=True).result("unused", {"name": "Grüße\n", "x": [1.5, None]})
    out, _ = capsys.readouterr()
    assert out.count("\n") == 1
    assert out.isascii()
    assert json.loads(out) == {"name": "Grüße\n", "x": [1.5, None]}


def test_json_never_holds_nan() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        Console(as_json=True).result("", {"x": math.nan})


def test_quiet_drops_notes_and_verbose_adds_details(capsys: pytest.CaptureFixture[str]) -> None:
    Console(quiet=True).note("a note")
    Console(quiet=True).result("the result", {})
    Console(verbose=True).detail("a detail")
    assert capsys.readouterr() == ("the result\n", "a detail\n")


@pytest.mark.parametrize("only_here", [True, False])
def test_a_full_stdout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], abandoned: list[bool], only_here: bool
) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(FULL))
    if only_here:
        with pytest.raises(OutputError, match="standard output: No space left on device"):
            Console().result("the result", {}, only_here=True)
        assert capsys.readouterr().err == ""
    else:
        Console().result("the result", {})
        assert capsys.readouterr().err == ("Warning: standard output: No space left on device; the files are written\n")
    assert abandoned


@pytest.mark.parametrize("only_here", [True, False])
def test_a_reader_that_is_gone_is_no_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], abandoned: list[bool], only_here: bool
) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(GONE))
    Console().result("the result", {}, only_here=only_here)
    assert capsys.readouterr().err == ""
    assert abandoned


def test_a_closed_stdout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    Console().result("the result", {})
    with pytest.raises(OutputError, match="is closed"):
        Console().result("the result", {}, only_here=True)


@pytest.mark.parametrize("stream", [None, Broken(FULL), Broken(GONE)])
def test_a_lost_stderr_is_no_error(monkeypatch: pytest.MonkeyPatch, stream: Broken | None) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    to_stderr("once")
    to_stderr("twice")
    Console(verbose=True).detail("three times")


def test_the_bar_is_drawn_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, console in ((io.StringIO(), Console()), (Terminal(), Console(quiet=True)), (None, Console())):
        monkeypatch.setattr(sys, "stderr", stream)
        with console.bar("work") as update:
            assert update is silent
            update(1, 2)
        assert stream is None or stream.getvalue() == ""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with Console().bar("work") as update:
        for done in (1, 5, 10):
            update(done, 10)
    assert "work" in terminal.getvalue()


def test_the_bar_ends_with_the_work_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)

    def work() -> None:
        with Console().bar("work") as update:
            update(1, 2)
            raise OutputError("disk full")

    with pytest.raises(OutputError):
        work()
    assert terminal.getvalue().endswith("\r")


def test_compiling_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    from numba.core import event

    with Console().bar("work"):
        for _ in range(2):
            with event.trigger_event("numba:compile"):
                pass
    assert capsys.readouterr().err.count("compiling") == 1
