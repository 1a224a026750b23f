"""The reference of the commands, docs/cli/, made from the commands: `python tests/shell/reference.py --write`."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import click

from hrt_cli import options as opt
from hrt_cli.main import COMMANDS, cli
from hrt_cli.manual import EXITS, arguments_of, default_of, example_of, names, range_of, sectioned

FOLDER = Path(__file__).parents[2] / "docs" / "cli"
WRITE = "make docs (or: python tests/shell/reference.py --write)"
MADE = f"<!-- Made from the commands by {WRITE}. -->"


def root() -> click.Context:
    """Return the context of `hrt` itself."""
    return click.Context(cli, info_name="hrt", **cli.context_settings)


def commands(above: click.Context) -> Iterator[click.Context]:
    """Yield the contexts of `hrt plan`, `hrt evaluate`, `hrt evaluate plan`, ...; plugins are left out."""
    group = above.command
    assert isinstance(group, click.Group)
    for name in COMMANDS if group is cli else group.list_commands(above):
        command = group.get_command(above, name)
        assert command is not None
        context = click.Context(command, info_name=name, parent=above)
        yield context
        if isinstance(command, click.Group):
            yield from commands(context)


def pages() -> dict[str, str]:
    """Return the text of every page by the name of its file."""
    return {"README.md": _index(root()), **{_file(each.command_path): _page(each) for each in commands(root())}}


def stale(folder: Path = FOLDER) -> list[str]:
    """Return the pages that are absent, too many, or not what the commands say."""
    made = pages()
    there = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.md")}
    return sorted(name for name in {*made, *there} if made.get(name) != there.get(name))


def _index(context: click.Context) -> str:
    lines = [MADE, "", "# The commands of hrt", "", *_prose(cli.help), "", _usage(context), "", *_listed(context)]
    lines += [
        "Of inputs, the endings that the pages name are the usual ones, which the shell completes: what a file is, its",
        "content tells.",
        "",
    ]
    lines += ["## Options of hrt", "", *_options(context), "", *_exits("a check found a difference"), ""]
    lines += ["## Example", "", "```sh", example_of(cli.epilog), "```"]
    return "\n".join(lines) + "\n"


def _page(context: click.Context) -> str:
    command = context.command
    lines = [MADE, "", f"# {context.command_path}", "", *_prose(command.help), "", _usage(context), ""]
    if arguments := arguments_of(command):
        lines += ["## Arguments", "", "| argument | takes | how often |", "| --- | --- | --- |"]
        lines += [f"| `{_called(each)}` | {_takes(each)} | {_count(each)} |" for each in arguments]
        lines += [""]
    if isinstance(command, click.Group):
        lines += ["## Commands", "", *_listed(context)]
    lines += ["## Options", "", *_options(context), "", *_files(command)]
    if keys := getattr(command, "keys", ()):
        listed = ", ".join(f"`{key}`" for key in keys)
        lines += [
            "## Keys of `--json`",
            "",
            f"Always there, null where they are not known: {listed}. More may stand beside them.",
            "",
        ]
    if not isinstance(command, click.Group):
        lines += [*_exits(getattr(command, "difference", "")), ""]
    if see := getattr(command, "see_also", ()):
        lines += ["## See also", "", ", ".join(f"[`hrt {each}`]({_file(f'hrt {each}')})" for each in see), ""]
    lines += ["## Example", "", "```sh", example_of(command.epilog), "```"]
    return "\n".join(lines) + "\n"


def _listed(context: click.Context) -> Iterator[str]:
    yield from ["| command | |", "| --- | --- |"]
    for each in commands(context):
        yield f"| [`{each.command_path}`]({_file(each.command_path)}) | {_cell(_first(each.command))} |"
    yield ""


def _usage(context: click.Context) -> str:
    pieces = " ".join(context.command.collect_usage_pieces(context))
    return f"    {context.command_path} {pieces}"


def _prose(text: str | None) -> list[str]:
    return inspect.cleandoc(text or "").replace("*", "\\*").splitlines()


def _first(command: click.Command) -> str:
    return " ".join((command.help or "").split("\n\n")[0].split())


def _options(context: click.Context) -> Iterator[str]:
    yield "| option | takes | default | |"
    yield "| --- | --- | --- | --- |"
    for title, options in sectioned(context.command, context).items():
        yield f"| **{title}** | | | |"
        for each in options:
            default = f"`{default_of(each)}`" if each.show_default else "**required**" if each.required else ""
            often = "; repeatable" if each.multiple else ""
            yield f"| `{_bare(names(each, context))}` | {_takes(each)}{often} | {default} | {_cell(each.help or '')} |"


def _bare(text: str) -> str:
    """Leave choices out of the names of an option: they stand in the column of what it takes."""
    return re.sub(r" \[[^\]]*\]$", "", text)


def _takes(param: click.Parameter) -> str:
    kind = param.type
    if isinstance(param, click.Option) and param.is_flag:
        return ""
    if isinstance(kind, click.Choice):
        return ", ".join(f"`{each}`" for each in kind.choices)
    if isinstance(kind, opt.File):
        return (
            "folder"
            if kind.folder
            else f"file: {' '.join(f'`{each}`' for each in kind.suffixes)}"
            if kind.suffixes
            else "file or folder"
        )
    if isinstance(kind, click.Path):
        return "file or folder"
    if isinstance(kind, click.IntRange):
        return f"whole number, {range_of(kind)}"
    if isinstance(kind, opt.FiniteFloat):
        return f"number, {range_of(kind)}".removesuffix(", ")
    return range_of(kind) or ("text" if kind is click.STRING else _cell(kind.name))


def _count(argument: click.Argument) -> str:
    if argument.nargs == -1:
        return "one or more" if argument.required else "none or more"
    return "once" if argument.required else "once or not at all"


def _files(command: click.Command) -> Iterator[str]:
    files = [each for each in command.params if isinstance(each.type, click.Path)]
    written = [each for each in files if getattr(each.type, "writes", False)]
    more = inspect.cleandoc(getattr(command, "files", ""))
    if not files and not more:
        return
    yield from ["## Files", ""]
    for verb, which in (("Reads", [each for each in files if each not in written]), ("Writes", written)):
        if which:
            yield f"- {verb} {', '.join(f'`{_called(each)}`' for each in which)}."
    if more.startswith("\b\n"):
        yield from ["```sh", more.removeprefix("\b\n"), "```"]
    elif more:
        yield f"- {more}"
    yield ""


def _called(param: click.Parameter) -> str:
    if isinstance(param, click.Argument):
        return (param.metavar or param.name or "").upper().removesuffix("...")
    return max(param.opts, key=len)


def _exits(difference: str) -> Iterable[str]:
    codes = dict(EXITS)
    if difference:
        codes = {**codes, "3": difference}
    rows = [f"| {code} | {codes[code]} |" for code in sorted(codes, key=lambda code: int(code.split(",")[0]))]
    return ["## Exit codes", "", "| code | |", "| --- | --- |", *rows]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")


def _file(name: str) -> str:
    return f"{name.removeprefix('hrt ').replace(' ', '-')}.md"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", required=True, help="write the pages that are stale")
    parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    made = pages()
    for name in stale():
        path = FOLDER / name
        if name in made:
            path.write_text(made[name], encoding="utf-8")
        else:
            path.unlink()
        print(path.relative_to(FOLDER.parents[1]))


if __name__ == "__main__":
    main()
