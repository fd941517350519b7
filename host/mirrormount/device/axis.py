"""One axis of a mount: moves, jogs, homing, limits. Imports encoder, errors, moves, settings, status.

An Axis uses a Session, which keeps its motion alive and orders stops before starts. An interrupt (Ctrl-C, or an
interrupted cell of a notebook) of a method that waits for a motion stops all motors.
"""

import html

from mirrormount.common.errors import BadValue
from mirrormount.common.validation import jog_duty, whole_number, whole_numbers
from mirrormount.device import settings
from mirrormount.device.encoder import Encoded
from mirrormount.device.moves import Progress
from mirrormount.device.status import Homed, Limits, table
from mountfw.settings import MAX_STEPS

_SOFT_LIMITS_CHECKED = 8  # the bit of ZH


class Axis(Encoded):
    """One axis: x (right positive), y (up positive), axis3 … number: the board's. Its settings are properties."""

    __slots__ = ()

    def __repr__(self) -> str:
        """The last status; the board is not asked."""
        last = self._session.board.last
        shown = f"{last[1].by_name[self.name]}, {self._session.age()}" if last else "not seen yet"
        return f"<Axis {self.name}: {shown}>"

    def _repr_html_(self) -> str:
        last = self._session.board.last
        if not last:
            return html.escape(repr(self))
        return table({self.name: last[1].by_name[self.name]}, self._session.age())

    def zero(self, steps: int = 0) -> None:
        """Define the present position as `steps`; from here on it is counted. Raises BadValue as step() does."""
        steps = whole_number(steps, MAX_STEPS, "position")
        self._check_units(*self.ask_whole("SN?"))
        self._session.send(f"{self.number}DH{steps}")

    def home(self, progress: Progress | None = None) -> Homed:
        """Find the home switch (or the end-stop that stands in for it); position 0 is there. Returns when done.

        Raises BoardError (n35: no switch fitted), MoveEnded (n45: switch not found, n46: it did not
        release, n04 or n05: the other end's switch came first), ConnectionLost, NoAnswer.
        """
        with self._session.stopped_by_interrupt():
            self.start_homing()
            self._wait_until_done(None, progress)
        known, millisteps = whole_numbers(self.ask("OR?")[0], 2)
        return Homed(millisteps / 1000 if known else None)

    def start_homing(self) -> None:
        """Start homing and return; the caller keeps it alive, as in Mount.drive(). Raises BoardError."""
        self._seek("OR")

    def find_end_stop(self, direction: int) -> None:
        """Go to the end-stop in direction 1 or -1, and stand at it. Raises as home() does."""
        if isinstance(direction, bool) or direction not in (1, -1):
            raise BadValue(f"an end-stop's direction is 1 or -1, not {direction!r}")
        with self._session.stopped_by_interrupt():
            self._seek("MT+" if direction > 0 else "MT-")
            self._wait_until_done(None)

    @property
    def limits(self) -> Limits:
        """The soft limits, in steps. Settable; raises BadValue if the minimum is above the maximum."""
        low, high, checking = self.ask_whole("SL?", "SR?", "ZH?")
        return Limits(low, high, bool(checking & _SOFT_LIMITS_CHECKED))

    @limits.setter
    def limits(self, limits: Limits) -> None:
        if not isinstance(limits, Limits):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise BadValue(f"soft limits are Limits(minimum, maximum), not {limits!r}")
        if limits.minimum > limits.maximum:
            raise BadValue(
                f"a soft minimum of {limits.minimum} above the maximum of {limits.maximum} forbids everything"
            )
        checking = self.ask_whole("ZH?")[0] & ~_SOFT_LIMITS_CHECKED
        wanted = {
            "soft_minimum": limits.minimum,
            "soft_maximum": limits.maximum,
            "checking": checking | (_SOFT_LIMITS_CHECKED if limits.checked else 0),
        }
        settings.write(self._session, {self.name: wanted})

    @property
    def run_limit_s(self) -> float:
        """How long the board lets one jog or drive run, in seconds (`XM`)."""
        return whole_numbers(self._session.ask(f"{self.number}XM?"), 1)[0] / 1000

    def jog(self, speed: float, *, feed: bool = True) -> None:
        """Run at speed, -1 ... 1 of full duty and not 0, until stop(), a limit, or this program's end.

        The duty comes in steps of 1/255; the nearest is taken. Without feed the caller keeps it alive,
        as in Mount.drive().
        """
        duty = jog_duty(speed)
        a, session = self.number, self._session
        stops = session.gate.last_stop()
        if self.status().moving:  # the present move is superseded
            self.stop()
        run_duty, limit_ms = whole_numbers(session.ask(f"{a}XV?;{a}XM?"), 2, "; ")
        sign = "+" if duty > 0 else "-"
        with session.stopped_by_interrupt():
            # the stored run duty is put back in the same line
            session.start(f"{a}XV{abs(duty)};{a}MV{sign};{a}XV{run_duty}", stops)
            self.expect_end(limit_ms / 1000)
            if feed:
                session.keep_alive.start()

    def stop(self) -> None:
        """End this axis's move soon: a step that is nearly done is finished. Mount.stop() is immediate."""
        self._session.ask(f"{self.number}ST;{self.number}MD?")
        self.wait()

    def _seek(self, command: str) -> None:
        """Start a search for a switch. The search limit bounds the drive time; slow pulses have rests between them."""
        session = self._session
        stops = session.gate.last_stop()
        limit_ms, pulse_us = self.ask_whole("XT?", "XP?")
        slow_us = max(pulse_us // 8, 200)  # a pulse of the search
        longest_s = limit_ms / 1000 * (1 + max(slow_us, 20_000) / slow_us)
        session.start(f"{self.number}{command}", stops)
        self.expect_end(longest_s)
