from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from conftest import ArraySource, patchwork
from gabor_reference import photograph, reference
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, map_coordinates

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.windows import Window
from hrt_cli.texture import measure
from hrt_cli.texture.lattice import gaussian_taps
from hrt_cli.texture.measure import COLOUR, SHARE, TEXTURE, Gauge
from hrt_cli.texture.segment import NODATA, SegmentSpec
from hrt_cli.texture.settings import FeatureSettings

F64 = NDArray[np.float64]
LUMA = np.array([0.299, 0.587, 0.114])


def ragged(rows: int, cols: int, seed: int) -> ArraySource:
    """A textured image with a hole, a ragged edge and single pixels that are not valid."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols]
    valid = (np.hypot(y - rows / 2, x - cols / 3) > min(rows, cols) / 6) & (x > 4 + 3 * np.sin(y / 5))
    valid &= rng.random((rows, cols)) > 0.02
    light = 110 + 30 * photograph(max(rows, cols, 8), seed)[:rows, :cols, None]
    rgb = light * [1.0, 0.9, 0.8] + 8 * rng.normal(size=(rows, cols, 3))
    return ArraySource(np.clip(rgb, 0, 255).astype(np.uint8), valid, anchor=(5, 1003))


def directional(
    source: ArraySource, wavelengths_px: tuple[float, ...], features: str = "paper", step_px: int = 8, **options: float
) -> FeatureSettings:
    """Settings under which every orientation is kept apart; lengths in pixels."""
    ground = max(source.pixel_m)
    wavelengths_m = tuple(px * ground for px in wavelengths_px)
    settings_ = SegmentSpec(2, features, "aware", wavelengths_m).settings(source.pixel_m)
    metres = {name: px * ground for name, px in options.items()}
    return replace(settings_, orientations=6, step_m=step_px * ground, **metres)


def swept(
    source: ArraySource, gauge: Gauge, rows_px: int = 4096, cuts: list[int] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Cells and valid pixels of an image; checks that the parts meet and do not overlap."""
    grid = gauge.grid(source)
    cells = np.full((grid.rows, grid.cols, gauge.channels), np.nan, np.float32)
    valid = np.zeros(source.shape, bool)
    cells_seen, pixels_seen = np.zeros(cells.shape[:2], int), np.zeros(source.shape, int)
    for rows in itertools.pairwise([grid.row, *(grid.row + cut for cut in cuts or []), grid.row + grid.rows]):
        for part in gauge.sweep(source, rows, rows_px):
            place = Window(part.grid.row - grid.row, part.grid.col - grid.col, part.grid.rows, part.grid.cols).slices
            assert part.cells.shape == cells[place].shape
            cells[place] = part.cells
            cells_seen[place] += 1
            shape = (part.window.height, part.window.width)
            bits = np.zeros(shape, np.uint8)
            if part.invalid is not None:
                bits = np.unpackbits(part.invalid, axis=1)[:, : shape[1]]
            assert bits.shape == shape
            assert part.valid_pixels == bits.size - bits.sum()
            valid[part.window.slices] = bits == 0
            pixels_seen[part.window.slices] += 1
    assert (cells_seen == 1).all()
    assert (pixels_seen == 1).all()
    return cells, valid


