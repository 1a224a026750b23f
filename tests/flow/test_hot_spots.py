"""With the thermal layer a plan visits what smoulders; without it, in the same budget, it passes by.

A hot spot is visited if the path comes within the sensor's radius of it, and counts if some cell to go that is
connected with the start does lie so near. The budget is 1.5 times the shortest tour from the start through the cells
nearest to those spots, for all plans compared.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.stage import Existing
from hrt_cli.drivability.interest import Interest
from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.planning.request import PlanRequest, Spending, Start, middle_of_largest_region
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.scoremap import Scoremap, read_scoremap
from hrt_cli.world.stage import synthesize
from hrt_cli.world.synth import SiteSpec

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")]

SEEDS = range(11, 19)
RADIUS_M = 2.0
SLACK = 1.5

Cell = tuple[int, int]


@dataclass(frozen=True)
class Site:
    """A burnt site, what is known of it, and the hot spots that can be reached."""

    folder: Path
    scores: Path
    start: Cell
    spots: NDArray[np.float64]
    budget: int

    def scoremap(self, name: str, interest: Interest | None = None) -> Path:
        return scoremap_of(self.folder, self.scores, name, interest)

    def visited(self, scoremap: Path) -> int:
        """Plan and count the spots whose distance from the path is within the radius."""
        output = scoremap.with_suffix(".json")
        request = PlanRequest((Start("cell", *self.start),), Spending(self.budget, "steps"))
        plan_file(scoremap, output, request, existing=Existing(overwrite=True))
        cells = np.array(read_plan(output).cells) + 0.5
        x, y = read_scoremap(scoremap).grid.xy(*cells.T)
        return sum(distance_to_path(np.stack([x, y], 1), spot) <= RADIUS_M for spot in self.spots)


def scoremap_of(folder: Path, scores: Path, name: str, interest: Interest | None = None) -> Path:
    output = folder / name
    make_scoremap(
        folder / "truth.tif",
        output,
        scores_path=scores,
        no_go_below=0.3,
        no_go_share=0.5,
        interest=interest,
        existing=Existing(overwrite=True),
    )
    return output


def distance_to_path(path: NDArray[np.float64], spot: NDArray[np.float64]) -> float:
    legs, there = np.diff(path, axis=0), spot - path[:-1]
    along = np.clip((legs * there).sum(1) / np.maximum((legs**2).sum(1), 1e-12), 0, 1)
    return float(np.hypot(*(path[:-1] + along[:, None] * legs - spot).T).min())


def steps_between(go: NDArray[np.bool_], stops: list[Cell]) -> NDArray[np.float64]:
    """Count the moves between stops on 4-connected ground."""
    index = np.full(go.shape, -1)
    index[go] = np.arange(go.sum())
    pairs = [(index[:, 1:], index[:, :-1]), (index[1:], index[:-1])]
    both = [np.stack([a, b])[:, (a >= 0) & (b >= 0)] for a, b in pairs]
    one, other = np.concatenate(both, axis=1)
    graph = coo_matrix((np.ones(one.size), (one, other)), (go.sum(), go.sum())).tocsr()
    at = [index[stop] for stop in stops]
    return dijkstra(graph, directed=False, unweighted=True, indices=at)[:, at]


def shortest_tour(steps: NDArray[np.float64]) -> float:
    """Return the length of the shortest way from the first stop through all others (Held and Karp 1962)."""
    n = len(steps) - 1
    best = {(1 << i, i): steps[0, i + 1] for i in range(n)}
    for visited in range(1, 1 << n):
        for last in range(n):
            here = best.get((visited, last))
            for then in range(n) if here is not None else ():
                if not visited >> then & 1:
                    key = (visited | 1 << then, then)
                    best[key] = min(best.get(key, np.inf), here + steps[last + 1, then + 1])
    return min(best[(1 << n) - 1, last] for last in range(n))


def reachable(plain: Scoremap, start: Cell, spots: list[tuple[float, float]]) -> tuple[list[Cell], NDArray[np.float64]]:
    labels, _ = ndimage.label(np.isfinite(plain.score))
    ground = np.argwhere(labels == labels[start])
    places = np.stack(plain.grid.xy(*(ground + 0.5).T), 1)
    stops, found = [], []
    for spot in spots:
        away = np.hypot(*(places - spot).T)
        if away.min() <= RADIUS_M:
            row, col = ground[away.argmin()]
            stops.append((int(row), int(col)))
            found.append(spot)
    return stops, np.array(found)


def burnt_site(folder: Path, seed: int, too_hot_c: float | None = None) -> Site:
    """Make a site; where a tenth of a cell is `too_hot_c` or hotter no robot may go."""
    synthesize(folder, SiteSpec("wildfire", (60.0, 60.0), 0.2, seed))
    world = json.loads((folder / "world.json").read_text())
    table = {k: each["drivability"] for k, each in world["classes"].items()}
    if too_hot_c is not None:
        table[str(len(table))] = 0.0
        embers(folder, len(table) - 1, too_hot_c)
    scores = folder / "scores.json"
    scores.write_text(json.dumps({"format": "hrt-scores", "version": 1, "scores": table}))
    plain = read_scoremap(scoremap_of(folder, scores, "plain.tif"))
    start = tuple(int(at) for at in plain.grid.rowcol(*world["start"]["xy"]))
    if not np.isfinite(plain.score[start]):
        start = middle_of_largest_region(plain.score)
    stops, spots = reachable(plain, start, [tuple(each["xy"]) for each in world["hotspots"]])
    tour = shortest_tour(steps_between(np.isfinite(plain.score), [start, *stops]))
    return Site(folder, scores, start, spots, round(SLACK * tour))


def embers(folder: Path, class_id: int, too_hot_c: float) -> None:
    """Make a class of what is too hot, a metre wide about it."""
    with rasterio.open(folder / "thermal.tif") as dataset:
        hot = ndimage.binary_dilation(dataset.read(1) >= too_hot_c, iterations=3)
    with rasterio.open(folder / "truth.tif") as dataset:
        classes, profile = dataset.read(1), dataset.profile
    classes[hot & (classes != 255)] = class_id
    plain = {key: profile[key] for key in ("width", "height", "count", "dtype", "crs", "transform", "nodata")}
    with rasterio.open(folder / "truth.tif", "w", driver="GTiff", **plain) as dataset:
        dataset.write(classes, 1)


def hot(site: Site, radius_m: float | None) -> Interest:
    return Interest(site.folder / "thermal.tif", (45.0, 90.0), units="celsius", radius_m=radius_m)


@pytest.mark.parametrize("seed", SEEDS)
def test_with_heat_the_plan_visits_the_hot_spots_and_without_it_misses_most(tmp_path: Path, seed: int) -> None:
    site = burnt_site(tmp_path, seed)
    assert len(site.spots) >= 5
    assert site.visited(site.scoremap("heat.tif", hot(site, RADIUS_M))) >= 0.95 * len(site.spots)
    assert site.visited(site.scoremap("plain.tif")) < 0.5 * len(site.spots)


def test_hot_spots_that_must_not_be_driven_over_are_visited_from_their_rims(tmp_path: Path) -> None:
    counted, by_radius, by_cell = 0, 0, 0
    for seed in range(1, 5):
        site = burnt_site(tmp_path / str(seed), seed, too_hot_c=60.0)
        counted += len(site.spots)
        by_radius += site.visited(site.scoremap("rim.tif", hot(site, RADIUS_M)))
        by_cell += site.visited(site.scoremap("cell.tif", hot(site, None)))
    assert by_radius >= 0.9 * counted
    assert by_cell < 0.8 * counted
