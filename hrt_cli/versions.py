"""What a bug report needs: versions of the program, of all it stands on, and of the machine."""

from __future__ import annotations

import io
import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout

from hrt_cli import __version__

_SETTINGS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "NUMBA_CACHE_DIR",
    "NUMBA_DISABLE_JIT",
    "GDAL_CACHEMAX",
    "GDAL_NUM_THREADS",
    "PROJ_DATA",
    "PROJ_NETWORK",
    "CUDA_VISIBLE_DEVICES",
    "HRT_DEBUG",
)
"""Environment variables that change how fast or how exactly the program computes."""


_MODULES = {"opencv-python-headless": "cv2", "scikit-learn": "sklearn"}
"""What is imported of packages that are not called as their module is."""


def lines() -> Iterator[str]:
    """Yield `name: value` lines; what is broken says so in its own."""
    yield f"hrt: {__version__}"
    yield f"Python: {sys.version.split()[0]} ({platform.python_implementation()})"
    yield f"system: {platform.platform()}"
    yield f"machine: {platform.machine()}, {os.cpu_count()} CPUs"
    core, extras = _requirements()
    for name in core:
        yield f"{name}: {_version(name)}{_problem(name)}"
    for name, ask in _LIBRARIES.items():
        yield f"{name}: {_attempt(ask)}"
    for extra, names in extras.items():
        yield f"extra {extra}: {', '.join(f'{name} {_version(name)}' for name in names)}"
    for name in _SETTINGS:
        if name in os.environ:
            yield f"{name}={os.environ[name]}"


def _attempt(ask: Callable[[], str]) -> str:
    # A package may fail in any way when it is imported: what is broken is what a report is about.
    # What it prints meanwhile (OpenCV does without NumPy) is no line of ours.
    try:
        with redirect_stdout(io.StringIO()):
            return ask()
    except Exception as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _problem(package: str) -> str:
    """Return why a package cannot be imported, with a comma before; torch, which takes seconds, is only looked for."""
    module = _MODULES.get(package, package.replace("-", "_"))

    def find() -> str:
        from importlib import import_module
        from importlib.util import find_spec

        if find_spec(module) is None:
            return f"there is no module {module}"
        if module != "torch":
            import_module(module)
        return ""

    problem = _attempt(find)
    return f", cannot be imported: {problem}" if problem else ""


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Return the packages that hrt needs, and those of each extra, as its own metadata name them."""
    import re
    from importlib.metadata import PackageNotFoundError, requires

    try:
        declared = requires("hrt") or []
    except PackageNotFoundError:  # run from its sources
        return [], {}
    core: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in declared:
        name = re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0]
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", line)
        (core if extra is None else extras.setdefault(extra[1], [])).append(name)
    extras.pop("dev", None)
    return core, extras


def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def _gdal() -> str:
    import rasterio

    return str(rasterio.__gdal_version__)


def _proj() -> str:
    import rasterio

    return str(rasterio.__proj_version__)


def _geos() -> str:
    import shapely

    return ".".join(map(str, shapely.geos_version))


def _cuda() -> str:
    # Not asked of torch itself, which takes seconds to import: its version file says what it was built for.
    import re
    from importlib.util import find_spec

    spec = find_spec("torch")
    if spec is None or not spec.submodule_search_locations:
        return "torch is absent"
    with open(os.path.join(next(iter(spec.submodule_search_locations)), "version.py"), encoding="utf-8") as file:
        built = re.search(r"^cuda.*= *['\"](.+)['\"]", file.read(), re.MULTILINE)
    driver = "a" if os.path.exists("/proc/driver/nvidia/version") else "no"
    return f"torch built {f'for CUDA {built[1]}' if built else 'without CUDA'}; {driver} NVIDIA driver"


_LIBRARIES: dict[str, Callable[[], str]] = {"GDAL": _gdal, "PROJ": _proj, "GEOS": _geos, "CUDA": _cuda}