def expected_cells(source: ArraySource, gauge: Gauge, sampled: bool) -> F64:
    """The measures in double precision, [rows, cols, channels].

    Amplitudes are averaged over all pixels of a cell, or with `sampled` over those that the gauge looks at.
    """
    step, grid = gauge.step_px, gauge.grid(source)
    margin = 12
    wide = grid.grown(margin, margin)
    planes, valid = source.read_planes(wide.window(source.anchor))

    def per_cell(values: F64) -> F64:
        blocks = values.reshape(values.shape[0], wide.rows, step, wide.cols, step)
        return np.asarray(blocks.sum(axis=(2, 4)))

    inside = valid.astype(np.float64)
    count = per_cell(inside[None])[0]
    mean = per_cell(planes * inside) / np.maximum(count, 1)
    share = count / step**2
    taps = [gaussian_taps(gauge.settings.contrast_sigma_m / (d * step)).astype(np.float64) for d in source.pixel_m]

    def blurred(values: F64) -> F64:
        for axis, one in enumerate(taps):
            values = correlate1d(values, np.concatenate([one[:0:-1], one]), axis=axis, mode="constant")
        return values

    weight = blurred(share)
    local = np.where(weight > 1e-12, blurred(np.tensordot(LUMA, mean, 1) * share) / np.maximum(weight, 1e-12), 0)
    y, x = np.mgrid[: wide.rows * step, : wide.cols * step]
    # 8 is added to both, and what is interpolated is the factor.
    factor = map_coordinates(1 / (local + 8), [(y + 0.5) / step - 0.5, (x + 0.5) / step - 0.5], order=1, mode="nearest")
    relative = ((np.tensordot(LUMA, planes.astype(np.float64), 1) + 8) * factor - 1) * inside
    channels = [*mean, share]
    for one, wavelength_m in zip(gauge.filters, gauge.settings.wavelengths_m, strict=True):
        answer = reference(relative, wavelength_m, gauge.settings.orientations, source.pixel_m)
        if sampled:
            assert one.level == 0
            answer = answer[:, :: one.stride, :: one.stride]
        side = answer.shape[1] // wide.rows
        blocks = answer.reshape(len(answer), wide.rows, side, wide.cols, side)
        channels += list(np.log(blocks.mean(axis=(2, 4)) + 1e-3))
    return np.stack(channels, axis=-1)[margin:-margin, margin:-margin]


@pytest.mark.parametrize("features", ["paper", "texture"])
@pytest.mark.parametrize(("pixel_m", "step_px"), [((1.0, 1.0), 8), ((0.05, 0.04), 4), ((0.03, 0.05), 16)])
def test_the_finest_wavelength_agrees_with_the_definition(
    pixel_m: tuple[float, float], step_px: int, features: str
) -> None:
    source = ragged(130, 110, 1)
    source.pixel_m = pixel_m
    gauge = Gauge(directional(source, (4.0,), features, step_px), pixel_m)
    got, valid = swept(source, gauge)
    assert gauge.step_px == step_px
    assert source.valid is not None
    assert np.array_equal(valid, source.valid)
    expected = expected_cells(source, gauge, sampled=True)
    known = got[..., SHARE] > 0
    assert 0.8 < known.mean() < 1
    # Only single precision tells them apart.
    assert got[..., SHARE] == pytest.approx(expected[..., SHARE], abs=1e-6)
    assert got[..., COLOUR] == pytest.approx(expected[..., COLOUR], abs=1e-4)
    assert np.abs(got - expected)[known][:, TEXTURE].max() < 2e-5


# Amplitudes a cell along a side, from the finest wavelength on: 2, 1, 1, 1 and 4, 2, 1, 1.
@pytest.mark.parametrize(
    ("features", "noise"), [("paper", [0.25, 0.52, 0.27, 0.08]), ("texture", [0.08, 0.15, 0.27, 0.08])]
)
def test_the_pyramid_comes_near_the_definition(features: str, noise: list[float]) -> None:
    source = ragged(260, 250, 2)
    gauge = Gauge(directional(source, (4.0, 8.0, 16.0, 32.0), features), source.pixel_m)
    assert [one.level for one in gauge.filters] == [0, 1, 2, 3]
    got, expected = swept(source, gauge)[0], expected_cells(source, gauge, sampled=False)
    known = got[..., SHARE] > 0
    off = (got - expected)[known][:, TEXTURE].reshape(-1, 4, 6)
    # Sparse samples are noise from cell to cell, and halving folds a few per cent; of the mean there is little.
    assert (np.sqrt((off**2).mean(axis=(0, 2))) < noise).all()
    assert (np.abs(off.mean(axis=0)).max(axis=1) < [0.05, 0.15, 0.08, 0.05]).all()


