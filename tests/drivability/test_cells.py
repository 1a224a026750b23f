from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS

from hrt_cli.artifacts.scores import ClassScore
from hrt_cli.drivability import cells
from hrt_cli.drivability.cells import Cover, cover, score_cells
from hrt_cli.errors import ArgumentError
from hrt_cli.main import cli
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.windows import Window

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

QUICK = settings(deadline=None, max_examples=60)


def pixels(rows: int, cols: int) -> Grid:
    """Return a grid without a CRS, of which a pixel measures one metre."""
    return Grid(rows, cols, Affine(1, 0, 0, 0, -1, 0), None)


def cover_of(classes: np.ndarray, cell_m: float, grid: Grid | None = None) -> Cover:
    return cover(grid or pixels(*classes.shape), lambda window: classes[window.slices], cell_m)


def by_hand(classes: np.ndarray, cell_px: float) -> dict[tuple[int, int, int], int]:
    """Count pixel by pixel: {(class, cell row, cell column): pixels}; a last cell of less than half is left out."""
    rows, cols = (max(1, math.floor(side / cell_px + 0.5)) for side in classes.shape)
    counts: dict[tuple[int, int, int], int] = {}
    for row in range(classes.shape[0]):
        for col in range(classes.shape[1]):
            if classes[row, col] != 255:
                cell = int((row + 0.5) / cell_px), int((col + 0.5) / cell_px)
                key = (int(classes[row, col]), *cell)
                if cell[0] < rows and cell[1] < cols:
                    counts[key] = counts.get(key, 0) + 1
    return counts


def as_counts(covered: Cover) -> dict[tuple[int, int, int], int]:
    return {tuple(map(int, at)): int(covered.counts[tuple(at)]) for at in np.argwhere(covered.counts)}


sides = st.integers(1, 40)


@QUICK
@given(sides, sides, st.floats(1, 50), st.integers(0, 2**32 - 1), st.sampled_from([2, 5, 255]))
def test_every_pixel_is_counted_in_the_cell_of_its_middle(
    rows: int, cols: int, cell: float, seed: int, classes: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, classes, (rows, cols)).astype(np.uint8)
    values[rng.random((rows, cols)) < 0.3] = 255
    covered = cover_of(values, cell)
    assert as_counts(covered) == by_hand(values, cell)
    assert covered.pixels_per_cell == pytest.approx(cell * cell)
    assert covered.counts.shape[1:] == covered.grid.shape
    assert covered.classes == sorted({k for k, _, _ in by_hand(values, cell)})


@pytest.mark.parametrize("budget_px", [1, 7 * 33, 2**24])
def test_it_does_not_matter_how_many_rows_are_read_at_once(monkeypatch: pytest.MonkeyPatch, budget_px: int) -> None:
    rng = np.random.default_rng(3)
    values = rng.integers(0, 4, (50, 33)).astype(np.uint8)
    values[30:, :] += 3  # a class that comes up late
    values[:5] = 255  # a first band of nothing
    windows: list[Window] = []

    def read(window: Window) -> np.ndarray:
        windows.append(window)
        return values[window.slices]

    monkeypatch.setattr(cells, "_BAND_PX", budget_px)
    covered = cover(pixels(50, 33), read, 3.7)
    assert as_counts(covered) == by_hand(values, 3.7)
    assert sum(window.height for window in windows) == 50
    assert all(window.height * window.width <= max(budget_px, 33) for window in windows)


def test_cells_are_metres_of_ground() -> None:
    # UTM metres are 1/0.9996 m of ground here; pixels of 0.1 m by 0.2 m: a cell of 1 m is 10 columns by 5 rows.
    grid = Grid(20, 40, Affine(0.09996, 0, 500_000, 0, -0.19992, 5_000_000), CRS.from_epsg(32633))
    covered = cover_of(np.zeros((20, 40), np.uint8), 1.0, grid)
    assert covered.grid.shape == (4, 4)
    assert (covered.counts == 50).all()
    assert covered.pixels_per_cell == pytest.approx(50, rel=1e-4)


def test_progress_comes_to_its_end() -> None:
    seen: list[tuple[int, int]] = []
    values = np.zeros((1200, 3), np.uint8)
    cover(pixels(1200, 3), lambda w: values[w.slices], 5, lambda done, total: seen.append((done, total)))
    assert seen == [(512, 1200), (1024, 1200), (1200, 1200)]


def test_a_raster_of_nothing_has_no_class() -> None:
    covered = cover_of(np.full((9, 9), 255, np.uint8), 3)
    assert covered.classes == []
    score, sd = score_cells(covered, {})
    assert np.isnan(score).all()
    assert np.isnan(sd).all()


