"""common/signals.py: the first signal ends what is under way, no other one interrupts the order that is made then."""

import signal

import pytest

from mirrormount.common.signals import ended_in_order


@pytest.mark.parametrize("second", ["SIGINT", "SIGTERM"])
def test_a_second_signal_does_not_interrupt_what_the_first_ctrl_c_began(second):
    before, written = signal.getsignal(signal.SIGINT), []

    def interrupted():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(getattr(signal, second))
            written.append("a file")

    with pytest.raises(KeyboardInterrupt), ended_in_order(interrupts=True):
        interrupted()
    assert written == ["a file"]
    assert signal.getsignal(signal.SIGINT) == before
