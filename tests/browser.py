"""Reports driven in a real browser with the network off: what a person would do with one, and what they must see.

`python tests/browser.py report.html` checks a report by hand; without Chromium the tests are skipped, except where
`HRT_NEEDS_BROWSER` is set.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


def is_wanted() -> bool:
    """Whether the browser's tests can or must run."""
    return BROWSER is not None or bool(os.environ.get("HRT_NEEDS_BROWSER"))


@dataclass
class Opened:
    """A report in a browser: the page (of playwright), and what went wrong so far."""

    page: Any
    wrong: list[str] = field(default_factory=list)

    def data(self) -> dict[str, Any]:
        """What the page carries within it."""
        found: dict[str, Any] = json.loads(self.page.locator("#data").text_content())
        return found

    def settle(self) -> None:
        """Wait for two pictures to be drawn."""
        self.page.evaluate("() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))")

    def ink(self) -> list[int]:
        """Sums over red, green, blue and alpha of what the map's canvas shows."""
        script = """() => {
          const small = Object.assign(document.createElement("canvas"), { width: 320, height: 240 });
          const pen = small.getContext("2d", { willReadFrequently: true });
          pen.drawImage(document.querySelector(".frame canvas"), 0, 0, 320, 240);
          const all = pen.getImageData(0, 0, 320, 240).data;
          const sums = [0, 0, 0, 0];
          all.forEach((value, k) => { sums[k % 4] += value; });
          return sums;
        }"""
        self.settle()
        found: list[int] = self.page.evaluate(script)
        return found

    def place_of(self, selector: str) -> tuple[float, float]:
        """Where the middle of a mark on the map is, in pixels of the window."""
        script = """(selector) => {
          const box = document.querySelector(selector).getBoundingClientRect();
          return [box.x + box.width / 2, box.y + box.height / 2];
        }"""
        x, y = self.page.evaluate(script, selector)
        return x, y

    def tip(self) -> str:
        """What is told of what is pointed at."""
        return str(self.page.locator(".tip").inner_text())


@contextmanager
def opened(report: Path, *, width: int = 1280, height: int = 900, dark: bool = False) -> Iterator[Opened]:
    """Open a report with the network off; leaving, nothing may have gone wrong or been asked for."""
    from playwright.sync_api import sync_playwright

    assert BROWSER is not None, "no Chromium was found"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        scheme = "dark" if dark else "light"
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, offline=True)
        page = context.new_page()
        found = Opened(page)
        page.on("console", lambda message: found.wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: found.wrong.append(f"error: {error}"))
        page.on("request", lambda asked: _note_request(found, report, asked.url))
        page.goto(report.resolve().as_uri())
        page.wait_for_selector("html[data-ready]", timeout=60_000)
        found.settle()
        yield found
        browser.close()
    assert not found.wrong, found.wrong


def _note_request(found: Opened, report: Path, url: str) -> None:
    if url != report.resolve().as_uri() and not url.startswith("data:"):
        found.wrong.append(f"request: {url[:200]}")


def check_report(report: Path) -> None:
    """Do with a report what a person would: layers, waypoints, the drive, both themes, a desk and a tablet."""
    with opened(report) as shown:
        check_layers(shown)
        check_alignment(shown)
        check_waypoints(shown)
        check_player(shown)
        check_theme(shown)
    for width, dark in ((800, False), (800, True), (1280, True)):
        with opened(report, width=width, dark=dark) as shown:
            assert shown.page.evaluate("document.documentElement.scrollWidth") <= width
            assert sum(shown.ink()) > 0
            check_waypoints(shown, most=1)


def check_layers(shown: Opened) -> None:
    """Every layer shows when its box is checked and is gone when it is not."""
    boxes = shown.page.locator(".panel .entry:has(.swatch.layer) input[type=checkbox]")
    assert boxes.count() == len(shown.data()["sites"][0]["layers"]) > 0
    for k in range(boxes.count()):
        box = boxes.nth(k)
        first = shown.ink()
        box.click()
        second = shown.ink()
        title = box.evaluate("(box) => box.closest('.entry').innerText")
        assert second != first, f"{title} changes nothing"
        box.click()
        assert shown.ink() == first, f"{title} leaves something behind"


