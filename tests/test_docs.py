"""What the pages in docs say of one another and of their sources is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAME = r"[A-ZÄÖÜ][\wäöüäéü-]+"
CITED = re.compile(rf"({NAME})(?:,? (?:et al\.|and {NAME}|{NAME},? (?:and|et) {NAME}))? ((?:18|19|20)\d\d)\b")


def anchors(text: str) -> set[str]:
    """The anchors of the headings of a page, as GitHub makes them."""
    found = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file.read_text(encoding="utf-8")), target


def method() -> tuple[str, list[tuple[str, str]]]:
    """The text of the method without its sources, and these as (first author, year)."""
    text, _, sources = (ROOT / "docs" / "method.md").read_text(encoding="utf-8").partition("\n## Sources\n")
    entries = [re.match(rf"- ({NAME}),.*? (\d{{4}})\. ", line) for line in sources.splitlines() if line]
    assert all(entries)
    return " ".join(text.split()), [(entry[1], entry[2]) for entry in entries if entry]


def test_every_paper_that_the_method_names_is_among_its_sources() -> None:
    text, sources = method()
    cited = {(found[1], found[2]) for found in CITED.finditer(text)}
    assert len(cited) > 40
    assert cited - set(sources) - {("NovaLogic", "1992")} == set()


def test_every_source_of_the_method_is_named_in_it_and_they_stand_in_order() -> None:
    text, sources = method()
    assert sources == sorted(sources)
    assert len(set(sources)) == len(sources)
    for author, year in sources:
        assert re.search(
            rf"{author}[^.;]*?(?:et al\.[^.;]*?)? {year}|{author} et al\. {year}|{author}.{{0,80}}\({year}\)", text
        ), (author, year)
