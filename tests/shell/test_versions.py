"""`hrt --show-versions`: what a bug report needs, also where something is broken."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import requires, version
from pathlib import Path

import pytest

from hrt_cli import __version__

TEMPLATE = Path(__file__).parents[2] / ".github" / "ISSUE_TEMPLATE" / "bug_report.md"


def shown(**env: str) -> dict[str, str]:
    command = [sys.executable, "-m", "hrt_cli.main", "--show-versions"]
    done = subprocess.run(command, env=os.environ | env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return dict(line.replace("=", ": ", 1).split(": ", 1) for line in done.stdout.splitlines())


@pytest.fixture(scope="module")
def found() -> dict[str, str]:
    return shown(OMP_NUM_THREADS="3")


def test_the_version_is_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hrt_cli.main", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"hrt {__version__}\n"


def test_program_machine_and_settings_are_told(found: dict[str, str]) -> None:
    assert found["hrt"] == __version__
    assert found["Python"].startswith(sys.version.split()[0])
    assert f"{os.cpu_count()} CPUs" in found["machine"]
    assert found["OMP_NUM_THREADS"] == "3"


def test_every_package_that_is_needed_is_told(found: dict[str, str]) -> None:
    needed = [line for line in requires("hrt") or [] if "extra" not in line]
    assert len(needed) > 10
    for line in needed:
        name = line.split(">")[0].split("<")[0].split("!")[0]
        assert found[name] == version(name)


def test_the_libraries_beneath_are_told(found: dict[str, str]) -> None:
    import rasterio
    import shapely

    assert found["GDAL"] == rasterio.__gdal_version__
    assert found["GEOS"] == shapely.geos_version_string
    assert found["PROJ"] == rasterio.__proj_version__
    assert "CUDA" in found["CUDA"]
    assert any(name.startswith("extra ") for name in found)


def test_a_broken_package_says_so_in_its_line_and_the_others_stay(tmp_path: Path, found: dict[str, str]) -> None:
    for name in ("rasterio", "shapely", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('lib" + name + ".so:\\n cannot open')\n")
    path = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    broken = shown(PYTHONPATH=path)
    problem = "cannot be imported: ImportError: librasterio.so: cannot open"
    assert broken["rasterio"] == f"{found['rasterio']}, {problem}"
    assert broken["GDAL"] == "ImportError: librasterio.so: cannot open"
    assert "libnumpy.so" in broken["numpy"]
    assert broken["click"] == found["click"]


def test_torch_is_not_imported() -> None:
    probe = (
        "import sys; sys.argv = ['hrt', '--show-versions']\n"
        "from hrt_cli.main import main\ntry: main()\nfinally: print('torch' in sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stderr == "False\n"


def test_the_template_of_a_bug_report_asks_for_it() -> None:
    assert "hrt --show-versions" in TEMPLATE.read_text(encoding="utf-8")
