"""Where and with what numbers to compute, and how to compute the same twice.

The bytes of a trained network depend on the device, the numbers and, on a CPU, the number of threads (sums are split
among them), so all three are part of what a training is. They also depend on the build of PyTorch and on the kernels
that it picks for the kind of CPU or GPU; nobody chooses those, and they are not.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from hrt_cli.progress import Note, unheard

Precision = Literal["auto", "float32", "bf16"]

_CPUINFO = Path("/proc/cpuinfo")
_NATIVE = {"avx512_bf16", "amx_bf16"}
"""What Linux calls a CPU's own bfloat16 arithmetic. Without it PyTorch emulates: ten times slower than float32."""


@dataclass(frozen=True)
class Arithmetic:
    """Where to compute, and whether the forward pass in training is bfloat16.

    Attributes
    ----------
    device : {"cpu", "cuda"}
    bf16 : bool
        Under autocast; weights, loss and optimiser are float32 in any case.
    """

    device: Literal["cpu", "cuda"]
    bf16: bool

    @property
    def precision(self) -> Literal["float32", "bf16"]:
        """Its name."""
        return "bf16" if self.bf16 else "float32"


def choose(precision: Precision, note: Note = unheard) -> Arithmetic:
    """Return what to compute with on this machine.

    A GPU that CUDA finds is used. `auto` is bfloat16 where the device computes it natively, else float32.
    """
    device: Literal["cpu", "cuda"] = "cuda" if torch.cuda.is_available() else "cpu"
    native = torch.cuda.is_bf16_supported() if device == "cuda" else cpu_computes_bf16()
    if precision == "bf16" and not native:
        note(
            f"Warning: this {device} only emulates bf16, many times slower than float32; --precision float32 is faster"
        )
    return Arithmetic(device, native if precision == "auto" else precision == "bf16")


def cpu_computes_bf16(cpuinfo: Path = _CPUINFO) -> bool:
    """Tell whether every core here has bfloat16 of its own, and PyTorch the library that uses it."""
    try:
        text = cpuinfo.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False  # no Linux: float32 is right anywhere
    cores = [set(flags.split()) for flags in re.findall(r"^flags\s*:(.*)$", text, re.MULTILINE)]
    return bool(cores) and all(_NATIVE & flags for flags in cores) and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]


@contextmanager
def on_threads(count: int) -> Iterator[None]:
    """Compute on so many threads of the CPU (0: as many as were set), and set what was set before in the end."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def repeatable(arithmetic: Arithmetic, threads: int) -> Iterator[None]:
    """Compute so that the same is computed again; put PyTorch's global settings back in the end.

    On a GPU a few operations have no deterministic form; there a second training may differ in the last digits.

    Parameters
    ----------
    threads : int
        Of PyTorch on the CPU.
    """
    on_gpu = arithmetic.device == "cuda"
    if on_gpu:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    deterministic = torch.utils.deterministic
    before = (
        torch.are_deterministic_algorithms_enabled(),
        torch.is_deterministic_algorithms_warn_only_enabled(),
        deterministic.fill_uninitialized_memory,  # type: ignore[attr-defined]
        torch.backends.cudnn.allow_tf32,
    )
    try:
        with on_threads(threads), torch.random.fork_rng(), warnings.catch_warnings():
            torch.use_deterministic_algorithms(True, warn_only=on_gpu)
            # Nothing here reads what it has not written, and filling it takes time.
            deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
            torch.backends.cudnn.allow_tf32 = False
            if on_gpu:
                warnings.filterwarnings("ignore", message=".*does not have a deterministic implementation")
            yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])
        deterministic.fill_uninitialized_memory = before[2]  # type: ignore[attr-defined]
        torch.backends.cudnn.allow_tf32 = before[3]
