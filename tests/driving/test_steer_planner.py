"""The learnt planner: what it asks its model, what it makes of the answer, and which models it takes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from numpy.typing import NDArray
from tiny_trunk import TinyTrunk
from world_files import ground_site, map_xy, put_plan, put_world

from hrt_cli import main as shell
from hrt_cli.artifacts.drivelog import drive_provenance
from hrt_cli.artifacts.provenance import file_sha256, record
from hrt_cli.driving.course import Course
from hrt_cli.driving.lens import camera_of, look
from hrt_cli.driving.local import Command, Pose
from hrt_cli.driving.simulator import Setting, first_heading, simulate
from hrt_cli.driving.stage import DriveRequest, drive_file, local_planner
from hrt_cli.driving.steer import Steer, best_angle, both_ways
from hrt_cli.driving.vehicle import AUV, UGV
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.logs.read import read_drive_log
from hrt_cli.steering.network import net as network
from hrt_cli.steering.network.model import publish_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet, directions
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.world.site import Site

EAST = math.pi / 2
MIDDLE = Pose(5.0, 5.0, 0.0, 0.0, 0.0)
"""In the middle of the site, nose to the north."""
HALF = 7


class Model:
    """Answers the same whatever it is shown, and remembers what that was."""

    def __init__(self, *, goal: bool = False, mirrored: bool = True, **answers: NDArray[np.float64]) -> None:
        self.config = SteeringConfig(
            outputs=tuple(answers), half_classes=HALF, width=40, height=32, goal=goal, mirrored=mirrored
        )
        self._answers = answers
        self.seen: list[NDArray[np.uint8]] = []
        self.told: list[NDArray[np.float32] | None] = []

    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None = None) -> dict:
        self.seen.append(pictures)
        self.told.append(goal)
        both = {name: np.stack([a, a[::-1] if name == "yaw" else a]) for name, a in self._answers.items()}
        return {name: each[: len(pictures)] for name, each in both.items()}


def peaks(**shares: float) -> NDArray[np.float64]:
    """A distribution with these shares in the classes k7, k-3, ... (minus written as _)."""
    out = np.zeros(2 * HALF + 1)
    for name, share in shares.items():
        out[HALF + int(name[1:].replace("_", "-"))] = share
    return out / out.sum()


def setting(*points: tuple[float, float], site: Site | None = None, limit_s: float = 60.0) -> Setting:
    site = site or ground_site(np.zeros((100, 100), np.bool_))
    course = Course(np.array(points or ((5.0, 5.0), (5.0, 1.0)), float))
    vehicle = AUV if site.under_water else UGV
    return Setting(site, vehicle, course, vehicle.cruise_m_s, limit_s, first_heading(course), 3)


def water() -> Site:
    return ground_site(np.zeros((100, 100), np.bool_), bottom_m=-6.0, under_water=True)


def decided(model: Model, pose: Pose = MIDDLE, **more: object) -> Command:
    command = Steer(model, setting(**more)).decide(pose, pose)  # type: ignore[arg-type]
    assert command is not None
    return command


@pytest.mark.parametrize(
    ("distribution", "yaw"),
    [
        # The mean of all would be 0.1 and lead into what the ways lead round.
        (peaks(k_5=0.4, k5=0.5), 5 / 7),
        (peaks(k_5=0.5, k5=0.4), -5 / 7),
        # About the best class: two on either side, by their shares.
        (peaks(k1=0.1, k2=0.2, k3=0.4, k4=0.2, k5=0.1), 3 / 7),
        (peaks(k2=0.3, k3=0.5, k6=0.2), (0.3 * 2 + 0.5 * 3) / 0.8 / 7),
        # Three neighbours are likelier than one class that stands out a little.
        (peaks(k_6=0.34, k2=0.22, k3=0.23, k4=0.21), (0.22 * 2 + 0.23 * 3 + 0.21 * 4) / 0.66 / 7),
        # At the ends there is nothing beyond.
        (peaks(k7=0.7, k6=0.1, k5=0.2), (0.7 * 7 + 0.1 * 6 + 0.2 * 5) / 7),
        (peaks(k_7=0.7, k_6=0.1, k_5=0.2), -(0.7 * 7 + 0.1 * 6 + 0.2 * 5) / 7),
    ],
)
def test_it_takes_the_mean_about_the_best_class(distribution: NDArray[np.float64], yaw: float) -> None:
    assert decided(Model(yaw=distribution)).yaw == pytest.approx(yaw)


def test_what_a_picture_and_its_mirror_image_say_is_averaged() -> None:
    own, other = peaks(k1=0.6, k5=0.4), peaks(k_1=0.2, k4=0.8)
    up, down = peaks(k3=1.0), peaks(k_2=1.0)
    found = both_ways({"yaw": np.stack([own, other]), "pitch": np.stack([up, down])})
    assert found["yaw"] == pytest.approx(peaks(k1=0.4, k5=0.2, k_4=0.4))
    assert found["pitch"] == pytest.approx(peaks(k3=0.5, k_2=0.5))


def test_one_that_learnt_from_no_mirrored_pictures_is_not_shown_one() -> None:
    model = Model(goal=True, mirrored=False, yaw=peaks(k2=1.0))
    planner = Steer(model, setting((2.0, 5.0), (9.0, 5.0)))
    command = planner.decide(MIDDLE, MIDDLE)
    assert command is not None
    assert command.yaw == pytest.approx(2 / 7)
    (seen,), (told,) = model.seen, model.told
    assert len(seen) == 1
    assert told == pytest.approx([EAST], abs=1e-6)


def test_it_stays_with_the_side_that_it_took() -> None:
    both = peaks(k_5=0.5, k5=0.45)
    for last, angle, share in ((None, -5 / 7, 0.5), (0.0, -5 / 7, 0.5), (0.6, 5 / 7, 0.45)):
        assert best_angle(both, last) == pytest.approx((angle, share / 0.95))
    assert best_angle(peaks(k_5=0.97, k5=0.03), 0.6)[0] == pytest.approx(-5 / 7), "but not against all reason"


def test_where_it_does_not_know_it_turns_on_the_spot() -> None:
    """To the likelier side, and on to that one: the way ahead is a little likelier than any other, but not likely."""
    unsure = peaks(k_7=0.16, k_4=0.04, k_1=0.11, k0=0.21, k1=0.11, k4=0.14, k7=0.23)
    assert decided(Model(yaw=unsure)) == Command(1.0, 0.0, 0.0)
    assert decided(Model(yaw=unsure[::-1])) == Command(-1.0, 0.0, 0.0)
    planner = Steer(Model(yaw=peaks(k_7=1.0)), setting())
    planner.decide(MIDDLE, MIDDLE)
    planner.decide(MIDDLE, MIDDLE)
    planner._predictor = Model(yaw=unsure)
    command = planner.decide(MIDDLE, MIDDLE)
    assert command == Command(-1.0, 0.0, 0.0)
    surer = peaks(k_7=0.11, k_4=0.04, k_1=0.13, k0=0.25, k1=0.14, k4=0.14, k7=0.19)
    assert decided(Model(yaw=surer)).yaw == pytest.approx((0.14 - 0.13) / 0.52 / 7)


def test_one_that_turned_to_and_fro_looks_round_before_it_drives_on() -> None:
    """On the spot, on to the side of its last turn, though the model would drive on."""
    planner = Steer(Model(goal=True, yaw=peaks(k_6=1.0)), setting())
    commands = []
    for k in range(60):
        pose = replace(MIDDLE, heading_rad=0.5 * (k // 2))
        commands.append(planner.decide(pose, pose))
    looking = [command == Command(-1.0, 0.0, 0.0) for command in commands]
    first, last = looking.index(True), 59 - looking[::-1].index(True)
    assert all(looking[first : last + 1])
    assert (first, last - first) == (pytest.approx(26, abs=2), pytest.approx(25, abs=2)), "after a turn, for a turn"
    assert not looking[-1]


class Ordered:
    """A detour that does as it is told."""

    spinning, aligning, to_rad = False, False, 0.0

    def bearing_rad(self, known: Pose, goal_rad: float, told_m: float, ahead: object) -> float:
        return self.to_rad


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_diver_turns_to_its_way_out_and_forgets_the_side_that_it_took(side: float) -> None:
    """Whatever it sees, and by however little; it would swim on while it turns, where there may be no room."""
    pose, ahead = Pose(5.0, 5.0, -3.0, 0.0, 0.0), peaks(k0=1.0)
    aside = Model(goal=True, yaw=peaks(k_7=1.0) if side < 0 else peaks(k7=1.0), pitch=ahead)
    planner = Steer(aside, setting(site=water()))
    planner._detour = detour = Ordered()  # type: ignore[assignment]

    def command() -> Command:
        found = [planner.decide(pose, pose) for _ in range(2)]
        assert found[0] is not None
        return found[0]

    assert command().yaw == pytest.approx(side)
    detour.aligning, detour.to_rad = True, -0.4 * side
    assert command() == Command(-side, 0.0, 0.0)
    detour.aligning, detour.to_rad = False, 0.0
    tempting = {"k_7" if side < 0 else "k7": 0.36}
    planner._predictor = Model(goal=True, yaw=peaks(k_1=0.12, k0=0.4, k1=0.12, **tempting), pitch=ahead)
    assert (command().yaw, command().speed) == (pytest.approx(0.0), pytest.approx(1.0))
    planner._yaw = side
    assert command().yaw == pytest.approx(side), "or else nothing was shown"


def test_a_diver_that_does_not_know_swims_on() -> None:
    unsure = peaks(k_7=0.16, k_4=0.04, k_1=0.11, k0=0.21, k1=0.11, k4=0.14, k7=0.23)
    model = Model(yaw=unsure, pitch=peaks(k0=1.0))
    command = decided(model, Pose(5.0, 5.0, -3.0, 0.0, 0.0), site=water())
    assert command.yaw == pytest.approx(0.0)
    assert command.speed == pytest.approx(1.0)


def test_it_drives_slower_in_turns() -> None:
    speeds = {k: decided(Model(yaw=peaks(**{f"k{k}".replace("-", "_"): 1.0}))).speed for k in (-7, -3, 0, 3, 7)}
    # It turns on the spot from yaw 0.9 on.
    assert speeds == pytest.approx({k: max(0.0, 1.0 - abs(k) / 7 / 0.9) for k in speeds})


def test_a_diver_keeps_way_in_turns() -> None:
    model = Model(yaw=peaks(k7=1.0), pitch=peaks(k0=1.0))
    assert decided(model, Pose(5.0, 5.0, -3.0, 0.0, 0.0), site=water()).speed == pytest.approx(1.0 - 45.0 / 70.0)


def test_pitch_is_told_only_by_a_model_that_has_one() -> None:
    assert decided(Model(yaw=peaks(k0=1.0))).pitch == 0.0
    model = Model(yaw=peaks(k_3=1.0), pitch=peaks(k2=0.5, k4=0.5))
    command = decided(model, Pose(5.0, 5.0, -3.0, 0.0, 0.0), site=water())
    assert (command.yaw, command.pitch) == (pytest.approx(-3 / 7), pytest.approx(3 / 7))


def test_it_looks_at_every_second_decision_and_follows_the_course_at_each() -> None:
    model = Model(goal=True, yaw=peaks(k2=1.0))
    planner = Steer(model, setting((5.0, 9.0), (5.0, 1.0)))
    looked, along, commands = [], [], []
    for step in range(6):
        pose = Pose(5.0, 9.0 - step, 0.0, 0.0, 0.0)
        commands.append(planner.decide(pose, pose))
        looked.append(len(model.seen))
        along.append(planner.along_m)
    assert looked == [1, 1, 2, 2, 3, 3]
    assert along == pytest.approx([0, 1, 2, 3, 4, 5])
    assert commands[0] is commands[1]
    assert commands[1] is not commands[2]


def test_the_goal_is_told_to_a_model_that_asks_for_it() -> None:
    """In radians, right positive: the way goes east and the robot looks north; it is told where it thinks it is.

    The second is that of the mirror image.
    """
    asking, other = Model(goal=True, yaw=peaks(k0=1.0)), Model(yaw=peaks(k0=1.0))
    way = setting((2.0, 5.0), (9.0, 5.0))
    known, true = Pose(4.0, 5.0, 0.0, 0.0, 0.0), Pose(4.0, 6.5, 0.0, 0.1, 0.0)
    for model in (asking, other):
        Steer(model, way).decide(known, true)
    (told,) = asking.told
    assert told is not None
    assert (told.shape, told.dtype) == ((2,), np.float32)
    assert told == pytest.approx([EAST, -EAST], abs=1e-6)
    assert other.told == [None]


def test_it_sees_what_the_camera_sees_where_the_robot_is() -> None:
    """West of it all is red, east of it all is blue; the place that it believes in is elsewhere."""
    site = ground_site(np.zeros((100, 100), np.bool_))
    rgb = np.empty((100, 100, 3), np.uint8)
    rgb[:, :50], rgb[:, 50:] = (200, 40, 40), (40, 40, 200)
    site = replace(site, rgb=rgb)
    model = Model(yaw=peaks(k0=1.0))
    there = setting(site=site)
    planner = Steer(model, there)
    for _ in range(3):
        planner.decide(Pose(1.0, 5.0, 0.0, 0.0, 0.0), MIDDLE)
    (first, mirrored), (second, _) = model.seen
    assert np.array_equal(mirrored, first[:, ::-1])
    assert (first.shape, first.dtype) == ((32, 40, 3), np.uint8)
    left, right = first[24:, :18].mean(axis=(0, 1)), first[24:, 22:].mean(axis=(0, 1))
    assert left[0] > left[2] + 50
    assert right[2] > right[0] + 50
    assert not np.array_equal(first, second), "noise of its own in each frame"
    bare = look(camera_of(site, UGV, there.seed), site, UGV, MIDDLE).rgb
    assert np.abs(first.astype(int) - fitted(bare, model.config)).mean() < 4, "in the weather of the drive's seed"


@pytest.mark.parametrize("k", [-4, 4])
def test_right_is_positive(k: int) -> None:
    model = Model(yaw=peaks(**{f"k{k}".replace("-", "_"): 1.0}))
    there = setting(limit_s=2.0)
    drive = simulate(there, Steer(model, there))
    turned = math.sin(drive.records[-1, 3] - drive.records[0, 3])
    assert math.copysign(1.0, turned) == math.copysign(1.0, k)
    assert abs(turned) > 0.5


def put_net(path: Path, net: SteeringNet) -> Path:
    publish_model(path, net, net.config, record("train-steer", 1, {}, {}))
    return path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks with a tiny trunk."""
    monkeypatch.setattr(network, "ResNet18", TinyTrunk)