def test_of_a_site_the_mean_over_orientations_is_kept() -> None:
    source = ragged(120, 130, 3)
    each = Gauge(directional(source, (4.0, 8.0)), source.pixel_m)
    one = Gauge(replace(each.settings, features="site", rotation="invariant"), source.pixel_m)
    assert (one.channels, each.channels) == (6, 16)
    mean, apart = swept(source, one)[0], swept(source, each)[0]
    assert np.array_equal(mean[..., : TEXTURE.start], apart[..., : TEXTURE.start])
    assert mean[..., TEXTURE] == pytest.approx(
        apart[..., TEXTURE].reshape(*mean.shape[:2], 2, 6).mean(axis=3), abs=1e-5
    )


cut_lists = st.lists(st.floats(0, 1), max_size=3)


@settings(max_examples=40)
@given(
    st.integers(0, 99), st.integers(1, 140), st.integers(1, 170), st.tuples(st.integers(0, 99), st.integers(0, 9999)),
    st.sampled_from([2, 4, 8, 16]), st.integers(16, 200), st.integers(4, 30), st.integers(20, 200), cut_lists,
)  # fmt: skip
def test_the_cells_do_not_depend_on_how_the_sweep_is_cut(
    seed: int, rows: int, cols: int, anchor: tuple[int, int], step_px: int, rows_px: int, columns: int,
    stripe: int, cuts: list[float],
) -> None:  # fmt: skip
    source = ragged(rows, cols, seed)
    source.anchor = anchor
    gauge = Gauge(directional(source, (4.0, 9.0), step_px=step_px, contrast_sigma_m=8.0), source.pixel_m)
    expected, valid = swept(source, gauge)
    assert np.array_equal(valid, source.valid)
    assert np.isfinite(expected).all()
    whole_rows = sorted(int(cut * gauge.grid(source).rows) for cut in cuts)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "_COLUMNS_PX", 8 * columns)
        patch.setattr(measure, "_STRIPE_PX", stripe)
        again, valid = swept(source, gauge, rows_px, whole_rows)
    assert np.array_equal(again, expected)
    assert np.array_equal(valid, source.valid)


@settings(max_examples=20)
@given(st.integers(0, 99), st.integers(0, 90), st.integers(0, 90), st.integers(0, 5), st.integers(0, 5))
def test_a_crop_with_its_anchor_has_the_cells_of_the_whole(seed: int, top: int, left: int, down: int, on: int) -> None:
    whole = ragged(230, 240, seed)
    assert whole.valid is not None
    gauge = Gauge(directional(whole, (4.0, 8.0)), whole.pixel_m)
    step, (reach_r, reach_c) = gauge.step_px, gauge.reach_cells
    # A lattice that starts whole cells later is the same lattice.
    anchor = (whole.anchor[0] + top + down * step, whole.anchor[1] + left + on * step)
    crop = ArraySource(whole.rgb[top:, left:], whole.valid[top:, left:], anchor=anchor)
    first, grid = gauge.grid(whole), gauge.grid(crop)
    row, col = grid.row - down - first.row, grid.col - on - first.col
    part, expected = swept(crop, gauge, 64)[0], swept(whole, gauge)[0]
    assert np.array_equal(part[reach_r:, reach_c:], expected[row + reach_r :, col + reach_c :])


@pytest.mark.parametrize("fill", [0, 255])
def test_what_is_masked_has_no_influence(fill: int) -> None:
    source = ragged(150, 140, 4)
    assert source.valid is not None
    gauge = Gauge(directional(source, (4.0, 8.0, 16.0)), source.pixel_m)
    expected, _ = swept(source, gauge)
    rgb = source.rgb.copy()
    rgb[~source.valid] = fill
    again, _ = swept(ArraySource(rgb, source.valid, anchor=source.anchor), gauge)
    assert np.array_equal(again, expected)


