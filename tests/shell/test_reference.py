"""The reference of the commands says what the commands say."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest
from reference import FOLDER, WRITE, commands, pages, root, stale

from hrt_cli.main import COMMANDS, STAGES
from hrt_cli.manual import Command

PAGES = pages()
EVERY = list(commands(root()))
CALLED = [each.command_path for each in EVERY]
ROOT = Path(__file__).parents[2]


def test_the_pages_are_what_the_commands_say() -> None:
    wrong = stale()
    assert not wrong, f"stale pages in docs/cli: {wrong}; run {WRITE}"


def test_a_page_that_is_changed_absent_or_too_many_is_stale(tmp_path: Path) -> None:
    for name, text in PAGES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert stale(tmp_path) == []
    (tmp_path / "plan.md").write_text(PAGES["plan.md"].replace("budget", "bugdet"), encoding="utf-8")
    (tmp_path / "verify.md").unlink()
    (tmp_path / "gone.md").write_text("", encoding="utf-8")
    assert stale(tmp_path) == ["gone.md", "plan.md", "verify.md"]


def test_every_command_has_a_page_that_the_index_links() -> None:
    linked = set(re.findall(r"\]\(([a-z-]+\.md)\)", PAGES["README.md"]))
    assert linked == set(PAGES) - {"README.md"}
    assert {f"{name}.md" for name in COMMANDS} <= linked
    assert "evaluate-plan.md" in linked


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_to_pages_and_tables_have_as_many_cells_in_every_row(name: str) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", PAGES[name]):
        assert target in PAGES
    for table in re.findall(r"(?:^\|.*\n)+", PAGES[name], re.MULTILINE):
        cells = {len(re.findall(r"(?<!\\)\|", re.sub(r"`[^`]*`", "", row))) for row in table.splitlines()}
        assert len(cells) == 1, table


@pytest.mark.parametrize("context", EVERY, ids=CALLED)
def test_a_page_names_every_option_and_argument(context: click.Context) -> None:
    text = PAGES[f"{context.command_path.removeprefix('hrt ').replace(' ', '-')}.md"]
    for param in context.command.get_params(context):
        for flag in [*param.opts, *param.secondary_opts] if isinstance(param, click.Option) else []:
            assert re.search(rf"`.*{flag}\b.*`", text), flag
        if isinstance(param, click.Argument):
            assert f"| `{(param.metavar or param.name or '').upper().removesuffix('...')}` |" in text


@pytest.mark.parametrize("context", EVERY, ids=CALLED)
def test_what_a_help_names_is_there(context: click.Context) -> None:
    command = context.command
    if not isinstance(command, Command):
        return
    flags = {flag for param in command.get_params(context) for flag in param.opts}
    named = [flag for options in command.sections.values() for flag in options.split()]
    assert set(named) <= flags
    assert len(set(named)) == len(named)
    assert {f"hrt {each}" for each in command.see_also} <= set(CALLED)
    assert bool(command.keys) == ("--json" in flags), (
        "what --json promises: tests/flow/test_examples.py holds it to that"
    )
    module = ROOT / "commands" / f"{context.command_path.removeprefix('hrt ').replace(' ', '_').replace('-', '_')}.py"
    raises = re.search(r"raise DifferenceError|\brequire(_same)?\(", module.read_text(encoding="utf-8"))
    assert bool(raises) == bool(command.difference), "exit code 3 is told by those that end with it"


def test_the_stages_of_the_help_name_each_command_once() -> None:
    staged = [name for names in STAGES.values() for name in names]
    assert len(set(staged)) == len(staged)
    assert set(COMMANDS) <= set(staged), "add the command to STAGES"


def test_the_readme_leads_to_the_reference() -> None:
    assert f"]({FOLDER.relative_to(ROOT)}/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
