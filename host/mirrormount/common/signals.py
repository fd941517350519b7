"""Signals that end a program, turned into an exception, so that what is under way is put in order. Imports nothing."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

NAMES = ("SIGTERM", "SIGHUP")


class Interrupts:
    """Ctrl-C in a process of ours, once note() was called. It raises KeyboardInterrupt, as ever.

    came: there has been one; NumPy's import, for one, makes another error of it. over: further ones do nothing. Where
    that is assigned, and no function called, no further one comes between.
    """

    came = False
    over = False

    def note(self) -> None:
        """Begin, in the main thread."""
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.handle)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """The handler."""
        self.came = True
        if not self.over:
            signal.default_int_handler(number, frame)

    @contextlib.contextmanager
    def left_to_python(self) -> Iterator[None]:
        """Python's own handler is there within this: asyncio leaves every other one alone."""
        before = signal.getsignal(signal.SIGINT)
        if before != self.handle or threading.current_thread() is not threading.main_thread():
            yield
            return
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


INTERRUPTS = Interrupts()


class Terminated(BaseException):
    """A signal asks this program to end. Like KeyboardInterrupt it is no Exception; number is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.number = number


@contextlib.contextmanager
def ended_in_order(*, interrupts: bool = False) -> Iterator[None]:
    """SIGTERM and SIGHUP raise Terminated within this, in the main thread; further ones are ignored from then on.

    interrupts: a second Ctrl-C is ignored, too: the first one raises KeyboardInterrupt, as ever, and ends them all.
    A signal that was ignored before (nohup) stays so. The handlers of before are there again afterwards.
    """
    names = (*NAMES, "SIGINT") if interrupts else NAMES
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def end(number: int, _frame: FrameType | None) -> None:
        for every in before:
            signal.signal(every, signal.SIG_IGN)  # nothing may interrupt the order that is made now
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated(number)

    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
