from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from conftest import ArraySource, patchwork
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.raster.windows import Window
from hrt_cli.texture import segment
from hrt_cli.texture.cells import measured
from hrt_cli.texture.model import describe
from hrt_cli.texture.segment import NODATA, SegmentSpec, halo_px, predict


@pytest.mark.parametrize("features", ["site", "paper", "texture"])
def test_the_answer_does_not_depend_on_blocks_workers_or_threads(site: ArraySource, features: str) -> None:
    spec = SegmentSpec(4, features=features)
    model = site.model(spec)
    expected, stats = site.classes(model, block_px=512)
    for block_px, workers in [(64, 2), (97, 1), (256, 3)]:
        again, same = site.classes(model, block_px=block_px, rows_px=block_px, workers=workers)
        assert np.array_equal(again, expected)
        assert same == stats
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        second = site.model(spec, rows_px=128, workers=2)
    finally:
        cv2.setNumThreads(threads)
    for name, array in model.to_arrays().items():
        assert np.array_equal(array, second.to_arrays()[name]), name


def test_pixels_that_are_not_square(site: ArraySource) -> None:
    model = site.model(SegmentSpec(4))
    expected, _ = site.classes(model)
    assert site.valid is not None
    wide = ArraySource(site.rgb.repeat(2, axis=1), site.valid.repeat(2, axis=1), (0.05, 0.025), (3, 5))
    classes, _ = wide.classes(model)
    assert (classes[:, ::2] == expected).mean() > 0.95
    assert np.array_equal(wide.classes(model, block_px=128, workers=2)[0], classes)
    own = wide.model(SegmentSpec(4))
    assert own.settings.wavelengths_m == pytest.approx((0.2, 0.4, 0.8, 1.6))


def test_the_sample_is_drawn_by_the_seed_alone(site: ArraySource, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment, "SAMPLE_TILE_PX", 64)
    monkeypatch.setattr(segment, "MAX_SAMPLE_TILES", 9)
    monkeypatch.setattr(segment, "MAX_SAMPLE", 300)
    one, two = (site.model(SegmentSpec(4), workers=workers) for workers in (1, 2))
    assert np.array_equal(one.centroids, two.centroids)
    assert not np.array_equal(one.mean, site.model(SegmentSpec(4, seed=1)).mean)


def test_every_invalid_pixel_and_no_other_is_nodata(site: ArraySource) -> None:
    classes, stats = site.classes(site.model(SegmentSpec(4)))
    assert site.valid is not None
    assert np.array_equal(classes == NODATA, ~site.valid)
    assert stats.valid_pixels == site.valid.sum() == sum(stats.class_pixels)
    assert stats.pixels == classes.size
    assert sum(stats.class_fractions) == pytest.approx(1)
    assert list(stats.class_pixels) == [int((classes == k).sum()) for k in range(4)]


def test_a_patch_less_than_half_valid_far_from_others_is_nodata(site: ArraySource) -> None:
    model = site.model(SegmentSpec(4))
    site.valid = np.zeros(site.shape, bool)
    site.valid[100:200, 100:200] = True
    site.valid[20, 20] = True
    classes, stats = site.classes(model)
    assert classes[20, 20] == NODATA
    assert stats.valid_pixels == 10_001
    assert sum(stats.class_pixels) == 10_000


def test_a_patchwork_is_told_apart_with_sharp_edges() -> None:
    source = ArraySource(patchwork(320, 320))
    classes, _ = source.classes(source.model(SegmentSpec(4)))
    quarters = [classes[:160, :160], classes[:160, 160:], classes[160:, :160], classes[160:, 160:]]
    votes = [int(np.bincount(one.ravel()).argmax()) for one in quarters]
    assert sorted(votes) == [0, 1, 2, 3]
    for one, vote in zip(quarters, votes, strict=True):
        assert (one[8:-8, 8:-8] == vote).mean() > 0.97


def test_a_crop_with_its_anchor_gets_the_classes_of_the_whole() -> None:
    whole = ArraySource(patchwork(420, 400), anchor=(5, 6))
    model = whole.model(SegmentSpec(4))
    classes, _ = whole.classes(model)
    top, left = 41, 33
    crop = ArraySource(whole.rgb[top:, left:], anchor=(5 + top, 6 + left))
    part, _ = crop.classes(model)
    halo_r, halo_c = halo_px(model.settings, whole.pixel_m)
    assert np.array_equal(part[halo_r:, halo_c:], classes[top + halo_r :, left + halo_c :])


def test_pixels_under_the_mask_do_not_matter(site: ArraySource) -> None:
    model = site.model(SegmentSpec(4))
    expected, _ = site.classes(model)
    assert site.valid is not None
    site.rgb = site.rgb.copy()
    site.rgb[~site.valid] = 255
    again = site.model(SegmentSpec(4))
    assert np.array_equal(again.centroids, model.centroids)
    assert np.array_equal(site.classes(again)[0], expected)


def test_seeds_and_canonical_order(site: ArraySource) -> None:
    one, two = (site.model(SegmentSpec(4, seed=seed)) for seed in (0, 1))
    light = one.mean_rgb @ np.array([0.299, 0.587, 0.114])
    assert (np.diff(light) > 0).all()
    assert np.allclose(one.mean_rgb, two.mean_rgb, atol=3)
    table = describe(one)
    assert [row["id"] for row in table] == [0, 1, 2, 3]
    assert sum(float(str(row["share"])) for row in table) == pytest.approx(1)


def test_grey_images_work(site: ArraySource) -> None:
    grey = site.rgb.mean(axis=2).astype(np.uint8)
    site.rgb = np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2))
    for features in ("site", "paper", "texture"):
        model = site.model(SegmentSpec(3, features=features))
        assert np.isfinite(model.centroids).all()


