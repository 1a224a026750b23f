from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli.artifacts.jsonio import to_text
from hrt_cli.artifacts.scores import (
    PRIOR,
    PRIOR_STRENGTH,
    ClassScore,
    ScoreTable,
    read_score_table,
    read_scores,
    scores_document,
)
from hrt_cli.errors import InputError


def write(folder: Path, document: Any) -> Path:
    path = folder / "scores.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return path


def test_a_table_of_the_tool_is_read_back(tmp_path: Path) -> None:
    scores = {0: ClassScore(8.5, 1.5, 120.25, "grass"), 254: ClassScore(1, 1), 7: ClassScore(0, 3.0, 1.0, "é")}
    assert read_scores(write(tmp_path, to_text(scores_document(scores)))) == scores


@settings(deadline=None, max_examples=60)
@given(
    st.dictionaries(
        st.integers(0, 254),
        st.builds(ClassScore, st.floats(1e-3, 1e6), st.floats(1e-3, 1e6), st.floats(0, 1e6), st.text(max_size=20)),
        min_size=1,
        max_size=5,
    )
)
def test_every_table_is_read_back(tmp_path_factory: pytest.TempPathFactory, scores: dict[int, ClassScore]) -> None:
    folder = tmp_path_factory.mktemp("scores", numbered=True)
    assert read_scores(write(folder, to_text(scores_document(scores)))) == scores


class TestByHand:
    @pytest.mark.parametrize("mean", [0, 1, 0.0, 0.25, 1.0])
    def test_a_bare_number_is_a_mean(self, tmp_path: Path, mean: float) -> None:
        found = read_scores(write(tmp_path, {"scores": {"3": mean}}))
        assert list(found) == [3]
        assert found[3].mean == mean
        assert found[3].alpha + found[3].beta == PRIOR_STRENGTH
        assert found[3].evidence_m == 0

    def test_a_mean_with_a_name(self, tmp_path: Path) -> None:
        found = read_scores(write(tmp_path, {"scores": {"0": {"mean": 0.75, "name": "path"}}}))
        assert found == {0: ClassScore.expecting(0.75, "path")}

    def test_a_beta_distribution(self, tmp_path: Path) -> None:
        found = read_scores(write(tmp_path, {"scores": {"0": {"alpha": 4, "beta": 1.0, "evidence_m": 3}}}))
        assert found == {0: ClassScore(4, 1, 3)}
        assert found[0].mean == 0.8

    def test_a_mean_that_agrees_with_its_distribution(self, tmp_path: Path) -> None:
        found = read_scores(write(tmp_path, {"scores": {"0": {"alpha": 2, "beta": 1, "mean": 0.667}}}))
        assert found[0].mean == pytest.approx(2 / 3)

    def test_a_byte_order_mark(self, tmp_path: Path) -> None:
        assert read_scores(write(tmp_path, '\ufeff{"scores": {"0": 0.5}}'))[0].mean == 0.5