def test_cells_beyond_reach_do_not_count_and_those_within_do() -> None:
    source = ragged(200, 200, 5)
    source.anchor = (0, 0)
    assert source.valid is not None
    source.valid[:] = True
    gauge = Gauge(directional(source, (4.0, 8.0)), source.pixel_m)
    expected, _ = swept(source, gauge)
    source.rgb = source.rgb.copy()
    source.rgb[96:104, 96:104] = np.random.default_rng(0).integers(0, 256, (8, 8, 3))
    changed = (swept(source, gauge)[0] != expected).any(axis=2)
    rows, cols = np.nonzero(changed)
    assert changed[12, 12]
    assert 2 <= np.abs(rows - 12).max() <= gauge.reach_cells[0]
    assert 2 <= np.abs(cols - 12).max() <= gauge.reach_cells[1]


@pytest.mark.parametrize("columns", [48, 2048])
def test_a_sweep_reads_every_pixel_once(monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    monkeypatch.setattr(measure, "_COLUMNS_PX", columns)
    source = ragged(150, 180, 6)
    gauge = Gauge(directional(source, (4.0, 8.0, 16.0)), source.pixel_m)
    swept(source, gauge, rows_px=40)
    reads = np.zeros(source.shape, int)
    for window in source.windows:
        reads[window.clipped(source.shape).slices] += 1
    assert (reads == 1).all()


def test_a_reach_wider_than_what_is_measured_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    source = ragged(100, 330, 8)
    whole = source.model(SegmentSpec(3, wavelengths_m=(4.0, 80.0)))
    monkeypatch.setattr(measure, "_COLUMNS_PX", 64)
    again = source.model(SegmentSpec(3, wavelengths_m=(4.0, 80.0)), rows_px=64)
    assert np.array_equal(again.centroids, whole.centroids)


def test_where_no_pixel_is_valid_all_is_zero() -> None:
    source = ragged(100, 100, 7)
    source.valid = np.zeros(source.shape, bool)
    gauge = Gauge(directional(source, (4.0,)), source.pixel_m)
    cells, valid = swept(source, gauge)
    assert not cells.any()
    assert not valid.any()


@pytest.mark.parametrize(("pixels", "classified"), [(31, False), (32, True)])
def test_a_patch_less_than_half_valid_has_no_class(pixels: int, classified: bool) -> None:
    source = ArraySource(patchwork(200, 200))
    model = source.model(SegmentSpec(4))
    cell = np.arange(64).reshape(8, 8) < pixels
    source.valid = np.zeros(source.shape, bool)
    source.valid[16:24, 16:24] = cell
    source.valid[150:, 150:] = True
    classes, _ = source.classes(model)
    assert ((classes[16:24, 16:24] != NODATA) == (cell & classified)).all()


@pytest.mark.parametrize(
    ("pixel_m", "step_m", "step_px"),
    [((0.1, 0.1), 0.8, 8), ((0.1, 0.05), 0.8, 8), ((0.1, 0.1), 1.1, 8), ((0.1, 0.1), 1.2, 16), ((0.1, 0.1), 99.0, 32)],
)
def test_cells_are_a_power_of_two_of_pixels(pixel_m: tuple[float, float], step_m: float, step_px: int) -> None:
    found = SegmentSpec(2).settings(pixel_m)
    assert Gauge(FeatureSettings(**{**vars(found), "step_m": step_m}), pixel_m).step_px == step_px


def test_wavelengths_that_the_pixels_cannot_show_are_refused() -> None:
    fitted = SegmentSpec(2).settings((0.1, 0.1))
    for pixel_m in [(0.1, 0.1), (0.16, 0.16), (0.01, 0.16), (0.00625, 0.00625)]:
        Gauge(fitted, pixel_m)
    for pixel_m in [(0.1601, 0.1), (0.05, 0.17)]:
        with pytest.raises(ArgumentError, match=r"wavelength 0\.4 m is 2\.\d pixels .* but 2\.5 pixels are needed"):
            Gauge(fitted, pixel_m)
    with pytest.raises(ArgumentError, match=r"wavelength 3\.2 m is 533 pixels .* more than 512"):
        Gauge(fitted, (0.006, 0.1))
