"""The door: two files in, what kind they are, how they differ, and whether that is within the tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrt_cli.artifacts.carriers import json_provenance, npz_provenance
from hrt_cli.artifacts.drivelog import drive_provenance
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.stage import ReadProvenance
from hrt_cli.errors import DifferenceError, InputError
from hrt_cli.evaluation.compare import printed
from hrt_cli.evaluation.compare.kinds import TITLES, Kind, kind_of
from hrt_cli.evaluation.compare.names import NAMES
from hrt_cli.evaluation.compare.origin import compare_origins, read_origin
from hrt_cli.evaluation.compare.result import Found, Verdict, judge, unknown
from hrt_cli.progress import Note, Progress, silent, unheard

_MOST_TOLD = 3


@dataclass(frozen=True)
class Comparison:
    """How two artifacts differ.

    Attributes
    ----------
    kind : str
    verdicts : list of Verdict
    lines : list of str
        For people: what differs in detail.
    detail : dict
        JSON values: the same for programs.
    origin : dict
        What made them has in common (`compare_origins`); it does not count.
    """

    kind: Kind
    verdicts: list[Verdict]
    lines: list[str]
    detail: dict[str, Any]
    origin: dict[str, Any]

    @property
    def same(self) -> bool:
        """Whether every figure that counts is within its tolerance."""
        return not self.differing

    @property
    def differing(self) -> list[Verdict]:
        """The figures that are not."""
        return [verdict for verdict in self.verdicts if verdict.state == "DIFFERENT"]


def compare_files(
    path_a: Path,
    path_b: Path,
    tolerances: Mapping[str, float],
    *,
    progress: Progress = silent,
    note: Note = unheard,
) -> Comparison:
    """Compare two artifacts of one kind, by what they hold.

    Parameters
    ----------
    path_a, path_b : Path
    tolerances : mapping of str to float
        By figure; of JSON also by the end of a path. A figure without one has 0.
    progress : Progress
        Called with (blocks done, blocks).
    note : Note
        Told where a content is not what its provenance recorded.

    Raises
    ------
    InputError
        A file cannot be read, is of no kind that is compared, or they are of two.
    ArgumentError
        A tolerance is for what is no figure of this kind.
    """
    kind, other = kind_of(path_a), kind_of(path_b)
    if kind != other:
        raise InputError(path_b, f"is {TITLES[other]}, and {path_a} {TITLES[kind]}: they cannot be compared")
    for name in tolerances:
        if kind in NAMES and name not in NAMES[kind]:
            raise unknown(name, NAMES[kind])
    found = _compare(kind, path_a, path_b, progress)
    if kind == "figures":
        verdicts = judge(found.figures, tolerances, printed.tolerates)
    else:
        there = {figure.name for figure in found.figures}
        verdicts = judge(found.figures, {name: value for name, value in tolerances.items() if name in there})
    a, b = (_origin(kind, path, note) for path in (path_a, path_b))
    return Comparison(kind, verdicts, found.lines, found.detail, compare_origins(a, b))


def require_same(path_a: Path, path_b: Path, comparison: Comparison) -> None:
    """Raise a `DifferenceError` that names the first figures beyond their tolerances, where there are any."""
    beyond = comparison.differing
    if beyond:
        told = ", ".join(map(_told, beyond[:_MOST_TOLD]))
        more = f", and {len(beyond) - _MOST_TOLD} more" if len(beyond) > _MOST_TOLD else ""
        raise DifferenceError(f"{path_b}: differs from {path_a} in {told}{more}")


def _compare(kind: Kind, a: Path, b: Path, progress: Progress) -> Found:
    # Each only when it is asked for: some bring numba or PyTorch with them, which take seconds to import.
    if kind == "classes":
        from hrt_cli.evaluation.compare.classes import compare_classes

        return compare_classes(a, b, progress)
    if kind == "scoremap":
        from hrt_cli.evaluation.compare.scoremaps import compare_scoremaps

        return compare_scoremaps(a, b)
    if kind == "scores":
        from hrt_cli.evaluation.compare.scores import compare_scores

        return compare_scores(a, b)
    if kind in ("plan", "team plan"):
        from hrt_cli.evaluation.compare.plans import compare_plans

        return compare_plans(a, b)
    if kind == "drive log":
        from hrt_cli.evaluation.compare.drives import compare_drives

        return compare_drives(a, b)
    if kind == "figures":
        return printed.compare_printed(a, b)
    from hrt_cli.evaluation.compare.models import compare_models, read_weights

    return compare_models(read_weights(kind, a), read_weights(kind, b))


def _told(verdict: Verdict) -> str:
    figure = verdict.figure
    if figure.difference is None:
        words = f"{figure.a} and {figure.b}" if figure.a is not None or figure.b is not None else "differs"
        return f"{figure.name} ({words})"
    unit = f" {figure.unit}" if figure.unit else ""
    return f"{figure.name} ({figure.difference:.6g}{unit}, tolerance {verdict.tolerance:g})"


def _origin(kind: Kind, path: Path, note: Note) -> Provenance | None:
    readers: dict[str, ReadProvenance] = {
        "texture model": npz_provenance,
        "policy": npz_provenance,
        "steering model": _of_steering_model,
        "drive log": _of_log,
        "classes": _of_raster,
        "scoremap": npz_provenance if path.suffix.lower() == ".npz" else _of_raster,
    }
    return read_origin(path, readers.get(kind, json_provenance), note)


def _of_raster(path: Path) -> Provenance | None:
    from hrt_cli.raster.cog import tagged_provenance
    from hrt_cli.raster.gate import open_raster

    with open_raster(path, unreferenced=True) as raster:
        return tagged_provenance(raster)


def _of_log(path: Path) -> Provenance | None:
    return drive_provenance(path) if path.suffix.lower() == ".jsonl" else None


def _of_steering_model(path: Path) -> Provenance | None:
    from hrt_cli.steering.network.model import model_provenance  # PyTorch takes a second to import

    return model_provenance(path)
