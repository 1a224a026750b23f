"""The benchmarks still run: every section on inputs as small as they go."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
METHODS = {"hrt texture, aware", "hrt texture, invariant", "hrt texture, sorted"}


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "texture"))
    module = importlib.import_module("texture")
    tables = importlib.import_module("tables")
    tiny = tables.Effort(
        bank_px=256, slow_px=256, crop_px=192, raster_px=(256,), tile_px=256, mosaics=1, composites=1, seeds=1,
        site_px=200, sites=0,
    )  # fmt: skip
    monkeypatch.setattr(module, "NORMAL", tiny)
    monkeypatch.setattr(module.texture_kernel, "ORFEO", "no such program")
    return module


def run(bench: ModuleType, path: Path, *sections: str) -> dict[str, list[dict[str, object]]]:
    bench.main([*sections, "--json", str(path)])
    told = json.loads(path.read_text(encoding="utf-8"))
    assert told["machine"]["packages"]["numpy"] == np.__version__
    return {name: one["tables"][0]["rows"] for name, one in told["sections"].items()}


def test_other_banks_compute_what_the_fused_one_does(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # scikit-image's longest kernels take ten seconds even here: cv2.filter2D stands in.
    kernel = bench.texture_kernel
    monkeypatch.setattr(kernel, "scikit_bank", kernel.filter2d_bank)
    rows = run(bench, tmp_path / "out.json", "speed-kernel")["speed-kernel"]
    assert [row["bank"] for row in rows].count("hrt") == 2
    assert all(row["Mpx/cpu-s"] > 0 and row["hrt is faster by"] > 0 for row in rows)
    others = [row for row in rows if not str(row["bank"]).startswith("hrt")]
    assert len(others) == 4
    assert all(row["correlation"] > 0.97 for row in others)
    assert "Orfeo left out" in capsys.readouterr().out


def test_scikit_image_computes_it_too(bench: ModuleType) -> None:
    kernel = bench.texture_kernel
    image = kernel.natural_image(64)
    assert np.allclose(kernel.scikit_bank(image, [4.0])[:, :, 1:-1, 1:-1],
                       kernel.filter2d_bank(image, [4.0])[:, :, 1:-1, 1:-1], rtol=1e-4)  # fmt: skip


def test_quality(bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.texture_mosaics, "DATA", tmp_path)
    rows = run(bench, tmp_path / "out.json", "quality-rotated", "quality-synth")
    by_method = {row["method"]: row["ARI"] for row in rows["quality-rotated"]}
    assert set(by_method) == METHODS
    assert by_method["hrt texture, invariant"] > by_method["hrt texture, aware"]
    assert {row["scene"] for row in rows["quality-synth"]} == {"meadow", "wildfire", "reef"}
    assert all(0 < row["accuracy"] <= 1 for row in rows["quality-synth"])


@pytest.mark.slow
def test_the_whole_command(bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = bench.texture_command
    costs = iter([(3.0, 200), (2.0, 200), (4.0, 300), (4.5, 350), (10.0, 330), (11.0, 360)])

    def segment_cost(ortho: Path, out: Path, workers: int) -> object:
        cpu_s, peak_mb = next(costs)
        return command.Cost(cpu_s, cpu_s, peak_mb)

    really = command.segment_cost
    monkeypatch.setattr(command, "segment_cost", segment_cost)
    monkeypatch.setattr(command, "plain_cost", lambda tile, side: 1.0)
    (table,) = command.speed_command(replace(bench.NORMAL, raster_px=(256, 512)))
    assert [row["what"] for row in table.rows].count("hrt segment") == 4
    assert table.rows[1]["less start-up"] == pytest.approx(256**2 / 1e6 / 2)
    assert table.notes[-1].endswith("0.0328 Mpx per CPU second for what is added, peak memory +10.0%.")
    command.write_raster(
        tmp_path / "ortho.tif", 256, np.random.default_rng(1).integers(0, 256, (3, 256, 256), np.uint8)
    )
    assert really(tmp_path / "ortho.tif", tmp_path / "classes.tif", 1).cpu_s > 0
    assert (tmp_path / "classes.tif").exists()


def test_the_memory_of_the_parent_is_not_the_child_s(bench: ModuleType) -> None:
    held = np.ones(50_000_000)
    cost = bench.texture_command.process_cost([sys.executable, "-c", "bytearray(60_000_000)"])
    assert 60 < cost.peak_mb < 150 < held.nbytes / 1e6
    with pytest.raises(RuntimeError, match="status 1"):
        bench.texture_command.process_cost([sys.executable, "-c", "raise SystemExit(3)"])


def test_what_is_missing_is_skipped_with_a_word(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench.texture_mosaics, "DATA", tmp_path)
    bench.main(["quality-outex", "quality-sites", "--json", str(tmp_path / "out.json")])
    sections = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["sections"]
    assert "absent" in sections["quality-outex"]["skipped"]
    assert "quality-sites: skipped" in capsys.readouterr().out


def test_an_unknown_section_is_refused(bench: ModuleType) -> None:
    with pytest.raises(SystemExit):
        bench.main(["speed-of-light"])
