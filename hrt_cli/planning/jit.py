"""How the kernels of this room are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True}
_LEAN: dict[str, Any] = {**_OPTIONS, "_nrt": False}

kernel: Any = njit(**_OPTIONS)
"""Compiled once, kept on disk, free of the interpreter lock."""

lean_kernel: Any = njit(**_LEAN)
"""The same without reference counting, for helpers that allocate nothing and take no slices.

Numba counts references to every array a call passes on, with atomic instructions; in helpers of a few
nanoseconds that is most of the time.
"""

lean_sums: Any = njit(**_LEAN, fastmath={"reassoc", "contract"})
"""The same for helpers that add up long rows of float32, which may be added in another order, eight at a time."""
