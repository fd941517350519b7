"""What is checked of a driver, and how: each check on a board at rest, from zero, with no errors waiting."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pins import told
from place import SETTINGS, WAYS, Place

_AT_REST = "AB;*RCL1;XK0;1DH;2DH"
NO_ERROR = "0"


class Driver(Protocol):
    """A file driver_NAME.py: how a published driver is opened and closed, how it sends any line, and its checks."""

    NAME: str
    WAYS: tuple[str, ...]  # of place.WAYS
    CHECKS: "list[Check]"

    def connect(self, address: str, way: str, **options: Any) -> Any: ...

    def disconnect(self, driver: Any) -> None: ...

    def send(self, driver: Any, line: str) -> str:
        """Send a command line as it stands; its answer if it ends in `?`, else ""."""
        ...


@dataclass(frozen=True)
class Check:
    """call: what a program writes, for the table. run raises if the pins or the positions are not what they must be.

    ways: over which of place.WAYS it makes sense. slow: it takes so long that the tests run it at one place only.
    """

    call: str
    run: "Callable[[Trial], None]"
    ways: tuple[str, ...]
    slow: bool = False

    @property
    def name(self) -> str:
        """The fact that it checks."""
        return self.run.__name__


class Checks(list[Check]):
    """The checks of a driver; `@CHECKS.add(call)` puts one in."""

    def add(
        self, call: str, ways: tuple[str, ...] = WAYS, *, slow: bool = False
    ) -> "Callable[[Callable[[Trial], None]], None]":
        """Decorates a function whose name is the fact that it checks."""

        def put(run: "Callable[[Trial], None]") -> None:
            self.append(Check(call, run, ways, slow))

        return put


class Trial:
    """A published driver that is connected to a place; checks get this. driver is the published one's object."""

    def __init__(self, kind: Driver, place: Place) -> None:
        self.kind, self.place = kind, place
        self.driver: Any = None
        self.connect()

    def connect(self, **options: Any) -> None:
        """Connect, or connect anew."""
        self.disconnect()
        self.driver = self.kind.connect(self.place.address, self.place.way, **options)

    def disconnect(self) -> None:
        """Close the driver, as a program that ends would."""
        driver, self.driver = self.driver, None
        if driver is not None:
            self.kind.disconnect(driver)

    def restart(self) -> None:
        """Cut the board's power for a moment, and connect again."""
        self.disconnect()
        self.place.restart()
        self.connect()

    def line(self, text: str) -> str:
        """A command line for which the driver has no method."""
        return self.kind.send(self.driver, text)

    def errors(self) -> list[int]:
        """The errors that the board has queued, taken from its queue."""
        numbers = []
        while (number := self.line("TE?")) != NO_ERROR:
            numbers.append(int(number))
        return numbers

    def run(self, check: Check) -> None:
        """Run a check. Raises what it raises, or AssertionError if it leaves a motor driven or an unexpected error."""
        if self.driver is None:
            self.connect()
        self.line(_AT_REST)
        self.errors()
        self.place.mark()
        try:
            check.run(self)
            assert self.errors() == [], "the board has queued errors"
            assert not self.place.driving(), "a motor is left driven"
        except BaseException:
            self.disconnect()  # the next check begins with another connection
            raise

    def told(self) -> str:
        """What the pins did in the last check, in words."""
        return told(self.place.drives())


@contextmanager
def trial(kind: Driver, way: str, machine: str) -> Iterator[Trial]:
    """A driver at a new place. Raises EmulatorMissing if there is no such machine here."""
    with tempfile.TemporaryDirectory(prefix="mirrormount-") as folder:
        settings, encoder = getattr(kind, "SETTINGS", SETTINGS), getattr(kind, "ENCODER", None)
        place = Place(Path(folder), way, machine, settings, encoder)
        try:
            opened = Trial(kind, place)
            try:
                yield opened
            finally:
                opened.disconnect()
        finally:
            place.close()
