"""Which arithmetic a machine gets, and that the settings of PyTorch come back."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from hrt_cli.steering.network import precision
from hrt_cli.steering.network.precision import Arithmetic, choose, cpu_computes_bf16, repeatable

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
