"""Which arithmetic a machine gets, and that the settings of PyTorch come back."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from hrt_cli.steering import precision
from hrt_cli.steering.precision import Arithmetic, choose, cpu_computes_bf16, keep_memory, repeatable

CORE = "processor\t: {}\nflags\t\t: fpu avx avx2 {}\nbugs\t\t: spectre\n\n"


@pytest.mark.parametrize(
    ("flags", "native"),
    [
        (["avx512_bf16", "avx512_bf16"], True),
        (["amx_bf16 amx_tile"], True),
        (["avx512f avx512_vnni"], False),
        (["avx512_bf16", ""], False),
        (["avx512_bf16_not"], False),
        ([], False),
    ],
)
def test_only_a_cpu_whose_every_core_computes_bf16_gets_it(tmp_path: Path, flags: list[str], native: bool) -> None:
    path = tmp_path / "cpuinfo"
    path.write_text("".join(CORE.format(i, each) for i, each in enumerate(flags)))
    assert cpu_computes_bf16(path) is native


def test_a_system_that_does_not_tell_gets_float32(tmp_path: Path) -> None:
    assert not cpu_computes_bf16(tmp_path / "absent")


@pytest.mark.parametrize("native", [False, True])
def test_what_is_asked_for_is_used_and_auto_is_what_the_device_can(
    native: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(precision, "cpu_computes_bf16", lambda: native)
    notes: list[str] = []
    assert choose("float32", notes.append) == Arithmetic("cpu", False)
    assert choose("auto", notes.append) == Arithmetic("cpu", native)
    assert not notes
    assert choose("bf16", notes.append) == Arithmetic("cpu", True)
    assert len(notes) == (not native)
    assert Arithmetic("cpu", True).precision == "bf16"


def test_a_gpu_is_used_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: True)
    assert choose("auto") == Arithmetic("cuda", True)
    assert choose("float32") == Arithmetic("cuda", False)


def test_settings_and_generator_of_pytorch_are_put_back() -> None:
    threads = torch.get_num_threads()
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    with pytest.raises(KeyError), repeatable(Arithmetic("cpu", False), threads + 1):  # noqa: PT012
        assert torch.get_num_threads() == threads + 1
        assert torch.are_deterministic_algorithms_enabled()
        torch.manual_seed(1)
        raise KeyError
    assert torch.get_num_threads() == threads
    assert not torch.are_deterministic_algorithms_enabled()
    torch.testing.assert_close(torch.rand(3), expected)


_FAULTS = """
import resource
from hrt_cli.steering.precision import keep_memory
import torch
if {keep}:
    keep_memory()
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        [torch.ones(4_000_000) for _ in range(8)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
print(faults())
"""


def test_memory_that_is_freed_is_used_again() -> None:
    """Twenty times 128 MB of pages of 4 kB; kept, they come from the system once."""
    if not hasattr(ctypes.CDLL(None), "mallopt"):
        pytest.skip("the C library is not glibc")
    found = [
        int(subprocess.run([sys.executable, "-c", _FAULTS.format(keep=keep)], capture_output=True, text=True).stdout)
        for keep in (False, True)
    ]
    assert found[1] < 0.1 * found[0]


def test_a_c_library_without_mallopt_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    keep_memory()
