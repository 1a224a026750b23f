"""The tutorials' commands run as they stand, and print what they say."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from tutorial import IMAGES, TUTORIALS, Step, agree, pictures, run, steps_of, written

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
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_prints_what_it_says(name: str, tmp_path: Path) -> None:
    text = TUTORIALS[name].read_text(encoding="utf-8")
    steps = steps_of(text)
    assert len(steps) >= 10
    for step, printed in run(steps, tmp_path):
        assert agree(step.printed, printed), f"$ {step.command}\nsays:\n{step.printed}prints:\n{printed}"
    made = pictures(name, text)
    assert len(made) >= 3
    assert all((tmp_path / png).is_file() for png in made.values())


@pytest.mark.parametrize("name", TUTORIALS)
def test_the_pictures_of_a_tutorial_are_there_and_light(name: str) -> None:
    for picture in pictures(name, TUTORIALS[name].read_text(encoding="utf-8")):
        path = IMAGES / picture
        assert path.stat().st_size <= 150_000
        assert cv2.imread(str(path)).shape[1] <= 1000


def test_no_picture_is_left_over_and_all_are_light() -> None:
    pages = [IMAGES.parents[1] / "README.md", *IMAGES.parent.glob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    there = sorted(IMAGES.iterdir())
    assert all(f"images/{path.name})" in text for path in there)
    assert sum(path.stat().st_size for path in there) <= 1_500_000


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
