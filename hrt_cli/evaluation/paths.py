"""The figures of a JSON document by their paths, keys joined by dots: `plans.site/plan.json.score`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

Parts = tuple[str, ...]


def leaves(document: Any, above: Parts = ()) -> Iterator[tuple[Parts, Any]]:
    """Yield what is neither an object nor a list, and the keys and indices that lead to it."""
    inside = children(document)
    if inside is None:
        yield above, document
        return
    for key, value in inside:
        yield from leaves(value, (*above, key))


def children(value: Any) -> list[tuple[str, Any]] | None:
    """Return what an object or a list holds, by key or index; None where a value is neither."""
    if isinstance(value, dict):
        return [(str(key), inner) for key, inner in value.items()]
    if isinstance(value, list):
        return [(str(index), inner) for index, inner in enumerate(value)]
    return None


def is_number(value: Any) -> bool:
    """Whether a value is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def meets(name: str, parts: Parts) -> bool:
    """Whether a name is a path, where `*` stands for any one part. Parts may hold dots themselves, as files do."""
    if not parts:
        return False
    for word in (parts[0], "*"):
        if len(parts) == 1 and name == word:
            return True
        if name.startswith(f"{word}.") and meets(name[len(word) + 1 :], parts[1:]):
            return True
    return False


def patterns(document: Any) -> list[str]:
    """Return the paths of the numbers in a document, `*` standing for files, classes and indices."""
    return list(dict.fromkeys(_patterns(document, ())))


def _patterns(value: Any, above: Parts) -> Iterator[str]:
    inside = children(value)
    if inside is None:
        if value is None or is_number(value):
            yield ".".join(above)
        return
    alike = isinstance(value, list) or (bool(above) and all(isinstance(inner, dict) for _, inner in inside))
    for key, inner in inside:
        yield from _patterns(inner, (*above, "*" if alike else key))
