"""HTML pages that carry their provenance in a script element of data, so that they are cached and verified."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from hrt_cli.artifacts.carriers import checked, parse_provenance
from hrt_cli.artifacts.jsonio import canonical, parse_strict, read_text
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.artifacts.publish import publishing
from hrt_cli.errors import InputError

MAX_BYTES = 256 * 1024 * 1024
_END = "</body>"
_OURS = re.compile(r'<script type="application/json" id="hrt-provenance">(.*?)</script>\n', re.DOTALL)


def publish_html(target: Path, html: str, provenance: Provenance) -> None:
    """Publish a page, which has a `</body>`, with its provenance at the end of the body."""
    stamped = provenance.with_content(_sha256(html))
    body, end, rest = html.rpartition(_END)
    record = in_script(canonical(stamped.model_dump(mode="json")).decode())
    script = f'<script type="application/json" id="hrt-provenance">{record}</script>\n'
    with publishing(target, html_provenance) as draft:
        draft.write_text(body + script + end + rest, encoding="utf-8")


def html_provenance(path: Path) -> Provenance | None:
    """Read the provenance of a page and check the rest against it; None if it carries none."""
    html = read_text(path, MAX_BYTES)
    found = _OURS.findall(html)
    if not found:
        return None
    if len(found) > 1:
        raise InputError(path, "carries two provenance records")
    provenance = parse_provenance(path, parse_strict(path, found[0]))
    return checked(path, provenance, _sha256(_OURS.sub("", html)))


def in_script(json_text: str) -> str:
    """Return JSON that may stand in a script element: no text in it can end that, or begin a comment."""
    return json_text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _sha256(html: str) -> str:
    return hashlib.sha256(html.encode()).hexdigest()
