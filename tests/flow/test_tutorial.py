"""The tutorial's commands run as they stand, and print what it says."""

from __future__ import annotations

from pathlib import Path

import pytest
from tutorial import TUTORIAL, Step, agree, run, steps_of, written

TEXT = """Words.

```console
$ echo a 1.00; \\
>   echo b
a 1.00
b
$ echo 7 > f
```

```sh
echo not run
```

```console
$ cat f
7
```
"""


@pytest.mark.slow
def test_the_tutorial_prints_what_it_says(tmp_path: Path) -> None:
    steps = steps_of(TUTORIAL.read_text(encoding="utf-8"))
    assert len(steps) > 10
    for step, printed in run(steps, tmp_path):
        assert agree(step.printed, printed), f"$ {step.command}\nsays:\n{step.printed}prints:\n{printed}"


def test_commands_and_what_they_print_are_found_and_run_in_order(tmp_path: Path) -> None:
    steps = steps_of(TEXT)
    assert steps == [Step("echo a 1.00; \\\n  echo b", "a 1.00\nb\n"), Step("echo 7 > f", ""), Step("cat f", "7\n")]
    assert [printed for _, printed in run(steps, tmp_path)] == [step.printed for step in steps]


def test_a_command_that_fails_is_told(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="exit 3"):
        list(run([Step("exit 3", "")], tmp_path))


def test_what_was_printed_is_written_back() -> None:
    assert written(TEXT, ["a 1.00\nb\n", "", "7\n"]) == TEXT
    assert "x (... s)\n```" in written(TEXT, ["", "", "x (1.2 s)\n"])


@pytest.mark.parametrize(
    ("told", "printed", "same"),
    [
        ("a 100 b\n", "a 101 b\n", True),
        ("a 100 b\n", "a 103 b\n", False),
        ("a 100 b\n", "a 100 c\n", False),
        ("a (... s)\n", "a (12.5 s)\n", True),
        ("a ... 4\n", "a x y 4\n", True),
        ("a ... 4\n", "a x y 5\n", False),
        ("a\n", "a\nb\n", False),
        ("-1.5\n", "1.5\n", False),
        ("0\n", "0\n", True),
        ("0\n", "1\n", False),
    ],
)
def test_numbers_may_differ_by_little_and_words_not_at_all(told: str, printed: str, same: bool) -> None:
    assert agree(told, printed) is same
