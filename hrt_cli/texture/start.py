"""What makes the first second of a process shorter."""

from __future__ import annotations

import importlib
import sys


def spare_linear_algebra() -> None:
    """Let numba start without SciPy's linear algebra, whose import takes as long as decoding 40 megapixels.

    When numba loads its first kernel it looks for a BLAS there, for `np.dot` inside kernels; no kernel of this
    package has one. Nothing is done in a process that has either already.
    """
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # importing it raises ImportError
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg"]
