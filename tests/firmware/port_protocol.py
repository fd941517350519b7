"""The verbs of a port: what the core asks of a platform. tests/firmware/test_ports.py checks every port against it."""

from collections.abc import Callable, Iterator
from typing import Any, Protocol


class Output(Protocol):
    """An output pin, low from the start."""

    def low(self) -> None:
        """Pin low, at once where the platform can."""

    def high(self) -> None:
        """Pin high."""


class Port(Protocol):
    """The hardware's verbs. Times wrap at 2**30; file verbs raise OSError."""

    # ---- time

    def ticks_us(self) -> int: ...

    def ticks_ms(self) -> int: ...

    def pause_us(self, us: int) -> object:
        """Wait without sleeping."""

    # ---- bytes; wire/receiver.py says what is done with each

    def any(self, wait_ms: int) -> bool:
        """True as soon as a byte waits; False after wait_ms without one. The loop sleeps only here."""
        ...

    def drain(self, receiver: Any, most: int) -> int:
        """Hand at most `most` bytes that wait to the receiver, no further than to a stop. Returns that stop, or 0.

        A board with an input of its own needs none.
        """
        ...

    def pack(self, ring: Any, at: int, mask: int) -> int:
        """wire.frame.pack(), or faster code that does the same."""
        ...

    def writable(self) -> bool:
        """True if write() neither blocks nor loses its byte."""
        ...

    def write(self, c: int) -> None: ...

    # ---- pins

    def output(self, number: int, pwm_hz: int = 0) -> Output:
        """An output pin; with pwm_hz it has level(duty_u16), too."""
        ...

    def reader(self, number: int | None) -> Callable[[], int] | None:
        """A function that reads an input against its pull-up; None for None."""
        ...

    def analog(self, number: int) -> Callable[[], int]:
        """A function that reads analog input `number`, 0 ... 65535, without an allocation."""
        ...

    def encoder(self, number: int, pins: dict[str, Any]) -> Any:
        """The reader (ports/encoders.py) of an axis whose pins name an encoder; None, after a printed line."""
        ...

    def on_rise(self, number: int, handler: Callable[[Any], None]) -> None:
        """Call handler(pin) from an interrupt when that input rises, where the platform has such interrupts."""

    def led(self, on: bool) -> None: ...

    # ---- the board

    def unique_id(self) -> bytes: ...

    def boot_id(self) -> int: ...

    def reset_cause(self) -> int:
        """As in codes.py."""
        ...

    def firmware_hash(self) -> Iterator[bytes | None]: ...

    def start_watchdog(self) -> Callable[[], object]:
        """From here on the board is reset unless the returned function is called every second."""
        ...

    def stop_watchdog(self) -> None: ...

    def collect(self) -> None:
        """Collect garbage."""

    def free_memory(self) -> int:
        """Free bytes of the heap. Allocates nothing."""
        ...

    def uninterrupted(self, action: Callable[[Any], object], argument: Any) -> None:
        """action(argument), started again whenever Ctrl-C interrupts it, until it is done."""

    # ---- files

    def load(self, name: str) -> bytes | None:
        """The first bytes of a file, b"" if it cannot be read, None if it is absent."""
        ...

    def store(self, name: str, data: bytes) -> None: ...

    def rename(self, old: str, new: str) -> None:
        """Replaces `new`, wholly or not at all."""

    def remove(self, name: str) -> None: ...


class OptionalVerbs(Protocol):
    """Verbs that a port may have: without one, the core does it by the others."""

    def gate(self, board: Any) -> Any:
        """The gate of a board file's drive pins (docs/gate.md), not yet in place; None on a chip that it does not know.

        It has enter(), leave(), release(), differs(), recount() and axes, each with end_at(), clock() and ended().
        """

    def lane(self, controller: Any, receiver: Any, frame: Any, replies: Any, commands: Any, board: Any) -> Any:
        """An input of the port's own, which may drive at frames (docs/gate.md), instead of app.Input."""


class EntryPort(Port, Protocol):
    """The verbs that only the entry files and the prompt use: the rig's port has none of these."""

    def find_board(self) -> Any:
        """The board file as a module; None, after a printed line, if there is none or it cannot be used."""

    def motors_off(self, board: Any) -> None:
        """Every drive pin of every axis low, the enables first."""

    def leave(self, board: Any) -> None:
        """Motors and watchdog off, however often Ctrl-C comes meanwhile."""