REFUSED = {
    "nan": ('{"scores": {"0": NaN}}', "NaN is not a number"),
    "infinity": ('{"scores": {"0": {"alpha": Infinity, "beta": 1}}}', "Infinity is not a number"),
    "beyond a double": ('{"scores": {"0": {"alpha": 1e999, "beta": 1}}}', "1e999 is too large"),
    "a class twice": ('{"scores": {"0": 0.5, "1": 0.2, "0": 0.7}}', "'0' stands twice"),
    "a member twice": ('{"scores": {"0": {"mean": 0.5, "mean": 0.6}}}', "'mean' stands twice"),
    "just above one": ({"scores": {"0": 1.0001}}, "scores.0.mean: .*less than or equal to 1"),
    "below zero": ({"scores": {"0": -1e-9}}, "scores.0.mean: .*greater than or equal to 0"),
    "a whole number above one": ({"scores": {"2": 2}}, "scores.2.mean"),
    "an entry of unknown members": ({"scores": {"0": {"mean": 0.5, "colour": "red"}}}, "scores.0.colour"),
    "an unknown member": ({"scores": {"0": 0.5}, "note": "x"}, "note"),
    "alpha alone": ({"scores": {"0": {"alpha": 2}}}, "alpha and beta go together"),
    "beta alone": ({"scores": {"0": {"beta": 2, "mean": 0.5}}}, "alpha and beta go together"),
    "alpha below zero": ({"scores": {"0": {"alpha": -1, "beta": 2}}}, "scores.0.alpha"),
    "no weight": ({"scores": {"0": {"alpha": 0, "beta": 0}}}, "more than 0"),
    "a mean of another distribution": ({"scores": {"0": {"alpha": 1, "beta": 1, "mean": 0.7}}}, "mean is not alpha"),
    "an entry of nothing": ({"scores": {"0": {}}}, "needs a mean"),
    "an entry of null": ({"scores": {"0": None}}, "scores.0"),
    "a number as text": ({"scores": {"0": "0.5"}}, "scores.0"),
    "a truth value": ({"scores": {"0": True}}, "scores.0"),
    "a mean as text": ({"scores": {"0": {"mean": "0.5"}}}, "scores.0.mean"),
    "class 255": ({"scores": {"255": 0.5}}, "'255' is not a class id"),
    "class -1": ({"scores": {"-1": 0.5}}, "'-1' is not a class id"),
    "class 01": ({"scores": {"01": 0.5}}, "'01' is not a class id"),
    "class of another script": ({"scores": {"٣": 0.5}}, "is not a class id"),
    "class by name": ({"scores": {"grass": 0.5}}, "'grass' is not a class id"),
    "class of a thousand digits": ({"scores": {"9" * 5000: 0.5}}, "is not a class id"),
    "no class": ({"scores": {}}, "holds no class"),
    "no scores": ({}, "scores: "),
    "a list of scores": ({"scores": [0.5, 0.6]}, "scores: "),
    "a list": ("[]", "the document"),
    "another format": ({"format": "hrt-plan", "scores": {"0": 0.5}}, "format"),
    "a later version": ({"version": 2, "scores": {"0": 0.5}}, "version"),
    "cut short": ('{"scores": {"0": 0.5', "not valid JSON"),
    "something behind": ('{"scores": {"0": 0.5}} x', "not valid JSON"),
    "empty": ("", "not valid JSON"),
    "nested": ("[" * 100_000, "nested"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_table_is_refused(tmp_path: Path, name: str) -> None:
    document, problem = REFUSED[name]
    path = write(tmp_path, document)
    with pytest.raises(InputError, match=problem) as refusal:
        read_scores(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert len(str(refusal.value)) < 1000


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_scores(tmp_path / "absent.json")
    (tmp_path / "latin1.json").write_bytes(b'{"scores": {"0": {"mean": 1, "name": "\xe9"}}}')
    with pytest.raises(InputError, match="UTF-8"):
        read_scores(tmp_path / "latin1.json")


@settings(deadline=None, max_examples=60)
@given(st.floats(0.01, 1e4), st.floats(0.01, 1e4))
def test_mean_and_deviation_are_those_of_the_beta_distribution(alpha: float, beta: float) -> None:
    from scipy import stats

    belief, beta_distribution = ClassScore(alpha, beta), stats.beta(alpha, beta)
    assert belief.mean == pytest.approx(beta_distribution.mean(), rel=1e-9)
    assert belief.sd == pytest.approx(beta_distribution.std(), rel=1e-6)


def test_the_prior_is_uniform() -> None:
    assert (PRIOR.alpha, PRIOR.beta, PRIOR.evidence_m) == (1.0, 1.0, 0.0)
    assert math.isclose(PRIOR.sd, math.sqrt(1 / 12))


class TestLogs:
    SUMS = ("0" * 64, "f" * 64)

    def test_the_logs_are_read_back_in_their_order(self, tmp_path: Path) -> None:
        for logs in (self.SUMS, self.SUMS[::-1], ()):
            path = write(tmp_path, to_text(scores_document({0: ClassScore(2, 1)}, logs)))
            assert read_score_table(path) == ScoreTable({0: ClassScore(2, 1)}, logs)

    def test_none_are_not_written(self) -> None:
        assert "logs" not in scores_document({0: ClassScore(2, 1)})

    @pytest.mark.parametrize("logs", ["0" * 64, ["0" * 63], ["g" * 64], ["F" * 64], [5], None, {}])
    def test_what_is_no_hash_is_refused(self, tmp_path: Path, logs: object) -> None:
        with pytest.raises(InputError, match="logs"):
            read_score_table(write(tmp_path, {"scores": {"0": 0.5}, "logs": logs}))