def test_a_cell_smaller_than_a_pixel_is_refused() -> None:
    values = np.zeros((9, 9), np.uint8)
    with pytest.raises(ArgumentError, match="smaller than a pixel of 1 m"):
        cover_of(values, 0.99)
    oblong = Grid(9, 9, Affine(0.1, 0, 500_000, 0, -0.2, 5_000_000), CRS.from_epsg(32633))
    with pytest.raises(ArgumentError, match=r"smaller than a pixel of 0\.2 m"):
        cover_of(values, 0.15, oblong)
    assert cover_of(values, 1.0).grid.shape == (9, 9)


def test_too_many_cells_are_refused_unread() -> None:
    def read(window: Window) -> np.ndarray:
        raise AssertionError("nothing should be read")

    with pytest.raises(ArgumentError, match="5000 x 5000 cells; use larger ones"):
        cover(pixels(5000, 5000), read, 1.0)


@pytest.mark.parametrize("cell", [1e9, 1e300])
def test_one_cell_may_hold_all(cell: float) -> None:
    covered = cover_of(np.zeros((9, 9), np.uint8), cell)
    assert covered.grid.shape == (1, 1)
    assert covered.counts.tolist() == [[[81]]]
    assert np.isnan(score_cells(covered, {0: ClassScore(1, 1)})[0]).all()


SCORES = {0: ClassScore(9, 1), 1: ClassScore(2, 6), 7: ClassScore(1, 1)}


class TestScores:
    def test_a_cell_has_the_mean_of_the_ground_in_it(self) -> None:
        # One cell of 4 x 4: 8 pixels of class 0, 4 of class 1, 4 of none.
        values = np.array([[0] * 4, [0] * 4, [1] * 4, [255] * 4], np.uint8)
        score, sd = score_cells(cover_of(values, 4), SCORES)
        assert score.dtype == sd.dtype == np.float32
        assert score[0, 0] == pytest.approx(2 / 3 * 0.9 + 1 / 3 * 0.25)
        variances = 9 * 1 / (10**2 * 11), 2 * 6 / (8**2 * 9)
        assert sd[0, 0] == pytest.approx(math.sqrt((2 / 3) ** 2 * variances[0] + (1 / 3) ** 2 * variances[1]))

    def test_a_cell_of_one_class_has_its_score(self) -> None:
        values = np.kron([[0, 1], [7, 0]], np.ones((3, 3))).astype(np.uint8)
        score, sd = score_cells(cover_of(values, 3), SCORES)
        np.testing.assert_allclose(score, [[0.9, 0.25], [0.5, 0.9]], rtol=1e-6)
        np.testing.assert_allclose(sd[1, 0], math.sqrt(1 / 12), rtol=1e-6)

    @pytest.mark.parametrize(("seen", "enters"), [(16, True), (8, True), (7, False), (0, False)])
    def test_half_of_a_cell_must_be_seen(self, seen: int, enters: bool) -> None:
        values = np.full(16, 255, np.uint8)
        values[:seen] = 1
        score, sd = score_cells(cover_of(values.reshape(4, 4), 4), SCORES)
        assert np.isfinite(score[0, 0]) == enters
        assert np.isfinite(sd[0, 0]) == enters

    def test_what_lies_beyond_the_edge_was_not_seen(self) -> None:
        score, _ = score_cells(cover_of(np.zeros((4, 4 + 1), np.uint8), 4), SCORES)
        assert np.isfinite(score).tolist() == [[True]]
        score, _ = score_cells(cover_of(np.zeros((4, 4 + 2), np.uint8), 4), SCORES)
        assert np.isfinite(score).tolist() == [[True, True]]

    def test_exploring_adds_doubt_to_the_score(self) -> None:
        values = np.array([[0, 1, 7]], np.uint8)
        plain, sd = score_cells(cover_of(values, 1), SCORES)
        bold, same_sd = score_cells(cover_of(values, 1), SCORES, explore=2.0)
        np.testing.assert_allclose(bold, plain + 2 * sd, rtol=1e-6)
        np.testing.assert_array_equal(same_sd, sd)

    def test_the_limit_is_on_the_score_before_exploring(self) -> None:
        values = np.array([[0, 1, 7]], np.uint8)
        score, sd = score_cells(cover_of(values, 1), SCORES, explore=5.0, no_go_below=0.5)
        assert np.isnan(score).tolist() == [[False, True, False]]
        assert np.isnan(sd).tolist() == [[False, True, False]]

    @pytest.mark.parametrize("percent", range(3, 99, 7))
    def test_a_limit_that_a_score_meets_lets_it_pass(self, percent: int) -> None:
        # Of ten classes that all score 0.3, the shares times 0.3 add up to 0.3 but for the last bits.
        scores = {k: ClassScore.expecting(percent / 100) for k in range(10)}
        values = np.random.default_rng(percent).integers(0, 10, (9, 9)).astype(np.uint8)
        score, _ = score_cells(cover_of(values, 9), scores, no_go_below=percent / 100)
        assert np.isfinite(score).all()
        score, _ = score_cells(cover_of(values, 9), scores, no_go_below=percent / 100 + 1e-6)
        assert np.isnan(score).all()


