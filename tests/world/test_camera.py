"""The terrain camera against pinhole equations, a brute-force ray-march, and what a picture must obey."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rasterio.crs import CRS
from scipy import ndimage

from hrt_cli.raster.grid import Grid
from hrt_cli.world.camera import UNKNOWN, Camera, Frame, Lens, Weather
from hrt_cli.world.site import Site

PIXEL_M = 0.05
VACUUM = Weather((0.0, 0.0, 0.0))
DEG = math.pi / 180.0


def make_site(
    surface: NDArray[np.float32],
    rgb: NDArray[np.uint8] | None = None,
    classes: NDArray[np.uint8] | None = None,
    ground: NDArray[np.float32] | None = None,
    pixel_m: float = PIXEL_M,
) -> Site:
    shape = surface.shape
    grid = Grid(*shape, Affine(pixel_m, 0, 500_000, 0, -pixel_m, 5_000_000), CRS.from_epsg(32633))
    bare = surface if ground is None else ground
    return Site(
        grid, pixel_m, np.full((*shape, 3), 120, np.uint8) if rgb is None else rgb, surface.astype(np.float32),
        bare.astype(np.float32), np.ones(shape, np.bool_), np.zeros(shape, np.uint8) if classes is None else classes,
        np.ones(shape, np.float32), surface > bare, np.full(shape, 9.0, np.float32), {}, None, False,
    )  # fmt: skip


def rays(lens: Lens, heading: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Unit rays (east, south, up), [height, width, 3], by turning the axes of a level lens one after the other."""
    focal = lens.width / 2 / math.tan(lens.hfov_deg * DEG / 2)
    x, y = np.meshgrid(np.arange(lens.width) + 0.5 - lens.width / 2, np.arange(lens.height) + 0.5 - lens.height / 2)
    right, down, ahead = x / focal, y / focal, np.ones_like(x)
    right, down = right * math.cos(roll) - down * math.sin(roll), right * math.sin(roll) + down * math.cos(roll)
    ahead, up = ahead * math.cos(pitch) + down * math.sin(pitch), ahead * math.sin(pitch) - down * math.cos(pitch)
    east = ahead * math.sin(heading) + right * math.cos(heading)
    south = -ahead * math.cos(heading) + right * math.sin(heading)
    out = np.stack([east, south, up], axis=-1)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def brute_range(site: Site, place: tuple[float, float, float], toward: NDArray[np.float64], most_m: float = 55.0):
    """Distance to the surface along every ray by steps of 2 cm on the ground; inf where it meets none."""
    reach = np.arange(0.01, most_m, 0.02)
    flat = np.hypot(toward[..., 0], toward[..., 1])
    out = np.full(flat.shape, np.inf)
    for index in np.ndindex(flat.shape):
        length = reach / max(flat[index], 1e-3)
        east, south = place[0] + length * toward[index][0], place[1] + length * toward[index][1]
        at = [south / site.pixel_m - 0.5, east / site.pixel_m - 0.5]
        surface = ndimage.map_coordinates(site.surface_m, at, order=1, mode="nearest")
        under = np.flatnonzero(place[2] + length * toward[index][2] <= surface)
        if under.size:
            out[index] = length[under[0]]
    return out


def smooth_terrain(seed: int, side: int = 800, relief_m: float = 1.2) -> NDArray[np.float32]:
    noise = np.random.default_rng(seed).normal(size=(side, side))
    field = ndimage.gaussian_filter(noise, 40) / ndimage.gaussian_filter(noise, 40).std()
    return (0.5 * relief_m * field).astype(np.float32)


POSES = [
    (0.0, -10.0, 0.0, 75.0),
    (77.0, -25.0, 12.0, 60.0),
    (200.0, 3.0, -30.0, 90.0),
    (305.0, -60.0, 5.0, 75.0),
    (10.0, -90.0, 40.0, 50.0),
    (130.0, -35.0, 170.0, 75.0),
]


