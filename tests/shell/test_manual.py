"""Help as a manual page: sections, units, ranges, exit codes, and the example at the end."""

from __future__ import annotations

import math

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from hrt_cli import options as opt
from hrt_cli.manual import Command, facts_of, interval, sectioned, told


@click.command(
    cls=Command,
    sections={"Shape": "--side --round", "Output": "--colour", "Ghosts": "--absent"},
    files="OUT.log stands beside.",
    difference="it is not round",
    see_also=("plan",),
    epilog="\b\nExample:\n  hrt draw a.tif\n  hrt draw b.tif\n",
)
@click.argument("raster", type=opt.RASTER)
@opt.output("OUT.tif", "What is drawn.")
@click.option("--side", "side_m", type=opt.FiniteFloat(0, low_open=True), default=2.0, show_default=True, help="Side.")
@click.option("--round/--square", default=True, show_default=True, help="Shape.")
@click.option("--colour", type=click.Choice(["red", "blue"]), multiple=True, help="Colours.")
@click.option("--loose", type=click.IntRange(1, 9), required=True, help="Not in any section.")
@click.option("--hidden", hidden=True)
@opt.existing_options
@opt.console_options
def draw(**given: object) -> None:
    """Draw RASTER."""


def test_the_whole_help() -> None:
    shown = CliRunner().invoke(draw, ["--help"], terminal_width=100).output
    assert shown == (
        "Usage: draw RASTER -o OUT.tif --loose N [OPTIONS]\n"
        "\n"
        "  Draw RASTER.\n"
        "\n"
        "Options:\n"
        "  --loose N             Not in any section.  [required; 1 to 9]\n"
        "\n"
        "Shape:\n"
        "  --side METRES         Side.  [default: 2; above 0]\n"
        "  --round / --square    Shape.  [default: --round]\n"
        "\n"
        "Output:\n"
        "  -o, --output OUT.tif  What is drawn.  [required]\n"
        "  --colour [red|blue]   Colours.  [repeatable]\n"
        "  --overwrite           Replace an output made from other inputs or parameters.\n"
        "  --force               Compute again even what is up to date (implies --overwrite).\n"
        "\n"
        "Messages:\n"
        "  --json                Print the result as one JSON object.\n"
        "  -q, --quiet           No notes and no progress bar.\n"
        "  -v, --verbose         Tell more on stderr.\n"
        "  --help                Show this message and exit.\n"
        "\n"
        "Files:\n"
        "  OUT.log stands beside.\n"
        "\n"
        "Exit codes:\n"
        "  0 done or up to date; 1 an input or output refused; 2 wrong usage; 3 it is not round; 130, 143\n"
        "  stopped by a signal.\n"
        "\n"
        "See also:\n"
        "  hrt plan\n"
        "\n"
        "Example:\n"
        "  hrt draw a.tif\n"
        "  hrt draw b.tif\n"
    )


def test_every_option_is_in_one_section() -> None:
    context = click.Context(draw)
    found = [option.name for options in sectioned(draw, context).values() for option in options]
    shown = [each.name for each in draw.get_params(context) if isinstance(each, click.Option) and not each.hidden]
    assert sorted(map(str, found)) == sorted(map(str, shown))


@pytest.mark.parametrize(
    ("option", "facts"),
    [
        (click.Option(["--a"]), ""),
        (click.Option(["--a"], type=opt.FiniteFloat()), ""),
        (click.Option(["--a"], type=opt.FiniteFloat(0, 1, high_open=True)), "0, below 1"),
        (click.Option(["--a"], type=opt.Size(8, 64), default="9x9", show_default=True), "default: 9x9; 8x8 to 64x64"),
        (click.Option(["--a"], type=opt.ClassCount()), "2 to 255, or auto"),
        (
            click.Option(["--a"], type=click.IntRange(min=1), show_default="as many as fit"),
            "default: as many as fit; 1 or more",
        ),
        (click.Option(["--a/--no-a"], default=False, show_default=True), "default: --no-a"),
        (click.Option(["--a"], type=float, default=1e-3, show_default=True, multiple=False), "default: 0.001"),
    ],
)
def test_what_is_told_of_a_value(option: click.Option, facts: str) -> None:
    assert "; ".join(facts_of(option)) == facts
    assert told(option) == (f"  [{facts}]" if facts else "")


@given(st.integers(-9, 9), st.integers(0, 9), st.booleans(), st.booleans(), st.booleans(), st.booleans())
def test_an_interval_is_told_with_its_ends(
    low: int, width: int, low_open: bool, high_open: bool, no_low: bool, no_high: bool
) -> None:
    """The words, read back, are the interval."""
    ends = (-math.inf if no_low else low, math.inf if no_high else low + width)
    words = interval(*ends, low_open=low_open, high_open=high_open)
    read = [float(word.strip(",")) for word in words.split() if word.strip(",").lstrip("-").isdigit()]
    assert read == [end for end in ends if math.isfinite(end)]
    assert ("above" in words) == (low_open and not no_low)
    assert ("below" in words) == (high_open and not no_high)
    assert ("more" in words) == (no_high and not no_low and not low_open)
    assert ("up to" in words) == (no_low and not no_high and not high_open)
