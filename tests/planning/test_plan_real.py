from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrt_cli.planning.planner import plan
from hrt_cli.planning.problem import Budget, Problem

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "planning" / "gaussian_mixture_test1.npz"


@pytest.mark.real
@pytest.mark.skipif(not DATA.exists(), reason="the Gaussian-mixture map is not here")
def test_published_test_map_is_nearly_emptied():
    with np.load(DATA, allow_pickle=False) as arrays:
        score = arrays["score"]
    starts = [(row, col) for row in (0, 14, 29) for col in (0, 14, 29)]
    share = {
        method: np.mean([plan(Problem(score, s, Budget(200.0)), method).score for s in starts]) / score.sum()
        for method in ("policy", "policy-sample", "refined", "greedy", "lawnmower")
    }
    assert share["policy"] > 0.97
    assert share["policy-sample"] > 0.97
    assert share["refined"] > 0.98
    assert share["greedy"] < 0.7
    assert share["lawnmower"] < 0.35
