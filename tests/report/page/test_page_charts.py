"""Charts carry the numbers of the artifacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrt_cli.artifacts.carriers import publish_json
from hrt_cli.artifacts.npz import write_npz
from hrt_cli.artifacts.provenance import record
from hrt_cli.artifacts.scores import ClassScore, scores_document
from hrt_cli.errors import InputError
from hrt_cli.raster.style import class_colour
from hrt_cli.report.page.charts import policy_chart, reliability_charts, score_chart, score_course, training_charts


def table(path: Path, **scores: tuple[float, float]) -> Path:
    beliefs = {int(k[1:]): ClassScore(a, b, 10.0 * (a + b), "") for k, (a, b) in scores.items()}
    publish_json(path, scores_document(beliefs), record("feedback", 1, {}, {}))
    return path


def test_scores_before_and_after_with_what_nothing_was_known_of(tmp_path: Path) -> None:
    before = table(tmp_path / "a.json", c0=(1, 3))
    after = table(tmp_path / "b.json", c0=(5, 3), c7=(9, 1))
    chart = score_chart(after, "b.json", before, {7: "road"})
    first, second = chart["rows"]
    assert first["before"]["mean"] == 0.25
    assert first["after"] == {"mean": 0.625, "sd": round(float(np.sqrt(15 / (64 * 9))), 4)}
    assert (second["name"], second["colour"]) == ("road", class_colour(7))
    assert second["before"] == {"mean": 0.5, "sd": 0.2887}  # Beta(1, 1)
    assert second["detail"] == "100 m driven"


def test_the_course_of_scores_begins_where_a_class_was_met(tmp_path: Path) -> None:
    tables = [
        (name, table(tmp_path / name, **scores))
        for name, scores in (("1.json", {"c0": (1, 1)}), ("2.json", {"c0": (3, 1), "c2": (1, 3)}))
    ]
    series = score_course(tables, {})["series"]
    assert [(each["name"], each["points"]) for each in series] == [
        ("class 0", [[1, 0.5], [2, 0.75]]),
        ("class 2", [[2, 0.25]]),
    ]


def test_the_running_mean_of_a_learning_curve_is_that_of_its_neighbours(tmp_path: Path) -> None:
    curve = np.random.default_rng(0).random(200)
    write_npz(tmp_path / "p.npz", {"learning_curve": curve})
    raw, mean = policy_chart(tmp_path / "p.npz", "p.npz")["series"]
    assert [y for _, y in raw["points"]] == [round(float(y), 5) for y in curve]
    assert mean["name"] == "mean of 11"
    # At the start over as much on either side, at the end over what there is.
    for at, first, last in ((0, 0, 1), (3, 0, 7), (100, 95, 106), (199, 194, 200)):
        assert mean["points"][at][1] == pytest.approx(curve[first:last].mean(), abs=1e-5)
    write_npz(tmp_path / "none.npz", {"weights": curve})
    with pytest.raises(InputError, match="learning curve"):
        policy_chart(tmp_path / "none.npz", "none.npz")


def test_training_and_reliability_are_those_of_the_documents() -> None:
    epochs = [
        {"epoch": k, "train_loss": 3 / k, "validation_loss": 4 / k, "train_mae": 0.1, "mae": 0.2, "lr": 1}
        for k in (1, 2)
    ]
    loss, mae = training_charts("m.safetensors", epochs)
    assert [series["points"] for series in loss["series"]] == [[[1, 3.0], [2, 1.5]], [[1, 4.0], [2, 2.0]]]
    assert mae["series"][1]["points"] == [[1, 0.2], [2, 0.2]]
    bins = [{"count": 3, "confidence": 0.4, "accuracy": 0.5}]
    document = {
        "mae": 0.1,
        "nll": 1.0,
        "ece": 0.02,
        "constant_baseline_mae": 0.2,
        "reliability": {"yaw": bins, "pitch": []},
    }
    yaw, pitch = reliability_charts("e.json", document)
    assert yaw["bins"] == bins
    assert pitch["bins"] == []
    assert "ECE 0.020" in yaw["detail"]
