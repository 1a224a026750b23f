"""What a comparison finds: figures by which two artifacts may differ, and whether each is within its tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from hrt_cli.errors import ArgumentError

Value = float | int | str | bool | None


@dataclass(frozen=True)
class Figure:
    """One figure of two artifacts A and B.

    Attributes
    ----------
    name : str
    difference : float or None
        0 where they are the same, more the further they are apart; None where they differ and no number says how far.
    a, b : number, str, bool or None
        The figure of each, where each has one by itself.
    similarity : float or None
        What `difference` is 1 less of, where that is how the figure is known.
    unit : str
        Of `difference`.
    family : str
        Figures of one family are different measures of the same thing: where one that `speaks` for it is given a
        tolerance, those of it that are given none only tell.
    speaks : bool
        Whether a difference in the family cannot escape it altogether.
    counts : bool
        Whether a difference makes the artifacts differ; otherwise the figure only tells.
    parts : tuple of str
        Of the path that the name is, where it is one.
    """

    name: str
    difference: float | None
    a: Value = None
    b: Value = None
    similarity: float | None = None
    unit: str = ""
    family: str = ""
    speaks: bool = True
    counts: bool = True
    parts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """What the comparison of one kind of artifact found.

    Attributes
    ----------
    figures : list of Figure
    lines : list of str
        For people: what differs in detail.
    detail : dict
        JSON values: the same for programs.
    """

    figures: list[Figure]
    lines: list[str] = field(default_factory=list)
    detail: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """A figure beside its tolerance (None where it has none: it differs or does not)."""

    figure: Figure
    tolerance: float | None
    state: Literal["ok", "DIFFERENT", "told"]


def judge(
    figures: Sequence[Figure],
    tolerances: Mapping[str, float],
    meets: Callable[[str, Figure], bool] = lambda name, figure: name == figure.name,
) -> list[Verdict]:
    """Judge figures, each by its tolerance, which is 0 where none is given.

    Parameters
    ----------
    meets : callable
        Whether the name of a tolerance means a figure.

    Raises
    ------
    ArgumentError
        A tolerance is for no figure, or for one that is either the same or not.
    """
    given: dict[str, float] = {}
    for name, value in tolerances.items():
        met = [figure for figure in figures if meets(name, figure)]
        if not met:
            raise unknown(name, [figure.name for figure in figures])
        for figure in met:
            if isinstance(figure.a, str) or isinstance(figure.b, str):
                raise ArgumentError(f"--tolerance {name}: is the same or is not; it takes no tolerance")
            given[figure.name] = value
    spoken = {figure.family for figure in figures if figure.family and figure.speaks and figure.name in given}
    return [_verdict(figure, given.get(figure.name), figure.family in spoken) for figure in figures]


def _verdict(figure: Figure, given: float | None, spoken: bool) -> Verdict:
    if given is None and (spoken or not figure.counts):
        return Verdict(figure, None, "told")
    tolerance = given or 0.0
    within = figure.difference is not None and figure.difference <= tolerance
    text = isinstance(figure.a, str) or isinstance(figure.b, str)
    return Verdict(figure, None if text else tolerance, "ok" if within else "DIFFERENT")


def unknown(name: str, known: Iterable[str]) -> ArgumentError:
    """Return the refusal of a tolerance for what is no figure of this comparison."""
    names = list(known)
    shown = ", ".join(names[:_MOST_NAMES]) + (f", and {len(names) - _MOST_NAMES} more" * (len(names) > _MOST_NAMES))
    return ArgumentError(f"--tolerance {name}: is no figure of this comparison (it has: {shown})")


_MOST_NAMES = 60


def number(name: str, a: float | None, b: float | None, unit: str = "", **more: Any) -> Figure:
    """Return the figure of two numbers; one that only one of them has differs by no number."""
    difference = abs(a - b) if a is not None and b is not None else 0.0 if a is b else None
    return Figure(name, difference, a, b, unit=unit, **more)


def text(name: str, a: str | None, b: str | None, *, same: bool | None = None, **more: Any) -> Figure:
    """Return the figure of two texts, which are the same or are not."""
    return Figure(name, 0.0 if (a == b if same is None else same) else None, a, b, **more)


def apart(name: str, difference: float | None, unit: str = "", **more: Any) -> Figure:
    """Return a figure that only two artifacts together have: a distance, a number of things that differ."""
    return Figure(name, difference, unit=unit, **more)


def alike(name: str, similarity: float, **more: Any) -> Figure:
    """Return the figure of a similarity, 1 for the same."""
    return Figure(name, 1.0 - similarity, similarity=similarity, **more)
