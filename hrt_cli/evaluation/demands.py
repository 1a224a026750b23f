"""What is demanded of the figures of an evaluation (`--require 'ari>=0.8'`), and whether they meet it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Sequence
from typing import Any

from hrt_cli.errors import ArgumentError, DifferenceError
from hrt_cli.evaluation.paths import Parts, is_number, leaves, meets, patterns

Demand = tuple[str, str, float]
"""Name of a figure, how it compares (`>=`, `<=`, `>`, `<`, `==`), and to what."""

_COMPARES: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "==": operator.eq,
}


def check_names(demands: Sequence[Demand], known: Collection[str]) -> None:
    """Refuse a demand on what is no figure: before the evaluation, which may take long.

    Parameters
    ----------
    known : collection of str
        What names may begin with.

    Raises
    ------
    ArgumentError
    """
    for name, _, _ in demands:
        if not any(name == key or name.startswith(f"{key}.") for key in (*known, "*")):
            raise _unknown(name, known)


def require(document: dict[str, Any], demands: Sequence[Demand], *, within: str = "") -> None:
    """Check what an evaluation found.

    Parameters
    ----------
    document : dict
        As `--json` prints it.
    demands : sequence of Demand
        A name is a path, where `*` stands for any one key or index.
    within : str
        Key of an object whose members have figures each: a name that is no path is sought in all of them.

    Raises
    ------
    ArgumentError
        A name is no figure of this evaluation.
    DifferenceError
        A figure that a name meets, of several any, is not as demanded, or is not known.
    """
    found = dict(leaves(document))
    failed: list[str] = []
    for name, how, bound in demands:
        met = _met(name, found) or (_met(f"{within}.*.{name}", found) if within else [])
        if not met:
            raise _unknown(name, patterns(document))
        for parts in met:
            value = found[parts]
            if value is None or not _COMPARES[how](value, bound):
                told = "is not known" if value is None else f"is {value:.6g}"
                failed.append(f"{'.'.join(parts)} {told}, and {name}{how}{bound:g} is required")
    if failed:
        rest = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise DifferenceError(f"{failed[0]}{rest}")


def _met(name: str, found: dict[Parts, Any]) -> list[Parts]:
    return [parts for parts, value in found.items() if (value is None or is_number(value)) and meets(name, parts)]


def _unknown(name: str, known: Collection[str]) -> ArgumentError:
    return ArgumentError(f"--require {name}: is no figure of this evaluation (it has: {', '.join(known)})")