@pytest.mark.parametrize(("heading", "pitch", "roll", "hfov"), POSES)
def test_flat_ground_is_seen_where_the_pinhole_equations_say(
    heading: float, pitch: float, roll: float, hfov: float
) -> None:
    side, height = 1600, 1.3
    squares = np.indices((side, side)) // 30
    classes = ((squares[0] * 7 + squares[1] * 3) % 5).astype(np.uint8)
    site = make_site(np.full((side, side), 10.0, np.float32), classes=classes)
    lens = Lens(hfov_deg=hfov)
    place = (40.3, 39.1, 10.0 + height)
    frame = Camera(site, lens, VACUUM).view(*place, heading * DEG, pitch * DEG, roll * DEG)
    toward = rays(lens, heading * DEG, pitch * DEG, roll * DEG)
    below = toward[..., 2] < -0.5 / lens.focal_px  # nearer to the horizon a pixel is as much sky
    length = height / -np.where(below, toward[..., 2], -1.0)
    assert np.allclose(frame.range_m[below], length[below], rtol=0.01)
    assert np.isinf(frame.range_m[toward[..., 2] > 0.0]).all()
    assert np.isfinite(frame.range_m[toward[..., 2] < -1e-6]).all(), "below the horizon there is no sky"
    col = (place[0] + length * toward[..., 0]) / PIXEL_M
    row = (place[1] + length * toward[..., 1]) / PIXEL_M
    inside = below & (col > 0) & (row > 0) & (col < side) & (row < side)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    edge = np.minimum(np.abs(row / 30 - np.rint(row / 30)), np.abs(col / 30 - np.rint(col / 30))) * 30 * PIXEL_M
    sure = inside & (edge > 0.001 * length / -np.minimum(toward[..., 2], -1e-9))
    assert np.count_nonzero(sure) > 3000
    assert np.array_equal(frame.classes[sure], classes[row.astype(int), col.astype(int)][sure])
    assert (frame.classes[~inside & (np.abs(toward[..., 2]) > 0.5 / lens.focal_px)] == UNKNOWN).all()


@pytest.mark.parametrize(("seed", "pitch", "roll", "height"), [(1, -10, 0, 1.0), (2, -5, 20, 0.6), (3, -50, -8, 4.0)])
def test_a_brute_force_march_sees_the_same_surface(seed: int, pitch: float, roll: float, height: float) -> None:
    site = make_site(smooth_terrain(seed))
    lens = Lens()
    camera = Camera(site, lens, VACUUM)
    place = (19.0, 23.0, float(site.surface_m[460, 380]) + height)
    frame = camera.view(*place, 0.7 + seed, pitch * DEG, roll * DEG)
    truth = brute_range(site, place, rays(lens, 0.7 + seed, pitch * DEG, roll * DEG)[2::4, 2::4])
    found = frame.range_m[2::4, 2::4]
    agrees = np.abs(found / np.where(np.isfinite(truth), truth, 1.0) - 1.0) < 0.03
    agrees[np.isinf(truth)] = found[np.isinf(truth)] > 40.0
    assert agrees.mean() >= 0.98


def test_a_wall_hides_the_rows_it_should() -> None:
    surface = np.zeros((800, 800), np.float32)
    surface[360:380] = 1.5
    site = make_site(surface, ground=np.zeros_like(surface))
    lens = Lens(160, 120)
    frame = Camera(site, lens, VACUUM).view(20.0, 24.0, 1.0, 0.0)  # 5 m before its face, looking north
    rows = np.arange(lens.height) + 0.5 - lens.height / 2
    top, foot = -lens.focal_px * 0.5 / 5.0, lens.focal_px * 1.0 / 5.0
    middle = frame.range_m[:, 80]
    on_wall = (rows > top + 1.0) & (rows < foot - 1.0)
    assert np.allclose(middle[on_wall] * np.cos(np.arctan(rows[on_wall] / lens.focal_px)), 5.0, atol=0.06)
    assert np.isinf(middle[rows < top - 1.0]).all(), "over the wall there is sky: the ground behind is hidden"
    ground = rows > foot + 1.0
    assert np.allclose(middle[ground], np.hypot(1.0, lens.focal_px / rows[ground]), rtol=0.01)


def test_a_lower_wall_shows_the_ground_behind_it() -> None:
    surface = np.zeros((1200, 400), np.float32)
    surface[1000:1010] = 0.5
    frame = Camera(make_site(surface, ground=np.zeros_like(surface)), weather=VACUUM).view(10.0, 55.0, 1.0, 0.0)
    rows = np.arange(120) + 0.5 - 60
    focal = Lens().focal_px
    behind = (rows > 2) & (rows < focal * 0.5 / 5.0 - 1)
    assert np.allclose(frame.range_m[behind, 80], np.hypot(1.0, focal / rows[behind]), rtol=0.02)


def wild_site() -> Site:
    rng = np.random.default_rng(5)
    rgb = ndimage.zoom(rng.integers(20, 230, (32, 32, 3)), (16, 16, 1), order=1).astype(np.uint8)
    classes = ndimage.zoom(rng.integers(0, 4, (32, 32)), 16, order=0).astype(np.uint8)
    return make_site(smooth_terrain(7, 512), rgb, classes)


def same(one: Frame, other: Frame, share: float = 0.985) -> bool:
    """Whether two frames agree but for pixels at edges, where rounding decides."""
    colours = np.abs(one.rgb.astype(int) - other.rgb).max(axis=-1) <= 3
    return bool(np.mean(colours) >= share and np.mean(one.classes == other.classes) >= share)


