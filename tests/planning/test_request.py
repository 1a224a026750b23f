from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rasterio.crs import CRS

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.problem import Budget
from hrt_cli.planning.request import (
    Spending,
    Start,
    budget_in_cells,
    middle_of_largest_region,
    parse_budget,
    parse_start,
    start_cell,
)
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap

UTM33 = CRS.from_epsg(32633)
ROWS, COLS = 30, 40
NORTH_UP = Affine(2.0, 0, 500_000.0, 0, -2.0, 5_400_000.0)
TURNED = Affine.translation(500_000.0, 5_400_000.0) @ Affine.rotation(30) @ Affine.scale(2.0, -2.0)

NOT_NUMBERS = ["nan", "inf", "-inf", "1_0", "x", "", " ", "1e", "0x1", "--1", "1 0", "\u0661", "1;2"]


def scoremap(transform: Affine = NORTH_UP, crs: CRS | None = UTM33) -> Scoremap:
    score = np.ones((ROWS, COLS), np.float32)
    return Scoremap(score, np.zeros_like(score), Grid(ROWS, COLS, transform, crs), 2.0)


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("auto", Start("auto")),
        ("cell:3,4", Start("cell", 3, 4)),
        (" cell: 3 , 4 ", Start("cell", 3, 4)),
        ("cell:-1,+2", Start("cell", -1, 2)),
        ("cell:3.0,1e1", Start("cell", 3, 10)),
        ("lonlat:15.5,48.25", Start("lonlat", 15.5, 48.25)),
        ("lonlat:-180,-90", Start("lonlat", -180, -90)),
        ("lonlat:.5,5.", Start("lonlat", 0.5, 5)),
        ("xy:500001.5,-2e6", Start("xy", 500001.5, -2e6)),
    ],
)
def test_starts_are_read(text: str, start: Start) -> None:
    assert parse_start(text) == start


@pytest.mark.parametrize(
    "text",
    [
        "",
        "automatic",
        "3,4",
        "cell",
        "cell:",
        "cell:3",
        "cell:3,",
        "cell:3,4,5",
        "cell:3;4",
        "cell:3.5,4",
        "cell:1e999,0",
        "Cell:3,4",
        "latlon:48,15",
        "lonlat:181,0",
        "lonlat:-180.0001,0",
        "lonlat:48.2,105.4",
        "lonlat:0,-90.1",
        "xy:1e999,0",
        "xy:1,2\nxy:3,4",
        *[f"{kind}:{number},0" for kind in ("cell", "lonlat", "xy") for number in NOT_NUMBERS],
        *[f"{kind}:0,{number}" for kind in ("cell", "lonlat", "xy") for number in NOT_NUMBERS],
    ],
)
def test_what_is_no_start_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match=r"^--start "):
        parse_start(text)


@pytest.mark.parametrize(
    ("text", "spending"),
    [
        ("250", Spending(250, "steps")),
        ("250 steps", Spending(250, "steps")),
        ("1step", Spending(1, "steps")),
        ("1e3", Spending(1000, "steps")),
        ("400m", Spending(400, "m")),
        ("400.5 m", Spending(400.5, "m")),
        ("+.5m", Spending(0.5, "m")),
        ("15min", Spending(15, "min")),
        (" 1.5 min ", Spending(1.5, "min")),
        ("1e9m", Spending(1e9, "m")),
    ],
)
def test_budgets_are_read(text: str, spending: Spending) -> None:
    assert parse_budget(text) == spending


@pytest.mark.parametrize(
    "text",
    [
        "0",
        "0m",
        "-0",
        "-1",
        "-5min",
        "2.5",
        "2.5steps",
        "1e308",
        "1e308m",
        "1e999",
        "1000000001",
        "m",
        "min",
        "10s",
        "10km",
        "10 minutes",
        "10M",
        "10m m",
        "10,5m",
        *NOT_NUMBERS,
        *[f"{number}m" for number in NOT_NUMBERS],
    ],
)
def test_what_is_no_budget_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match=r"^--budget "):
        parse_budget(text)


@settings(deadline=None)
@given(st.text("0123456789.eE+-_ naifmsteps:,", max_size=12))
def test_any_text_is_read_or_refused(text: str) -> None:
    for parse in (parse_budget, parse_start):
        try:
            found = parse(text)
        except ArgumentError as error:
            assert repr(text) in str(error)  # noqa: PT017 - that it may be refused is what is tested
        else:
            assert isinstance(found, Start) or 0 < found.value <= 1e9


def test_budgets_in_cells() -> None:
    assert budget_in_cells(Spending(250, "steps"), 0.5, 1.0) == Budget(250, 1.0)
    assert budget_in_cells(Spending(400, "m"), 0.5, 1.0) == Budget(800, math.sqrt(2))
    assert budget_in_cells(Spending(15, "min"), 0.5, 0.4) == Budget(720, math.sqrt(2))
    assert budget_in_cells(Spending(2, "m"), 2.0, 1.0).limit == 1