@pytest.mark.usefixtures("small")
def test_a_model_of_another_kind_of_robot_is_refused(tmp_path: Path) -> None:
    ground, sea = setting(), setting(site=water())
    models = {}
    for outputs in (("yaw",), ("yaw", "pitch")):
        config = SteeringConfig(outputs=outputs, width=32, height=32)
        models[outputs] = put_net(tmp_path / f"{len(outputs)}.safetensors", SteeringNet(config))
    assert local_planner("steer", ground, models["yaw",]).name == "steer"
    assert local_planner("steer", sea, models["yaw", "pitch"]).name == "steer"
    with pytest.raises(InputError, match=r"1\.safetensors: steers yaw: made for another kind of robot"):
        local_planner("steer", sea, models["yaw",])
    with pytest.raises(InputError, match=r"2\.safetensors: steers yaw and pitch: made for another kind of robot"):
        local_planner("steer", ground, models["yaw", "pitch"])
    with pytest.raises(ArgumentError, match="needs a model"):
        local_planner("steer", ground)


@pytest.mark.usefixtures("small")
def test_a_model_of_another_lens_is_refused(tmp_path: Path) -> None:
    ground = setting()
    for hfov in (None, ground.vehicle.lens_hfov_deg, 60.0):
        path = put_net(
            tmp_path / f"{hfov}.safetensors", SteeringNet(SteeringConfig(width=32, height=32, hfov_deg=hfov))
        )
        if hfov != 60.0:
            assert local_planner("steer", ground, path).name == "steer"
            continue
        with pytest.raises(InputError, match=r"is of a lens 60 degrees wide, and it must be one of 100"):
            local_planner("steer", ground, path)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return put_world(tmp_path_factory.mktemp("world"), np.zeros((60, 100)), classes=np.zeros((60, 100)))


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return put_plan(tmp_path / "p.json", [map_xy(*place) for place in ((2.0, 3.0), (5.0, 3.0), (7.0, 3.0))])


