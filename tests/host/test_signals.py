"""terminal.py: the first signal ends what is under way, no other one interrupts the order that is made then."""

import signal

import pytest

from mirrormount.terminal import Terminated, ended_in_order


def test_a_second_signal_does_not_interrupt_what_the_first_began():
    before, written = signal.getsignal(signal.SIGTERM), []

    def interrupted():
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)
            written.append("a file")

    with pytest.raises(Terminated), ended_in_order():
        interrupted()
    assert written == ["a file"]
    assert signal.getsignal(signal.SIGTERM) == before
