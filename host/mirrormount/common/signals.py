"""Signals that end a program, turned into an exception, so that what is under way is put in order. Imports nothing."""

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

NAMES = ("SIGTERM", "SIGHUP")


class Terminated(BaseException):
    """A signal asks this program to end. Like KeyboardInterrupt it is no Exception; number is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.number = number


@contextlib.contextmanager
def ended_in_order() -> Iterator[None]:
    """SIGTERM and SIGHUP raise Terminated within this, in the main thread; further ones are ignored from then on.

    A signal that was ignored before (nohup) stays so. The handlers of before are there again afterwards.
    """
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def end(number: int, _frame: FrameType | None) -> None:
        for every in before:
            signal.signal(every, signal.SIG_IGN)  # systemd sends both: the second must not interrupt the stop
        raise Terminated(number)

    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