def check_waypoints(shown: Opened, most: int = 5) -> None:
    """Pointing at a waypoint tells its coordinates, and the place under the pointer is that place."""
    plans = shown.data()["sites"][0]["plans"]
    if not plans:
        return
    last = max(k for k, plan in enumerate(plans) if plan["shown"])
    plan, marks = plans[last], f".marks .plan:nth-of-type({last + 1})"
    for point in plan["waypoints"][:: max(1, len(plan["waypoints"]) // most)][:most]:
        # Waypoints may lie close together, or under the camera's picture: each is looked at from near.
        shown.page.locator(".frame").focus()
        shown.page.keyboard.press("0")
        shown.settle()
        for _ in range(6):
            x, y = shown.place_of(f'{marks} [data-waypoint="{point["index"]}"]')
            box = shown.page.locator(".frame").bounding_box()
            x, y = (
                min(max(x, box["x"] + 60), box["x"] + box["width"] - 20),
                min(max(y, box["y"] + 2), box["y"] + box["height"] - 2),
            )
            shown.page.mouse.move(x, y)
            shown.page.mouse.wheel(0, -400)
            shown.settle()
        x, y = shown.place_of(f'{marks} [data-waypoint="{point["index"]}"]')
        shown.page.mouse.move(x, y)
        said = shown.tip()
        assert f"waypoint {point['index'] + 1}" in said, said
        if point["lat"] is None:
            continue
        assert f"{point['lat']:.7f}, {point['lon']:.7f}" in said
        under = re.match(r"(-?[0-9.]+), (-?[0-9.]+)", shown.page.locator(".place").inner_text())
        assert under is not None
        off = math.hypot(float(under[1]) - point["lat"], float(under[2]) - point["lon"])
        assert off < 2e-6, f"the pointer is at {under[0]}, the waypoint at {point['lat']}, {point['lon']}"
    shown.page.locator(".frame").focus()
    shown.page.keyboard.press("0")
    shown.settle()


def check_alignment(shown: Opened) -> None:
    """Marks, lines and the ground under the pointer lie on one another to a pixel."""
    plans = shown.data()["sites"][0]["plans"]
    if not plans:
        return
    last = max(k for k, plan in enumerate(plans) if plan["shown"])
    start = plans[last]["waypoints"][0]
    x, y = shown.place_of(f".marks .plan:nth-of-type({last + 1}) .start")
    script = """(k) => {
      const line = document.querySelectorAll(".lines .plan")[k].querySelector(".line");
      const point = line.getPointAtLength(0).matrixTransform(line.getScreenCTM());
      return [point.x, point.y];
    }"""
    line_x, line_y = shown.page.evaluate(script, last)
    assert math.hypot(line_x - x, line_y - y) < 1.0, (x, y, line_x, line_y)
    if start["lat"] is None:
        return

    def under(at_x: float, at_y: float) -> tuple[float, float]:
        shown.page.mouse.move(at_x, at_y)
        lat, lon = shown.page.locator(".place").text_content().split("  ·  ")[0].split(", ")
        return float(lon), float(lat)

    (lon, lat), (east, _), (_, south) = under(x, y), under(x + 40, y), under(x, y + 40)
    assert abs(lon - start["lon"]) < 1.2 * abs(east - lon) / 40
    assert abs(lat - start["lat"]) < 1.2 * abs(south - lat) / 40


def check_player(shown: Opened) -> None:
    """The slider moves the robot along the drive; playing does too, and stops at the end."""
    drives = [drive for drive in shown.data()["sites"][0]["drives"] if drive["shown"]]
    slider = shown.page.locator("#player input[type=range]")
    if not drives:
        assert not slider.is_visible()
        return
    drive = drives[-1]
    to_screen = _screen_of(shown)
    for share in (0.0, 0.37, 1.0):
        time = share * drive["t"][-1]
        slider.evaluate("(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", time)
        shown.settle()
        x, y = shown.place_of(".robot circle")
        want_x, want_y = to_screen(_at(drive, "e", time), _at(drive, "n", time))
        assert math.hypot(x - want_x, y - want_y) < 1.5, (share, x, y, want_x, want_y)
        if drive["frames"]:
            at = max(k for k, frame in enumerate(drive["frames"]) if k == 0 or frame["t"] <= time + 1e-6)
            assert shown.page.locator(".camera img").get_attribute("src") == drive["frames"][at]["src"]
    shown.page.locator("#player .rate").select_option("60")
    shown.page.locator("#player .play").click()
    assert float(slider.input_value()) < drive["t"][-1]
    shown.page.wait_for_function(
        "(last) => +document.querySelector('#player input[type=range]').value >= Math.min(last, 3)", arg=drive["t"][-1]
    )
    # In one go: it may come to its end meanwhile.
    stop = "(button) => { if (button.getAttribute('aria-label') === 'pause') button.click(); }"
    shown.page.locator("#player .play").evaluate(stop)
    assert shown.page.locator("#player .play").get_attribute("aria-label") == "play"


def _screen_of(shown: Opened) -> Any:
    """The way from metres to the window's pixels, as three places of the robot tell it."""
    slider = shown.page.locator("#player input[type=range]")
    drive = [each for each in shown.data()["sites"][0]["drives"] if each["shown"]][-1]
    seen = []
    for k in {0, len(drive["t"]) // 3, len(drive["t"]) // 2, len(drive["t"]) - 1}:
        slider.evaluate("(s, value) => { s.value = value; s.dispatchEvent(new Event('input')); }", drive["t"][k])
        shown.settle()
        seen.append((drive["e"][k], drive["n"][k], *shown.place_of(".robot circle")))
    e, n, x, y = zip(*seen, strict=True)
    span = max(range(len(seen)), key=lambda k: math.hypot(e[k] - e[0], n[k] - n[0]))
    scale = math.hypot(x[span] - x[0], y[span] - y[0]) / math.hypot(e[span] - e[0], n[span] - n[0])
    return lambda east, north: (x[0] + scale * (east - e[0]), y[0] - scale * (north - n[0]))


def _at(drive: dict[str, Any], key: str, time: float) -> float:
    """A track's place at a time, between its records."""
    t, values = drive["t"], drive[key]
    after = next((k for k, each in enumerate(t) if each > time), len(t) - 1)
    before = max(0, after - 1)
    if t[after] <= time:
        return float(values[after])
    part = (time - t[before]) / (t[after] - t[before])
    return float(values[before] + part * (values[after] - values[before]))


def check_theme(shown: Opened) -> None:
    """The button turns light into dark and back."""
    ground = "() => getComputedStyle(document.body).backgroundColor"
    first = shown.page.evaluate(ground)
    shown.page.locator("#theme").click()
    assert shown.page.evaluate(ground) != first
    shown.page.locator("#theme").click()
    assert shown.page.evaluate(ground) == first


if __name__ == "__main__":
    for name in sys.argv[1:]:
        check_report(Path(name))
        print(f"{name}: layers, waypoints, player and themes work offline")
