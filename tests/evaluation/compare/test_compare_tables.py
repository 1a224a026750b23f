"""Score tables, models, drive logs and printed figures: every planted change is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from compare_files import (
    compare,
    differing,
    drive,
    figures,
    put_drive,
    put_policy,
    put_scores,
    put_texture,
)
from tiny_trunk import TinyTrunk

from hrt_cli.artifacts.provenance import record
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.raster.grid import lonlat_length_m


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"_0": {"alpha": 7.9}}, {"rmse", "max", "sd_max"}),
        ({"_0": {"alpha": 4.0, "beta": 1.0}}, {"sd_max"}),
        ({"_2": {"mean": 0.11}}, {"rmse", "max", "sd_max"}),
        ({"_1": {"evidence_m": 4.5}}, {"evidence_m"}),
        ({"_1": {"name": "mud"}}, {"names"}),
        ({"_1": None}, {"classes"}),
        ({"_7": {"mean": 0.5}}, {"classes"}),
    ],
)
def test_a_score_table_with_one_change(tmp_path: Path, change: dict[str, Any], wanted: set[str]) -> None:
    a, b = put_scores(tmp_path / "a.json"), put_scores(tmp_path / "b.json", **change)
    assert differing(a, b) == wanted
    assert f"class {next(iter(change))[1:]}" in compare(a, b).stdout
    limits = [word for name in wanted for word in ("--tolerance", f"{name}=1")]
    assert differing(a, b, *limits) == set()


def test_the_error_of_a_score_table_is_that_of_its_means(tmp_path: Path) -> None:
    found = figures(put_scores(tmp_path / "a.json"), put_scores(tmp_path / "b.json", _2={"mean": 0.4}))
    assert found["max"]["difference"] == pytest.approx(0.3)
    assert found["rmse"]["difference"] == pytest.approx(0.3 / np.sqrt(3))


def test_a_number_and_a_mean_are_the_same_belief(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"scores": {"0": 0.5}}')
    (tmp_path / "b.json").write_text('{"format": "hrt-scores", "version": 1, "scores": {"0": {"alpha": 1, "beta": 1}}}')
    assert differing(tmp_path / "a.json", tmp_path / "b.json") == set()


def weight(name: str, *at: int) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][at] += 1e-4

    return change


@pytest.mark.parametrize(("put", "name", "at"), [(put_policy, "weights", (3,)), (put_texture, "centroids", (1, 2))])
def test_one_weight_off(tmp_path: Path, put: Callable[..., Path], name: str, at: tuple[int, ...]) -> None:
    a, b = put(tmp_path / "a.npz"), put(tmp_path / "b.npz", weight(name, *at))
    assert differing(a, put(tmp_path / "again.npz")) == set()
    assert differing(a, b) == {"max", "relative"}
    assert figures(a, b)["max"]["difference"] == pytest.approx(1e-4)
    found = json.loads(compare(a, b, "--json").stdout)
    assert [k for k, each in found["per_tensor"].items() if each["max"]] == [name]
    assert f"{name}: max 0.0001" in compare(a, b).stdout
    assert differing(a, b, "--tolerance", "max=0.00011") == set()
    assert differing(a, b, "--tolerance", "relative=1e-9") == {"relative"}


def test_the_relative_distance_is_that_of_all_weights(tmp_path: Path) -> None:
    def half(arrays: dict[str, Any]) -> None:
        arrays["weights"] *= 0.5

    assert figures(put_policy(tmp_path / "a.npz"), put_policy(tmp_path / "b.npz", half))["relative"]["difference"] == (
        pytest.approx(0.5)
    )


def test_a_model_set_otherwise(tmp_path: Path) -> None:
    def turn(arrays: dict[str, Any]) -> None:
        arrays["scale_invariant"] = np.array(1, np.int64)

    def retrain(arrays: dict[str, Any]) -> None:
        arrays["recipe_values"] = np.array([f"{each}1" for each in arrays["recipe_values"]])

    a = put_texture(tmp_path / "a.npz")
    b = put_texture(tmp_path / "b.npz", lambda arrays: arrays.update(step_m=np.array(0.5)))
    assert differing(a, b) == {"settings"}
    assert "step_m: 0.4 in A, 0.5 in B" in compare(a, b).stdout
    assert "settings" in differing(put_policy(tmp_path / "p.npz"), put_policy(tmp_path / "q.npz", retrain))


@pytest.fixture
def steering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    import torch

    from hrt_cli.steering.network import net as module
    from hrt_cli.steering.network.model import publish_model
    from hrt_cli.steering.network.net import SteeringConfig, SteeringNet

    monkeypatch.setattr(module, "ResNet18", TinyTrunk)

    def put(name: str, change: float = 0.0, **config: Any) -> Path:
        torch.manual_seed(0)
        made = SteeringConfig(width=32, height=32, **config)
        net = SteeringNet(made)
        with torch.no_grad():
            next(iter(net.state_dict().values())).view(-1)[5] += change
        publish_model(tmp_path / name, net, made, record("train-steer", 1, {}, {}))
        return tmp_path / name

    return put


def test_a_steering_model_with_one_weight_or_setting_off(steering: Callable[..., Path]) -> None:
    a = steering("a.safetensors")
    assert differing(a, steering("same.safetensors")) == set()
    assert differing(a, steering("b.safetensors", 1e-3)) == {"max", "relative"}
    assert differing(a, steering("c.safetensors", crop_top=0.1)) == {"settings"}
    assert {"tensors", "settings"} <= differing(a, steering("d.safetensors", half_classes=3))
    a.write_bytes(a.read_bytes()[:-5])
    assert isinstance(compare(a, a).exception, InputError)


def test_what_was_edited_in_place_is_compared_as_it_stands_and_it_is_said(
    tmp_path: Path, steering: Callable[..., Path]
) -> None:
    from safetensors import safe_open
    from safetensors.torch import save_file

    log, model = put_drive(tmp_path / "a.jsonl"), steering("a.safetensors")
    lines = log.read_text().splitlines()
    lines[8] = json.dumps(json.loads(lines[8]) | {"y": 4_999_993.0})
    (tmp_path / "b.jsonl").write_text("\n".join(lines) + "\n")
    with safe_open(model, "pt") as file:
        tensors, metadata = {name: file.get_tensor(name) for name in file.keys()}, file.metadata()  # noqa: SIM118
    next(iter(tensors.values())).view(-1)[0] += 1e-3
    save_file(tensors, tmp_path / "b.safetensors", metadata)
    arrays = np.load(put_policy(tmp_path / "a.npz"))
    moved = {name: arrays[name].copy() for name in arrays.files}
    moved["weights"][0] += 1e-3
    np.savez(tmp_path / "b.npz", **moved)
    for a, wanted in ((log, {"apart_m"}), (model, {"max", "relative"}), (tmp_path / "a.npz", {"max", "relative"})):
        other = tmp_path / f"b{a.suffix}"
        assert differing(a, other) == wanted
        assert "not what its provenance recorded" in compare(a, other).stderr
        assert differing(other, other) == set()


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda each: each[7].update(y=each[7]["y"] + 2.0), {"apart_m"}),
        (lambda each: each[7].update(heading_deg=91.0), {"heading_deg"}),
        (lambda each: each[7].update(event="collision"), {"collisions", "events"}),
        (lambda each: each[7].pop("heading_deg"), {"heading_deg"}),
        (lambda each: each.pop(), {"records", "duration_s", "distance_m", "apart_m"}),
        (lambda each: each[7].update(t=each[7]["t"] + 0.1), {"times_s", "apart_m", "distance_m"}),
    ],
)
def test_a_drive_log_with_one_change(tmp_path: Path, change: Callable[[list[Any]], object], wanted: set[str]) -> None:
    records = drive()
    change(records)
    a, b = put_drive(tmp_path / "a.jsonl"), put_drive(tmp_path / "b.jsonl", records)
    assert differing(a, b) == wanted
    limits = [word for name in wanted - {"heading_deg"} for word in ("--tolerance", f"{name}=3")]
    assert differing(a, b, *limits) <= {"heading_deg"}


def test_one_pose_moved_is_told_in_ground_metres(tmp_path: Path) -> None:
    records = drive()
    records[7]["y"] += 2.0
    found = figures(put_drive(tmp_path / "a.jsonl"), put_drive(tmp_path / "b.jsonl", records))
    assert found["apart_m"]["difference"] == pytest.approx(2.0, rel=1e-3)


def test_drives_are_apart_at_equal_times_and_one_that_is_over_stands(tmp_path: Path) -> None:
    place = [(15.0 + 1e-5 * k, 45.0) for k in range(4)]
    fast = [{"t": float(k), "lon": lon, "lat": lat} for k, (lon, lat) in enumerate(place)]
    slow = [{"t": 100.0 + 2.0 * k, "lon": lon, "lat": lat} for k, (lon, lat) in enumerate(place)]
    a, b = put_drive(tmp_path / "a.jsonl", fast, None), put_drive(tmp_path / "b.jsonl", slow, None)
    step_m = float(lonlat_length_m([15.0, 15.0 + 1e-5], [45.0, 45.0])[0])
    assert figures(a, b)["apart_m"]["difference"] == pytest.approx(1.5 * step_m, rel=1e-6)
    later = [{**each, "t": each["t"] + 50.0} for each in fast]
    assert differing(a, put_drive(tmp_path / "later.jsonl", later, None)) == set()


def test_a_drive_off_the_map_is_not_laid_on_one(tmp_path: Path) -> None:
    a, b = put_drive(tmp_path / "a.jsonl"), put_drive(tmp_path / "b.jsonl", crs=None)
    assert differing(a, b) == {"apart_m", "frame"}


PRINTED = {
    "plans": {"site/p.json": {"score": 3.5, "gap": 0.1}},
    "list": [1, [2, 3]],
    "ok": True,
    "none": None,
    "seconds": 1.5,
    "steps_per_second": 9.0,
    "output": "a/b.tif",
}


def put_printed(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps(PRINTED | changes))
    return path


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"plans": {"site/p.json": {"score": 3.6, "gap": 0.1}}}, {"plans.site/p.json.score"}),
        ({"plans": {"site/p.json": {"score": 3.5}}}, {"plans.site/p.json.gap"}),
        ({"more": 1}, {"more"}),
        ({"list": [1, [2, 4]]}, {"list.1.1"}),
        ({"ok": False}, {"ok"}),
        ({"none": 0}, {"none"}),
        ({"seconds": 99, "steps_per_second": 1.0, "output": "elsewhere"}, set()),
    ],
)
def test_printed_figures_with_one_change(tmp_path: Path, change: dict[str, Any], wanted: set[str]) -> None:
    a, b = put_printed(tmp_path / "a.json"), put_printed(tmp_path / "b.json", **change)
    assert differing(a, b) == wanted
    told = figures(a, b)
    assert {name for name, each in told.items() if each["ok"] is None} == {"seconds", "steps_per_second"}


@pytest.mark.parametrize("name", ["score", "plans.site/p.json.score", "plans.*.score", "*.score", "site/p.json.score"])
def test_a_tolerance_is_for_a_path_or_the_end_of_one(tmp_path: Path, name: str) -> None:
    change = {"plans": {"site/p.json": {"score": 3.6, "gap": 0.1}}}
    a, b = put_printed(tmp_path / "a.json"), put_printed(tmp_path / "b.json", **change)
    assert differing(a, b, "--tolerance", f"{name}=0.11") == set()
    assert differing(a, b, "--tolerance", f"{name}=0.09") == {"plans.site/p.json.score"}


@pytest.mark.parametrize("option", ["score=-1", "score=nan", "score=inf", "score", "=1", "0.02", "score="])
def test_a_tolerance_that_is_none_is_a_usage_error(tmp_path: Path, option: str) -> None:
    a = put_printed(tmp_path / "a.json")
    assert compare(a, a, "--tolerance", option).exit_code == 2


def test_a_tolerance_for_no_figure_is_refused_with_their_names(tmp_path: Path) -> None:
    def refused(done: Result) -> str:
        assert isinstance(done.exception, ArgumentError)
        assert done.stdout == ""
        return str(done.exception)

    printed, scores = put_printed(tmp_path / "a.json"), put_scores(tmp_path / "s.json")
    assert "plans.site/p.json.score" in refused(compare(printed, printed, "--tolerance", "scor=1"))
    assert "rmse, max, sd_max, evidence_m, classes, names" in refused(compare(scores, scores, "--tolerance", "mse=1"))
    log = put_drive(tmp_path / "d.jsonl")
    assert "apart_m" in refused(compare(log, log, "--tolerance", "end=1"))
    assert compare(scores, scores, "--tolerance", "max=1", "--tolerance", "max=2").exit_code == 2
