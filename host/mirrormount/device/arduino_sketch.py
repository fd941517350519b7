"""Drives an Arduino that runs the paper's own sketch, within the limits of that sketch.

The sketch parses frames only. It takes about 143 ms for each, loses bytes that arrive meanwhile,
cannot time a pulse and never stops by itself; docs/protocol.md has the measurements. So frames
are spaced, each is confirmed by its echo, and a stop is repeated until it is confirmed.
"""

from typing import Self

from mirrormount.common.errors import BadValue, ConnectionLost, MountError, NoAnswer, NotAMount, NotSupported
from mirrormount.common.validation import jog_duty, whole_number
from mirrormount.device.frame import encode
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_port
from mirrormount.transport.stop_socket import STOPPED
from mirrormount.transport.stoppable import Stoppable

LIMITS = (
    "the paper's sketch: a step is timed by this computer (about 0.2 s, +-2 ms), positions are unknown,"
    " and if this program or the cable dies while a motor runs, the motor runs on"
)
MOST_STEPS = 10_000
_BAUD = 9600
_RESET_S = 2.0  # opening the port resets an Arduino; its boot loader waits this long
_SPACING_S = 0.2  # the sketch needs 143 ms for a frame
_PULSE_S = 0.2
_ECHO_S = 0.5
_LOOK_S = 0.1  # between two looks at whether another program has stopped the motors


class SketchMount:
    """The part of a Mount that the sketch can do: step, drive, jog, stop. Use open()."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.stoppable: Stoppable | None = None
        self._stops = 0  # by other programs,
        self._since = 0  # and as many of them were before the present motion
        self._free_at = 0.0  # when the sketch reads again
        link.sleep(_RESET_S)
        link.drain(0.1)
        link.write(b"*IDN?\n")  # to the sketch a frame of zeros
        link.sleep(_SPACING_S)
        if b"mirrormount," in link.drain(0.1):
            raise NotAMount("this board runs mountfw, which can do more: leave --sketch out")
        self.stop()
        self.x = SketchAxis(self, "x", 2)
        self.y = SketchAxis(self, "y", 1)

    @classmethod
    def open(cls, address: str) -> Self:
        """Open the port of an Arduino; it must be named. Raises CannotOpen, NotAMount."""
        link = Link(open_port(address, baud=_BAUD))
        try:
            mount = cls(link)
            mount.stoppable = Stoppable([address], mount.stop_for_another_program)
            return mount
        except BaseException:
            link.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        finally:
            self.close()

    def close(self) -> None:
        """Close the port. A running motor runs on: stop() first."""
        if self.stoppable:
            self.stoppable.close()
        self.link.close()

    def axis(self, name: str) -> "SketchAxis":
        """x or y. Raises BadValue."""
        if name not in ("x", "y"):
            raise BadValue(f"there is no axis {name!r}: the sketch has x, y")
        return self.x if name == "x" else self.y

    def drive(self, m1: int, m2: int) -> None:
        """Drive both motors at -255 ... 255. Raises BadValue, NoAnswer if the sketch did not echo it."""
        self.begin()
        self._drive(m1, m2)

    def begin(self) -> None:
        """A motion is asked for now: stops of other programs from now on end it."""
        self._since = self._stops

    def _drive(self, m1: int, m2: int) -> None:
        frame = encode(whole_number(m1, 255, "m1"), whole_number(m2, 255, "m2"))
        with self.link.lock:
            self._wait_until_free()
            self._check_stops()
            if not self._send(frame):
                self.stop()
                raise NoAnswer("the sketch did not confirm a frame; stopped")

    def stop(self) -> None:
        """Stop both motors: at once, and again until the sketch has confirmed it.

        A stop that reaches the sketch within 32 ms of another frame is lost with it, so the first
        may not be enough. Raises NotAMount, ConnectionLost.
        """
        with self.link.lock:
            zero = encode(0, 0)
            self.link.write(zero)
            self._free_at = self.link.monotonic() + _SPACING_S
            for _ in range(3):
                self._wait_until_free()
                self.link.drain(0.02)
                if self._send(zero):
                    return
        raise NotAMount("the paper's sketch does not answer here")

    def stop_for_another_program(self) -> str:
        """Stop both motors, and end the motion that is under way. Returns STOPPED; raises as stop()."""
        self._stops += 1
        self.link.port.write(encode(0, 0))  # for no lock is waited
        self.stop()
        return STOPPED

    def _check_stops(self) -> None:
        if self._stops != self._since:
            raise MountError("another program has stopped the motors (mirrormount stop)")

    def status(self) -> None:
        """Raises NotSupported."""
        raise NotSupported(f"no status or position: {LIMITS}")

    def sleep(self, seconds: float) -> None:
        """Let time pass. Raises MountError if another program stops the motors meanwhile."""
        end = self.link.monotonic() + seconds
        while (left := end - self.link.monotonic()) > 0:
            self._check_stops()
            self.link.sleep(min(left, _LOOK_S))
        self._check_stops()

    def pulse(self, m1: int, m2: int) -> None:
        """One step of a motion: on, 0.2 s by this computer's clock, off. The off is always sent."""
        try:
            self._drive(m1, m2)
            # the sketch reads the next frame only after this one
            self.link.sleep(max(0.0, self._free_at - _SPACING_S + _PULSE_S - self.link.monotonic()))
        finally:
            with self.link.lock:
                self._free_at = 0.0
                if not self._send(encode(0, 0)):
                    self.stop()

    def _wait_until_free(self) -> None:
        wait = self._free_at - self.link.monotonic()
        if wait > 0:
            self.link.sleep(wait)

    def _send(self, frame: bytes) -> bool:
        """Send a frame. True if its echo came."""
        try:
            self.link.write(frame)
            self._free_at = self.link.monotonic() + _SPACING_S
            lines = [self.link.read_line(_ECHO_S) for _ in range(5)]
        except ConnectionLost:
            raise
        except MountError:
            self.link.drain(0.05)
            return False
        return lines[0] == frame.decode()


class SketchAxis:
    """One axis behind the sketch."""

    def __init__(self, mount: SketchMount, name: str, number: int) -> None:
        self._mount = mount
        self.name = name
        self.number = number

    def step(self, n: int, *, wait: bool = True) -> None:
        """n steps of about 0.2 s, one after the other, timed by this computer."""
        n = whole_number(n, MOST_STEPS, "steps")
        speed = 255 if n > 0 else -255
        self._mount.begin()
        for _ in range(abs(n)):
            self._mount.pulse(*((speed, 0) if self.number == 1 else (0, speed)))

    def jog(self, speed: float) -> None:
        """Run at speed, -1 … 1 and not 0, until stop(): nothing else stops it. Raises BadValue, and as drive()."""
        duty = jog_duty(speed)
        self._mount.drive(*((duty, 0) if self.number == 1 else (0, duty)))

    def stop(self) -> None:
        """Stop both motors."""
        self._mount.stop()

    @property
    def position(self) -> float:
        """Raises NotSupported."""
        raise NotSupported(f"no position: {LIMITS}")

    def move_to(self, steps: float, *, wait: bool = True) -> None:
        """Raises NotSupported."""
        raise NotSupported(f"no absolute moves: {LIMITS}")
