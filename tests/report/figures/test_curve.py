"""The learning curve as a figure and as numbers, and the command that asks for it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from hrt_cli import main as shell
from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.npz import write_npz
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import HrtError, InputError, OutputError
from hrt_cli.planning.families import FAMILIES
from hrt_cli.planning.train import TrainSpec
from hrt_cli.report.figures.curve import _figure, draw_curve, smoothed

COMMAND = shell.cli.get_command(click.Context(shell.cli), "train-plan")
SMALL = ["--iterations", "4", "--maps-per-iteration", "2", "--rollouts", "2", "--budget", "12", "--json", "-q"]


def train(*arguments: object) -> Result:
    found = CliRunner().invoke(COMMAND, [*SMALL, *map(str, arguments)])
    if isinstance(found.exception, HrtError):
        raise found.exception
    return found


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    path = tmp_path / "p.npz"
    rise = 0.6 - 0.5 * np.exp(-np.arange(200) / 20)
    write_npz(path, {"learning_curve": rise, "weights": np.zeros(3)})
    return path


def draw(policy: Path, output: Path, existing: Existing = REFUSE) -> bool:
    return draw_curve(policy, output, steps=3_000_000, last=10, caption="a training", existing=existing)


def test_the_figure_is_an_artifact_like_any_other(policy: Path) -> None:
    output = policy.with_suffix(".png")
    assert not draw(policy, output)
    before = output.read_bytes()
    assert draw(policy, output)
    assert not draw(policy, output, Existing(force=True))
    assert output.read_bytes() == before
    found = png_provenance(output)
    assert found is not None
    assert [(each.role, each.name) for each in found.inputs] == [("policy", "p.npz")]
    picture = cv2.imread(str(output))
    assert picture.shape[1] > 900
    assert picture.std() > 10


def test_the_figure_shows_the_curve_and_says_what_was_reached() -> None:
    curve = np.linspace(0.2, 0.5, 100)
    figure = _figure(curve, 3_000_000, 10, "a training")
    axes = figure.axes[0]
    raw, smooth, final = axes.lines
    np.testing.assert_array_equal(raw.get_xdata(), np.arange(1, 101))
    np.testing.assert_array_equal(raw.get_ydata(), curve)
    np.testing.assert_allclose(smooth.get_ydata()[:98], curve[:98])
    assert final.get_ydata()[0] == pytest.approx(curve[-10:].mean())
    assert "48.6% at the end (mean of the last 10)" in [text.get_text() for text in axes.get_legend().get_texts()]
    above = axes.child_axes[0]
    assert above.get_xlabel() == "million rollout steps"
    figure.draw_without_rendering()
    # 100 iterations are three million steps.
    assert above.get_xlim()[1] / axes.get_xlim()[1] == pytest.approx(0.03)


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_short_trainings_have_a_figure_too(count: int) -> None:
    figure = _figure(np.linspace(0.1, 0.2, count), 40 * count, 1, "short")
    figure.draw_without_rendering()
    assert len(figure.axes[0].lines) == (2 if count < 3 else 3)
    assert figure.axes[0].child_axes[0].get_xlabel() == "rollout steps"


def test_smoothing_is_a_mean_over_the_window() -> None:
    values = np.random.default_rng(0).random(30)
    found = smoothed(values, 3)
    for i in range(30):
        reach = min(i, 3)
        assert found[i] == pytest.approx(values[i - reach : i + reach + 1].mean())


def test_the_numbers_are_an_artifact_too(policy: Path) -> None:
    output = policy.with_suffix(".json")
    assert not draw(policy, output)
    assert draw(policy, output)
    assert json_provenance(output) is not None
    found = json.loads(output.read_text())
    assert (found["iterations"], found["steps"]) == (200, 3_000_000)
    assert len(found["learning_curve"]) == 200
    assert found["final_share"] == pytest.approx(np.mean(found["learning_curve"][-10:]))


def test_what_is_no_curve_is_refused(policy: Path) -> None:
    with pytest.raises(OutputError, match=r"p\.svg: a learning curve is a \.png .* or a \.json"):
        draw(policy, policy.with_suffix(".svg"))
    write_npz(policy, {"weights": np.zeros(3)})
    with pytest.raises(InputError, match="has no learning curve"):
        draw(policy, policy.with_suffix(".png"))
    assert not policy.with_suffix(".png").exists()


@pytest.mark.parametrize("suffix", [".png", ".json"])
def test_the_command_writes_the_curve(tmp_path: Path, suffix: str) -> None:
    policy, curve = tmp_path / "p.npz", tmp_path / f"c{suffix}"
    options = ("--map-side", 12, "--family", "noise", "--family", "speckle", "-o", policy, "--figure", curve)
    first = json.loads(train(*options).stdout)
    assert (first["resumed_at"], first["up_to_date"], len(first["learning_curve"])) == (0, False, 4)
    before = curve.read_bytes()
    # A curve that is asked for later is drawn from what is there.
    curve.unlink()
    again = json.loads(train(*options[:-2], "--curve", curve).stdout)
    assert again["up_to_date"]
    assert again["learning_curve"] == first["learning_curve"]
    assert curve.read_bytes() == before
    with np.load(policy, allow_pickle=False) as arrays:
        recipe = dict(zip(arrays["recipe_names"].tolist(), arrays["recipe_values"].tolist(), strict=True))
    assert recipe["families"] == "str:noise,speckle"
    assert recipe["map_side"] == "int:12"


def test_the_command_trains_on_maps_of_any_shape(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    shapes = {"a": (3, 9), "b": (20, 14), "c": (1, 2)}
    for name, shape in shapes.items():
        score = rng.random(shape)
        score[rng.random(shape) < (0.2 if name == "b" else 0)] = np.nan
        write_npz(tmp_path / f"{name}.npz", {"score": score})
    maps = [tmp_path / f"{name}.npz" for name in shapes]
    found = train(*maps, "-o", tmp_path / "p.npz", "--eight", 0.5, "--learning-rate", 0.1, "--trace-decay", 1)
    assert found.exit_code == 0
    assert np.isfinite(json.loads(found.stdout)["learning_curve"]).all()


def test_a_bad_name_for_the_curve_is_refused_before_the_training(tmp_path: Path) -> None:
    for curve in ("c.svg", "absent/c.png"):
        with pytest.raises(OutputError):
            train("-o", tmp_path / "p.npz", "--curve", tmp_path / curve)
        assert not list(tmp_path.iterdir())


def test_options_of_generated_maps_do_not_go_with_scoremaps(tmp_path: Path) -> None:
    for option in (("--family", "noise"), ("--map-side", "20")):
        found = train(tmp_path / "s.npz", "-o", tmp_path / "p.npz", *option)
        assert found.exit_code == 2
        assert "are for generated maps" in found.stderr


def test_the_command_knows_the_families_and_the_defaults_of_the_library(tmp_path: Path) -> None:
    spec, shown = TrainSpec(), {each.name: each for each in COMMAND.params}
    names = {"features": "layout", "budget": "moves"}
    own = {"scoremaps", "output", "curve", "overwrite", "force", "as_json", "quiet", "verbose"}
    for name, option in shown.items():
        if name == "families":
            assert tuple(option.type.choices) == FAMILIES
        elif name == "map_side":
            assert re.search(r"Default: (\d+)", option.help or "").group(1) == str(spec.map_side)
        elif name not in own:
            assert option.default == getattr(spec, names.get(name, name)), name