@pytest.mark.parametrize("spending", [Spending(1.9, "m"), Spending(0.01, "min"), Spending(1e-300, "m")])
def test_a_budget_that_does_not_reach_the_next_cell_is_refused(spending: Spending) -> None:
    with pytest.raises(ArgumentError, match=r"does not reach the next cell \(2 m away\)"):
        budget_in_cells(spending, 2.0, 1.0)


def test_a_mistyped_budget_is_refused() -> None:
    with pytest.raises(ArgumentError, match="check its unit"):
        budget_in_cells(Spending(1e9, "steps"), 2.0, 1.0)


@pytest.mark.parametrize("transform", [NORTH_UP, TURNED])
@settings(deadline=None)
@given(row=st.integers(0, ROWS - 1), col=st.integers(0, COLS - 1), within=st.tuples(*[st.floats(0.001, 0.999)] * 2))
def test_every_form_of_start_finds_the_cell(transform: Affine, row: int, col: int, within: tuple[float, float]) -> None:
    world = scoremap(transform)
    x, y = world.grid.xy(row + within[0], col + within[1])
    (lon,), (lat,) = world.grid.lonlat([x], [y])
    assert start_cell(parse_start(f"cell:{row},{col}"), world) == (row, col)
    assert start_cell(parse_start(f"xy:{float(x)!r},{float(y)!r}"), world) == (row, col)
    assert start_cell(parse_start(f"lonlat:{float(lon)!r},{float(lat)!r}"), world) == (row, col)


@pytest.mark.parametrize(
    "text",
    [
        f"cell:{ROWS},0",
        f"cell:0,{COLS}",
        "cell:-1,-1",
        "cell:-1,0",
        "cell:1e300,0",
        "xy:499999.9,5399999",
        "xy:500001,5400000.1",
        f"xy:{500_000 + 2 * COLS + 0.1},5399999",
        "xy:1e300,-1e300",
        "xy:0,0",
        "lonlat:15.0,48.0",
        "lonlat:105,45",
        "lonlat:-165,-89",
    ],
)
def test_a_start_off_the_map_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match=f"outside the map of {ROWS} x {COLS} cells|has no place"):
        start_cell(parse_start(text), scoremap())


def test_exchanged_coordinates_are_pointed_out() -> None:
    world = scoremap()
    (lon,), (lat,) = world.grid.lonlat(*[[float(v)] for v in world.grid.xy(15.5, 20.5)])
    with pytest.raises(ArgumentError, match="with longitude and latitude exchanged it would be inside"):
        start_cell(Start("lonlat", lat, lon), world)
    with pytest.raises(ArgumentError) as refusal:
        start_cell(Start("lonlat", lat + 1, lon), world)
    assert "exchanged" not in str(refusal.value)


@pytest.mark.parametrize("text", ["xy:3,4", "lonlat:15,48"])
def test_a_place_on_a_map_without_georeference_is_refused(text: str) -> None:
    plain = scoremap(Affine(2, 0, 0, 0, -2, 0), None)
    with pytest.raises(ArgumentError, match="has no georeference: give the start as cell:ROW,COL"):
        start_cell(parse_start(text), plain)
    assert start_cell(parse_start("cell:3,4"), plain) == (3, 4)


def deepest_by_hand(score: NDArray[np.float32]) -> tuple[int, int]:
    """The first cell that is farthest from the border of the largest 4-connected region, by brute force."""
    go = {(int(r), int(c)) for r, c in np.argwhere(~np.isnan(score))}
    regions = []
    left = set(go)
    while left:
        front = {min(left)}
        region: set[tuple[int, int]] = set()
        while front:
            region |= front
            steps = {(r + dr, c + dc) for r, c in front for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0))}
            front = steps & left - region
        regions.append(region)
        left -= region
    largest = max(regions, key=len)  # of equals the first, as they were found in reading order
    rows, cols = score.shape
    outside = [(r, c) for r in range(-1, rows + 1) for c in range(-1, cols + 1) if (r, c) not in largest]
    return max(sorted(largest), key=lambda cell: min(abs(cell[0] - r) + abs(cell[1] - c) for r, c in outside))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7), st.floats(0.1, 1.0))
def test_auto_is_the_deepest_cell_of_the_largest_region(seed: int, rows: int, cols: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    score = np.where(rng.random((rows, cols)) < share, 0.5, np.nan).astype(np.float32)
    if np.isnan(score).all():
        with pytest.raises(ArgumentError, match="no cell that may be entered"):
            middle_of_largest_region(score)
    else:
        found = middle_of_largest_region(score)
        assert found == deepest_by_hand(score)
        assert not np.isnan(score[found])


def test_auto_is_taken_from_the_map() -> None:
    world = scoremap()
    world.score[:, 20:] = np.nan
    assert start_cell(parse_start("auto"), world) == middle_of_largest_region(world.score)
