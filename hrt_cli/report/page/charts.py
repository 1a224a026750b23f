"""Charts as data: what a page's script draws, with the numbers that it shows on hover."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hrt_cli.artifacts.npz import read_npz
from hrt_cli.artifacts.scores import PRIOR, ClassScore, read_scores
from hrt_cli.errors import InputError
from hrt_cli.raster.style import class_colour
from hrt_cli.report.figures.curve import smoothed

_MOST_POINTS = 400
_SMOOTHED_SHARE = 0.05


def score_chart(after: Path, name: str, before: Path | None, names: dict[int, str]) -> dict[str, Any]:
    """Return each class's score before and after a robot's drives, with standard deviations and metres of evidence.

    Parameters
    ----------
    after : Path
        A score table that drives taught.
    before : Path or None
        The one that it came from. None: nothing was known.
    names : dict of int to str
        Of the classes, where the tables have none.
    """
    found, earlier = read_scores(after), read_scores(before) if before else {}
    rows = [
        {
            "name": belief.name or names.get(k, "") or f"class {k}",
            "colour": class_colour(k),
            "before": _belief(earlier.get(k, PRIOR)),
            "after": _belief(belief),
            "detail": f"{belief.evidence_m:.0f} m driven",
        }
        for k, belief in sorted(found.items())
    ]
    return {"type": "scores", "title": f"{name}: score of each class before and after the drives", "rows": rows}


def score_course(tables: Sequence[tuple[str, Path]], names: dict[int, str]) -> dict[str, Any]:
    """Return how the scores of the classes went from one table to the next."""
    beliefs = [read_scores(path) for _, path in tables]
    classes = sorted({k for each in beliefs for k in each})
    series = [
        {
            "name": names.get(k, "")
            or next((each[k].name for each in beliefs if k in each and each[k].name), f"class {k}"),
            "colour": class_colour(k),
            "points": [[at + 1, round(each[k].mean, 4)] for at, each in enumerate(beliefs) if k in each],
        }
        for k in classes
    ]
    return {
        "type": "lines",
        "title": f"score of each class, {tables[0][0]} to {tables[-1][0]}",
        "x": "score tables in order",
        "y": "expected score",
        "series": series,
        "levels": [],
        "top": 1.0,
    }


def _belief(belief: ClassScore) -> dict[str, float]:
    return {"mean": round(belief.mean, 4), "sd": round(belief.sd, 4)}


def policy_chart(path: Path, name: str) -> dict[str, Any]:
    """Return the learning curve of a planning policy, and its running mean."""
    curve = read_npz(path).get("learning_curve", np.zeros(0))
    if curve.ndim != 1 or curve.size == 0 or not np.isfinite(curve).all():
        raise InputError(path, "has no learning curve")
    half = int(_SMOOTHED_SHARE * curve.size / 2)
    at, smooth = np.arange(curve.size) + 1, smoothed(curve, half)
    return {
        "type": "lines",
        "title": f"{name}: learning curve of the planning policy",
        "x": "iterations",
        "y": "share of the best cells that a rollout collects",
        "series": [
            {"name": "each iteration", "role": "faint", "points": points(at, curve)},
            {"name": f"mean of {2 * half + 1}", "role": "plan", "points": points(at, smooth)},
        ],
        "levels": [],
    }


def training_charts(name: str, epochs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return loss and error of a steering network by epoch; each epoch a row of the training's history."""
    charts = []
    for label, training, held_out in (("loss", "train_loss", "validation_loss"), ("MAE", "train_mae", "mae")):
        series = [
            {"name": told, "role": role, "points": [[each["epoch"], each[key]] for each in epochs if key in each]}
            for told, role, key in (("training", "faint", training), ("held out", "plan", held_out))
        ]
        charts.append(
            {
                "type": "lines",
                "title": f"{name}: {label} of the steering network",
                "x": "epoch",
                "y": label,
                "series": series,
                "levels": [],
            }
        )
    return charts


def reliability_charts(name: str, document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the reliability diagrams of what `hrt evaluate steer --json` printed: whether confidence is earned."""
    return [
        {
            "type": "reliability",
            "title": f"{name}: reliability of {output}",
            "bins": [
                {key: each.get(key) for key in ("confidence", "accuracy", "count")}
                for each in bins
                if isinstance(each, dict)
            ],
            "detail": f"ECE {document['ece']:.3f}, NLL {document['nll']:.2f}, MAE {document['mae']:.3f} "
            f"(a constant: {document.get('constant_baseline_mae', float('nan')):.3f})",
        }
        for output, bins in document["reliability"].items()
    ]


def points(x: np.ndarray[Any, Any], y: np.ndarray[Any, Any]) -> list[list[float]]:
    """Return the points of a curve [n], of many an even choice with the first and the last."""
    keep = np.unique(np.linspace(0, len(x) - 1, min(len(x), _MOST_POINTS)).astype(int))
    return [[round(float(a), 3), round(float(b), 5)] for a, b in zip(x[keep], y[keep], strict=True)]