def test_other_resolution(site: ArraySource) -> None:
    model = site.model(SegmentSpec(4))
    twice = ArraySource(
        np.kron(site.rgb, np.ones((2, 2, 1), np.uint8)),
        np.kron(site.valid, np.ones((2, 2), bool)),
        pixel_m=(0.025, 0.025),
    )
    finer, _ = twice.classes(model)
    expected, _ = site.classes(model)
    assert (finer[::2, ::2] == expected).mean() > 0.9
    site.pixel_m = (0.1, 0.1)
    with pytest.raises(ArgumentError, match="pixels are needed"):
        site.classes(model)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (SegmentSpec(1), "2 to 255"),
        (SegmentSpec(256), "2 to 255"),
        (SegmentSpec(4, features="nose"), "feature set"),
        (SegmentSpec(4, rotation="up"), "rotation"),
        (SegmentSpec(4, wavelengths_m=(0.1,)), "pixels"),
        (SegmentSpec(4, wavelengths_m=()), "above 0"),
        (SegmentSpec(4, wavelengths_m=(float("nan"),)), "above 0"),
    ],
)
def test_specifications_out_of_range_are_refused(site: ArraySource, spec: SegmentSpec, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        site.model(spec)


def test_images_without_textures_are_refused() -> None:
    flat = np.full((100, 100, 3), 90, np.uint8)
    with pytest.raises(ArgumentError, match="one texture only"):
        ArraySource(flat).model(SegmentSpec(2))
    with pytest.raises(ArgumentError, match="no valid pixel"):
        ArraySource(flat, np.zeros((100, 100), bool)).model(SegmentSpec(2))
    few = patchwork(100, 100)[:16, :16]
    with pytest.raises(ArgumentError, match=r"only \d+ distinct textures, K=5 asked"):
        ArraySource(few).model(SegmentSpec(5))


def test_an_interruption_in_the_sink_ends_the_threads(site: ArraySource, monkeypatch: pytest.MonkeyPatch) -> None:
    model = site.model(SegmentSpec(2))
    blocks_worked_on: list[Window] = []
    classify = segment._classify

    def counted(*args: Any) -> NDArray[np.uint8]:
        blocks_worked_on.append(args[2])
        return classify(*args)

    monkeypatch.setattr(segment, "_classify", counted)

    def sink(window: Window, classes: NDArray[np.uint8]) -> None:
        raise KeyboardInterrupt

    with measured(site, model.settings) as cells, pytest.raises(KeyboardInterrupt):
        predict(cells, model, sink, block_px=32, workers=2)
    assert len(blocks_worked_on) < 30


def test_an_interruption_while_measuring_ends_the_threads(site: ArraySource) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    settings = SegmentSpec(2).settings(site.pixel_m)
    with (
        pytest.raises(KeyboardInterrupt),
        measured(site, settings, rows_px=64, workers=2, progress=interrupt),
    ):
        raise AssertionError("nothing may be done with cells that are not all measured")
    assert len(site.windows) < 8


@pytest.mark.parametrize("shape", [(1, 1), (5, 70), (70, 6)])
def test_slivers_are_classified(site: ArraySource, shape: tuple[int, int]) -> None:
    model = site.model(SegmentSpec(3))
    sliver = ArraySource(site.rgb[: shape[0], : shape[1]].copy(), pixel_m=site.pixel_m, anchor=(3, 2))
    classes, stats = sliver.classes(model)
    assert (classes < 3).sum() == sum(stats.class_pixels)
    if max(shape) > 1:
        assert (classes < 3).mean() > 0.9


def stripes(vertical: bool) -> NDArray[np.uint8]:
    y, x = np.mgrid[:256, :256]
    wave = 50 * np.sin(2 * np.pi * (x if vertical else y) / 8)
    noise = np.random.default_rng(5).normal(size=(256, 256))
    return np.repeat((120 + wave + 10 * noise)[..., None], 3, axis=2).astype(np.uint8)


def test_direction_counts_when_asked_and_only_then() -> None:
    noise = np.random.default_rng(6).normal(120, 30, (256, 256, 1)).clip(0, 255)
    parts = [stripes(True), stripes(False), np.repeat(noise, 3, axis=2).astype(np.uint8)]
    source = ArraySource(np.concatenate(parts, axis=1))
    for rotation, same in [("aware", False), ("invariant", True), ("sorted", True)]:
        model = source.model(SegmentSpec(2 if same else 3, features="texture", rotation=rotation))
        classes, _ = source.classes(model)
        votes = [int(np.bincount(classes[:, a : a + 200].ravel()).argmax()) for a in (28, 284, 540)]
        assert (votes[0] == votes[1]) == same, rotation
        assert votes[2] not in votes[:2]


def test_a_turned_image_gets_the_turned_classes() -> None:
    source = ArraySource(patchwork(320, 320))
    model = source.model(SegmentSpec(4))
    classes, _ = source.classes(model)
    turned, _ = ArraySource(np.rot90(source.rgb).copy()).classes(model)
    assert (turned == np.rot90(classes)).mean() > 0.98


def test_every_pixel_is_read_once_and_reads_stay_bounded() -> None:
    source = ArraySource(np.tile(patchwork(300, 64), (1, 90, 1)))
    source.model(SegmentSpec(2), rows_px=128)
    reads = np.zeros(source.shape, int)
    for window in source.windows:
        reads[window.clipped(source.shape).slices] += 1
    assert (reads == 1).all()
    assert max(window.width for window in source.windows) <= 3072
    assert max(window.height for window in source.windows) <= 400
