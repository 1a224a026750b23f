from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from tiny_trunk import TinyTrunk

from hrt_cli.steering import network


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Networks with a tiny trunk, and one thread."""
    monkeypatch.setattr(network, "ResNet18", TinyTrunk)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
