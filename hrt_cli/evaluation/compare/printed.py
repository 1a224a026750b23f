"""Two JSON objects that `hrt ... --json` printed, or any others: number by number, by their paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.evaluation.compare.result import Figure, Found, number
from hrt_cli.evaluation.paths import Parts, is_number, leaves, meets

_CLOCK = ("seconds", "megapixels_per_second")
_RATE = "_per_second"
_ABSENT = "absent"


def compare_printed(path_a: Path, path_b: Path) -> Found:
    """Compare the numbers, truths and nulls of two JSON objects; text only tells, and so do times and rates.

    Provenance is left out.

    Raises
    ------
    InputError
        A file is no strict JSON.
    """
    a, b = (_leaves(path) for path in (path_a, path_b))
    figures, words = [], []
    for parts in dict.fromkeys([*a, *b]):
        of_a, of_b = a.get(parts, _ABSENT), b.get(parts, _ABSENT)
        name = ".".join(parts)
        if all(isinstance(each, str) for each in (of_a, of_b)):
            if of_a != of_b:
                words.append(f"{name}: {of_a!r} in A, {of_b!r} in B")
            continue
        figures.append(_figure(name, parts, of_a, of_b))
    return Found(figures, words)


def tolerates(name: str, figure: Figure) -> bool:
    """Whether the name of a tolerance means a figure: its path or the end of it, `*` standing for any one part."""
    return any(meets(name, figure.parts[first:]) for first in range(len(figure.parts)))


def _leaves(path: Path) -> dict[Parts, Any]:
    document = parse_strict(path, read_text(path))
    if isinstance(document, dict):
        document.pop("provenance", None)
    return dict(leaves(document))


def _figure(name: str, parts: Parts, a: Any, b: Any) -> Figure:
    counts = not (parts[-1] in _CLOCK or parts[-1].endswith(_RATE))
    if is_number(a) and is_number(b):
        return number(name, a, b, counts=counts, parts=parts)
    return Figure(name, 0.0 if type(a) is type(b) and a == b else None, a, b, counts=counts, parts=parts)
