from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli import options as opt
from hrt_cli.artifacts.stage import Existing
from hrt_cli.progress import Console


def given_to(*decorators: Any, args: list[str]) -> tuple[Result, dict[str, Any]]:
    """Run a command that has these options; what it was handed, by name."""
    handed: dict[str, Any] = {}

    def body(**kwargs: Any) -> None:
        handed.update(kwargs)

    for decorator in reversed(decorators):
        body = decorator(body)
    return CliRunner().invoke(click.command()(body), args), handed


def number(text: str, *limits: float, **opens: bool) -> float:
    return opt.FiniteFloat(*limits, **opens).convert(text, None, None)


@pytest.mark.parametrize("text", ["nan", "NaN", "-nan", "inf", "-inf", "Infinity", "1e999", "-1e999"])
def test_a_number_that_is_not_finite_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a finite number"):
        number(text)


@pytest.mark.parametrize("text", ["", "x", "1,5", "1 000", "0x10", "1e", "--1", "1_000", "\u0661"])
def test_what_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a number"):
        number(text)


@settings(deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_is_taken_as_it_is(value: float) -> None:
    assert number(repr(value)) == value


@settings(deadline=None)
@given(st.floats(-10, 10), st.booleans(), st.booleans())
def test_the_limits_are_as_in_an_interval(value: float, low_open: bool, high_open: bool) -> None:
    inside = (value > -1 or (value == -1 and not low_open)) and (value < 2 or (value == 2 and not high_open))
    try:
        found = number(repr(value), -1.0, 2.0, low_open=low_open, high_open=high_open)
    except click.BadParameter:
        found = math.nan
    assert (found == value) == inside


@pytest.mark.parametrize(
    ("text", "opens", "message"),
    [
        ("0", {"low_open": True}, "0 is too small; it must be more than 0"),
        ("-1", {}, "-1 is too small; it must be at least 0"),
        ("5", {"high_open": True}, "5 is too large; it must be less than 5"),
        ("6", {}, "6 is too large; it must be at most 5"),
    ],
)
def test_the_refusal_names_the_option_and_the_limit(text: str, opens: dict[str, bool], message: str) -> None:
    option = click.option("--speed", type=opt.FiniteFloat(0, 5, **opens))
    result, _ = given_to(option, args=["--speed", text])
    assert result.exit_code == 2
    assert f"Error: Invalid value for '--speed': {message}" in result.output


@pytest.mark.parametrize(
    ("text", "pair"),
    [("COMPRESS=ZSTD", ("COMPRESS", "ZSTD")), ("A=b=c", ("A", "b=c")), ("A=", ("A", "")), ("=b", None), ("A", None)],
)
def test_creation_options_are_pairs(text: str, pair: tuple[str, str] | None) -> None:
    result, handed = given_to(opt.creation_opt, args=["--co", text, "--co", "X=1"])
    if pair is None:
        assert result.exit_code == 2
        assert f"'{text}' is not of the form NAME=VALUE" in result.output
    else:
        assert handed["creation"] == (pair, ("X", "1"))


@pytest.mark.parametrize(
    ("args", "bands"),
    [
        ([], ()),
        (["-b", "3,2,1"], (3, 2, 1)),
        (["--bands", "1"], (1,)),
        (["-b", "1,,2"], None),
        (["-b", "red"], None),
        (["-b", ""], None),
        (["-b", "0,1,2"], None),
        (["-b", "-1"], None),
        (["-b", "1.5"], None),
    ],
)
def test_bands(args: list[str], bands: tuple[int, ...] | None) -> None:
    result, handed = given_to(opt.bands_opt, args=args)
    if bands is None:
        assert result.exit_code == 2
        assert "Invalid value for '-b' / '--bands'" in result.output
    else:
        assert handed["bands"] == bands


@pytest.mark.parametrize(("option", "name"), [(opt.seed_opt, "--seed"), (opt.workers_opt, "--workers")])
@pytest.mark.parametrize("text", ["-1", "1.5", "nan", "99999999999"])
def test_counts_are_whole_and_bounded(option: Any, name: str, text: str) -> None:
    result, _ = given_to(option, args=[name, text])
    assert result.exit_code == 2
    assert f"Invalid value for '{name}'" in result.output


def test_defaults() -> None:
    result, handed = given_to(
        opt.output_opt, opt.seed_opt, opt.workers_opt, opt.nodata_opt, opt.unreferenced_opt, args=["-o", "a.tif"]
    )
    assert result.exit_code == 0, result.output
    assert handed == {"output": Path("a.tif"), "seed": 0, "workers": 1, "nodata": None, "unreferenced": False}
    assert given_to(opt.output_opt, args=[])[0].exit_code == 2


@pytest.mark.parametrize(
    ("args", "console"),
    [
        ([], Console()),
        (["--json"], Console(as_json=True)),
        (["-q"], Console(quiet=True)),
        (["-v", "--json"], Console(as_json=True, verbose=True)),
    ],
)
def test_console_options_are_handed_over_as_one(args: list[str], console: Console) -> None:
    assert given_to(opt.console_options, args=args)[1] == {"console": console}


@pytest.mark.parametrize(
    ("args", "existing"),
    [
        ([], Existing()),
        (["--overwrite"], Existing(overwrite=True)),
        (["--force"], Existing(force=True)),
    ],
)
def test_existing_options_are_handed_over_as_one(args: list[str], existing: Existing) -> None:
    assert given_to(opt.existing_options, args=args)[1] == {"existing": existing}
