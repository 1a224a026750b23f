"""The policies that ship with the package are what the default training writes."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib import resources
from pathlib import Path

import pytest

from hrt_cli.artifacts.carriers import read_stamped_npz
from hrt_cli.planning.policy import DEFAULT_POLICY_FILES, default_policies
from hrt_cli.planning.train import TrainSpec
from hrt_cli.planning.training import train_file


@pytest.mark.parametrize(("name", "layout"), list(zip(DEFAULT_POLICY_FILES, ("network", "manjanna24"), strict=True)))
def test_the_shipped_policies_record_the_default_recipe(name: str, layout: str) -> None:
    with resources.as_file(resources.files("hrt_cli.planning").joinpath(name)) as path:
        arrays, provenance = read_stamped_npz(path)
    assert provenance is not None
    assert provenance.stage == "train-plan"
    assert provenance.inputs == []
    assert provenance.parameters == json.loads(json.dumps(asdict(TrainSpec(layout=layout))))
    # It learnt: late rollouts collect far more than the first, random ones.
    curve = arrays["learning_curve"]
    assert curve[-20:].mean() > 1.5 * curve[0]


def test_the_shipped_policies_are_those_of_these_files() -> None:
    assert [policy.layout for policy in default_policies()] == ["network", "manjanna24"]
    assert all(policy.recipe["seed"] == 0 for policy in default_policies())


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    spec = TrainSpec(iterations=2, maps_per_iteration=2, rollouts=2, map_side=12, moves=20, seed=5)
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    train_file((), first, spec)
    train_file((), second, spec)
    assert first.read_bytes() == second.read_bytes()
    assert train_file((), first, spec).up_to_date
