"""A signal waits for the end of a step, the second does not, and the handlers come back."""

from __future__ import annotations

import signal
import threading

import pytest

from hrt_cli.steering.network.signals import undivided


class Came(Exception):
    pass


@pytest.fixture(autouse=True)
def _handlers():
    def come(number: int, frame: object) -> None:
        raise Came(number)

    before = {number: signal.signal(number, come) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        assert signal.getsignal(number) is come
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_waits_for_the_end_of_the_block(number: int) -> None:
    done: list[int] = []
    with pytest.raises(Came) as raised:  # noqa: PT012 - the end of the block is what raises
        with undivided():
            signal.raise_signal(number)
            done.append(1)
        done.append(2)
    assert done == [1]
    assert raised.value.args == (number,)


def test_the_second_signal_does_not_wait() -> None:
    done: list[int] = []
    with pytest.raises(Came), undivided():  # noqa: PT012
        signal.raise_signal(signal.SIGINT)
        done.append(1)
        signal.raise_signal(signal.SIGTERM)
        done.append(2)
    assert done == [1]


def test_without_a_signal_nothing_happens_and_errors_pass() -> None:
    with undivided():
        pass
    with pytest.raises(KeyError), undivided():
        raise KeyError


def test_ignored_signals_stay_ignored() -> None:
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    with undivided():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        signal.raise_signal(signal.SIGINT)
    signal.signal(signal.SIGINT, handler)


def test_off_the_main_thread_it_does_nothing() -> None:
    done: list[int] = []

    def work() -> None:
        with undivided():
            done.append(1)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [1]