def drive(*args: object) -> list[str]:
    return ["drive", *map(str, args)]


@pytest.mark.parametrize("more", [["--local", "steer"], ["--model", "m"], ["--local", "expert", "--model", "m"]])
def test_steer_and_a_model_go_together(world: Path, plan: Path, tmp_path: Path, more: list[str]) -> None:
    done = CliRunner().invoke(shell.cli, drive(plan, "--world", world, "-o", tmp_path / "d.jsonl", *more))
    assert done.exit_code == 2
    assert "--local steer needs a --model, and no other takes one" in done.stderr
    assert not (tmp_path / "d.jsonl").exists()
    request = DriveRequest(more[1] if "--local" in more else "pursuit", Path("m") if "--model" in more else None)
    with pytest.raises(ArgumentError, match="needs a --model"):
        drive_file(plan, world, tmp_path / "d.jsonl", request)


def damaged(path: Path) -> str:
    with torch.random.fork_rng():
        put_net(path, SteeringNet(SteeringConfig(width=32, height=32)))
    whole = bytearray(path.read_bytes())
    whole[-9] ^= 1
    path.write_bytes(whole)
    return "its content is not what its provenance recorded"


def pickled(path: Path) -> str:
    torch.save({"weight": torch.zeros(3)}, path)
    return "is no safetensors file"


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("name", "make"), [("m.pth", pickled), ("m.safetensors", damaged), ("absent.safetensors", lambda path: "no such")]
)
def test_a_model_that_cannot_be_used_is_refused_in_one_line(
    world: Path, plan: Path, tmp_path: Path, name: str, make, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = make(tmp_path / name)
    before = sorted(tmp_path.iterdir())
    words = drive(plan, "--world", world, "-o", tmp_path / "d.jsonl", "--local", "steer", "--model", tmp_path / name)
    assert shell._run(words) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("Error: ")
    assert name in line
    assert problem in line
    assert sorted(tmp_path.iterdir()) == before


def homing(seed: int = 0) -> SteeringNet:
    """An untrained network but for its head, which steers to the goal whatever it sees."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = SteeringNet(SteeringConfig(width=64, height=48, goal=True))
    error = (directions() + math.pi) % (2 * math.pi) - math.pi
    wanted = (error / (math.pi / 4)).clamp(-1, 1)
    angles = torch.linspace(-1, 1, 2 * HALF + 1)
    head = net.heads["yaw"]
    with torch.no_grad():
        head.weight.zero_()
        head.bias.zero_()
        head.weight[:, -24:] = -20.0 * (angles[:, None] - wanted) ** 2
    return net


def test_a_network_in_a_file_drives_to_where_it_is_told(
    world: Path, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On one thread, so that it is the same drive on any machine."""
    threads, set_threads = [], torch.set_num_threads
    monkeypatch.setattr(torch, "set_num_threads", lambda count: (threads.append(count), set_threads(count)))
    model = put_net(tmp_path / "m.safetensors", homing())
    request = DriveRequest("steer", model, time_limit_s=40.0, seed=2)
    logs = [tmp_path / "1.jsonl", tmp_path / "2.jsonl"]
    for path in logs:
        found = drive_file(plan, world, path, request)
        assert (found.end, found.collisions, found.interventions) == ("arrived", 0, 0)
        assert found.distance_m == pytest.approx(5.0, abs=0.7)
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert 1 in threads
    assert read_drive_log(logs[0]).place[-1] == pytest.approx(map_xy(7.0, 3.0), abs=1.0)
    told = {each.role: each.sha256 for each in drive_provenance(logs[0]).inputs}
    assert told["model"] == file_sha256(model)
    assert drive_file(plan, world, logs[0], request).up_to_date


def test_an_untrained_network_drives_the_same_way_twice(world: Path, plan: Path, tmp_path: Path) -> None:
    """By what it sees, which is the same twice, too."""
    with torch.random.fork_rng():
        torch.manual_seed(1)
        net = SteeringNet(SteeringConfig(width=64, height=48, goal=True))
        torch.nn.init.normal_(net.heads["yaw"].weight, std=0.5)
    model = put_net(tmp_path / "m.safetensors", net)
    request = DriveRequest("steer", model, time_limit_s=6.0)
    logs = [tmp_path / "1.jsonl", tmp_path / "2.jsonl", tmp_path / "3.jsonl"]
    for path, seed in zip(logs, (0, 0, 1), strict=True):
        drive_file(plan, world, path, replace(request, seed=seed))
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert logs[0].read_text().splitlines()[1:] != logs[2].read_text().splitlines()[1:]
