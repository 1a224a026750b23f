"""Demands on the figures of an evaluation: which figures a name means, and what holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st
from raster_files import write_raster

from hrt_cli.errors import ArgumentError, DifferenceError
from hrt_cli.evaluation.demands import check_names, require
from hrt_cli.evaluation.paths import leaves, meets, patterns
from hrt_cli.main import cli
from hrt_cli.options import Demand

FOUND: dict[str, Any] = {
    "score": 3.0,
    "none": None,
    "told": True,
    "plans": {"a/b.json": {"gap": 0.1}, "c.json": {"gap": 0.3}},
    "table": [[1, 2], [3, 4]],
}


def parse(text: str) -> tuple[str, str, float]:
    return Demand().convert(text, None, None)


@pytest.mark.parametrize(
    "text",
    ["score>=3", "score<=3", "score==3", "score<4", "score > 2", "plans.*.gap<=0.3", "gap<0.31", "table.1.0==3",
     "plans.a/b.json.gap==0.1", "table.*.*>0", "score>=-1e3"],
)  # fmt: skip
def test_what_holds_passes(text: str) -> None:
    require(FOUND, [parse(text)], within="plans")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("score>3", "score is 3, and score>3 is required"),
        ("score<3", "score is 3"),
        ("gap<=0.2", "plans.c.json.gap is 0.3, and gap<=0.2 is required"),
        ("plans.*.gap>0.3", r"plans.a/b.json.gap is 0.1.*\(and 1 more\)"),
        ("none>=0", "none is not known"),
    ],
)
def test_what_does_not_hold_is_named_with_its_value(text: str, told: str) -> None:
    with pytest.raises(DifferenceError, match=told):
        require(FOUND, [parse("score>=0"), parse(text)], within="plans")


@pytest.mark.parametrize("name", ["scores", "told", "plans", "plans.gap", "table.2.0", "table.0", "a/b.json", "Score"])
def test_a_name_that_is_no_figure_is_refused_with_those_that_are(name: str) -> None:
    with pytest.raises(ArgumentError, match=r"it has: score, none, plans\.\*\.gap, table\.\*\.\*\)"):
        require(FOUND, [(name, ">=", 0.0)], within="plans")


def test_names_are_checked_before_the_work() -> None:
    check_names([("plans.x.gap", ">=", 0.0), ("*.x", ">=", 0.0), ("gap", ">=", 0.0)], ["plans", "gap"])
    with pytest.raises(ArgumentError, match=r"gaps: is no figure of this evaluation \(it has: plans, gap\)"):
        check_names([("gaps", ">=", 0.0)], ["plans", "gap"])


@pytest.mark.parametrize(
    "text", ["", "0.9", "ari", "ari=0.8", "ari>=", ">=1", "ari=>1", "ari>=x", "ari>=inf", "ari>>1", " >=1", "a>=1_0"]
)
def test_what_is_no_demand_is_a_usage_error(text: str) -> None:
    with pytest.raises(click.UsageError):
        parse(text)


PART = st.text("ab.*", min_size=1, max_size=3)


@given(st.lists(PART, min_size=1, max_size=4))
def test_a_path_meets_its_own_name_and_the_one_with_a_star(parts: list[str]) -> None:
    assert meets(".".join(parts), tuple(parts))
    for k in range(len(parts)):
        assert meets(".".join([*parts[:k], "*", *parts[k + 1 :]]), tuple(parts))


@given(
    st.recursive(st.integers(), lambda inner: st.dictionaries(PART, inner, max_size=3) | st.lists(inner, max_size=3))
)
def test_every_number_is_met_by_a_pattern(document: Any) -> None:
    found = dict(leaves({"top": document}))
    told = patterns({"top": document})
    assert all(any(meets(name, parts) for name in told) for parts in found)


def run(*args: object) -> Result:
    return CliRunner().invoke(cli, ["evaluate", "segment", *map(str, args)])


def test_every_figure_of_a_segmentation_can_be_demanded(tmp_path: Path) -> None:
    ids = (np.arange(400).reshape(20, 20) // 100).astype(np.uint8)
    truth = write_raster(tmp_path / "t.tif", ids, nodata=255)
    ids[0, :10] = 3
    classes = write_raster(tmp_path / "c.tif", ids, nodata=255)
    import json

    from hrt_commands.evaluate_segment import FIGURES

    found = json.loads(run(classes, truth, "--json").stdout)
    assert tuple(found) == FIGURES
    assert run(classes, truth, "--require", "ari>=0.8", "--require", "per_class.*.iou>0.5").exit_code == 0
    failed = run(classes, truth, "--require", "ari>=0.999")
    assert isinstance(failed.exception, DifferenceError)
    assert failed.stdout.startswith(f"{classes}: ARI")
    refused = run(classes, truth, "--require", "arri>=0.8")
    assert isinstance(refused.exception, ArgumentError)
    assert refused.stdout == ""
