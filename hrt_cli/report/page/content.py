"""All that a page shows, as one document: maps, charts, tables, pictures, and where everything comes from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hrt_cli.artifacts.plan import read_plan, team_members
from hrt_cli.errors import HrtError, InputError
from hrt_cli.report.page import charts
from hrt_cli.report.page.collect import Folder, Item
from hrt_cli.report.page.drives import clearance_chart
from hrt_cli.report.page.lineage import lineage
from hrt_cli.report.page.pictures import webp
from hrt_cli.report.page.seen import Drives
from hrt_cli.report.page.sites import SiteMap, draw_site, find_sites
from hrt_cli.report.page.walks import reward_chart

MOST_CHARTS = 12
"""Of one kind; of more the last are shown."""
_TROUBLES = {"collisions": "collision", "stuck": "stall", "interventions": "intervention"}
_MOST_PICTURES, _PICTURE_PX, _PICTURE_QUALITY = 24, 1200, 80


@dataclass(frozen=True)
class Detail:
    """How much of everything goes into a page.

    Attributes
    ----------
    pixels : int
        Most rows and columns of a layer.
    frames : int
        Most camera frames, over all drives; 0 for none.
    """

    pixels: int = 2048
    frames: int = 240


WHOLE = Detail()
"""What fits into a few megabytes."""


@dataclass
class Page:
    """What a page shows.

    `charts` are drawn and `sites` played by the page's script; `plans`, `drives`, `facts`, `pictures`, `files` and
    `notes` stand in its tables.
    """

    title: str
    sites: list[SiteMap]
    charts: list[dict[str, Any]] = field(default_factory=list)
    plans: list[dict[str, Any]] = field(default_factory=list)
    drives: list[dict[str, Any]] = field(default_factory=list)
    facts: list[dict[str, str]] = field(default_factory=list)
    pictures: list[dict[str, Any]] = field(default_factory=list)
    files: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """Return what the script needs as JSON values."""
        return {"sites": [site.document() for site in self.sites], "charts": self.charts}

    @contextmanager
    def telling(self, item: Item) -> Iterator[None]:
        """Do something with an item; what is wrong with it is told on the page instead."""
        try:
            yield
        except (HrtError, ValueError) as error:
            self.notes.append(f"{item.name}: {str(error).removeprefix(f'{item.path}: ')}")


def compose(title: str, folder: Folder, world: Path | None, detail: Detail, tick: Callable[[], None]) -> Page:
    """Make a page of what a folder holds.

    Parameters
    ----------
    title : str
    folder : Folder
        Its items get a `problem` where they cannot be shown.
    world : Path or None
        The site that drives are seen on whose own site is not in the folder.
    detail : Detail
    tick : callable
        Called after each item.

    Raises
    ------
    InputError
        `world` is no site.
    """
    drives = Drives(folder, world)
    page = Page(title, find_sites(folder))
    for site in page.sites:
        draw_site(site, detail.pixels, tick)
    page.sites = [site for site in page.sites if site.layers or site.plans or site.drives]
    _show_plans(page, folder, tick)
    _show_drives(page, folder, drives, detail.frames, tick)
    _show_scores(page, folder)
    _show_learning(page, folder)
    _show_evaluations(page, folder)
    _show_pictures(page, folder)
    page.facts = _facts(page) + page.facts
    page.notes += folder.notes
    page.files = lineage(folder)
    return page


def _show_plans(page: Page, folder: Folder, tick: Callable[[], None]) -> None:
    items = folder.plans()
    for item in items:
        with page.telling(item):
            row = _plan_row(item)
            page.plans.append(row)
            if not row["length_m"] > 0:  # in rounds a robot may stay where it is
                continue
            scoremap = folder.input_of(item, "scoremap")
            if scoremap is None:
                page.notes.append(f"{item.name}: the scoremap that it was made from is not here: no reward curves")
            elif item in items[-MOST_CHARTS:]:
                chart, row["score"], row["fraction_of_bound"] = reward_chart(scoremap.path, item.path, item.name)
                page.charts.append(chart)
        tick()


def _plan_row(item: Item) -> dict[str, Any]:
    members = [read_plan(path) for path in team_members(item.path) or [item.path]]
    return {
        "name": item.name,
        "method": members[0].method,
        "robots": len(members),
        "score": sum(plan.score for plan in members),
        "length_m": sum(plan.length_m for plan in members),
        "time_s": max(plan.time_s for plan in members),
        "waypoints": sum(len(plan.waypoints) for plan in members),
        "fraction_of_bound": None,
    }


def _show_drives(page: Page, folder: Folder, drives: Drives, frames: int, tick: Callable[[], None]) -> None:
    tracks = {drive["name"]: drive for site in page.sites for drive in site.drives}
    items = [item for item in folder.of("drive log") if item.name in tracks]
    shown = items[-MOST_CHARTS:]
    for item in items:
        track = tracks[item.name]
        with page.telling(item):
            found = drives.measure(item)
            page.drives.append({"name": item.name} | asdict(found.total))
            chart = clearance_chart(item.name, found)
            if chart is not None and item in shown and found.total.distance_m > 0:
                page.charts.append(chart)
        if item in shown and frames:
            with page.telling(item):
                track["frames"], track["seen"] = drives.frames(item, frames // len(shown))
        tick()


def _show_scores(page: Page, folder: Folder) -> None:
    names = {
        entry["id"]: entry["label"]
        for site in page.sites
        for layer in site.layers
        if layer["group"] == "classes"
        for entry in layer["legend"]
    }
    learnt = [each for each in folder.of("score table") if each.provenance and each.provenance.stage == "feedback"]
    if not learnt:
        return
    last, before = learnt[-1], folder.input_of(learnt[0], "scores")
    title = last.name if len(learnt) == 1 else f"{learnt[0].name} to {last.name}"
    with page.telling(last):
        page.charts.append(charts.score_chart(last.path, title, before.path if before else None, names))
        if len(learnt) > 2:
            page.charts.append(charts.score_course([(each.name, each.path) for each in learnt], names))


def _show_learning(page: Page, folder: Folder) -> None:
    for item in folder.of("policy")[-MOST_CHARTS:]:
        with page.telling(item):
            page.charts.append(charts.policy_chart(item.path, item.name))
    models = folder.of("steering model")[-MOST_CHARTS:]
    for item in models:
        from hrt_cli.steering.network.model import read_training

        with page.telling(item):
            page.charts += charts.training_charts(item.name, (read_training(item.path) or {}).get("history", []))
    for item in [] if models else folder.of("training history")[-MOST_CHARTS:]:
        page.charts += charts.training_charts(item.name, item.document["epochs"])


def _show_evaluations(page: Page, folder: Folder) -> None:
    for item in folder.of("evaluation"):
        document = item.document
        if "reliability" in document:
            with page.telling(item):
                page.charts += charts.reliability_charts(item.name, document)
        elif "ari" in document:
            told = f"NMI {document['nmi']:.3f}, matched accuracy {document['accuracy']:.3f}, {item.name}"
            page.facts.append({"label": "ARI", "value": f"{document['ari']:.3f}", "detail": told})


def _show_pictures(page: Page, folder: Folder) -> None:
    for item in folder.of("figure")[-_MOST_PICTURES:]:
        with page.telling(item):
            image = cv2.imdecode(np.frombuffer(item.path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                raise InputError(item.path, "is no picture, or a damaged one")
            if image.shape[1] > _PICTURE_PX:
                size = (_PICTURE_PX, round(image.shape[0] * _PICTURE_PX / image.shape[1]))
                image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            source = webp(np.asarray(image[..., ::-1], np.uint8), _PICTURE_QUALITY)
            page.pictures.append({"name": item.name, "src": source, "rows": image.shape[0], "cols": image.shape[1]})


def _facts(page: Page) -> list[dict[str, str]]:
    """Return what stands out, of the last of each kind."""
    facts = []

    def tell(label: str, value: str, detail: str) -> None:
        facts.append({"label": label, "value": value, "detail": detail})

    if page.plans:
        plan = ([each for each in page.plans if each["length_m"] > 0] or page.plans)[-1]
        share = plan["fraction_of_bound"]
        bound = "" if share is None else f"{share:.1%} of the best possible, "
        tell("score planned", f"{plan['score']:.1f}", f"{bound}{plan['length_m']:.0f} m, {plan['name']}")
    going = [drive for drive in page.drives if drive["distance_m"] > 0]
    if going:
        which = going[0]["name"] if len(going) == 1 else f"{len(going)} drives"
        minutes, seconds = divmod(round(sum(drive["duration_s"] for drive in going)), 60)
        tell("driven", f"{sum(drive['distance_m'] for drive in going):.0f} m", f"in {minutes} min {seconds} s, {which}")
        troubles = {word: sum(each[key] for each in going) for key, word in _TROUBLES.items()}
        told = ", ".join(f"{count} {word}{'s' * (count != 1)}" for word, count in troubles.items())
        tell("troubles logged", str(sum(troubles.values())), told)
        last = going[-1]
        if last["score_collected"] is not None:
            tell("score collected", f"{last['score_collected']:.1f}", f"on the way, {last['name']}")
        clearances = [each["min_clearance_m"] for each in going if each["min_clearance_m"] is not None]
        if clearances:
            tell(
                "least clearance",
                f"{min(clearances):.2f} m",
                f"from the robot's rim to an obstacle, by the places logged, {which}",
            )
    return facts