@pytest.mark.parametrize("pitch", [-8.0, -40.0])
def test_a_roll_by_half_a_turn_turns_the_picture(pitch: float) -> None:
    camera = Camera(wild_site())
    upright = camera.view(8.0, 12.0, 2.0, 1.0, pitch * DEG)
    over = camera.view(8.0, 12.0, 2.0, 1.0, pitch * DEG, math.pi)
    turned = Frame(over.rgb[::-1, ::-1], over.classes[::-1, ::-1], over.range_m[::-1, ::-1])
    assert same(upright, turned)


def test_a_turned_site_seen_from_a_turned_heading_looks_the_same() -> None:
    site = wild_site()
    turned = make_site(
        np.rot90(site.surface_m, -1), np.ascontiguousarray(np.rot90(site.rgb, -1)), np.rot90(site.classes, -1)
    )  # clockwise by a quarter: north becomes east
    one = Camera(site).view(8.0, 13.0, 1.5, 0.4, -15 * DEG, 0.1)
    other = Camera(turned).view(25.6 - 13.0, 8.0, 1.5, 0.4 + math.pi / 2, -15 * DEG, 0.1)
    assert same(one, other)


def test_nose_up_shows_sky_and_right_side_down_lifts_the_horizon_on_the_right() -> None:
    camera = Camera(make_site(np.zeros((400, 400), np.float32)), weather=VACUUM)
    sky = {pitch: float(np.isinf(camera.view(10, 10, 1, 0, pitch * DEG).range_m).mean()) for pitch in (-10, 0, 10)}
    assert sky[-10] < sky[0] == 0.5 < sky[10]
    banked = np.isinf(camera.view(10, 10, 1, 0, 0, 15 * DEG).range_m)
    assert banked[:, :40].mean() > 0.6
    assert banked[:, -40:].mean() < 0.4


def test_haze_follows_its_formula() -> None:
    colour = (40, 120, 200)
    site = make_site(np.zeros((400, 400), np.float32), np.full((400, 400, 3), colour, np.uint8))
    weather = Weather((0.02, 0.05, 0.3), (180.0, 190.0, 60.0), exposure=0.9, balance=(1.1, 1.0, 0.8))
    frame = Camera(site, weather=weather).view(10.0, 10.0, 1.0, 0.3, -12 * DEG)
    ground = frame.range_m < 50.0  # at the horizon a pixel shows some sky
    share = np.exp(-frame.range_m[ground][:, None].astype(float) * weather.haze_per_m)
    light = np.array(weather.veil) + share * (np.array(colour) - weather.veil)
    assert np.abs(np.clip(light * 0.9 * np.array(weather.balance), 0, 255) - frame.rgb[ground]).max() <= 0.51


def test_sky_goes_from_horizon_to_zenith() -> None:
    weather = Weather.clear()
    camera = Camera(make_site(np.zeros((100, 100), np.float32)), weather=weather)
    up = camera.view(2.0, 2.0, 1.0, 0.0, 90 * DEG)
    assert np.isinf(up.range_m).all()
    assert np.abs(up.rgb[60, 80] - np.array(weather.sky_zenith)).max() <= 1
    level = camera.view(2.0, 2.0, 1.0, 0.0).rgb
    assert np.abs(level[59, 80] - np.array(weather.sky_horizon)).max() <= 2
    assert np.abs(level[60, 80] - np.array(weather.veil)).max() <= 40


def test_same_seed_same_bytes_and_noise_has_its_size() -> None:
    camera = Camera(wild_site())
    pose = (8.0, 12.0, 2.0, 1.0, -0.2)
    clean, one, again, other = (camera.view(*pose, noise_seed=seed) for seed in (None, 4, 4, 5))
    assert one.rgb.tobytes() == again.rgb.tobytes()
    assert clean.rgb.tobytes() == camera.view(*pose).rgb.tobytes()
    assert one.rgb.tobytes() != other.rgb.tobytes()
    differs = one.rgb.astype(float) - clean.rgb
    assert abs(differs.mean()) < 0.1
    assert differs.std() == pytest.approx(2.0, rel=0.06)
    assert abs(np.corrcoef(differs[..., 0].ravel(), differs[..., 1].ravel())[0, 1]) < 0.03
    with ThreadPoolExecutor(4) as pool:
        many = list(pool.map(lambda _: camera.view(*pose, noise_seed=4).rgb.tobytes(), range(16)))
    assert set(many) == {one.rgb.tobytes()}


@pytest.mark.parametrize("place", [(-5.0, 10.0), (31.0, -8.0), (10.0, 27.0), (500.0, 500.0)])
def test_off_the_map_the_ground_goes_on(place: tuple[float, float]) -> None:
    camera = Camera(wild_site())
    for heading in (0.3, 2.0, 4.4):
        frame = camera.view(*place, camera.ground_m(*place) + 1.0, heading, -10 * DEG)
        assert frame.rgb.min() > 15
        assert np.isfinite(frame.range_m[70:]).all()


