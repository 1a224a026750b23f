"""Whole sites: what every scene promises, and that the same specification gives the same bytes."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy import ndimage
from scipy.optimize import linear_sum_assignment
from sklearn.cluster import KMeans

from hrt_cli.errors import ArgumentError
from hrt_cli.world import synth
from hrt_cli.world.scenes import SCENES
from hrt_cli.world.survey import inside
from hrt_cli.world.synth import Site, SiteSpec, make_site

SIZE_M, PIXEL_M = (25.6, 32.0), 0.1


@pytest.fixture(scope="module", params=sorted(SCENES))
def site(request: pytest.FixtureRequest) -> Site:
    return make_site(SiteSpec(request.param, SIZE_M, PIXEL_M, seed=1))


def class_mask(site: Site, name: str) -> np.ndarray:
    return np.asarray(site.truth == site.class_names.index(name))


def test_shapes_types_and_ranges(site: Site) -> None:
    shape = site.spec.shape
    assert shape == (256, 320)
    assert (site.rgb.shape, site.rgb.dtype) == ((*shape, 3), np.uint8)
    assert (site.truth.shape, site.truth.dtype) == (shape, np.uint8)
    assert (site.dsm.shape, site.dsm.dtype) == (shape, np.float32)
    assert np.isfinite(site.dsm).all()
    assert len(site.class_names) == len(site.drivability) == len(site.obstacle)
    assert all(0.0 <= score <= 1.0 for score in site.drivability)
    np.testing.assert_array_equal(site.truth == 255, ~site.valid)
    assert site.truth[site.valid].max() == len(site.class_names) - 1
    assert not site.rgb[~site.valid].any()
    assert site.valid.mean() >= 0.93


def test_same_specification_same_bytes(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(synth, "_BAND_ROWS", 77)
    again = make_site(site.spec)
    for field in fields(Site):
        one, two = getattr(site, field.name), getattr(again, field.name)
        if isinstance(one, np.ndarray):
            assert one.tobytes() == two.tobytes(), field.name
        else:
            assert one == two, field.name


def test_another_seed_is_another_site(site: Site) -> None:
    other = make_site(SiteSpec(site.spec.scene, SIZE_M, PIXEL_M, seed=2))
    both = site.valid & other.valid
    assert (site.truth[both] != other.truth[both]).mean() > 0.3


def test_every_class_has_its_share_in_large_pieces(site: Site) -> None:
    shares = np.bincount(site.truth[site.valid], minlength=len(site.class_names)) / site.valid.sum()
    assert shares.min() >= 0.04
    tiny = 0
    for value in range(len(site.class_names)):
        pieces, _ = ndimage.label(site.truth == value)
        sizes = np.bincount(pieces.ravel())[1:]
        tiny += sizes[sizes < 0.0015 * site.truth.size].sum()
    assert tiny < 0.01 * site.truth.size


def test_start_is_safe_and_inside(site: Site) -> None:
    assert site.valid[site.start]
    value = site.truth[site.start]
    assert site.drivability[value] >= 0.9
    assert not site.obstacle[value]
    assert inside(synth.Frame(*site.spec.shape, PIXEL_M), site.aoi)[site.start]


def test_heights_follow_the_classes(site: Site) -> None:
    dsm = site.dsm.astype(float)
    spread = np.sqrt(ndimage.uniform_filter(dsm**2, 5) - ndimage.uniform_filter(dsm, 5) ** 2 + 1e-9)
    roughness = {
        name: np.median(spread[ndimage.binary_erosion(class_mask(site, name), iterations=3)])
        for name in site.class_names
    }
    if site.spec.scene == "reef":
        assert dsm.max() < 0.0
        assert dsm[class_mask(site, "channel")].mean() < dsm[class_mask(site, "sand")].mean() - 1.0
        assert roughness["coral"] > 3.0 * roughness["sand"]
        return
    assert roughness["rock"] > 2.0 * roughness["road"]
    assert roughness["road"] <= min(roughness["grass"], roughness["tree"])
    rise = dsm - ndimage.minimum_filter(dsm, round(6.0 / PIXEL_M))
    assert np.median(rise[class_mask(site, "tree")]) > 1.0
    if site.spec.scene == "meadow":
        water = class_mask(site, "water")
        assert np.ptp(dsm[water]) < 1e-5
        assert dsm[water].max() < dsm[site.valid & ~water].min()


def test_thermal_layer_belongs_to_the_wildfire(site: Site) -> None:
    if site.spec.scene != "wildfire":
        assert site.thermal_c is None
        assert site.hotspots == ()
        return
    assert site.thermal_c is not None
    assert 6 <= len(site.hotspots) <= 12
    assert site.thermal_c.shape == site.spec.shape
    assert site.thermal_c.min() > 10.0
    for spot in site.hotspots:
        assert site.class_names[site.truth[spot.row, spot.col]] == site.target_class
        assert site.thermal_c[spot.row, spot.col] == pytest.approx(spot.peak_c, abs=1e-3)
    burnt, grass = (np.median(site.thermal_c[class_mask(site, name)]) for name in ("burnt", "grass"))
    assert burnt > grass + 3.0


def patch_features(site: Site, patch_px: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give mean opponent colours, log energies of levelled luminance in four octaves, and class of pure patches."""
    grey = site.rgb.astype(float).mean(axis=2) + 8.0
    level = grey / ndimage.gaussian_filter(grey, 12.0)
    bands = [ndimage.gaussian_filter(level, s) - ndimage.gaussian_filter(level, 2.0 * s) for s in (0.5, 1.0, 2.0, 4.0)]
    rows, cols = (n // patch_px for n in site.truth.shape)

    def pool(image: np.ndarray) -> np.ndarray:
        return image[: rows * patch_px, : cols * patch_px].reshape(rows, patch_px, cols, patch_px).swapaxes(1, 2)

    truth = pool(site.truth).reshape(rows * cols, -1)
    pure = (truth == truth[:, :1]).all(axis=1) & (truth[:, 0] != 255)
    red, green, blue = (pool(site.rgb[..., c]).mean(axis=(2, 3)).ravel() for c in range(3))
    colour = np.stack([red + green + blue, red - green, 0.5 * (red + green) - blue], axis=1)
    texture = np.stack([np.log(pool(band**2).mean(axis=(2, 3))).ravel() for band in bands], axis=1)
    return colour[pure], texture[pure], truth[pure, 0]


def matched_accuracy(features: np.ndarray, truth: np.ndarray, classes: int) -> float:
    found = KMeans(classes, n_init=5, random_state=0).fit_predict(features)
    table = np.zeros((classes, classes))
    np.add.at(table, (found, truth), 1)
    return float(table[linear_sum_assignment(-table)].sum() / len(truth))


@pytest.mark.slow
@pytest.mark.parametrize("scene", sorted(SCENES))
def test_colour_and_texture_together_tell_the_classes_apart(scene: str) -> None:
    site = make_site(SiteSpec(scene, (38.4, 38.4), seed=0))
    colour, texture, truth = patch_features(site, 24)
    colour, texture = ((x - x.mean(axis=0)) / x.std(axis=0) / np.sqrt(x.shape[1]) for x in (colour, texture))
    classes = len(site.class_names)
    both = matched_accuracy(np.hstack([colour, texture]), truth, classes)
    assert both >= 0.95
    assert matched_accuracy(colour, truth, classes) < both - 0.03
    assert matched_accuracy(texture, truth, classes) < both - 0.03


@pytest.mark.parametrize(
    "spec",
    [
        SiteSpec("moon"),
        SiteSpec("meadow", pixel_m=0.001),
        SiteSpec("meadow", pixel_m=float("nan")),
        SiteSpec("meadow", size_m=(0.0, 50.0)),
        SiteSpec("meadow", size_m=(float("inf"), 50.0)),
        SiteSpec("meadow", size_m=(5.0, 5.0)),
        SiteSpec("meadow", size_m=(5000.0, 5000.0)),
        SiteSpec("meadow", seed=-1),
    ],
)
def test_a_specification_out_of_range_is_refused(spec: SiteSpec) -> None:
    with pytest.raises(ArgumentError):
        make_site(spec)


def test_progress_ends_at_the_whole() -> None:
    calls: list[tuple[int, int]] = []
    make_site(SiteSpec("reef", (12.8, 12.8), 0.1), lambda done, total: calls.append((done, total)))
    assert calls == sorted(calls)
    assert calls[-1][0] == calls[-1][1]
