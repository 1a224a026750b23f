"""Pages carry their provenance, and are checked against it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from hrt_cli.artifacts.html import html_provenance, in_script, publish_html
from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import InputError
from hrt_cli.evaluation.verify import verify_file

PAGE = "<!doctype html>\n<html><body><p>a & b</p>\n</body></html>\n"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    publish_html(path, PAGE, record("report", 1, {"title": "</script><!-- x"}, {}))
    return path


def test_what_is_published_reads_back_with_its_provenance(page: Path) -> None:
    found = html_provenance(page)
    assert found is not None
    assert found.parameters == {"title": "</script><!-- x"}
    assert verify_file(page).verdict == "ok"
    assert page.read_text().count("</script>") == 1  # the title does not end the record


@pytest.mark.parametrize(
    ("old", "new"),
    [("a & b", "a & c"), ("</p>", "</p> "), ('"stage_version":1', '"stage_version":2')],
    ids=["text", "blank", "record"],
)
def test_a_page_that_was_edited_is_noticed(page: Path, old: str, new: str) -> None:
    text = page.read_text()
    assert old in text
    page.write_text(text.replace(old, new, 1))
    if "stage" in old:  # the record is not part of the content; its own fingerprint is what tells
        assert html_provenance(page) is not None
        return
    with pytest.raises(InputError, match="not what its provenance recorded"):
        html_provenance(page)
    assert verify_file(page).verdict == "damaged"


def test_a_page_of_others_carries_none_and_two_records_are_refused(page: Path, tmp_path: Path) -> None:
    foreign = tmp_path / "other.html"
    foreign.write_text(PAGE)
    assert html_provenance(foreign) is None
    script = re.search(r"<script.*?</script>\n", page.read_text(), re.DOTALL)
    assert script is not None
    page.write_text(page.read_text().replace("</body>", script[0] + "</body>"))
    with pytest.raises(InputError, match="two provenance records"):
        html_provenance(page)


def test_json_in_a_script_stays_the_same_json() -> None:
    value = {"a": "</script><script>alert(1)</script><!--", "b": "\u2028\u2029"}
    text = in_script(json.dumps(value, ensure_ascii=False))
    assert "<" not in text
    assert json.loads(text) == value
