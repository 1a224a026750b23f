"""The score table (`scores.json`): what is believed about each class's drivability.

A table made by the tool holds a Beta posterior per class, and in `logs` the sha256 of every drive log that it rests on,
so that none is counted twice. One written by hand may hold less: a bare number is an expected score, `{"mean": .8}`
likewise, `{"alpha": 4, "beta": 1}` a Beta distribution.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from hrt_cli.artifacts.jsonio import Document, read_model
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.errors import InputError

PRIOR_STRENGTH = 2.0
"""Weight, in pseudo-metres, of an expected score given without its own alpha and beta: that of Beta(1, 1)."""
_AGREE = 1e-3
_CLASS_ID = re.compile("0|[1-9][0-9]{0,2}")


@dataclass(frozen=True)
class ClassScore:
    """Belief about one class: a Beta(alpha, beta) over its drivability in [0, 1], and the metres it rests on."""

    alpha: float
    beta: float
    evidence_m: float = 0.0
    name: str = ""

    @property
    def mean(self) -> float:
        """Expected drivability."""
        return self.alpha / (self.alpha + self.beta)

    @property
    def sd(self) -> float:
        """Standard deviation of the Beta distribution."""
        total = self.alpha + self.beta
        return math.sqrt(self.alpha * self.beta / (total * total * (total + 1)))

    @staticmethod
    def expecting(mean: float, name: str = "") -> ClassScore:
        """Return the belief of weight `PRIOR_STRENGTH` with this mean."""
        return ClassScore(PRIOR_STRENGTH * mean, PRIOR_STRENGTH * (1 - mean), 0.0, name)


PRIOR = ClassScore.expecting(0.5)
"""What is believed of a class that nothing is known of: Beta(1, 1), uniform."""


@dataclass(frozen=True)
class ScoreTable:
    """Beliefs by class id, and the sha256 of every drive log that is counted in them, in the order of counting."""

    scores: dict[int, ClassScore]
    logs: tuple[str, ...] = ()


class _Entry(Document):
    mean: float | None = Field(default=None, ge=0, le=1)
    sd: float | None = Field(default=None, ge=0, le=0.5)
    alpha: float | None = Field(default=None, ge=0)
    beta: float | None = Field(default=None, ge=0)
    evidence_m: float = Field(default=0.0, ge=0)
    name: str = Field(default="", max_length=200)

    @model_validator(mode="after")
    def _complete(self) -> _Entry:
        if (self.alpha is None) != (self.beta is None):
            raise ValueError("alpha and beta go together")
        if self.alpha is None and self.mean is None:
            raise ValueError("needs a mean, or alpha and beta")
        if self.alpha is not None and self.beta is not None:
            if self.alpha + self.beta <= 0:
                raise ValueError("alpha + beta must be more than 0")
            if self.mean is not None and abs(self.alpha / (self.alpha + self.beta) - self.mean) > _AGREE:
                raise ValueError("mean is not alpha / (alpha + beta)")
        return self

    def belief(self) -> ClassScore:
        if self.alpha is not None and self.beta is not None:
            return ClassScore(self.alpha, self.beta, self.evidence_m, self.name)
        assert self.mean is not None
        return ClassScore.expecting(self.mean, self.name)


class _Table(Document):
    format: Literal["hrt-scores"] = "hrt-scores"
    version: Literal[1] = 1
    scores: dict[str, _Entry]
    logs: list[Annotated[str, Field(pattern="^[0-9a-f]{64}$")]] = Field(default=[])
    provenance: Provenance | None = None

    @field_validator("scores", mode="before")
    @classmethod
    def _numbers_are_means(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return {k: {"mean": float(v)} if type(v) in (int, float) else v for k, v in value.items()}
        return value

    @field_validator("scores")
    @classmethod
    def _keys_are_ids(cls, value: dict[str, _Entry]) -> dict[str, _Entry]:
        for key in value:
            if not (_CLASS_ID.fullmatch(key) and int(key) < 255):
                raise ValueError(f"{key[:20]!r} is not a class id from 0 to 254")
        return value


def read_scores(path: Path) -> dict[int, ClassScore]:
    """Read what a score table believes, by class id; raises as `read_score_table`."""
    return read_score_table(path).scores


def read_score_table(path: Path) -> ScoreTable:
    """Read a score table.

    Raises
    ------
    InputError
        As `read_model`; also where a mean lies outside [0, 1], or an entry says nothing or contradicts itself.
    """
    table = read_model(path, _Table)
    if not table.scores:
        raise InputError(path, "holds no class")
    return ScoreTable({int(key): entry.belief() for key, entry in table.scores.items()}, tuple(table.logs))


def scores_document(scores: dict[int, ClassScore], logs: Sequence[str] = ()) -> dict[str, Any]:
    """Return the JSON members of a score table (without provenance); `logs` is left out where there are none."""
    document: dict[str, Any] = {
        "format": "hrt-scores",
        "version": 1,
        "scores": {
            str(k): {
                "name": s.name,
                "mean": s.mean,
                "sd": s.sd,
                "alpha": s.alpha,
                "beta": s.beta,
                "evidence_m": s.evidence_m,
            }
            for k, s in sorted(scores.items())
        },
    }
    return document | ({"logs": list(logs)} if logs else {})
