from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch
from tiny_trunk import TinyTrunk

from hrt_cli.steering.network import net as network


@contextmanager
def _tiny() -> Iterator[None]:
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "ResNet18", TinyTrunk)
        torch.set_num_threads(1)
        yield
    torch.set_num_threads(threads)


@pytest.fixture
def tiny() -> Iterator[None]:
    """Networks with a tiny trunk, and one thread."""
    with _tiny():
        yield


@pytest.fixture
def cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """No GPU, whatever this machine has."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@pytest.fixture(scope="module")
def tiny_throughout() -> Iterator[None]:
    """The same for all of a module, and for what its tests share."""
    with _tiny():
        yield
