"""Signals that wait for the end of a step, so that what a stopped training leaves is whole."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def undivided() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the block is done, then handle them as before; the second does not wait.

    Signals that the program ignores or leaves to the system are left alone, and off the main thread, which alone gets
    signals, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    waiting: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        waiting.append(number)
        if len(waiting) > 1:
            restore()
            signal.raise_signal(number)

    def restore() -> None:
        for number, handler in handlers.items():
            signal.signal(number, handler)

    try:
        for number in handlers:
            signal.signal(number, hold)
        yield
    finally:
        restore()
    if waiting:
        signal.raise_signal(waiting[0])