def test_a_tree_at_the_rim_is_no_endless_wall() -> None:
    surface = np.zeros((400, 400), np.float32)
    surface[:, 380:] = 3.0
    camera = Camera(make_site(surface, ground=np.zeros_like(surface)), weather=VACUUM)
    frame = camera.view(30.0, 10.0, 1.0, math.pi / 2, -5 * DEG)
    assert np.isinf(frame.range_m[:40]).all()


def test_straight_down() -> None:
    site = make_site(np.full((400, 400), -9.0, np.float32))
    camera = Camera(site, weather=VACUUM)
    frame = camera.view(10.0, 10.0, -7.0, 2.0, -90 * DEG)
    focal = camera.lens.focal_px
    y, x = np.mgrid[:120, :160] + 0.5
    assert np.allclose(frame.range_m, 2.0 * np.sqrt(1 + ((x - 80) ** 2 + (y - 60) ** 2) / focal**2), rtol=0.003)


def test_a_lens_in_a_crown_looks_out_and_one_in_the_ground_is_lifted() -> None:
    surface = np.zeros((400, 400), np.float32)
    surface[180:220, 180:220] = 5.0
    camera = Camera(make_site(surface, ground=np.zeros_like(surface)), weather=VACUUM)
    inside = camera.view(10.0, 10.0, 1.0, 0.0, -10 * DEG)
    outside = Camera(make_site(np.zeros_like(surface)), weather=VACUUM).view(10.0, 10.0, 1.0, 0.0, -10 * DEG)
    ground = np.isfinite(outside.range_m) & (outside.range_m < 30)
    assert np.mean(np.isclose(inside.range_m, outside.range_m, rtol=0.03)[ground]) > 0.99
    sunk = camera.view(4.0, 4.0, -3.0, 0.0, -10 * DEG)
    assert np.isfinite(sunk.range_m[60:]).all()
    assert sunk.rgb.min() > 15


@settings(max_examples=15)
@given(
    heading=st.floats(-7.0, 7.0),
    pitch=st.floats(-1.57, 1.57),
    roll=st.floats(-3.2, 3.2),
    height=st.floats(0.1, 8.0),
    hfov=st.floats(20.0, 120.0),
)
def test_no_pose_breaks_it(heading: float, pitch: float, roll: float, height: float, hfov: float) -> None:
    site = make_site(smooth_terrain(9, 300))
    lens = Lens(40, 30, hfov)
    camera = Camera(site, lens)
    place = (7.0, 8.0, camera.ground_m(7.0, 8.0) + height)
    frame = camera.view(*place, heading, pitch, roll)
    up = rays(lens, heading, pitch, roll)[..., 2]
    assert np.isfinite(frame.range_m[up < -1e-3]).all()
    assert (frame.range_m > 0).all()
    seen = np.isfinite(frame.range_m) & (frame.range_m < 50)
    hit = place[2] + frame.range_m[seen] * up[seen]
    blur = 0.05 + frame.range_m[seen] / lens.focal_px  # at silhouettes a pixel off
    assert (hit - blur < site.surface_m.max()).all()
    assert (hit + blur > site.surface_m.min()).all()
    assert frame.rgb.min() > 15


def test_share_counts_all_pixels() -> None:
    classes = np.zeros((400, 400), np.uint8)
    classes[:, 200:] = 3
    frame = Camera(make_site(np.zeros((400, 400), np.float32), classes=classes)).view(10.0, 10.0, 2.0, 0.0, -90 * DEG)
    assert frame.share(3) == pytest.approx(0.5, abs=0.01)
    assert frame.share(0) + frame.share(3) == 1.0
    assert frame.share(9) == 0.0


def test_weathers() -> None:
    site = make_site(np.full((400, 400), -9.0, np.float32), np.full((400, 400, 3), 200, np.uint8))
    wet = Camera(site, weather=Weather.water(10.0)).view(10.0, 10.0, -7.5, 0.0, -60 * DEG)
    red, green, blue = wet.rgb[60, 80].tolist()
    assert red < 0.75 * green
    assert red < 0.75 * blue
    fog = Weather.fog(20.0)
    assert math.exp(-fog.haze_per_m[0] * 20.0) == pytest.approx(0.05)
    one, again = (fog.jittered(np.random.default_rng(3)) for _ in range(2))
    assert one == again != fog
    camera = Camera(site, weather=fog)
    other = camera.changed(weather=Weather.clear(), lens=Lens(40, 30))
    assert other.view(5, 5, -8, 0).rgb.shape == (30, 40, 3)
    assert camera.view(5, 5, -8, 0).rgb.shape == (120, 160, 3)
    assert Camera(site).weather == Weather.clear()
