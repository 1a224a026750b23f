"""The learning curves of a steering network."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.errors import OutputError
from hrt_cli.report.figures.steering_curve import draw_training, training_figure


def columns(n: int) -> dict[str, np.ndarray]:
    epoch = np.arange(1.0, n + 1)
    fall = np.exp(-epoch / 10)
    return {
        "epoch": epoch,
        "train_loss": 1 + fall,
        "validation_loss": 1.2 + fall + epoch / 100,
        "train_mae": 0.3 * fall,
        "mae": 0.05 + 0.3 * fall,
    }


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "m.safetensors"
    path.write_bytes(b"a model")
    return path


def draw(model: Path, output: Path, existing: Existing = REFUSE, caption: str = "a training") -> bool:
    found = columns(30)
    history = [{name: values[i] for name, values in found.items()} | {"more": None} for i in range(30)]
    return draw_training(model, output, history, baseline=0.31, best_epoch=24, caption=caption, existing=existing)


def test_the_figure_is_an_artifact_like_any_other(model: Path) -> None:
    output = model.with_suffix(".png")
    assert not draw(model, output)
    before = output.read_bytes()
    assert draw(model, output)
    assert not draw(model, output, Existing(force=True))
    assert output.read_bytes() == before
    found = png_provenance(output)
    assert found is not None
    assert [(each.role, each.name) for each in found.inputs] == [("model", "m.safetensors")]
    assert cv2.imread(str(output)).std() > 10
    with pytest.raises(OutputError, match="exists and was not made by this run"):
        draw(model, output, caption="another")
    with pytest.raises(OutputError, match=r"c\.svg: .* ends in \.png"):
        draw(model, model.with_name("c.svg"))
    link = model.with_name("link.png")
    link.symlink_to(model)
    with pytest.raises(OutputError, match="would overwrite"):
        draw(model, link)


def test_it_shows_training_validation_the_epoch_kept_and_the_constant() -> None:
    found = columns(30)
    figure = training_figure(found, 0.31, 24, "a training")
    loss, error = figure.axes
    for axes, names in ((loss, ("train_loss", "validation_loss")), (error, ("train_mae", "mae"))):
        for line, name in zip(axes.lines[:2], names, strict=True):
            np.testing.assert_array_equal(line.get_xdata(), found["epoch"])
            np.testing.assert_array_equal(line.get_ydata(), found[name])
        labels = [text.get_text() for text in axes.get_legend().get_texts()]
        assert labels[:3] == ["training, augmented", "validation", f"epoch 24, kept: {found[names[1]][23]:.3f}"]
    assert error.get_legend().get_texts()[3].get_text() == "best constant angle: 0.310"
    assert error.lines[-1].get_ydata()[0] == 0.31
    assert error.get_ylim()[0] == 0
    assert error.get_ylim()[1] > 0.32


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_trainings_have_a_figure_too(count: int) -> None:
    training_figure(columns(count), 0.0, 1, "short").draw_without_rendering()
