"""The report stage: files and folders in, one page out that needs nothing but itself."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from hrt_cli import __version__
from hrt_cli.artifacts.html import html_provenance, in_script, publish_html
from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Progress, silent
from hrt_cli.report.page.collect import Folder, Item, collect
from hrt_cli.report.page.content import WHOLE, Detail, Page, compose
from hrt_cli.world.site import site_files

STAGE, STAGE_VERSION = "report", 1
_SCRIPTS = ("unpack.js", "map.js", "charts.js", "player.js", "tables.js", "page.js")
_SHOWN = {"unknown", "mission"}


@dataclass(frozen=True)
class ReportSummary:
    """What the report stage did.

    Attributes
    ----------
    up_to_date : bool
    size : int
        Bytes of the page.
    sites, layers, plans, drives, charts : int
        How much of each it shows; 0 where it was up to date.
    problems : list of str
        What could not be shown, and why.
    """

    up_to_date: bool
    size: int
    sites: int = 0
    layers: int = 0
    plans: int = 0
    drives: int = 0
    charts: int = 0
    problems: tuple[str, ...] = ()


def report_files(
    paths: Sequence[Path],
    output: Path,
    *,
    title: str = "",
    world: Path | None = None,
    detail: Detail = WHOLE,
    existing: Existing = REFUSE,
    progress: Progress = silent,
) -> ReportSummary:
    """Write a page of whatever files and folders hold.

    Parameters
    ----------
    paths : sequence of Path
        Files, and folders with all that is in them.
    output : Path
        The page (`.html`). It may stand in one of the folders: pages are no part of what is shown.
    title : str
        Default: the name of the first folder.
    world : Path, optional
        Folder of the site (`ortho.tif`, `dsm.tif`) on which drives are seen whose own is not among `paths`.

    Raises
    ------
    InputError
        A path does not exist, `world` is no site, or there is nothing that can be shown.
    ArgumentError
        The name of `output` does not end in `.html`.
    OutputError
        See `hrt_cli.artifacts.stage.begin`.
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"{output}: a report is a page; choose a name that ends in .html")
    folder = collect(paths)
    inputs = {f"file/{item.name}": item.path for item in folder.items}
    inputs |= {f"world/{role}": path for role, path in (site_files(world) if world else {}).items()}
    if not any(item.kind not in _SHOWN and not item.problem for item in folder.items):
        raise InputError(paths[0], "holds nothing that can be shown", _why_not(folder))
    title = title or _title(paths[0])
    parameters = {"title": title, **asdict(detail)}
    job = begin(
        STAGE, STAGE_VERSION, inputs=inputs, parameters=parameters, outputs={output: html_provenance}, existing=existing
    )
    if job.up_to_date:
        return ReportSummary(True, output.stat().st_size)
    done, total = 0, 2 * len(folder.items) + 1

    def tick() -> None:
        nonlocal done
        done += 1
        progress(min(done, total - 1), total)

    page = compose(title, folder, world, detail, tick)
    publish_html(output, render(page), job.provenance)
    progress(total, total)
    return ReportSummary(
        False,
        output.stat().st_size,
        len(page.sites),
        sum(len(site.layers) for site in page.sites),
        len(page.plans),
        len(page.drives),
        len(page.charts),
        tuple(f"{item.name}: {item.problem}" for item in folder.items if item.problem) + tuple(page.notes),
    )


def render(page: Page) -> str:
    """Return a page as HTML: the template with styles, scripts and all data in it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    assets = files("hrt_cli.report.page") / "assets"
    environment = Environment(
        loader=PackageLoader("hrt_cli.report.page", "assets"), autoescape=True, undefined=StrictUndefined
    )
    data = json.dumps(page.document(), allow_nan=False, separators=(",", ":"))
    values: dict[str, Any] = {
        "page": page,
        "version": __version__,
        "style": Markup((assets / "page.css").read_text(encoding="utf-8")),
        "script": Markup("\n".join((assets / name).read_text(encoding="utf-8") for name in _SCRIPTS)),
        "data": Markup(in_script(data)),
    }
    return environment.get_template("page.html").render(values)


def _title(path: Path) -> str:
    """Name a page after a folder, whose name may be `.`, or after that of a file."""
    whole = path.resolve()
    return (whole.parent if whole.is_file() else whole).name or "report"


def _why_not(folder: Folder) -> str:
    wrong: list[Item] = [item for item in folder.items if item.problem]
    return f"{wrong[0].name}: {wrong[0].problem}" if wrong else "name a folder that the other commands wrote into"