def scored(counts: list[list[int]], means: list[float], **options: float) -> np.ndarray:
    """Scores of a row of cells of which each class covers so many pixels out of their sum."""
    arrays = np.array(counts, np.int32).T[:, None, :]
    table = {k: ClassScore(alpha=100 * mean, beta=100 * (1 - mean), evidence_m=0.0) for k, mean in enumerate(means)}
    covered = Cover(arrays, float(arrays.sum(axis=0).max()), pixels(1, arrays.shape[2]))
    return score_cells(covered, table, **options)[0][0]


def test_a_cell_may_hold_only_so_much_of_what_is_no_go() -> None:
    counts = [[100, 0], [90, 10], [80, 20], [70, 30], [0, 100]]
    plain = scored(counts, [0.9, 0.1], no_go_below=0.3)
    np.testing.assert_array_equal(np.isnan(plain), [False, False, False, False, True])
    strict = scored(counts, [0.9, 0.1], no_go_below=0.3, no_go_share=0.2)
    np.testing.assert_array_equal(np.isnan(strict), [False, False, False, True, True])
    np.testing.assert_array_equal(strict[:3], plain[:3])
    none = scored(counts, [0.9, 0.1], no_go_below=0.3, no_go_share=0.0)
    np.testing.assert_array_equal(np.isnan(none), [False, True, True, True, True])


def test_several_classes_below_the_limit_count_together_and_one_at_it_does_not() -> None:
    counts = [[80, 10, 10, 0], [80, 0, 10, 10]]
    found = scored(counts, [0.9, 0.1, 0.2, 0.3], no_go_below=0.3, no_go_share=0.15)
    np.testing.assert_array_equal(np.isnan(found), [True, False])


def test_a_share_says_nothing_without_a_limit_and_exploration_opens_no_cell() -> None:
    counts = [[50, 50]]
    assert np.isfinite(scored(counts, [0.9, 0.0], no_go_share=0.0)).all()
    assert np.isnan(scored(counts, [0.9, 0.1], no_go_below=0.3, no_go_share=0.4, explore=50.0)).all()


@pytest.mark.parametrize("share", ["0.2", "0"])
def test_the_command_refuses_a_share_without_a_limit(tmp_path, share: str) -> None:
    words = ["scoremap", str(tmp_path / "c.tif"), "-o", str(tmp_path / "s.tif"), "--no-go-share", share]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2
    assert "--no-go-share says how much of a cell --no-go-below may hold for: give both" in done.stderr


def test_a_margin_keeps_away_from_no_go_cells_and_not_from_what_was_not_seen() -> None:
    counts = np.zeros((2, 7, 7), np.int32)
    counts[0] = 100
    counts[:, 3, 3] = 0, 100
    counts[:, 0, 0] = 0
    covered = Cover(counts, 100.0, Grid(7, 7, Affine(2, 0, 0, 0, -2, 0), None))
    scores = {0: ClassScore.expecting(0.9), 1: ClassScore.expecting(0.1)}
    rows, cols = np.mgrid[:7, :7]
    for margin_m in (0.0, 1.9, 2.0, 3.0, 4.5):
        score, _ = score_cells(covered, scores, no_go_below=0.3, margin_m=margin_m)
        # Without a CRS a pixel is a metre, whatever its transform says.
        expected = np.hypot(rows - 3, cols - 3) <= max(margin_m, 0.0) + 1e-9
        expected[0, 0] = True
        np.testing.assert_array_equal(np.isnan(score), expected)


def test_the_command_refuses_a_margin_without_a_limit(tmp_path) -> None:
    words = ["scoremap", str(tmp_path / "c.tif"), "-o", str(tmp_path / "s.tif"), "--margin", "1"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2
    assert "--margin keeps away from what --no-go-below, --keep-out or --aoi bars" in done.stderr
