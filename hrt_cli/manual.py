"""Help that reads as a manual page: what must be given, options in sections, their ranges, exit codes, an example."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click

_FIRST = {"Options": ""}
_LAST = {
    "Output": "--output --figure --backdrop --co --overwrite --force",
    "Messages": "--json --quiet --verbose --help",
}
"""Sections that every command has, before and after its own; an option that no section names is under `Options`."""
EXITS = {
    "0": "done, or up to date",
    "1": "refused: an input, or an output that exists; one line on stderr says which, why, and what to do",
    "2": "wrong usage",
    "130, 143": "interrupted, terminated; no output is half-written",
}
"""What the exit codes of every command mean."""
_COLUMN = 26
"""Names of options that are longer stand on a line of their own."""
SHORT_EXITS = "0 done or up to date; 1 an input or output refused; 2 wrong usage; {three}130, 143 stopped by a signal."


class Command(click.Command):
    """A command whose help tells in sections what it takes, how it ends and what goes with it.

    Parameters
    ----------
    sections : mapping of str to str
        Title -> the options under it, named as the user does (`--aoi --margin`), with spaces between.
    files : str
        What is read or written that no argument or option names.
    difference : str
        When it exits with 3; empty if it never does.
    keys : sequence of str
        Keys of the object that `--json` prints which are always there.
    see_also : sequence of str
        Commands that go with it, without `hrt`.
    """

    def __init__(
        self,
        *args: Any,
        sections: Mapping[str, str] | None = None,
        files: str = "",
        difference: str = "",
        keys: Sequence[str] = (),
        see_also: Sequence[str] = (),
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.sections = dict(sections or {})
        self.files, self.difference = files, difference
        self.keys, self.see_also = tuple(keys), tuple(see_also)

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """Return the arguments, the options that must be given, and `[OPTIONS]`."""
        given = [piece for each in arguments_of(self) for piece in each.get_usage_pieces(ctx)]
        needed = [names(each, ctx).rpartition(" ") for each in options_of(self, ctx) if each.required]
        return [*given, *(f"{flags.split(', ')[0]} {value}" for flags, _, value in needed), "[OPTIONS]"]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options section by section, then how it ends, the files and what goes with it."""
        sections = sectioned(self, ctx)
        widths = [len(names(each, ctx)) for options in sections.values() for each in options]
        width = max((each for each in widths if each <= _COLUMN), default=0)
        for title, options in sections.items():
            with formatter.section(title):
                formatter.write_dl([(names(each, ctx).ljust(width), told(each)) for each in options], col_max=width)
        three = f"3 {self.difference}; " if self.difference else ""
        paragraphs = {"Files": self.files, "Exit codes": SHORT_EXITS.format(three=three)}
        paragraphs["See also"] = ", ".join(f"hrt {name}" for name in self.see_also)
        for title, text in paragraphs.items():
            if text:
                with formatter.section(title):
                    formatter.write_text(inspect.cleandoc(text))

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the example as the last section."""
        write_example(self.epilog, formatter)


def example_of(epilog: str | None) -> str:
    """Return the lines of the example that ends a help."""
    return inspect.cleandoc((epilog or "").removeprefix("\b\nExample:\n"))


def write_example(epilog: str | None, formatter: click.HelpFormatter) -> None:
    """Write the example of a help as a section, line by line as it is."""
    if epilog:
        with formatter.section("Example"):
            formatter.write_text(f"\b\n{example_of(epilog)}")


def arguments_of(command: click.Command) -> list[click.Argument]:
    """Return the arguments of a command in their order."""
    return [each for each in command.params if isinstance(each, click.Argument)]


def options_of(command: click.Command, ctx: click.Context) -> list[click.Option]:
    """Return the options of a command that are shown, `--help` the last."""
    return [each for each in command.get_params(ctx) if isinstance(each, click.Option) and not each.hidden]


def sectioned(command: click.Command, ctx: click.Context) -> dict[str, list[click.Option]]:
    """Return the options of a command by the title of their section, each once; no section is empty."""
    own = getattr(command, "sections", {})
    titles = {flag: title for title, flags in {**own, **_LAST}.items() for flag in flags.split()}
    titles |= {flag: title for title, flags in own.items() for flag in flags.split()}
    found: dict[str, list[click.Option]] = {title: [] for title in {**_FIRST, **own, **_LAST}}
    for option in options_of(command, ctx):
        title = next((titles[flag] for flag in option.opts if flag in titles), "Options")
        found[title].append(option)
    return {title: options for title, options in found.items() if options}


def names(option: click.Option, ctx: click.Context) -> str:
    """Return the names of an option and what stands for its value: `-o, --output CLASSES.tif`."""
    record = option.get_help_record(ctx)
    return "" if record is None else record[0].replace("INTEGER RANGE", "N")


def told(option: click.Option) -> str:
    """Return the help of an option, with what it may be in brackets."""
    facts = "; ".join(facts_of(option))
    return f"{option.help or ''}  [{facts}]" if facts else option.help or ""


def facts_of(option: click.Option) -> Iterator[str]:
    """Yield what is to be known of the value of an option: whether it must be given, its default, its range."""
    if option.required:
        yield "required"
    if option.show_default:
        yield f"default: {default_of(option)}"
    if allowed := range_of(option.type):
        yield allowed
    if option.multiple:
        yield "repeatable"


def default_of(option: click.Option) -> str:
    """Return a default as one would type it."""
    if isinstance(option.show_default, str):
        return option.show_default
    if option.secondary_opts:
        return (option.opts if option.default else option.secondary_opts)[0]
    return f"{option.default:g}" if isinstance(option.default, float) else str(option.default)


def range_of(kind: click.ParamType) -> str:  # type: ignore[type-arg]  # generic only from click 8.4
    """Return what a number may be, in words; empty where there is no limit, or no number."""
    if isinstance(kind, click.IntRange):
        return interval(-math.inf if kind.min is None else kind.min, math.inf if kind.max is None else kind.max)
    return str(getattr(kind, "allowed", ""))


def interval(low: float, high: float, *, low_open: bool = False, high_open: bool = False) -> str:
    """Return an interval in words: `0 to 1`, `above 0`, `below 1`, `above 0, to 1`; empty for all numbers."""
    if low == -math.inf and high == math.inf:
        return ""
    if low == -math.inf:
        return f"below {_plain(high)}" if high_open else f"up to {_plain(high)}"
    if high == math.inf:
        return f"above {_plain(low)}" if low_open else f"{_plain(low)} or more"
    start = f"above {_plain(low)}," if low_open else f"{_plain(low)}{',' * high_open}"
    return f"{start} {'below' if high_open else 'to'} {_plain(high)}"


def _plain(number: float) -> str:
    return str(int(number)) if number == int(number) else f"{number:g}"
